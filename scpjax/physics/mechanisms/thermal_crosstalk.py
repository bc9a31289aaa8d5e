"""Two actuators of a joint that warm each other."""

import jax.numpy as jnp

from scpjax.parameter import Parameter
from scpjax.physics.mechanism import Mechanism, Side, Values, View


class ThermalCrosstalk(Mechanism):
    name = "thermal_crosstalk"
    title = "The two actuators warm each other"
    subsystem = "thermoelectric"
    equation = "C_th dT_1/dt = P_1 - lambda_1 T_1 - g lambda (T_1 - T_2), and the same for 2; lambda: mean of both"
    source = "lumped exchange between two bodies: Incropera, Fundamentals of Heat and Mass Transfer, ch. 3"
    says = "Heat flows from the warmer muscle of the joint to the other, through the air and the mount between them."
    needs = ("thermal", "joint")
    excited_by = "one muscle heated while the other rests"
    parameters = (
        Parameter(
            name="exchange",
            symbol="g",
            unit="1",
            description="conductance between the two, as a share of that to the room",
            typical=0.2,
            bounds=(0.003, 30.0),
            null=0.0,
            spread=1.5,
        ),
    )
    starts = ((0.3,),)

    def heat(self, p: Values, view: View) -> Side:
        if view.temperature.ndim == 0:  # alone, there is no other
            return jnp.zeros_like(view.temperature)
        between = jnp.mean(p.exchange * view.shared["conductance"])
        return between * (view.temperature[::-1] - view.temperature)
