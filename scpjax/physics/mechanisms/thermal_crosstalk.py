"""Two actuators of a joint that warm each other."""

from typing import ClassVar

import jax.numpy as jnp

from scpjax.parameter import Parameter
from scpjax.physics.mechanism import Mechanism, Side, Values, View


class ThermalCrosstalk(Mechanism):
    name = "thermal_crosstalk"
    title = "The two actuators warm each other"
    subsystem = "thermoelectric"
    equation = (
        "C_th dT_1/dt = P_1 - lambda_1 T_1 - g lambda (T_1 - T_2), and the same for 2; lambda: mean of both;  "
        "law delayed: T_1 - a_1 in place of T_1 - T_2, tau da_1/dt = T_2 - a_1;  law radiation: "
        "((T_0 + T_1)^4 - (T_0 + T_2)^4)/(4 T_0^3) in place of T_1 - T_2, T_0: ambient;  law frame: T_1 - a in place "
        "of T_1 - T_2, tau da/dt = (T_1 + T_2)/2 - a;  law plume: + g lambda (1 - b) T_2 for 1, + g lambda (1 + b) T_1 "
        "for 2;  law free convection: of a plume, T ((T^2 + 1 K^2)/(50 K)^2)^((n - 1)/2) in place of T, with n = 5/4;  "
        "law power: the same with n free"
    )
    source = (
        "lumped exchange between two bodies: Incropera, Fundamentals of Heat and Mass Transfer, ch. 3; delayed: the "
        "air around each takes on the other's temperature as a well-mixed volume, ch. 5 there; radiation "
        "between two surfaces: ch. 13 there; frame: both are clamped to one body of a heat capacity of its own, "
        "ch. 5 there (what it loses to the room counts as the actuators' own loss); plume: air "
        "that one has warmed, and that has left it anyway, flows past the other, in proportion to T, or as free "
        "convection carries it, to T^(5/4): Incropera ch. 9; a plume above a line warms by the power 2/3 of what heats "
        "it where turbulent (Rouse, Yih, Humphreys, Tellus 4 (1952) 201), 4/5 where laminar (Gebhart, Pera, Schorr, "
        "Int. J. Heat Mass Transfer 13 (1970) 161): law power"
    )
    says = "Heat flows from the warmer muscle of the joint to the other, through the air and the mount between them."
    needs = ("thermal", "joint")
    excited_by = "one muscle heated while the other rests"
    parameters = (
        Parameter(
            name="exchange",
            symbol="g",
            unit="1",
            description="conductance between the two, as a share of that to the room (by radiation: near its own)",
            typical=0.2,
            bounds=(0.003, 30.0),
            null=0.0,
            spread=1.5,
        ),
        Parameter(
            name="time_constant",
            symbol="τ",
            unit="s",
            description="time in which the warmth of one reaches the other (law delayed), or of both the frame",
            typical=0.2,
            bounds=(0.01, 10.0),
            null=0.2,
            spread=2.0,
            time="response",
        ),
        Parameter(
            name="lean",
            symbol="b",
            unit="1",
            description="how one-sided it is: 1 if only the agonist warms the other, -1 if only the antagonist does "
            "(laws plume, free convection, power)",
            typical=0.5,
            bounds=(-1.0, 1.0),
            null=0.0,
            scale="linear",
            spread=0.7,
        ),
        Parameter(
            name="exponent",
            symbol="n",
            unit="1",
            description="power of the one's temperature by which it warms the air that reaches the other (law power)",
            typical=0.8,
            bounds=(0.4, 2.0),
            null=1.0,
            spread=0.4,
        ),
    )
    laws = ("direct", "delayed", "radiation", "frame", "plume", "free convection", "power")
    only_under: ClassVar[dict[str, tuple[int, ...]]] = {"time_constant": (1, 3), "lean": (4, 5, 6), "exponent": (6,)}
    states = ("air_temperature",)
    starts = ((0.3, 0.2, 0.0, 0.8),)

    def heat(self, p: Values, view: View) -> Side:
        if view.temperature.ndim == 0:  # alone, there is no other
            return jnp.zeros_like(view.temperature)
        between = jnp.mean(p.exchange * view.shared["conductance"])
        if_direct = jnp.where(_is_late(p), view.own[0], view.temperature[::-1]) - view.temperature
        exchanged = jnp.where(p.law == 2, _radiated(view)[::-1] - _radiated(view), if_direct)
        reaching = 1.0 + jnp.mean(p.lean) * jnp.array([-1.0, 1.0])
        plume = jnp.where(p.law >= 5, _carried(p, view), view.temperature)[::-1]
        return between * jnp.where(p.law >= 4, reaching * plume, exchanged)

    def rates(self, p: Values, view: View) -> tuple[Side, ...]:
        return (jnp.where(_is_late(p), (_nearby(p, view) - view.own[0]) / p.time_constant, 0.0),)

    def initial(self, p: Values, view: View) -> tuple[Side, ...]:
        return (_nearby(p, view),)


def _is_late(p: Values) -> Side:
    """Whether heat goes through what is between them and warms itself: laws delayed and frame."""
    return (p.law == 1) | (p.law == 3)


def _nearby(p: Values, view: View) -> Side:
    """What the air takes on: the other's temperature; the frame: the mean of both."""
    return jnp.where(p.law == 3, 0.5 * (view.temperature + _other(view)), _other(view))


def _radiated(view: View) -> Side:
    """((T_0 + T)^4 - T_0^4)/(4 T_0^3) [K]."""
    warm = view.temperature / view.ambient
    return view.temperature * (1.0 + warm * (1.5 + warm * (1.0 + 0.25 * warm)))


def _carried(p: Values, view: View) -> Side:
    """What is carried away goes with a power of the temperature [K], as one of 50 K does with it; so that its slope
    is finite at rest, as one of 1 K does near there."""
    power = jnp.where(p.law == 6, p.exponent, 1.25)
    return view.temperature * jnp.exp(0.5 * (power - 1.0) * jnp.log((view.temperature**2 + 1.0) / 50.0**2))


def _other(view: View) -> Side:
    """Temperature of the other actuator; its own where there is none."""
    return view.temperature if view.temperature.ndim == 0 else view.temperature[::-1]
