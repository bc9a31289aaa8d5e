"""Effects of the catalogue under laws that the library does not hold: is the effect still named, and nothing else?

Each takes what it does not say otherwise from the effect that it belongs to. Chosen from the literature before the
engine was run on any of them; `HELD` are those that the library holds all the same.
"""

from __future__ import annotations

from math import atan, exp, log, log1p, pi, tan, tanh
from typing import ClassVar

import numpy as np

from fits.concealed.effect import ALL, MOVING, WARM, Now, State
from fits.concealed.effects import elastic, electric, memory, sensing, thermal
from fits.concealed.plants import FULL_DRIVE

HELD = frozenset(
    {
        ("input_delay", "three lags"),
        ("fatigue", "Arrhenius"),
        ("thermal_crosstalk", "radiation"),
        ("two_node_thermal", "two stores"),
    }
)
"""Effects and laws that the library holds: the law spread of a dead time, which is three lags with a share of 1, was
there when these were chosen, and the others were added since. They are no test of foreign laws."""


class Recruitment(elastic.NonlinearThermalForce):
    """Fibres come to pull one after another as they warm: C ((1 - s) T + s T_full g), g a logistic about the middle
    of the range, 0 at T = 0 and 1 at T_full."""

    laws: ClassVar = {"logistic": MOVING}
    most = 0.8

    def pull(self, now: Now, newton: float, own: State) -> float:
        def logistic(x: float) -> float:
            return 1 / (1 + exp(-(x - 0.5) / 0.12))

        full = self.plant.coefficient * self.plant.hottest
        grown = (logistic(newton / full) - logistic(0.0)) / (logistic(1.0) - logistic(0.0))
        return newton + self.strength * (full * grown - newton)


class RampSoftening(elastic.ThermalSoftening):
    """As stiff as cold up to T_0, then softer in proportion: k (1 - s (T - T_0)/(T_full - T_0))."""

    laws: ClassVar = {"ramp": MOVING}

    def draw(self, rng: np.random.Generator) -> None:
        self.start = self.between(rng, "from_share", 0.2, 0.4) * self.plant.hottest

    def spring(self, now: Now, newton: float, metre: float, own: State) -> float:
        share = max(0.0, now.T - self.start) / (self.plant.hottest - self.start)
        return newton * max(1 - self.strength * share, 0.05)


class TangentStiffness(elastic.NonlinearStiffness):
    """k X/s tan(s x/X): a helix that is pulled out."""

    laws: ClassVar = {"tangent": MOVING}
    most = 1.2

    def spring(self, now: Now, newton: float, metre: float, own: State) -> float:
        s = max(self.strength, 1e-6)
        angle = max(-1.5, min(1.5, s * metre / self.plant.travel))
        return self.plant.stiffness * self.plant.travel / s * tan(angle)


class RoundedSlack(elastic.Slack):
    """The tendon straightens as it comes taut: w ln(1 + exp((F - g)/w)) with w = g/3, less what that is at F = 0."""

    laws: ClassVar = {"rounded": MOVING}

    def pull(self, now: Now, newton: float, own: State) -> float:
        gap = self.strength * self.plant.travel * self.plant.stiffness
        if gap <= 0:
            return newton
        w = gap / 3
        x = (newton - gap) / w
        return w * ((x if x > 30 else log1p(exp(x))) - log1p(exp(-3.0)))


class GasSpring(elastic.AntagonistLoad):
    """A closed volume that is pressed together: s k X ((1 - x/L)^-1.4 - 1), L = 2 X."""

    laws: ClassVar = {"gas spring": ("full", "plant")}

    def draw(self, rng: np.random.Generator) -> None:
        self.length = 2.0 * self.plant.travel

    def force(self, now: Now, own: State) -> float:
        left = max(1 - now.x / self.length, 0.1)
        return -self.strength * self.plant.stiffness * self.plant.travel * (left**-1.4 - 1)


class SourceResistance(electric.SupplySag):
    """A resistance before the wire that carries the mean current of both duties: V/(1 + s V/V_max)."""

    laws: ClassVar = {"source resistance": ALL}
    most = 0.8

    def draw(self, rng: np.random.Generator) -> None:
        self.states = 0

    def volts(self, now: Now, u: float, own: State) -> float:
        return u / (1 + self.strength * u / FULL_DRIVE)

    def rates(self, now: Now, own: State) -> State:
        return ()


class FewCompartments(electric.InputDelay):
    """Through three equal lags of s/3 each: a filter rather than a delay."""

    laws: ClassVar = {"three lags": ALL}

    def draw(self, rng: np.random.Generator) -> None:
        self.states = 3


class RoundedDeadZone(electric.DriveDeadZone):
    """V - v0 tanh(V/v0): a transistor that opens gradually."""

    laws: ClassVar = {"rounded": ALL}

    def volts(self, now: Now, u: float, own: State) -> float:
        v0 = self.strength * FULL_DRIVE
        return u - v0 * tanh(u / v0) if v0 > 0 else u


class SaturatingResistance(electric.ResistanceTemperature):
    """1 + a T/(1 + T/(2 T_full)): an alloy that flattens out."""

    laws: ClassVar = {"flattening": ALL}

    def resistance(self, now: Now, ohm: float, own: State) -> float:
        return ohm * (1 + self.strength * now.T / (1 + max(now.T, 0.0) / (2 * self.plant.hottest)))


class Backlash(memory.Hysteresis):
    """One play on the temperature: the whole share s comes late by the same width."""

    laws: ClassVar = {"backlash": MOVING}

    def draw(self, rng: np.random.Generator) -> None:
        self.states = 1
        self.widths = [self.between(rng, "width_share", 0.08, 0.25) * self.plant.hottest]

    def pull(self, now: Now, newton: float, own: State) -> float:
        return newton + self.plant.coefficient * self.strength * (own[0] - now.T)

    def rates(self, now: Now, own: State) -> State:
        (w,) = self.widths
        return ((max(now.T - w - own[0], 0.0) + min(now.T + w - own[0], 0.0)) / memory.LAG,)


class SoftFriction(memory.Friction):
    """A lubricated guide: s k X (2/pi) atan(v/v_s), which grows over a wide range of velocities."""

    laws: ClassVar = {"arctangent": MOVING}

    def draw(self, rng: np.random.Generator) -> None:
        self.slow = self.between(rng, "slow_m_per_s", 1e-5, 5e-5)

    def force(self, now: Now, own: State) -> float:
        size = self.strength * self.plant.stiffness * self.plant.travel
        return -size * 2 / pi * atan(now.v / self.slow)

    def rates(self, now: Now, own: State) -> State:
        return ()


class StrainCreep(memory.Creep):
    """Retarded the more the further it has gone (strain hardening): tau dc/dt = (s e - c) / (1 + (c/(s X))^2 * 3)."""

    laws: ClassVar = {"strain hardening": MOVING}

    def draw(self, rng: np.random.Generator) -> None:
        self.states, self.tau = 1, self.between(rng, "tau_s", 5.0, 25.0)

    def rates(self, now: Now, own: State) -> State:
        gone = own[0] / (max(self.strength, 1e-6) * self.plant.travel)
        return ((self.strength * (now.x - own[0]) - own[0]) / (self.tau * (1 + 3 * gone * gone)),)


class ArrheniusFatigue(memory.Fatigue):
    """Ages by Arrhenius' law: dD/dt = exp(8 (T - T_full)/(T + 300 K)) (1 - D)/tau."""

    laws: ClassVar = {"Arrhenius": MOVING}

    def draw(self, rng: np.random.Generator) -> None:
        self.tau = self.between(rng, "tau_s", 15.0, 60.0)

    def rates(self, now: Now, own: State) -> State:
        rate = exp(8 * (now.T - self.plant.hottest) / max(now.T + 300.0, 100.0))
        return (rate * (1 - own[0]) / self.tau,)


class TwoPathLag(sensing.SensorLag):
    """Heat reaches the thermometer by two ways, a quick one (0.4 tau) and a slow one (3 tau), half each."""

    laws: ClassVar = {"two ways": WARM}

    def draw(self, rng: np.random.Generator) -> None:
        self.states = 2

    def rates(self, now: Now, own: State) -> State:
        tau = max(self.strength, 1e-3)
        return (now.T - own[0]) / (0.4 * tau), (now.T - own[1]) / (3 * tau)

    def sense_temperature(self, now: Now, kelvin: float, own: State) -> float:
        return kelvin + 0.5 * (own[0] + own[1]) - now.T


class LogarithmicDrift(sensing.SensorDrift):
    """The zero wanders as log(1 + t/t_0), scaled to s of the range after 100 s."""

    laws: ClassVar = {"logarithmic": ALL}

    def draw(self, rng: np.random.Generator) -> None:
        super().draw(rng)
        self.first = self.between(rng, "t0_s", 3.0, 12.0)

    def _off(self, t: float, value: float, span: float) -> float:
        grown = log(1 + max(t, 0.0) / self.first) / log(1 + 100.0 / self.first)
        return value + self.sign * self.strength * grown * span


class OnsetOfConvection(thermal.NonlinearHeatLoss):
    """More is lost once the air begins to move: s lambda (T - T_0) beyond T_0."""

    laws: ClassVar = {"onset": ALL}

    def draw(self, rng: np.random.Generator) -> None:
        self.start = self.between(rng, "from_share", 0.15, 0.4) * self.plant.hottest

    def heat(self, now: Now, own: State) -> float:
        return -self.strength * self.plant.conductance * max(0.0, now.T - self.start)


class SlowAndQuickStores(thermal.TwoNodeThermal):
    """Two parts only take up heat, one five times slower than the other; the heated one is measured and pulls."""

    laws: ClassVar = {"two stores": ALL}

    def draw(self, rng: np.random.Generator) -> None:
        self.states, self.share = 2, self.between(rng, "share", 0.25, 0.5)

    def _exchanges(self) -> tuple[float, float]:
        quick = self._exchange() / 2
        return quick, quick / 5

    def heat(self, now: Now, own: State) -> float:
        return -sum(g * (now.T - node) for g, node in zip(self._exchanges(), own, strict=True))

    def rates(self, now: Now, own: State) -> State:
        mass = self.share * self.plant.thermal_mass / 2
        return tuple(g * (now.T - node) / mass for g, node in zip(self._exchanges(), own, strict=True))

    def pulling(self, now: Now, kelvin: float, own: State) -> float:
        return kelvin

    def sense_temperature(self, now: Now, kelvin: float, own: State) -> float:
        return kelvin


class Gust(thermal.AmbientDrift):
    """A door is opened once: s K off at t_0, and a bell about it."""

    laws: ClassVar = {"bell": ALL}

    def draw(self, rng: np.random.Generator) -> None:
        self.sign = float(rng.choice([-1.0, 1.0]))
        self.numbers["sign"] = self.sign
        self.at = self.between(rng, "at_s", 30.0, 80.0)
        self.width = self.between(rng, "width_s", 10.0, 25.0)

    def heat(self, now: Now, own: State) -> float:
        off = exp(-0.5 * ((now.t - self.at) / self.width) ** 2)
        return self.plant.conductance * self.sign * self.strength * off


class RadiantCrosstalk(thermal.ThermalCrosstalk):
    """One shines on the other: s lambda ((T_other + T_0)^4 - (T + T_0)^4)/(4 T_0^3)."""

    laws: ClassVar = {"radiation": ("joint",)}

    def draw(self, rng: np.random.Generator) -> None:
        self.states = 0

    def heat(self, now: Now, own: State) -> float:
        room = self.plant.ambient + 273.15
        shone = ((now.other_T + room) ** 4 - (now.T + room) ** 4) / (4 * room**3)
        return self.strength * self.plant.conductance * shone

    def rates(self, now: Now, own: State) -> State:
        return ()
