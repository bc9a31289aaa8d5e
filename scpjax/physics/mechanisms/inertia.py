"""Inertia of the hanging weight, of the actuator and of the pulley."""

from scpjax.parameter import Parameter
from scpjax.physics.mechanism import Mechanism, Side, Values


class Inertia(Mechanism):
    name = "inertia"
    title = "Inertia"
    subsystem = "thermomechanical"
    equation = "m d2x/dt2 = sum of forces;  a joint has m_1 + m_2 + m_p/2"
    source = "thesis (3.4), (3.7), (C.4)"
    says = "The moving mass has to be accelerated."
    parameters = (
        Parameter(
            name="mass",
            symbol="m",
            unit="kg",
            description="moving mass: load and actuator",
            typical=0.2,
            bounds=(1e-9, 1e6),
        ),
    )

    def inertia(self, p: Values) -> Side:
        return p.mass
