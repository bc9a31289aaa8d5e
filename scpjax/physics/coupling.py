"""Which states can influence which in the linear core, read off the operations of the balances."""

from __future__ import annotations

from functools import cache
from typing import Any

import jax
import numpy as np
from jax.extend.core import Literal
from jaxtyping import Array

from scpjax.physics.balances import Balances
from scpjax.physics.structure import Structure

Pattern = tuple[tuple[bool, ...], ...]
Trace = tuple[int, bool]  # (states that the value varies with at rest, as bits; whether it is 0 at rest)

_LINEAR = {"broadcast_in_dim", "convert_element_type", "copy", "neg", "reshape", "rev", "slice", "squeeze", "transpose"}
_SUMS = {"add", "add_any", "concatenate", "reduce_sum", "sub"}


@cache
def coupling(structure: Structure) -> Pattern:
    """Which state can influence which in any exponential of the linear core: (to, from).

    Whatever the laws and values are: a product of two things that are both zero at rest does not couple there. The time
    is left out, which changes slowly and alone.
    """
    n = structure.n_states

    def rates(z: tuple[Array, ...], effort: Array, theta: Array, laws: Array, ambient: Array) -> list[Array]:
        return Balances(structure, theta, laws, ambient, core=True).rates(list(z), effort)

    shape = lambda *size: jax.ShapeDtypeStruct(size, float)  # noqa: E731
    known = (shape(len(structure.slots)), shape(len(structure.mechanisms)), shape())
    traced = jax.make_jaxpr(rates)((shape(),) * n, shape(len(structure.sides)), *known).jaxpr
    given: list[Trace] = [(1 << i, True) for i in range(n)] + [(0, True)] + [(0, False)] * 3
    masks = [mask for mask, _ in _follow(traced, given, ())]
    reach = np.array([[i == j or bool(mask >> j & 1) for j in range(n)] for i, mask in enumerate(masks)])
    if structure.timed:
        reach[:-1, -1] = False
    for _ in range(n):
        reach = reach | ((reach.astype(int) @ reach.astype(int)) > 0)
    return tuple(tuple(bool(x) for x in row) for row in reach)


def _follow(jaxpr: Any, given: list[Trace], constants: Any) -> list[Trace]:
    """What every output varies with, when the inputs vary as given; an operation not known here hides nothing."""
    seen: dict[Any, Trace] = dict(zip(jaxpr.invars, given, strict=True))
    seen |= {v: (0, not np.any(c)) for v, c in zip(jaxpr.constvars, constants, strict=bool(constants))}

    def of(v: Any) -> Trace:
        return (0, not np.any(v.val)) if isinstance(v, Literal) else seen.get(v, (0, False))

    for equation in jaxpr.eqns:
        found = _results(equation, [of(v) for v in equation.invars])
        seen |= dict(zip(equation.outvars, found, strict=True))
    return [of(v) for v in jaxpr.outvars]


def _results(equation: Any, inputs: list[Trace]) -> list[Trace]:
    name, inner = equation.primitive.name, equation.params.get("jaxpr")
    if inner is not None and hasattr(inner, "jaxpr") and len(inner.jaxpr.invars) == len(inputs):
        return _follow(inner.jaxpr, inputs, inner.consts)
    every = 0
    for mask, _ in inputs:
        every |= mask
    zero = all(is_zero for _, is_zero in inputs)
    if name in _LINEAR or name in _SUMS:
        one = (every, zero)
    elif name in ("mul", "dot_general"):
        (a, no_a), (b, no_b) = inputs
        one = ((0 if no_b else a) | (0 if no_a else b), no_a or no_b)
    elif name == "div":
        (a, no_a), (b, _) = inputs
        one = (a | (0 if no_a else b), no_a)
    elif name in ("abs", "square") or (name == "integer_pow" and equation.params["y"] > 1):
        one = (0 if zero else every, zero)
    elif name == "select_n":  # what decides does not vary by a little
        mask = 0
        for m, _ in inputs[1:]:
            mask |= m
        one = (mask, all(is_zero for _, is_zero in inputs[1:]))
    else:
        one = (every, False)
    return [one for _ in equation.outvars]
