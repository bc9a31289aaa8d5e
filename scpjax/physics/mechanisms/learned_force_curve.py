"""Closure of the force balance: a force learned from the recordings as a smooth curve, without a name."""

from dataclasses import replace

import jax.numpy as jnp

from scpjax.physics.curves import PIECES, Form, LearnedCurve, product
from scpjax.physics.mechanism import Side, Values, View
from scpjax.physics.step_end import dampened


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
        Form("velocity", "temperature"),
        Form("velocity", "displacement"),
    )

    def force(self, p: Values, view: View) -> Side:
        given = -view.shared["stiffness"] * p.displacement_high * product(self.forms, p, view)
        drives_on = -jnp.minimum(self._damping(p, view), 0.0) * view.velocity
        return jnp.where(self._dampens(p), drives_on, given)

    def resistance(self, p: Values, view: View, force: Side) -> Side:
        """What dampens, ``-b v``, as `scpjax.physics.step_end.dampened` has it."""
        firm = jnp.where(self._dampens(p), jnp.maximum(self._damping(p, view), 0.0), 0.0)
        return dampened(view, force, firm, jnp.zeros_like(firm))

    def _dampens(self, p: Values) -> Side:
        """Whether the law in force is a damping that depends on something."""
        form = jnp.floor_divide(jnp.asarray(p.law, int), len(PIECES))
        return jnp.any(form == jnp.asarray([i for i, f in enumerate(self.forms) if f.factor == "velocity"]))

    def _damping(self, p: Values, view: View) -> Side:
        """b [N s/m], under such a law."""
        fast = replace(view, velocity=p.velocity_high * jnp.ones_like(view.velocity))
        return view.shared["stiffness"] * p.displacement_high / p.velocity_high * product(self.forms, p, fast)
