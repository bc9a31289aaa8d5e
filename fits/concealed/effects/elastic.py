"""Effects in the force balance that depend on where the actuator is now."""

from __future__ import annotations

from math import exp, sin, tanh
from typing import ClassVar

import numpy as np

from fits.concealed.effect import MOVING, Effect, Now, State


class NonlinearThermalForce(Effect):
    """The pull is not in proportion to the temperature. quadratic: C T (1 + s T/T_full); power: C T (T/T_full)^s;
    saturating: C T_s tanh(T/T_s), T_s = T_full / s."""

    name, subsystem = "nonlinear_thermal_force", "thermomechanical"
    laws: ClassVar = {"quadratic": MOVING, "power": MOVING, "saturating": MOVING}
    first_guess, most = 0.2, 1.2

    def pull(self, now: Now, newton: float, own: State) -> float:
        share = newton / (self.plant.coefficient * self.plant.hottest)
        if self.law == "quadratic":
            return newton * (1 + self.strength * share)
        if self.law == "power":
            return newton * max(share, 1e-9) ** self.strength
        s = max(self.strength, 1e-6)
        return self.plant.coefficient * self.plant.hottest / s * tanh(share * s)


class ThermalSoftening(Effect):
    """The warm polymer is softer. linear: k (1 - s T/T_full); glass: k (1 - s g), g from 0 to 1 about a transition
    (Ward, Sweeney, Mechanical Properties of Solid Polymers, ch. 5); exponential: k exp(-s T/T_full)."""

    name, subsystem = "thermal_softening", "thermomechanical"
    laws: ClassVar = {"linear": MOVING, "glass": MOVING, "exponential": MOVING}
    first_guess, most = 0.2, 0.75

    def draw(self, rng: np.random.Generator) -> None:
        if self.law == "glass":
            self.middle = self.between(rng, "transition_K", 0.3, 0.5) * self.plant.hottest
            self.width = self.between(rng, "width_K", 0.1, 0.25) * self.plant.hottest
            self.numbers |= {"transition_K": round(self.middle, 2), "width_K": round(self.width, 2)}

    def spring(self, now: Now, newton: float, metre: float, own: State) -> float:
        share = now.T / self.plant.hottest
        if self.law == "linear":
            return newton * max(1 - self.strength * share, 0.05)
        if self.law == "exponential":
            return newton * exp(-self.strength * share)
        grown = tanh((now.T - self.middle) / self.width) + tanh(self.middle / self.width)
        return newton * (1 - self.strength * grown / (1 + tanh(self.middle / self.width)))


class NonlinearStiffness(Effect):
    """The spring stiffens as it moves. cubic: k x (1 + s (x/X)^2); exponential: k X/s (exp(s x/X) - 1) (Fung);
    limited: k x / (1 - s x/X / 2) (a chain near its full length). X is the travel. Even in x but for the sign, where
    the law is odd: the joint's two springs are pre-stretched alike."""

    name, subsystem = "nonlinear_stiffness", "thermomechanical"
    laws: ClassVar = {"cubic": MOVING, "exponential": ("full", "plant"), "limited": ("full", "plant")}
    first_guess, most = 0.2, 1.6

    def spring(self, now: Now, newton: float, metre: float, own: State) -> float:
        share = metre / self.plant.travel
        s = max(self.strength, 1e-6)
        if self.law == "cubic":
            return newton * (1 + s * share * share)
        if self.law == "exponential":
            return self.plant.stiffness * self.plant.travel / s * (exp(min(s * share, 30.0)) - 1)
        return newton / max(1 - 0.5 * s * share, 0.05)


class Slack(Effect):
    """The tendon must be taut before anything moves: gap s X. sharp: the pull beyond k gap; toe: taken up gradually,
    z^2/(4 gap) up to 2 gap (fibres that straighten one after another)."""

    name, subsystem = "slack", "thermomechanical"
    laws: ClassVar = {"sharp": MOVING, "toe": MOVING}
    first_guess, most = 0.05, 0.45

    def pull(self, now: Now, newton: float, own: State) -> float:
        gap = self.strength * self.plant.travel * self.plant.stiffness
        if gap <= 0:
            return newton
        if self.law == "sharp":
            return max(0.0, newton - gap)
        return newton - gap if newton > 2 * gap else max(newton, 0.0) ** 2 / (4 * gap)


class AntagonistLoad(Effect):
    """What it pulls against is more than its own spring. engaging: another spring, s k, from x_0 on; lifting: a weight
    that leaves its support bit by bit, s k X (1 - exp(-x/x_0)); pendulum: a link that the joint raises
    from an angle a_0, s k X (sin(a + a_0) - sin a_0)."""

    name, subsystem = "antagonist_load", "thermomechanical"
    laws: ClassVar = {"engaging": ("full", "plant"), "lifting": ("full", "plant"), "pendulum": ("joint",)}
    first_guess, most = 0.2, 3.0

    def draw(self, rng: np.random.Generator) -> None:
        if self.law == "pendulum":
            self.angle = self.between(rng, "from_rad", 0.7, 1.2)
        else:
            self.start = self.between(rng, "from_share", 0.2, 0.45) * self.plant.travel

    def force(self, now: Now, own: State) -> float:
        k, travel = self.plant.stiffness, self.plant.travel
        if self.law == "engaging":
            return -self.strength * k * max(0.0, now.x - self.start)
        if self.law == "lifting":
            return -self.strength * k * travel * (1 - exp(-max(now.x, -self.start) / self.start))
        if now.side == 1:  # there is one link
            return 0.0
        return -self.strength * k * travel * (sin(now.x / self.plant.radius + self.angle) - sin(self.angle))
