"""A spring whose stiffness changes with how far it is stretched."""

from scpjax.parameter import Parameter
from scpjax.physics.mechanism import Mechanism, Side, Values, View


class NonlinearStiffness(Mechanism):
    name = "nonlinear_stiffness"
    title = "Stiffness changes with displacement"
    subsystem = "thermomechanical"
    equation = "F = -k x (a (x/x_ref) + b (x/x_ref)^2)"
    source = "Duffing spring; coil geometry: thesis 3.3.5, references 29-31 there"
    says = "The further the coil has moved, the stiffer (or softer) it is."
    needs = ("mechanical",)
    excited_by = "large and small amplitudes"
    parameters = (
        Parameter(
            name="quadratic",
            symbol="a",
            unit="1",
            description="relative change of stiffness at the reference displacement, odd part (differs by direction)",
            typical=0.0,
            bounds=(-0.95, 10.0),
            null=0.0,
            scale="linear",
            spread=1.0,
        ),
        Parameter(
            name="cubic",
            symbol="b",
            unit="1",
            description="relative change of stiffness at the reference displacement, even part",
            typical=0.0,
            bounds=(-0.95, 10.0),
            null=0.0,
            scale="linear",
            spread=1.0,
        ),
        Parameter(
            name="reference",
            symbol="x_ref",
            unit="m",
            description="displacement at which the relative changes are stated",
            typical=0.01,
            bounds=(1e-12, 1e12),
            null=0.01,
            fixed=True,
        ),
    )
    starts = ((0.1, 0.1, 0.0), (-0.1, -0.1, 0.0))

    def force(self, p: Values, view: View) -> Side:
        relative = view.deflection / p.reference
        return -view.shared["stiffness"] * view.deflection * relative * (p.quadratic + p.cubic * relative)
