"""The elastic spring that the coil is."""

from scpjax.parameter import Parameter
from scpjax.physics.mechanism import Mechanism, Side, Values, View


class ElasticSpring(Mechanism):
    name = "elastic_spring"
    title = "Elastic spring"
    subsystem = "thermomechanical"
    equation = "F = -k x"
    source = "thesis (3.4)"
    says = "The coil resists displacement like a spring."
    parameters = (
        Parameter(
            name="stiffness",
            symbol="k",
            unit="N/m",
            description="stiffness of the coil",
            typical=180.0,
            bounds=(1e-6, 1e12),
        ),
    )

    def restoring(self, p: Values, view: View) -> Side:
        return p.stiffness * view.deflection
