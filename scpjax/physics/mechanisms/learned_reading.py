"""Closure of the sensors: errors of the readings learned from the recordings, without a name."""

from typing import ClassVar

from scpjax.physics.mechanism import Mechanism, Quantity, Side, Values, View
from scpjax.physics.terms import Term, coefficients, total

TEMPERATURE = (
    Term("temperature_T2", temperature=2),
    Term("temperature_T3", temperature=3),
    Term("temperature_x", displacement=1),
    Term("temperature_u", effort=1),
    Term("temperature_v", velocity=1, odd=True),
)
DISPLACEMENT = (
    Term("displacement_x2", displacement=2),
    Term("displacement_x3", displacement=3),
    Term("displacement_T", temperature=1),
    Term("displacement_T2", temperature=2),
    Term("displacement_u", effort=1),
)


class LearnedReading(Mechanism):
    name = "learned_reading"
    title = "Learned sensor error"
    subsystem = "sensor"
    equation = "reading = true value + reference sum_i c_i phi_i(T, x, v, u)"
    source = "closure by sparse regression, fitted through the simulation: Brunton, Proctor, Kutz, PNAS 113 (2016) 3932"
    says = "An error of a sensor that no mechanism of the catalogue describes, as a sum of simple terms."
    excited_by = "whatever excited it in the recordings"
    learned = True
    terms: ClassVar[tuple[Term, ...]] = TEMPERATURE + DISPLACEMENT
    parameters = coefficients(terms)
    starts = ((0.0,) * len(parameters),)

    def reading(self, p: Values, view: View, quantity: Quantity, value: Side) -> Side:
        if quantity == "temperature":
            return value + p.reference_temperature * total(TEMPERATURE, p, view)
        return value + p.reference * total(DISPLACEMENT, p, view)
