"""Effects that the catalogue does not hold: no name is right for them."""

from __future__ import annotations

from math import exp, pi, sin
from typing import ClassVar

import numpy as np

from fits.concealed.effect import MOVING, WARM, Effect, Now, State
from fits.concealed.plants import FULL_DRIVE


class Outside(Effect):
    """An effect that must be placed, not named."""

    catalogue: ClassVar[bool] = False


class CoilContactLoss(Outside):
    """Coils that touch shield one another, open ones lose more heat: lambda (1 + s x/X)."""

    name, subsystem = "coil_contact_loss", "thermoelectric"
    laws: ClassVar = {"linear": ("full",), "quadratic": ("full",)}
    first_guess, most = 0.3, 2.5

    def heat(self, now: Now, own: State) -> float:
        share = max(now.x, 0.0) / self.plant.travel
        return (
            -self.plant.conductance * now.T * self.strength * (share if self.law == "linear" else 1.5 * share * share)
        )


class Evaporation(Outside):
    """Moist nylon dries as it warms, which takes heat: dw/dt = -w r(T), r doubling every 12 K; at the start of each
    recording s of the heat of half a minute at full power is bound."""

    name, subsystem = "evaporation", "thermoelectric"
    laws: ClassVar = {"drying": ("te", "full")}
    first_guess, most = 0.1, 1.5
    states = 1  # share that has gone

    def draw(self, rng: np.random.Generator) -> None:
        self.tau = self.between(rng, "tau_s", 10.0, 40.0)

    def rates(self, now: Now, own: State) -> State:
        return ((1 - own[0]) * 2 ** ((now.T - 0.7 * self.plant.hottest) / 12.0) / self.tau,)

    def heat(self, now: Now, own: State) -> float:
        bound = self.strength * 30.0 * self.plant.conductance * self.plant.hottest  # J
        return -bound * self.rates(now, own)[0]


class LatentHeat(Outside):
    """A phase that melts about T_m: thermal mass C_th (1 + s exp(-((T - T_m)/w)^2))."""

    name, subsystem = "latent_heat", "thermoelectric"
    laws: ClassVar = {"melting": ("te", "full")}
    first_guess, most = 0.5, 6.0

    def draw(self, rng: np.random.Generator) -> None:
        self.middle = self.between(rng, "melting_share", 0.35, 0.6) * self.plant.hottest
        self.width = self.between(rng, "width_share", 0.05, 0.12) * self.plant.hottest

    def capacity(self, now: Now, joule_per_kelvin: float, own: State) -> float:
        return joule_per_kelvin * (1 + self.strength * exp(-(((now.T - self.middle) / self.width) ** 2)))


class SwitchingFan(Outside):
    """A fan comes on now and then: lambda (1 + s) for a part of every period."""

    name, subsystem = "switching_fan", "thermoelectric"
    laws: ClassVar = {"periodic": ("te", "full", "joint")}
    first_guess, most = 0.2, 1.5

    def draw(self, rng: np.random.Generator) -> None:
        self.time = self.between(rng, "period_s", 14.0, 40.0)
        self.on = self.between(rng, "on_share", 0.35, 0.6) * self.time

    def breaks(self, end: float) -> list[float]:
        starts = np.arange(0.0, end, self.time)
        return [float(t) for t in np.concatenate([starts, starts + self.on]) if 0 < t < end]

    def heat(self, now: Now, own: State) -> float:
        blowing = (now.t + 1e-9) % self.time < self.on
        return -self.plant.conductance * now.T * self.strength if blowing else 0.0


class LooseContact(Outside):
    """A plug that opens and closes: no current for s seconds now and then, which no one wrote down."""

    name, subsystem = "loose_contact", "drive"
    laws: ClassVar = {"dropouts": ("te", "full")}
    first_guess, most = 0.5, 4.0  # s, length of a dropout

    def draw(self, rng: np.random.Generator) -> None:
        self.times = [float(t) for t in np.cumsum(rng.uniform(8.0, 22.0, 12))]

    def _edges(self) -> list[tuple[float, float]]:
        return [(t, t + self.strength) for t in self.times]

    def breaks(self, end: float) -> list[float]:
        return [t for edge in self._edges() for t in edge if 0 < t < end]

    def volts(self, now: Now, u: float, own: State) -> float:
        return 0.0 if any(a <= now.t + 1e-9 < b for a, b in self._edges()) else u


class OrificeDamping(Outside):
    """A dashpot with a small hole: force -c v|v|, c = s k X / (X/tau)^2."""

    name, subsystem = "orifice_damping", "thermomechanical"
    laws: ClassVar = {"quadratic": MOVING}
    first_guess, most = 0.3, 12.0

    def force(self, now: Now, own: State) -> float:
        p = self.plant
        speed = now.v * p.settling / p.travel
        return -self.strength * p.stiffness * p.travel * speed * abs(speed)


class SecondMode(Outside):
    """What it moves hangs on a soft tendon: a mass m_2 = s m swings at f_2 hertz, and its place is measured."""

    name, subsystem = "second_mode", "thermomechanical"
    laws: ClassVar = {"tendon": ("full", "plant")}
    first_guess, most = 0.5, 3.0
    states = 2  # its place and velocity

    def draw(self, rng: np.random.Generator) -> None:
        self.omega = 2 * pi * self.between(rng, "frequency_Hz", 0.15, 0.5)
        self.share = self.between(rng, "damping_share", 0.02, 0.08)

    def _between(self, now: Now, own: State) -> float:
        """Acceleration of the second mass [m/s2]."""
        return self.omega**2 * (now.x - own[0]) + 2 * self.share * self.omega * (now.v - own[1])

    def rates(self, now: Now, own: State) -> State:
        return own[1], self._between(now, own)

    def force(self, now: Now, own: State) -> float:
        return -self.strength * self.plant.mass * self._between(now, own)

    def sense_displacement(self, now: Now, metre: float, own: State) -> float:
        return metre + min(self.strength, 1.0) * (own[0] - metre)


class ScaleRipple(Outside):
    """An encoder whose marks are not even: reading x + s X sin(2 pi x/p)."""

    name, subsystem = "scale_ripple", "sensor"
    laws: ClassVar = {"periodic": MOVING}
    first_guess, most = 0.02, 0.08

    def draw(self, rng: np.random.Generator) -> None:
        self.pitch = self.between(rng, "pitch_share", 0.15, 0.3) * self.plant.travel

    def sense_displacement(self, now: Now, metre: float, own: State) -> float:
        return metre + self.strength * self.plant.travel * sin(2 * pi * metre / self.pitch)


class HeaterPickup(Outside):
    """The thermometer's leads run beside the heater's: reading T + s T_max u/U."""

    name, subsystem = "heater_pickup", "sensor"
    laws: ClassVar = {"in_step": WARM}
    first_guess, most = 0.02, 0.5

    def sense_temperature(self, now: Now, kelvin: float, own: State) -> float:
        return kelvin + self.strength * self.plant.hottest * now.u / FULL_DRIVE


class ClippedThermometer(Outside):
    """Its amplifier nears its rail: beyond a temperature the reading rises by 1 - s of what it should."""

    name, subsystem = "clipped_thermometer", "sensor"
    laws: ClassVar = {"bent": WARM}
    first_guess, most = 0.2, 1.0

    def draw(self, rng: np.random.Generator) -> None:
        self.from_here = self.between(rng, "linear_share", 0.3, 0.55) * self.plant.hottest

    def sense_temperature(self, now: Now, kelvin: float, own: State) -> float:
        return kelvin - self.strength * max(kelvin - self.from_here, 0.0)


class WaveringSupply(Outside):
    """A supply that swings slowly by itself: volts (1 + s sin(2 pi t/p + phase))."""

    name, subsystem = "wavering_supply", "drive"
    laws: ClassVar = {"sine": WARM}
    first_guess, most = 0.05, 0.5

    def draw(self, rng: np.random.Generator) -> None:
        self.pace = 2 * pi / self.between(rng, "period_s", 7.0, 30.0)
        self.phase = self.between(rng, "phase", 0.0, 2 * pi)

    def volts(self, now: Now, u: float, own: State) -> float:
        return u * (1 + self.strength * sin(self.pace * now.t + self.phase))


class Draught(Outside):
    """A coil that moves fans itself: lambda (1 + s |v| tau/X)."""

    name, subsystem = "draught", "thermoelectric"
    laws: ClassVar = {"speed": ("full", "joint")}
    first_guess, most = 1.0, 40.0

    def heat(self, now: Now, own: State) -> float:
        p = self.plant
        return -p.conductance * now.T * self.strength * abs(now.v) * p.settling / p.travel


class StiffGrease(Outside):
    """Grease that thins as it warms: force -c v, c = s k tau 2^(-T/T_half)."""

    name, subsystem = "stiff_grease", "thermomechanical"
    laws: ClassVar = {"thinning": ("full", "joint")}
    first_guess, most = 0.1, 8.0

    def draw(self, rng: np.random.Generator) -> None:
        self.halved = self.between(rng, "halving_share", 0.06, 0.2) * self.plant.hottest

    def force(self, now: Now, own: State) -> float:
        p = self.plant
        return -self.strength * p.stiffness * p.settling * now.v * 2.0 ** (-max(now.T, 0.0) / self.halved)
