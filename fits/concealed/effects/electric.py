"""Effects between the recorded voltage and the power in the wire."""

from __future__ import annotations

from math import exp
from typing import ClassVar

import numpy as np

from fits.concealed.effect import ALL, Effect, Now, State
from fits.concealed.plants import FULL_DRIVE


class SupplySag(Effect):
    """The supply gives less than it is told, the more so the more current is drawn.

    quadratic: V_w = V (1 - s V/V_max), a source that folds back; battery: V_w = V - w, tau dw/dt = s V - w, the
    polarisation of a cell (Thevenin model: Plett, Battery Management Systems I, ch. 2); rail: both actuators of a joint
    hang on one source, V_w = V - s (V + V_other) V/V_max.
    """

    name, subsystem = "supply_sag", "drive"
    laws: ClassVar = {"quadratic": ALL, "battery": ALL, "rail": ("joint",)}
    first_guess, most = 0.1, 0.45

    def draw(self, rng: np.random.Generator) -> None:
        self.states = int(self.law == "battery")
        if self.states:
            self.tau = self.between(rng, "tau_s", 4.0, 25.0)

    def volts(self, now: Now, u: float, own: State) -> float:
        if self.law == "battery":
            return u * (1 - own[0]) if u > 0 else 0.0
        if self.law == "rail":
            return u * (1 - self.strength * (u + now.other_u) / FULL_DRIVE)
        return u * (1 - self.strength * u / FULL_DRIVE)

    def rates(self, now: Now, own: State) -> State:
        return ((self.strength * now.u / FULL_DRIVE - own[0]) / self.tau,)


class InputDelay(Effect):
    """The drive comes late. pure: V(t - s); compartments: through n equal lags of s/n each (Erlang, near to a pure
    delay for many: MacDonald, Biological Delay Systems, ch. 2)."""

    name, subsystem = "input_delay", "drive"
    laws: ClassVar = {"pure": ALL, "compartments": ALL}
    first_guess, most = 0.3, 2.5  # s

    def draw(self, rng: np.random.Generator) -> None:
        self.states = 24 if self.law == "compartments" else 0

    def dead_time(self) -> float:
        return self.strength if self.law == "pure" else 0.0

    def volts(self, now: Now, u: float, own: State) -> float:
        return own[-1] if self.states and self.strength > 0 else u

    def rates(self, now: Now, own: State) -> State:
        if not self.states:
            return ()
        speed = self.states / max(self.strength, 1e-3)
        return tuple(speed * (a - b) for a, b in zip((now.u, *own[:-1]), own, strict=True))


class DriveDeadZone(Effect):
    """Small drives do nothing. subtract: what exceeds v0; cut: all of it above v0, nothing below; soft: a gate that
    opens about v0, V (1 - exp(-(V/v0)^4)). v0 = s V_max."""

    name, subsystem = "drive_dead_zone", "drive"
    laws: ClassVar = {"subtract": ALL, "cut": ALL, "soft": ALL}
    first_guess, most = 0.1, 0.6

    def volts(self, now: Now, u: float, own: State) -> float:
        v0 = self.strength * FULL_DRIVE
        if v0 <= 0 or u <= 0:
            return u
        if self.law == "subtract":
            return max(0.0, u - v0)
        if self.law == "cut":
            return u if u > v0 else 0.0
        return u * (1 - exp(-((u / v0) ** 4)))


class ResistanceTemperature(Effect):
    """The wire's resistance rises as it warms. linear: 1 + a T (copper's a is 0.0039 / K); quadratic: 1 + a T + b T^2
    with b = a^2 / 5, as nickel; exponential: exp(a T)."""

    name, subsystem = "resistance_temperature", "thermoelectric"
    laws: ClassVar = {"linear": ALL, "quadratic": ALL, "exponential": ALL}
    first_guess, most = 0.002, 0.012  # 1/K

    def resistance(self, now: Now, ohm: float, own: State) -> float:
        at = self.strength * now.T
        if self.law == "exponential":
            return ohm * exp(min(at, 3.0))
        return ohm * (1 + at + (0.2 * at * at if self.law == "quadratic" else 0.0))
