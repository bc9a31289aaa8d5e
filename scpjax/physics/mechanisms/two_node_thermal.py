"""A second thermal node: wire and polymer, or skin and core, are not at one temperature."""

import jax.numpy as jnp

from scpjax.parameter import Parameter
from scpjax.physics.mechanism import Mechanism, Side, Values, View

SHORTEST = 1e-3  # s: nodes that exchange heat faster than this are one node


class TwoNodeThermal(Mechanism):
    name = "two_node_thermal"
    title = "A second thermal node"
    subsystem = "thermoelectric"
    equation = (
        "(1-f) C_th dT/dt = P - lambda T - g (T - T_2),  f C_th dT_2/dt = g (T - T_2),  g = f (1-f) C_th / tau; "
        "law core: T is felt, T_2 pulls; law wire: T_2 loses the heat, is felt and pulls; "
        "law store: T is felt and pulls"
    )
    source = "lumped two-node conduction: Incropera ch. 5; wire and polymer: thesis 3.3.5"
    says = "The heated part warms first and the rest follows: the actuator is not at one temperature."
    needs = ("thermal",)
    excited_by = "voltage steps, with temperature and displacement recorded together"
    laws = ("core", "wire", "store")
    states = ("second_temperature",)
    parameters = (
        Parameter(
            name="share",
            symbol="f",
            unit="1",
            description="share of the thermal mass in the second node",
            typical=0.5,
            bounds=(0.02, 0.98),
            null=0.5,
            scale="linear",
            spread=0.35,
        ),
        Parameter(
            name="time_constant",
            symbol="τ",
            unit="s",
            description="time constant with which the two nodes come to one temperature",
            typical=0.1,
            bounds=(0.003, 10.0),
            null=0.0,
            spread=2.0,
            time="response",
        ),
    )
    starts = ((0.3, 0.05), (0.6, 0.3))

    def _conductance(self, p: Values, view: View) -> Side:
        tau = jnp.maximum(p.time_constant, SHORTEST)
        exchange = p.share * (1 - p.share) * view.shared["thermal_mass"] / tau
        return jnp.where(p.time_constant > SHORTEST, exchange, 0.0)

    def thermal_mass(self, p: Values, mass: Side) -> Side:
        return mass * jnp.where(p.time_constant > SHORTEST, 1 - p.share, 1.0)

    def _cooling(self, p: Values, view: View) -> Side:
        """Conductance to the room that the second node takes over under law wire."""
        wire = (p.law == 1) & (p.time_constant > SHORTEST)
        return jnp.where(wire, view.shared["conductance"], 0.0)

    def heat(self, p: Values, view: View) -> Side:
        (second,) = view.own
        return self._cooling(p, view) * view.temperature - self._conductance(p, view) * (view.temperature - second)

    def lost(self, p: Values, view: View) -> Side:
        (second,) = view.own
        return self._cooling(p, view) * (second - view.temperature)

    def stored(self, p: Values, view: View) -> Side:
        (second,) = view.own
        own = jnp.where(p.time_constant > SHORTEST, p.share * view.shared["thermal_mass"], 0.0)
        return own * second

    def rates(self, p: Values, view: View) -> tuple[Side, ...]:
        (second,) = view.own
        flow = self._conductance(p, view) * (view.temperature - second) - self._cooling(p, view) * second
        rate = flow / (p.share * view.shared["thermal_mass"])
        return (jnp.where(p.time_constant > SHORTEST, rate, 0.0),)

    def initial(self, p: Values, view: View) -> tuple[Side, ...]:
        return (view.temperature,)

    def actuating_temperature(self, p: Values, view: View, temperature: Side) -> Side:
        second = (p.law != 2) & (p.time_constant > SHORTEST)
        return jnp.where(second, view.own[0], temperature)

    def felt_temperature(self, p: Values, view: View, temperature: Side) -> Side:
        felt = (p.law == 1) & (p.time_constant > SHORTEST)
        return jnp.where(felt, view.own[0], temperature)
