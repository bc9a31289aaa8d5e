"""Closure of the energy balance: a heat flow learned from the recordings, without a name."""

from typing import ClassVar

from scpjax.physics.mechanism import Mechanism, Side, Values, View
from scpjax.physics.terms import Term, coefficients, total

TERMS = (
    Term("T2", temperature=2),
    Term("T3", temperature=3),
    Term("x", displacement=1),
    Term("x2", displacement=2),
    Term("Tx", temperature=1, displacement=1),
    Term("T2x", temperature=2, displacement=1),
    Term("Tx2", temperature=1, displacement=2),
    Term("x3", displacement=3),
    Term("T3x", temperature=3, displacement=1),
    Term("T2x2", temperature=2, displacement=2),
    Term("Tx3", temperature=1, displacement=3),
    Term("Tx4", temperature=1, displacement=4),
    Term("v", velocity=1, odd=True),
    Term("speed", velocity=1),
    Term("T_speed", temperature=1, velocity=1),
    Term("u2", effort=2),
    Term("uT", effort=1, temperature=1),
    Term("ux", effort=1, displacement=1),
)


class LearnedHeat(Mechanism):
    name = "learned_heat"
    title = "Learned heat flow"
    subsystem = "thermoelectric"
    equation = "heat = -lambda T_ref sum_i c_i phi_i(T, x, v, u)"
    source = "closure by sparse regression, fitted through the simulation: Brunton, Proctor, Kutz, PNAS 113 (2016) 3932"
    says = "A heat flow that no mechanism of the catalogue describes, as a sum of simple terms."
    needs = ("thermal",)
    excited_by = "whatever excited it in the recordings"
    learned = True
    terms: ClassVar[tuple[Term, ...]] = TERMS
    parameters = coefficients(TERMS)
    starts = ((0.0,) * len(parameters),)

    def heat(self, p: Values, view: View) -> Side:
        return -view.shared["conductance"] * p.reference_temperature * total(TERMS, p, view)
