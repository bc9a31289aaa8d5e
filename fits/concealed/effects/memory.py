"""Effects in the force balance that depend on what went before."""

from __future__ import annotations

from math import exp, sinh, tanh
from typing import ClassVar

import numpy as np

from fits.concealed.effect import MOVING, Effect, Now, State

LAG = 0.02  # s, with which a play or a stop follows: rate-independent as far as a thermal actuator can tell


class Hysteresis(Effect):
    """Heating and cooling take different ways; s is the share of the force that does.

    plays: C (1 - s) T + C s sum w_i P_i[T], plays of several widths (Prandtl, Ishlinskii: Krasnosel'skii, Pokrovskii,
    Systems with Hysteresis); duhem: C (T - s z), dz/dt = |dT/dt| (sign(dT/dt) - z/z_0) (Coleman, Hodgdon 1986);
    stops: elastic elements that slip at different forces on the displacement (Iwan 1966); bouc_wen: one element,
    dz/dt = v (1 - |z/z_0|^n (1 + sign(v z))/2) (Ismail et al. 2009).
    """

    name, subsystem = "hysteresis", "thermomechanical"
    laws: ClassVar = {"plays": MOVING, "duhem": MOVING, "stops": MOVING, "bouc_wen": MOVING}
    first_guess, most = 0.15, 0.8

    def draw(self, rng: np.random.Generator) -> None:
        widest = self.between(rng, "width_share", 0.12, 0.35)
        across = self.plant.hottest if self.law in ("plays", "duhem") else self.plant.travel
        if self.law in ("plays", "stops"):
            self.states = 4
            self.widths = [widest * across * f for f in (0.2, 0.45, 0.7, 1.0)]
            shares = np.sort(rng.uniform(0.5, 1.5, 4))[::-1]
            self.shares = [float(x) for x in shares / shares.sum()]
        else:
            self.states, self.width = 1, widest * across
            self.power = self.between(rng, "sharpness", 1.0, 3.0) if self.law == "bouc_wen" else 1.0

    def pull(self, now: Now, newton: float, own: State) -> float:
        if self.law == "plays":
            mean = sum(a * w for a, w in zip(self.shares, own, strict=True))
            return newton + self.plant.coefficient * self.strength * (mean - now.T)
        return newton - self.plant.coefficient * self.strength * own[0] if self.law == "duhem" else newton

    def force(self, now: Now, own: State) -> float:
        scale = self.strength * self.plant.stiffness * 2.0
        if self.law == "stops":
            return -scale * sum(a * z for a, z in zip(self.shares, own, strict=True))
        return -scale * own[0] if self.law == "bouc_wen" else 0.0

    def rates(self, now: Now, own: State) -> State:
        if self.law == "plays":
            return tuple(
                (max(now.T - w - r, 0.0) + min(now.T - w + r, 0.0)) / LAG for w, r in zip(own, self.widths, strict=True)
            )
        if self.law == "duhem":
            return (now.dT - abs(now.dT) * own[0] / self.width,)
        if self.law == "stops":
            return tuple(
                now.v - (max(z - r, 0.0) + min(z + r, 0.0)) / LAG for z, r in zip(own, self.widths, strict=True)
            )
        z = own[0] / self.width
        return (now.v * (1 - abs(z) ** self.power) if now.v * z > 0 else now.v,)


class Friction(Effect):
    """Dry friction of s k X. coulomb: F tanh(v/v_s); stribeck: more of it at rest, (F + 0.5 F exp(-(v/v_b)^2));
    dahl: a spring that slips, dz/dt = v (1 - sigma z sign(v)/F) (Dahl 1968)."""

    name, subsystem = "friction", "thermomechanical"
    laws: ClassVar = {"coulomb": MOVING, "stribeck": MOVING, "dahl": MOVING}
    first_guess, most = 0.05, 0.5

    def draw(self, rng: np.random.Generator) -> None:
        self.slow = 1e-5  # m/s
        self.states = int(self.law == "dahl")
        if self.law == "stribeck":
            self.band = self.between(rng, "stribeck_m_per_s", 2e-4, 1e-3)
        if self.law == "dahl":
            self.before = self.between(rng, "presliding_share", 0.01, 0.03) * self.plant.travel

    def force(self, now: Now, own: State) -> float:
        size = self.strength * self.plant.stiffness * self.plant.travel
        if self.law == "dahl":
            return -size * own[0]
        if self.law == "stribeck":
            size *= 1 + 0.5 * exp(-((now.v / self.band) ** 2))
        return -size * tanh(now.v / self.slow)

    def rates(self, now: Now, own: State) -> State:
        return ((now.v - abs(now.v) * own[0]) / self.before,)


class Creep(Effect):
    """The polymer gives way slowly: the spring feels x - c; s is the share that comes late.

    kelvin_voigt: tau dc/dt = s e - c, e = x - c; two_branches: another, five times slower; logarithmic: thermally
    activated flow, dc/dt = (c_0/tau) sinh((s e - c)/c_0) (Eyring 1936), which goes as log t; power: four branches
    spread over two decades, about t^n (Findley 1944); recovery: comes back more slowly than it went, by a factor.
    """

    name, subsystem = "creep", "thermomechanical"
    laws: ClassVar = dict.fromkeys(("kelvin_voigt", "logarithmic", "two_branches", "recovery", "power"), MOVING)
    first_guess, most = 0.15, 1.5

    def draw(self, rng: np.random.Generator) -> None:
        self.states = {"two_branches": 2, "power": 4}.get(self.law, 1)
        first = self.between(rng, "tau_s", 8.0, 40.0)
        self.taus = {
            "two_branches": [0.4 * first, 2 * first],
            "power": [first * f for f in (0.05, 0.25, 1.2, 6.0)],
        }.get(self.law, [first])
        self.shares = {"two_branches": [0.5, 0.5], "power": [0.2, 0.24, 0.27, 0.29]}.get(self.law, [1.0])
        self.small = self.between(rng, "activation_share", 0.03, 0.1) if self.law == "logarithmic" else 0.0
        self.slower = self.between(rng, "recovery_ratio", 1.8, 4.0) if self.law == "recovery" else 1.0

    def stretch(self, now: Now, metre: float, own: State) -> float:
        return metre - sum(own)

    def rates(self, now: Now, own: State) -> State:
        e = now.x - sum(own)
        if self.law == "logarithmic":
            small = self.small * self.strength * self.plant.travel + 1e-9
            drive = (self.strength * e - own[0]) / small
            return (small / self.taus[0] * sinh(max(min(drive, 25.0), -25.0)),)
        gaps = [self.strength * a * e - c for a, c in zip(self.shares, own, strict=True)]
        slower = self.slower if self.law == "recovery" and gaps[0] < 0 else 1.0
        return tuple(g / (t * slower) for g, t in zip(gaps, self.taus, strict=True))


class Fatigue(Effect):
    """It pulls less the longer it has worked: C (1 - s D), D from 0 at the start of each recording towards 1.

    dose: dD/dt = (T/T_full)^2 (1 - D)/tau, as thermal ageing; path: dD/dt = |v|/L, distance worked; linear: a constant
    rate while it is warmer than a third of T_full.
    """

    name, subsystem = "fatigue", "thermomechanical"
    laws: ClassVar = {"dose": MOVING, "path": MOVING, "linear": MOVING}
    first_guess, most = 0.2, 0.9
    states = 1

    def draw(self, rng: np.random.Generator) -> None:
        if self.law == "path":
            self.path = self.between(rng, "travels", 6.0, 20.0) * self.plant.travel
        else:
            self.tau = self.between(rng, "tau_s", 30.0, 150.0)

    def pull(self, now: Now, newton: float, own: State) -> float:
        return newton * (1 - self.strength * own[0])

    def rates(self, now: Now, own: State) -> State:
        share = max(now.T, 0.0) / self.plant.hottest
        if self.law == "dose":
            return (share * share * (1 - own[0]) / self.tau,)
        if self.law == "path":
            return (abs(now.v) / self.path * (1 - own[0]),)
        return (0.5 * (1 + tanh((share - 0.33) / 0.05)) / (3 * self.tau) * (1 - own[0]),)
