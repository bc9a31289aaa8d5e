"""Joule heating: the drive becomes power in the wire."""

from scpjax.parameter import Parameter
from scpjax.physics.mechanism import Mechanism, Side, Values, View


class JouleHeating(Mechanism):
    name = "joule_heating"
    title = "Joule heating"
    subsystem = "thermoelectric"
    equation = "P = g u;  g = 1/R for u = v^2, g = R for u = i^2, g = 1 for power, else a gain [W per unit of u]"
    source = "thesis (3.2)"
    says = "Current in the wire turns into heat."
    parameters = (
        Parameter(
            name="gain",
            symbol="g",
            unit="W/[u]",
            description="power per unit of electrical effort; 1/R for a voltage drive",
            typical=1.0,
            bounds=(1e-9, 1e9),
        ),
    )

    def power(self, p: Values, view: View, power: Side) -> Side:
        return power + p.gain * view.effort
