"""Newton cooling: heat leaves in proportion to the temperature excess, and one thermal mass stores the rest."""

from scpjax.parameter import Parameter
from scpjax.physics.mechanism import Mechanism, Side, Values, View


class NewtonCooling(Mechanism):
    name = "newton_cooling"
    title = "Newton cooling"
    subsystem = "thermoelectric"
    equation = "C_th dT/dt = P - lambda T"
    source = "thesis (3.1), (3.2)"
    says = "The actuator cools in proportion to how much warmer than the room it is."
    parameters = (
        Parameter(
            name="conductance",
            symbol="λ",
            unit="W/K",
            description="absolute thermal conductance to the room",
            typical=0.2,
            bounds=(1e-7, 1e7),
        ),
        Parameter(
            name="thermal_mass",
            symbol="C_th",
            unit="J/K",
            description="thermal mass of the actuator",
            typical=1.5,
            bounds=(1e-8, 1e8),
        ),
    )

    def thermal_mass(self, p: Values, mass: Side) -> Side:
        return mass + p.thermal_mass

    def heat(self, p: Values, view: View) -> Side:
        return -p.conductance * view.temperature
