"""A second thermal node: wire and polymer, or skin and core, are not at one temperature."""

from typing import ClassVar

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
        "law sheath: T_2 loses the heat and is felt, T pulls; law store: T is felt and pulls; "
        "law two stores: as store, but q of f C_th goes into T_3, with r tau in the place of tau; "
        "law layers: as core, but f C_th is two layers behind one another, 3/2 g to T_2 and from there 3/4 g to T_3, "
        "and their mean pulls; laws store, mean and two stores, mean: as store and two stores, but what pulls is the "
        "mean of all, (1-f) T + f ((1-q) T_2 + q T_3)"
    )
    source = (
        "lumped two-node conduction: Incropera ch. 5; wire and polymer: thesis 3.3.5; sheath: as a thermowell or a "
        "coating about what is heated, Incropera ch. 3; stores side by side, of several time constants: thermal "
        "networks as of JEDEC JESD51-14 (2010); layers: conduction into a slab by two finite volumes, Patankar (1980) "
        "ch. 4, whose mean is behind a steadily warming skin as T_2 of law core is; mean: a fibre heated from its skin "
        "contracts by the mean over its section, and however heat spreads in it, it is from the skin as stores side "
        "by side (Foster's network, JESD51-14), with the same mean, as the heat in them is the same"
    )
    says = "The heated part warms first and the rest follows: the actuator is not at one temperature."
    needs = ("thermal",)
    excited_by = "voltage steps, with temperature and displacement recorded together"
    laws = ("core", "wire", "store", "two stores", "layers", "sheath", "store, mean", "two stores, mean")
    only_under: ClassVar[dict[str, tuple[int, ...]]] = dict.fromkeys(("slow_part", "slow_ratio"), (3, 7))
    law_needs: ClassVar[dict[int, tuple[str, ...]]] = dict.fromkeys((6, 7), ("mechanical",))
    states = ("second_temperature", "third_temperature")
    parameters = (
        Parameter(
            name="share",
            symbol="f",
            unit="1",
            description="share of the thermal mass in the second node (laws two stores, layers: in both together)",
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
        Parameter(
            name="slow_part",
            symbol="q",
            unit="1",
            description="part of what both stores hold that is in the slower one (law two stores)",
            typical=0.5,
            bounds=(0.02, 0.98),
            null=0.5,
            scale="linear",
            spread=0.35,
        ),
        Parameter(
            name="slow_ratio",
            symbol="r",
            unit="1",
            description="time constant of the slower store over that of the other (law two stores)",
            typical=6.0,
            bounds=(1.5, 100.0),
            null=6.0,
            spread=1.0,
        ),
    )
    starts = ((0.3, 0.05, 0.5, 6.0), (0.6, 0.3, 0.5, 10.0))

    def _held(self, p: Values, view: View) -> tuple[Side, Side]:
        """Thermal masses of the second and the third node."""
        both = jnp.where(p.time_constant > SHORTEST, p.share * view.shared["thermal_mass"], 0.0)
        slow = jnp.where((p.law == 3) | (p.law == 7), p.slow_part, jnp.where(p.law == 4, 0.5, 0.0))
        return both * (1 - slow), both * slow

    def _nearing(self, p: Values, view: View) -> tuple[Side, Side]:
        """What the second and the third node warm [K/s] for coming to the temperature of the first one, or layer."""
        tau = jnp.maximum(p.time_constant, SHORTEST) / (1 - p.share)
        second, third = (jnp.where(p.time_constant > SHORTEST, view.temperature - t, 0.0) / tau for t in view.own)
        layers, onward = p.law == 4, 1.5 * (third - second)
        return (
            jnp.where(layers, 3.0 * second - onward, second),
            jnp.where(layers, onward, third / p.slow_ratio),
        )

    def thermal_mass(self, p: Values, mass: Side) -> Side:
        return mass * jnp.where(p.time_constant > SHORTEST, 1 - p.share, 1.0)

    def _cooling(self, p: Values, view: View) -> Side:
        """Conductance to the room that the second node takes over where it is the outer one."""
        return jnp.where(_is_outer(p), view.shared["conductance"], 0.0)

    def heat(self, p: Values, view: View) -> Side:
        taken = [m * rate for m, rate in zip(self._held(p, view), self._nearing(p, view), strict=True)]
        return self._cooling(p, view) * view.temperature - taken[0] - taken[1]

    def lost(self, p: Values, view: View) -> Side:
        return self._cooling(p, view) * (view.own[0] - view.temperature)

    def stored(self, p: Values, view: View) -> Side:
        second, third = (m * t for m, t in zip(self._held(p, view), view.own, strict=True))
        return second + third

    def rates(self, p: Values, view: View) -> tuple[Side, ...]:
        second, third = self._nearing(p, view)
        cooled = self._cooling(p, view) * view.own[0] / (p.share * view.shared["thermal_mass"])
        return second - cooled, third

    def initial(self, p: Values, view: View) -> tuple[Side, ...]:
        return (view.temperature, view.temperature)

    def actuating_temperature(self, p: Values, view: View, temperature: Side) -> Side:
        second, third = view.own
        inner = jnp.where(p.law == 4, 0.5 * (second + third), second)
        held = jnp.where(p.law == 7, second + p.slow_part * (third - second), second)
        pulls = jnp.where(p.law >= 6, temperature + p.share * (held - temperature), inner)
        heated = (p.law == 2) | (p.law == 3) | (p.law == 5)  # the node that is heated pulls, as without a second one
        return jnp.where(heated | (p.time_constant <= SHORTEST), temperature, pulls)

    def felt_temperature(self, p: Values, view: View, temperature: Side) -> Side:
        return jnp.where(_is_outer(p), view.own[0], temperature)


def _is_outer(p: Values) -> Side:
    """Whether the second node is about the first one: laws wire and sheath."""
    return ((p.law == 1) | (p.law == 5)) & (p.time_constant > SHORTEST)
