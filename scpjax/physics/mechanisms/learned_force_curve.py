"""Closure of the force balance: a force learned from the recordings as a smooth curve, without a name."""

from scpjax.physics.curves import Form, LearnedCurve, product
from scpjax.physics.mechanism import Side, Values, View


class LearnedForceCurve(LearnedCurve):
    name = "learned_force_curve"
    title = "Learned force"
    subsystem = "thermomechanical"
    equation = "force = -k x_high f s(w), s a spline that is 0 at rest"
    says = "A force that no mechanism of the catalogue describes, as a smooth curve."
    needs = ("mechanical",)
    forms = (
        Form("", "displacement", names=("nonlinear_stiffness", "antagonist_load")),
        Form("", "temperature", names=("nonlinear_thermal_force", "slack")),
        Form("temperature", "displacement"),
        Form("displacement", "temperature", names=("thermal_softening",)),
        Form("", "velocity"),
        Form("displacement", "velocity"),
        Form("temperature", "time", names=("fatigue",)),
    )

    def force(self, p: Values, view: View) -> Side:
        return -view.shared["stiffness"] * p.displacement_high * product(self.forms, p, view)
