"""Closure of the energy balance: a heat flow learned from the recordings as a smooth curve, without a name."""

from scpjax.physics.curves import Form, LearnedCurve, product
from scpjax.physics.mechanism import Side, Values, View


class LearnedHeatCurve(LearnedCurve):
    name = "learned_heat_curve"
    title = "Learned heat flow"
    subsystem = "thermoelectric"
    equation = "heat = -lambda T_high f s(w), s a spline that is 0 at rest"
    says = "A heat flow that no mechanism of the catalogue describes, as a smooth curve."
    needs = ("thermal",)
    forms = (
        Form("temperature", "displacement"),
        Form("temperature", "temperature"),
        Form("", "displacement"),
        Form("temperature", "velocity"),
        Form("effort", "temperature"),
        Form("effort", "displacement"),
    )

    def heat(self, p: Values, view: View) -> Side:
        return -view.shared["conductance"] * p.temperature_high * product(self.forms, p, view)
