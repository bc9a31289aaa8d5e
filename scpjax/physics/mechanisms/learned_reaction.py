"""Closure of the energy balance by what uses itself up while it is hot: learned, unnamed."""

from typing import ClassVar

import jax.numpy as jnp

from scpjax.parameter import Parameter, weight
from scpjax.physics.mechanism import Mechanism, Side, Values, View

STEEPEST = 30.0  # logarithm of a factor in the rate, that is fitted
_FASTEST = 3.0  # in the exponent of the rate: 20 times as fast nothing is left soon, and steps stay short enough


class LearnedReaction(Mechanism):
    name = "learned_reaction"
    title = "Learned reaction"
    subsystem = "thermoelectric"
    equation = (
        "heat = -c lambda T_ref t_ref r w, dw/dt = -r w, w = 1 at the start, r = exp(a (T/T_ref - 1))/tau, "
        "at most 20/tau"
    )
    source = (
        "a first-order reaction whose rate rises by a factor over some kelvin (Arrhenius' law over a small range; "
        "drying in the falling-rate period: Lewis, Ind. Eng. Chem. 13 (1921) 427)"
    )
    says = (
        "Something uses itself up the faster the hotter it is, and takes heat (as drying does) or gives it; in every "
        "recording anew."
    )
    needs = ("thermal",)
    excited_by = "heat from the start of a recording, to different temperatures"
    learned = True
    states = ("left",)
    terms: ClassVar[tuple[()]] = ()
    parameters = (
        weight("heat", "c", "heat that it takes in all, in units of what is lost at T_ref in the reference time"),
        Parameter(
            name="time",
            symbol="tau",
            unit="s",
            description="time constant of what is left, at the reference excess",
            typical=0.3,
            bounds=(0.003, 30.0),
            null=1.0,
            time="duration",
        ),
        Parameter(
            name="acceleration",
            symbol="a",
            unit="1",
            description="logarithm of the factor by which the rate is greater at the reference excess than at rest",
            typical=2.0,
            bounds=(0.05, STEEPEST),
            null=2.0,
        ),
        Parameter(
            name="reference_temperature",
            symbol="T_ref",
            unit="K",
            description="temperature excess at which the rate is stated",
            typical=50.0,
            bounds=(1e-6, 1e9),
            null=50.0,
            fixed=True,
        ),
        Parameter(
            name="reference_time",
            symbol="t_ref",
            unit="s",
            description="time for which the heat is stated",
            typical=100.0,
            bounds=(1e-9, 1e9),
            null=100.0,
            fixed=True,
        ),
    )
    starts = ((0.0, 0.3, 2.0, 0.0, 0.0), (0.0, 0.1, 5.0, 0.0, 0.0), (0.0, 1.0, 1.0, 0.0, 0.0))

    @property
    def may_need_short_steps(self) -> bool:
        """Far above the reference excess it is soon used up."""
        return True

    def _rate(self, p: Values, view: View) -> Side:
        over = jnp.minimum(p.acceleration * (view.temperature / p.reference_temperature - 1.0), _FASTEST)
        return jnp.exp(over) / p.time

    def heat(self, p: Values, view: View) -> Side:
        taken = p.heat * view.shared["conductance"] * p.reference_temperature * p.reference_time
        return -taken * self._rate(p, view) * view.own[0]

    def rates(self, p: Values, view: View) -> tuple[Side, ...]:
        return (-self._rate(p, view) * view.own[0],)

    def initial(self, p: Values, view: View) -> tuple[Side, ...]:
        return (jnp.ones_like(view.temperature),)
