"""The heating wire's resistance rises with its temperature."""

from typing import ClassVar

import jax.numpy as jnp

from scpjax.parameter import Parameter
from scpjax.physics.mechanism import Mechanism, Side, Values, View


class ResistanceTemperature(Mechanism):
    name = "resistance_temperature"
    title = "Resistance rises with temperature"
    subsystem = "thermoelectric"
    equation = (
        "R/R_0 = 1 + alpha T;  curved: 1 + alpha T + c (alpha T)^2;  "
        "P = P_0 R_0/R  (driven by voltage);  P_0 R/R_0  (driven by current)"
    )
    source = (
        "thesis (3.13): R = R_0 (1 + alpha (T - T_0)); copper alpha = 0.00404 1/K; "
        "curved: Callendar-Van Dusen, IEC 60751 (platinum c = -0.04), nickel c = 0.2"
    )
    says = (
        "The hot wire has a higher resistance, so the same voltage heats it less, and the same current more; where a "
        "voltage heats it more (law current), its resistance falls."
    )
    needs = ("electric", "thermal")
    excited_by = "steady states at several voltages"
    laws = ("voltage", "current", "voltage, curved", "current, curved")
    only_under: ClassVar[dict[str, tuple[int, ...]]] = {"curvature": (2, 3)}
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
        Parameter(
            name="curvature",
            symbol="c",
            unit="1",
            description="quadratic part of the rise, in units of the linear part's square (laws curved)",
            typical=0.0,
            bounds=(-0.5, 2.0),
            null=0.0,
            scale="linear",
            spread=0.5,
        ),
    )
    starts = ((0.004, 0.0),)

    def power(self, p: Values, view: View, power: Side) -> Side:
        rise = p.coefficient * view.temperature
        curved = jnp.where(p.law >= 2, p.curvature, 0.0)
        factor = jnp.maximum(1.0 + rise + curved * rise * rise, 0.05)
        return power * jnp.where(p.law % 2 == 1, factor, 1.0 / factor)
