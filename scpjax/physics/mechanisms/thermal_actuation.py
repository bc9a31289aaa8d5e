"""Thermal actuation: a warmer coil pulls harder."""

from math import inf

from scpjax.parameter import Parameter
from scpjax.physics.mechanism import Mechanism, Side, Values, View


class ThermalActuation(Mechanism):
    name = "thermal_actuation"
    title = "Thermal actuation"
    subsystem = "thermomechanical"
    equation = "F = C T"
    source = "thesis (3.4)"
    says = "The force of the coil grows in proportion to its temperature."
    parameters = (
        Parameter(
            name="coefficient",
            symbol="C",
            unit="N/K",
            description="force per kelvin (per unit of the drive where the drive pulls directly)",
            typical=0.02,
            bounds=(-inf, inf),
            scale="linear",
        ),
    )

    def pull(self, p: Values, view: View) -> Side:
        return p.coefficient * view.actuating
