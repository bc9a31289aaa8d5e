"""Viscous damping."""

from scpjax.parameter import Parameter
from scpjax.physics.mechanism import Mechanism, Side, Values, View


class ViscousDamping(Mechanism):
    name = "viscous_damping"
    title = "Viscous damping"
    subsystem = "thermomechanical"
    equation = "F = -beta dx/dt"
    source = "thesis (3.4)"
    says = "Motion is resisted in proportion to its speed."
    parameters = (
        Parameter(
            name="damping",
            symbol="β",
            unit="N s/m",
            description="damping coefficient",
            typical=5.0,
            bounds=(1e-8, 1e10),
        ),
    )

    def force(self, p: Values, view: View) -> Side:
        return -p.damping * view.velocity
