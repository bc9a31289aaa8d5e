"""Effects between the states and what the sensors show."""

from __future__ import annotations

from math import exp
from typing import ClassVar

import numpy as np

from fits.concealed.effect import ALL, WARM, Effect, Now, State


class SensorLag(Effect):
    """The thermometer reads late. first: tau dy/dt = T - y; cascade: two such, tau/2 each; part: half or so of it
    touches, y = (1 - f) T + f lagged. tau = s."""

    name, subsystem = "sensor_lag", "sensor"
    laws: ClassVar = {"first": WARM, "cascade": WARM, "part": WARM}
    first_guess, most = 0.5, 6.0  # s

    def draw(self, rng: np.random.Generator) -> None:
        self.states = 2 if self.law == "cascade" else 1
        self.share = self.between(rng, "share", 0.6, 0.9) if self.law == "part" else 1.0

    def rates(self, now: Now, own: State) -> State:
        tau = max(self.strength, 1e-3)
        if self.law == "cascade":
            return 2 * (now.T - own[0]) / tau, 2 * (own[0] - own[1]) / tau
        return ((now.T - own[0]) / tau,)

    def sense_temperature(self, now: Now, kelvin: float, own: State) -> float:
        return kelvin + self.share * (own[-1] - now.T)


class SensorDrift(Effect):
    """A sensor's zero wanders, the same way in every recording: s of its range after 100 s (ramp), for ever (warm_up),
    or its gain does, by s after 100 s (gain). One sensor, the thermometer or the one for the displacement."""

    name, subsystem = "sensor_drift", "sensor"
    laws: ClassVar = {"ramp": ALL, "warm_up": ALL, "gain": ALL}
    first_guess, most = 0.02, 0.3

    def draw(self, rng: np.random.Generator) -> None:
        kind = self.plant.kind
        warm = kind == "te" or (kind == "full" and rng.random() < 0.4)
        self.numbers["of_temperature"] = float(warm)
        self.warm, self.sign = warm, float(rng.choice([-1.0, 1.0]))
        self.numbers["sign"] = self.sign
        self.tau = self.between(rng, "tau_s", 20.0, 80.0) if self.law == "warm_up" else 100.0

    def _off(self, t: float, value: float, span: float) -> float:
        grown = 1 - exp(-t / self.tau) if self.law == "warm_up" else t / 100.0
        return value + self.sign * self.strength * grown * (value if self.law == "gain" else span)

    def sense_temperature(self, now: Now, kelvin: float, own: State) -> float:
        return self._off(now.t, kelvin, self.plant.hottest) if self.warm else kelvin

    def sense_displacement(self, now: Now, metre: float, own: State) -> float:
        return metre if self.warm else self._off(now.t, metre, self.plant.travel)
