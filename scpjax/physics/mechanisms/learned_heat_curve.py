"""Closure of the energy balance: a heat flow learned from the recordings as a smooth curve, without a name."""

from typing import ClassVar

from scpjax.physics.curves import Form, laws, only_under, parameters, product
from scpjax.physics.mechanism import Mechanism, Side, Values, View

FORMS = (
    Form("temperature", "displacement"),
    Form("temperature", "temperature"),
    Form("", "displacement"),
    Form("temperature", "velocity"),
    Form("effort", "temperature"),
    Form("effort", "displacement"),
)


class LearnedHeatCurve(Mechanism):
    name = "learned_heat_curve"
    title = "Learned heat flow"
    subsystem = "thermoelectric"
    equation = "heat = -lambda T_high f s(w), s a spline that is 0 at rest"
    source = "closure by a cubic spline, fitted through the simulation: de Boor, A Practical Guide to Splines (2001)"
    says = "A heat flow that no mechanism of the catalogue describes, as a smooth curve."
    needs = ("thermal",)
    excited_by = "whatever excited it in the recordings"
    learned = True
    forms: ClassVar[tuple[Form, ...]] = FORMS
    laws = laws(FORMS)
    only_under: ClassVar[dict[str, tuple[int, ...]]] = only_under(FORMS)
    parameters = parameters()
    starts = ((0.0,) * len(parameters),)

    def heat(self, p: Values, view: View) -> Side:
        return -view.shared["conductance"] * p.temperature_high * product(FORMS, p, view)
