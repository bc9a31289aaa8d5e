"""What a tuning makes small: terms of one response, added with weights; over several responses mean, worst or CVaR.

Every term is differentiable (almost everywhere) in the response and in the controller. Angles in rad, so that a
weight of 1 on `Tracking` says: in radian.
"""

from __future__ import annotations

import abc
from typing import Any, Literal

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array, Float

from scpjax.control.analysis import sensitivity_peak
from scpjax.control.controller import Scalar, check_number, scalar
from scpjax.control.errors import ControlError
from scpjax.control.loop import Loop, Response
from scpjax.control.metrics import energy, mae, rmse


class Term(eqx.Module):
    """One number of a response and the loop that made it."""

    weight: eqx.AbstractVar[Array]

    @abc.abstractmethod
    def value(self, loop: Loop, response: Response) -> Scalar:
        """The number, before its weight."""


class Tracking(Term):
    """Root mean square [rad] of reference less angle."""

    weight: Array = eqx.field(converter=scalar, default=1.0, kw_only=True)

    def value(self, loop: Loop, response: Response) -> Scalar:
        return rmse(response.error)


class AbsoluteError(Term):
    """Mean absolute error [rad]."""

    weight: Array = eqx.field(converter=scalar, default=1.0, kw_only=True)

    def value(self, loop: Loop, response: Response) -> Scalar:
        return mae(response.error)


class Effort(Term):
    """Mean effort [V^2], summed over sides."""

    weight: Array = eqx.field(converter=scalar, default=1.0, kw_only=True)

    def value(self, loop: Loop, response: Response) -> Scalar:
        return jnp.mean(jnp.sum(response.effort, axis=-1))


class Energy(Term):
    """Energy [J] into the wires (see `scpjax.control.metrics.energy`)."""

    weight: Array = eqx.field(converter=scalar, default=1.0, kw_only=True)

    def value(self, loop: Loop, response: Response) -> Scalar:
        return energy(loop, response)


class Overshoot(Term):
    """Angle [rad] beyond the greatest and the least reference, both added."""

    weight: Array = eqx.field(converter=scalar, default=1.0, kw_only=True)

    def value(self, loop: Loop, response: Response) -> Scalar:
        above = jnp.max(response.angle) - jnp.max(response.reference)
        below = jnp.min(response.reference) - jnp.min(response.angle)
        return jax.nn.relu(above) + jax.nn.relu(below)


class PeakTemperature(Term):
    """Kelvin by which the hottest side gets above ``limit`` [K]."""

    limit: Array = eqx.field(converter=scalar, kw_only=True)
    weight: Array = eqx.field(converter=scalar, default=1.0, kw_only=True)

    def value(self, loop: Loop, response: Response) -> Scalar:
        return jax.nn.relu(jnp.max(response.temperature) - self.limit)


class Robustness(Term):
    """How much the linear loop's sensitivity peak lies above ``limit``; 2 is a usual one."""

    limit: Array = eqx.field(converter=scalar, default=2.0, kw_only=True)
    weight: Array = eqx.field(converter=scalar, default=1.0, kw_only=True)

    def value(self, loop: Loop, response: Response) -> Scalar:
        return jax.nn.relu(sensitivity_peak(loop) - self.limit)


class StepSpecification(Term):
    """Squared relative distance of a step response from a rise and settling time [s] and an overshoot (share).

    For a reference that is one step from rest. Rise is from 10 to 90 %, settling into 2 %, both by the crossings
    interpolated between samples.
    """

    rise: Array = eqx.field(converter=scalar, kw_only=True)
    settling: Array = eqx.field(converter=scalar, kw_only=True)
    overshoot: Array = eqx.field(converter=scalar, kw_only=True)
    weight: Array = eqx.field(converter=scalar, default=1.0, kw_only=True)

    def value(self, loop: Loop, response: Response) -> Scalar:
        rise, settling, overshoot = step_measures(response.time, response.angle / response.reference[-1])
        parts = (rise / self.rise, settling / self.settling, overshoot / self.overshoot)
        return sum(((p - 1.0) ** 2 for p in parts), start=jnp.zeros(()))


def step_measures(time: Float[Array, " n"], y: Float[Array, " n"]) -> tuple[Scalar, Scalar, Scalar]:
    """(rise, settling, overshoot) of a response to a unit step, differentiable in ``y``.

    A response that never gets there rises and settles at the end.
    """
    rise = _first_above(time, y, 0.9) - _first_above(time, y, 0.1)
    off = jnp.abs(y - 1.0) - 0.02
    outside = off > 0
    n = y.shape[0]
    last = n - 1 - jnp.argmax(outside[::-1])
    after = jnp.minimum(last + 1, n - 1)
    share = off[last] / jnp.where(after > last, off[last] - off[after], 1.0)
    settling = time[last] + jnp.where(after > last, share, 0.0) * (time[after] - time[last])
    return rise, jnp.where(jnp.any(outside), settling, time[0]), jnp.max(y) - 1.0


def _first_above(time: Float[Array, " n"], y: Float[Array, " n"], level: float) -> Scalar:
    above = y >= level
    at = jnp.where(jnp.any(above), jnp.argmax(above), y.shape[0] - 1)
    before = jnp.maximum(at - 1, 0)
    rising = y[at] - y[before]
    share = (level - y[before]) / jnp.where(rising > 0, rising, 1.0)
    return time[before] + jnp.where(rising > 0, jnp.clip(share, 0.0, 1.0), 1.0) * (time[at] - time[before])


Over = Literal["mean", "worst", "cvar"]


class Objective(eqx.Module):
    """Weighted sum of terms; over several plants or references their ``over``: mean, worst or CVaR.

    ``tail`` is the share of the worst responses that CVaR averages over (Rockafellar, Uryasev, J. Risk 2 (2000) 21).

    **Raises** `ControlError` for no terms, a tail outside 0..1 or an unknown ``over``.
    """

    terms: tuple[Term, ...]
    over: Over = eqx.field(static=True)
    tail: float = eqx.field(static=True)

    def __init__(self, *terms: Term, over: Over = "mean", tail: float = 0.1):
        self.terms = terms or (Tracking(),)
        self.over, self.tail = over, tail

    def __check_init__(self) -> None:
        for term in self.terms:
            check_number(term.weight, f"the weight of {type(term).__name__}", not_negative=True)
        if self.over not in ("mean", "worst", "cvar"):
            raise ControlError(f"over {self.over!r}", mend="use mean, worst or cvar")
        if not 0 < self.tail <= 1:
            raise ControlError(f"a tail of {self.tail:g}", mend="give a share above 0 and at most 1")

    def value(self, loop: Loop, response: Response) -> Scalar:
        """Sum of the weighted terms of one response."""
        return sum((t.weight * t.value(loop, response) for t in self.terms), start=jnp.zeros(()))

    def gather(self, values: Float[Array, " s"]) -> Scalar:
        """One number for many responses."""
        if self.over == "mean":
            return jnp.mean(values)
        if self.over == "worst":
            return jnp.max(values)
        count = max(round(self.tail * values.shape[0]), 1)
        return jnp.mean(jax.lax.top_k(values, count)[0])


def describe(objective: Objective) -> list[tuple[str, float, dict[str, Any]]]:
    """(name, weight, options) of every term, for reports."""
    found = []
    for term in objective.terms:
        options = {k: float(v) for k, v in vars(term).items() if k != "weight"}
        found.append((type(term).__name__, float(term.weight), options))
    return found
