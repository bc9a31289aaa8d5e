"""The heating wire's resistance rises with its temperature."""

import jax.numpy as jnp

from scpjax.parameter import Parameter
from scpjax.physics.mechanism import Mechanism, Side, Values, View


class ResistanceTemperature(Mechanism):
    name = "resistance_temperature"
    title = "Resistance rises with temperature"
    subsystem = "thermoelectric"
    equation = "P = P_0 / (1 + alpha T)  (driven by voltage);  P_0 (1 + alpha T)  (driven by current)"
    source = "thesis (3.13): R = R_0 (1 + alpha (T - T_0)); copper alpha = 0.00404 1/K"
    says = "The hot wire has a higher resistance, so the same voltage heats it less."
    needs = ("electric", "thermal")
    excited_by = "steady states at several voltages"
    laws = ("voltage", "current")
    parameters = (
        Parameter(
            name="coefficient",
            symbol="α",
            unit="1/K",
            description="temperature coefficient of resistance",
            typical=0.004,
            bounds=(2e-4, 0.03),
            null=0.0,
            spread=1.0,
        ),
    )
    starts = ((0.004,),)

    def power(self, p: Values, view: View, power: Side) -> Side:
        factor = jnp.maximum(1.0 + p.coefficient * view.temperature, 0.05)
        return power * jnp.where(p.law == 1, factor, 1.0 / factor)
