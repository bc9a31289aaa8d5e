"""Closure of the force balance: a force learned from the recordings as a smooth curve, without a name."""

from typing import ClassVar

from scpjax.physics.curves import Form, laws, only_under, parameters, product
from scpjax.physics.mechanism import Mechanism, Side, Values, View

FORMS = (
    Form("", "displacement"),
    Form("", "temperature"),
    Form("temperature", "displacement"),
    Form("displacement", "temperature"),
    Form("", "velocity"),
    Form("displacement", "velocity"),
)


class LearnedForceCurve(Mechanism):
    name = "learned_force_curve"
    title = "Learned force"
    subsystem = "thermomechanical"
    equation = "force = -k x_high f s(w), s a spline that is 0 at rest"
    source = "closure by a cubic spline, fitted through the simulation: de Boor, A Practical Guide to Splines (2001)"
    says = "A force that no mechanism of the catalogue describes, as a smooth curve."
    needs = ("mechanical",)
    excited_by = "whatever excited it in the recordings"
    learned = True
    forms: ClassVar[tuple[Form, ...]] = FORMS
    laws = laws(FORMS)
    only_under: ClassVar[dict[str, tuple[int, ...]]] = only_under(FORMS)
    parameters = parameters()
    starts = ((0.0,) * len(parameters),)

    def force(self, p: Values, view: View) -> Side:
        return -view.shared["stiffness"] * p.displacement_high * product(FORMS, p, view)
