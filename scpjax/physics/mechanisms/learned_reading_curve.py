"""Closure of the sensors: an error of a reading learned from the recordings as a smooth curve, without a name."""

from scpjax.physics.curves import Form, LearnedCurve, product
from scpjax.physics.mechanism import Quantity, Side, Values, View


class LearnedReadingCurve(LearnedCurve):
    name = "learned_reading_curve"
    title = "Learned sensor error"
    subsystem = "sensor"
    equation = "reading = true value + reference s(w), s a spline that is 0 at rest"
    says = "An error of a sensor that no mechanism of the catalogue describes, as a smooth curve."
    forms = (
        Form("", "temperature", "temperature"),
        Form("", "displacement", "temperature"),
        Form("", "effort", "temperature"),
        Form("", "displacement", "displacement"),
        Form("", "temperature", "displacement"),
        Form("", "effort", "displacement"),
        Form("", "time", "temperature", names=("sensor_drift",)),
        Form("", "time", "displacement", names=("sensor_drift",)),
    )

    def reading(self, p: Values, view: View, quantity: Quantity, value: Side) -> Side:
        if quantity == "temperature":
            return value + p.temperature_high * product(self.forms, p, view, "temperature")
        return value + p.displacement_high * product(self.forms, p, view, "displacement")
