"""Closure of the force balance: a force learned from the recordings, without a name."""

from dataclasses import replace
from typing import ClassVar

import jax.numpy as jnp

from scpjax.physics.mechanism import Mechanism, Side, Values, View
from scpjax.physics.step_end import dampened
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
_OTHERS = tuple(t for t in TERMS if not t.odd)
_DAMPERS = {k: tuple(t for t in TERMS if t.odd and t.velocity == k) for k in (1, 2)}  # by their power of the velocity


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
        steady, growing = (jnp.minimum(c, 0.0) for c in _damping(p, view))  # what drives it on
        others = view.shared["stiffness"] * p.reference * total(_OTHERS, p, view)
        return -others - (steady + growing * jnp.abs(view.velocity)) * view.velocity

    def resistance(self, p: Values, view: View, force: Side) -> Side:
        """What dampens, as `scpjax.physics.step_end.dampened` has it."""
        steady, growing = (jnp.maximum(c, 0.0) for c in _damping(p, view))
        return dampened(view, force, steady, growing)


def _damping(p: Values, view: View) -> tuple[Side, Side]:
    """b [N s/m] and c [N s^2/m^2] of the force ``-(b + c |v|) v`` that the terms odd in the velocity make."""
    scale = view.shared["stiffness"] * p.reference
    steady, growing = (
        sum(getattr(p, t.name) * replace(t, velocity=0, odd=False).value(p, view) for t in terms) * scale
        for terms in _DAMPERS.values()
    )
    return steady / p.velocity_scale, growing / p.velocity_scale**2
