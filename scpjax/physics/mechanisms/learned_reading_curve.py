"""Closure of the sensors: an error of a reading learned from the recordings as a smooth curve, without a name."""

from typing import ClassVar

from scpjax.physics.curves import Form, laws, only_under, parameters, product
from scpjax.physics.mechanism import Mechanism, Quantity, Side, Values, View

FORMS = (
    Form("", "temperature", "temperature"),
    Form("", "displacement", "temperature"),
    Form("", "effort", "temperature"),
    Form("", "displacement", "displacement"),
    Form("", "temperature", "displacement"),
    Form("", "effort", "displacement"),
)


class LearnedReadingCurve(Mechanism):
    name = "learned_reading_curve"
    title = "Learned sensor error"
    subsystem = "sensor"
    equation = "reading = true value + reference s(w), s a spline that is 0 at rest"
    source = "closure by a cubic spline, fitted through the simulation: de Boor, A Practical Guide to Splines (2001)"
    says = "An error of a sensor that no mechanism of the catalogue describes, as a smooth curve."
    excited_by = "whatever excited it in the recordings"
    learned = True
    forms: ClassVar[tuple[Form, ...]] = FORMS
    laws = laws(FORMS)
    only_under: ClassVar[dict[str, tuple[int, ...]]] = only_under(FORMS)
    parameters = parameters()
    starts = ((0.0,) * len(parameters),)

    def reading(self, p: Values, view: View, quantity: Quantity, value: Side) -> Side:
        if quantity == "temperature":
            return value + p.temperature_high * product(FORMS, p, view, "temperature")
        return value + p.displacement_high * product(FORMS, p, view, "displacement")
