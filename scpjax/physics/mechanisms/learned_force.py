"""Closure of the force balance: a force learned from the recordings, without a name."""

from typing import ClassVar

from scpjax.physics.mechanism import Mechanism, Side, Values, View
from scpjax.physics.terms import Term, coefficients, total

TERMS = (
    Term("x2", displacement=2),
    Term("x3", displacement=3),
    Term("T2", temperature=2),
    Term("T3", temperature=3),
    Term("Tx", temperature=1, displacement=1),
    Term("T2x", temperature=2, displacement=1),
    Term("Tx2", temperature=1, displacement=2),
    Term("v_speed", velocity=2, odd=True),
    Term("xv", displacement=1, velocity=1, odd=True),
    Term("Tv", temperature=1, velocity=1, odd=True),
    Term("speed", velocity=1),
    Term("u", effort=1),
)


class LearnedForce(Mechanism):
    name = "learned_force"
    title = "Learned force"
    subsystem = "thermomechanical"
    equation = "force = -k x_ref sum_i c_i phi_i(T, x, v, u)"
    source = "closure by sparse regression, fitted through the simulation: Brunton, Proctor, Kutz, PNAS 113 (2016) 3932"
    says = "A force that no mechanism of the catalogue describes, as a sum of simple terms."
    needs = ("mechanical",)
    excited_by = "whatever excited it in the recordings"
    learned = True
    terms: ClassVar[tuple[Term, ...]] = TERMS
    parameters = coefficients(TERMS)
    starts = ((0.0,) * len(parameters),)

    def force(self, p: Values, view: View) -> Side:
        return -view.shared["stiffness"] * p.reference * total(TERMS, p, view)
