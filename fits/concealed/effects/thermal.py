"""Effects in the energy balance."""

from __future__ import annotations

from math import exp, pi, sin
from typing import ClassVar

import numpy as np

from fits.concealed.effect import ALL, WARM, Effect, Now, State


class NonlinearHeatLoss(Effect):
    """Heat is lost faster than in proportion to the temperature.

    radiation: s lambda ((T + T_0)^4 - T_0^4) / (4 T_0^3) (Stefan, Boltzmann); convection: s lambda T (T/T_full)^n,
    n = 1/4 to 1/3 (laminar to turbulent natural convection: Incropera, ch. 9); mixed: forced and natural convection
    together, lambda T ((1 + (s (T/T_full)^(1/4))^3)^(1/3) - 1) (Churchill 1977).
    """

    name, subsystem = "nonlinear_heat_loss", "thermoelectric"
    laws: ClassVar = {"radiation": ALL, "convection": ALL, "mixed": ALL}
    first_guess, most = 0.5, 3.0

    def draw(self, rng: np.random.Generator) -> None:
        if self.law == "convection":
            self.exponent = self.between(rng, "exponent", 0.25, 0.333)

    def heat(self, now: Now, own: State) -> float:
        loss, warm = self.plant.conductance, max(now.T, 0.0)
        if self.law == "radiation":
            room = self.plant.ambient + 273.15
            return -self.strength * loss * ((now.T + room) ** 4 - room**4) / (4 * room**3)
        share = warm / self.plant.hottest
        if self.law == "convection":
            return -self.strength * loss * now.T * share**self.exponent
        return -loss * now.T * ((1 + (self.strength * share**0.25) ** 3) ** (1 / 3) - 1)


class TwoNodeThermal(Effect):
    """Not all of it is at one temperature. s is the time constant of the exchange over that of the cooling.

    core: the heated skin is measured and loses the heat, a core behind it pulls; wire: the wire is heated, the polymer
    around it loses the heat, is measured and pulls; store: the heated part is measured and pulls, another one only
    takes up heat; layers: the skin is measured, two layers behind one another pull.
    """

    name, subsystem = "two_node_thermal", "thermoelectric"
    laws: ClassVar = {"core": ("full", "joint"), "wire": WARM, "store": ALL, "layers": ("full", "joint")}
    first_guess, most = 0.05, 1.5

    def draw(self, rng: np.random.Generator) -> None:
        self.states = 2 if self.law == "layers" else 1
        self.share = self.between(rng, "share", 0.25, 0.6)

    def _exchange(self) -> float:
        """Conductance between the nodes [W/K]."""
        tau = max(self.strength, 1e-4) * self.plant.settling
        return self.share * (1 - self.share) * self.plant.thermal_mass / tau

    def capacity(self, now: Now, joule_per_kelvin: float, own: State) -> float:
        return joule_per_kelvin * (1 - self.share)

    def heat(self, now: Now, own: State) -> float:
        g = self._exchange()
        if self.law == "layers":
            return -2 * g * (now.T - own[0])
        back = self.plant.conductance * now.T if self.law == "wire" else 0.0
        return back - g * (now.T - own[0])

    def rates(self, now: Now, own: State) -> State:
        g, mass = self._exchange(), self.share * self.plant.thermal_mass
        if self.law == "layers":
            first, last = own
            return (4 * g * (now.T - first) - 4 * g * (first - last)) / mass, 4 * g * (first - last) / mass
        lost = self.plant.conductance * own[0] if self.law == "wire" else 0.0
        return ((g * (now.T - own[0]) - lost) / mass,)

    def pulling(self, now: Now, kelvin: float, own: State) -> float:
        if self.law == "store":
            return kelvin
        return 0.5 * (own[0] + own[1]) if self.law == "layers" else own[0]

    def sense_temperature(self, now: Now, kelvin: float, own: State) -> float:
        return own[0] if self.law == "wire" else kelvin


class AmbientDrift(Effect):
    """The room is not at its recorded temperature: s K off after 100 s (ramp), for ever (warm_up, tau), or at the
    crests of a wave (wave, an air conditioner). The same in every recording."""

    name, subsystem = "ambient_drift", "thermoelectric"
    laws: ClassVar = {"ramp": ALL, "warm_up": ALL, "wave": ALL}
    first_guess, most = 1.0, 15.0  # K

    def draw(self, rng: np.random.Generator) -> None:
        self.sign = float(rng.choice([-1.0, 1.0]))
        self.numbers["sign"] = self.sign
        if self.law == "warm_up":
            self.tau = self.between(rng, "tau_s", 15.0, 60.0)
        elif self.law == "wave":
            self.time = self.between(rng, "period_s", 50.0, 160.0)

    def heat(self, now: Now, own: State) -> float:
        if self.law == "ramp":
            off = now.t / 100.0
        elif self.law == "warm_up":
            off = 1 - exp(-now.t / self.tau)
        else:
            off = sin(2 * pi * now.t / self.time)
        return self.plant.conductance * self.sign * self.strength * off


class ThermalCrosstalk(Effect):
    """One actuator warms the other. conduction: s lambda (T_other - T); plume: air warmed by the other arrives later,
    tau dw/dt = T_other - w, heat s lambda w."""

    name, subsystem = "thermal_crosstalk", "thermoelectric"
    laws: ClassVar = {"conduction": ("joint",), "plume": ("joint",)}
    first_guess, most = 0.1, 0.8

    def draw(self, rng: np.random.Generator) -> None:
        self.states = int(self.law == "plume")
        if self.states:
            self.tau = self.between(rng, "tau_s", 1.0, 6.0)

    def heat(self, now: Now, own: State) -> float:
        if self.law == "plume":
            return self.strength * self.plant.conductance * own[0]
        return self.strength * self.plant.conductance * (now.other_T - now.T)

    def rates(self, now: Now, own: State) -> State:
        return ((now.other_T - own[0]) / self.tau,)
