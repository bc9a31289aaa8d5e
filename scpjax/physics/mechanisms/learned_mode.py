"""Closure of the force balance by what swings along with the load: learned, unnamed."""

from typing import ClassVar

import jax.numpy as jnp

from scpjax.parameter import Parameter, weight
from scpjax.physics.mechanism import Mechanism, Quantity, Side, Values, View


class LearnedMode(Mechanism):
    name = "learned_mode"
    title = "Learned mode"
    subsystem = "thermomechanical"
    equation = (
        "d2q/dt2 = w^2 (x - q) + 2 z w (dx/dt - dq/dt), w = 2 pi/P;  force = c k (q - x + (2 z/w)(dq/dt - dx/dt)), "
        "reading of the displacement greater by g (q - x)"
    )
    source = (
        "a second mass m_2 = c k/w^2 on a spring and a damper, whose place is read in part: Den Hartog, Mechanical "
        "Vibrations (1956), section 3.2"
    )
    says = "Something is carried along on a spring of its own, swings after every move, and pulls back or is read."
    needs = ("mechanical", "displacement_output")
    excited_by = "moves quicker than its period"
    learned = True
    states = ("place", "velocity")
    terms: ClassVar[tuple[()]] = ()
    parameters = (
        weight("stiffness", "c", "stiffness of its spring, as a share of that of the actuator's"),
        weight("share", "g", "share of the reading that is its place"),
        Parameter(
            name="period",
            symbol="P",
            unit="s",
            description="period with which it would swing without damping if the load stood still",
            typical=3.0,
            bounds=(1e-4, 1e6),
            null=3.0,
        ),
        Parameter(
            name="damping",
            symbol="z",
            unit="1",
            description="damping of that swing, as a share of the critical one",
            typical=0.1,
            bounds=(1e-3, 3.0),
            null=0.1,
        ),
    )
    starts = ((0.0, 0.0, 3.0, 0.1),)

    def _behind(self, p: Values, view: View) -> Side:
        """Acceleration over w^2 [m]."""
        place, velocity = view.own
        late = p.damping * p.period / jnp.pi  # 2 z/w
        return view.displacement - place + late * (view.velocity - velocity)

    def force(self, p: Values, view: View) -> Side:
        return -p.stiffness * view.shared["stiffness"] * self._behind(p, view)

    def rates(self, p: Values, view: View) -> tuple[Side, ...]:
        return view.own[1], jnp.square(2.0 * jnp.pi / p.period) * self._behind(p, view)

    def initial(self, p: Values, view: View) -> tuple[Side, ...]:
        return view.displacement, jnp.zeros_like(view.displacement)

    def reading(self, p: Values, view: View, quantity: Quantity, value: Side) -> Side:
        return value + p.share * (view.own[0] - view.displacement) if quantity == "displacement" else value
