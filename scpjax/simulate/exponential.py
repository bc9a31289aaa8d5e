"""Fixed-step exponential integrators: the stiff linear core exactly, the rest by Runge-Kutta stages.

A hanging weight rings at tens of rad/s while its heat takes minutes: the linear core ``A`` of the balances (their
Jacobian at rest) is propagated by matrix functions, so the step need only resolve what is not linear. Where nothing
is, both methods are exact for an effort that is constant over the step, and the fourth-order one for a quadratic one.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import jax
import jax.numpy as jnp
from jaxtyping import Array, Float

Rates = Callable[[list[Array], Float[Array, " sides"]], list[Array]]

_TERMS = 14  # of the Taylor series; exact to rounding for a scaled norm of 1/2
_SQUARINGS = 20


def phi_functions(a: Float[Array, "n n"]) -> tuple[Array, Array, Array, Array]:
    """phi_0 = exp(a), phi_1, phi_2, phi_3 with phi_k(z) = (phi_{k-1}(z) - 1/(k-1)!) / z, for a square matrix.

    Scaling and squaring of the Taylor series: Higham, Functions of Matrices (2008), section 10.7.4.
    """
    n = a.shape[-1]
    norm = jnp.max(jnp.sum(jnp.abs(jax.lax.stop_gradient(a)), axis=-1))
    count = jnp.ceil(jnp.log2(jnp.maximum(norm, 1e-30) / 0.5))
    count = jnp.clip(count, 0, _SQUARINGS)
    x, eye = a / 2.0**count, jnp.eye(n, dtype=a.dtype)
    p3 = jnp.zeros_like(a)
    factorial = [1.0]
    for j in range(1, _TERMS + 4):
        factorial.append(factorial[-1] * j)
    for j in reversed(range(_TERMS)):
        p3 = eye / factorial[j + 3] + x @ p3
    p2 = eye / 2.0 + x @ p3
    p1 = eye + x @ p2

    def body(ps: Any, i: Array) -> tuple[Any, None]:
        return tuple(jnp.where(i < count, d, p) for d, p in zip(_double(ps), ps, strict=True)), None

    (e, p1, p2, p3), _ = jax.lax.scan(body, (x @ p1, p1, p2, p3), jnp.arange(_SQUARINGS))
    return eye + e, p1, p2, p3


def double(ps: tuple[Array, Array, Array, Array]) -> tuple[Array, Array, Array, Array]:
    """phi functions of 2a from those of a."""
    eye = jnp.eye(ps[0].shape[-1], dtype=ps[0].dtype)
    e, p1, p2, p3 = _double((ps[0] - eye, *ps[1:]))
    return eye + e, p1, p2, p3


def _double(ps: tuple[Array, Array, Array, Array]) -> tuple[Array, Array, Array, Array]:
    """The same with phi_0 - 1 in place of phi_0: a slow mode beside a fast one is a number much smaller than 1."""
    e, p1, p2, p3 = ps
    return (
        e @ e + 2 * e,
        (e @ p1) / 2 + p1,
        (e @ p2 + p1) / 4 + p2 / 2,
        (e @ p3 + p2 + p1 / 2) / 8 + p3 / 4,
    )


Pattern = tuple[tuple[bool, ...], ...]


class _Matrix:
    """A matrix taken apart into the scalars that can be other than zero.

    States are kept apart too: batched over trials and sensitivities, every operation of a step is then one long
    vector loop, several times as fast as small matrix products.
    """

    def __init__(self, matrix: Float[Array, "n n"], pattern: Pattern):
        self.rows = [[(j, matrix[i, j]) for j in range(len(pattern)) if pattern[i][j]] for i in range(len(pattern))]

    def __call__(self, vector: list[Array]) -> list[Array]:
        return [_total([m * vector[j] for j, m in row]) for row in self.rows]


def _total(terms: list[Array]) -> Array:
    return sum(terms[1:], start=terms[0])


def _add(*vectors: list[Array]) -> list[Array]:
    return [_total(list(parts)) for parts in zip(*vectors, strict=True)]


def _combine(*terms: tuple[float, list[Array]]) -> list[Array]:
    """Sum of vectors times plain numbers."""
    out = []
    for i in range(len(terms[0][1])):
        total = terms[0][1][i] if terms[0][0] == 1.0 else terms[0][0] * terms[0][1][i]
        for factor, vector in terms[1:]:
            part = vector[i] if abs(factor) == 1.0 else abs(factor) * vector[i]
            total = total + part if factor > 0 else total - part
        out.append(total)
    return out


Step = Callable[[list[Array], Array], list[Array]]


def etd2(rates: Rates, a: Float[Array, "n n"], step: Array, *, pattern: Pattern) -> Step:
    """Second order, two evaluations a step, for an effort (sides,) that is constant over each step.

    Cox, Matthews, J. Comput. Phys. 176 (2002) 430, equation (22). ``rates`` takes and gives lists of scalars;
    ``pattern`` says which entries of functions of ``a`` can differ from zero. Returns the map over one step.
    """
    p0, p1, p2, _ = phi_functions(a * step)
    # with n = f - A z: exp(A h) z + h phi_1 n = z + h phi_1 f, and the difference of n at both ends needs no product
    # with A either, for A h phi_1 = exp(A h) - 1
    first, second, back = (_Matrix(m, pattern) for m in (p1 * step, p2 * step, p2 @ p0 * step))

    def advance(z: list[Array], u: Array) -> list[Array]:
        f = rates(z, u)
        predicted = _add(z, first(f))
        return _combine((1.0, predicted), (1.0, second(rates(predicted, u))), (-1.0, back(f)))

    return advance


def etd4(rates: Rates, a: Float[Array, "n n"], step: Array, *, pattern: Pattern) -> Step:
    """Fourth order, four evaluations a step, effort (3, sides) given at its start, middle and end.

    Krogstad, J. Comput. Phys. 203 (2005) 72 (ETDRK4-B). Arguments and result as of `etd2`.
    """
    half = phi_functions(a * (step / 2))
    whole = double(half)
    core = _Matrix(a, pattern)
    h1, h2 = (_Matrix(m, pattern) for m in (half[1] * step / 2, half[2] * step))
    p1, p2, p3 = (_Matrix(m, pattern) for m in (whole[1] * step, whole[2] * step, whole[3] * step))

    def rest(z: list[Array], u: Array) -> list[Array]:
        return _combine((1.0, rates(z, u)), (-1.0, core(z)))

    def advance(z: list[Array], u: Array) -> list[Array]:
        f0 = rates(z, u[0])
        n0 = _combine((1.0, f0), (-1.0, core(z)))
        at_half = _add(z, h1(f0))
        na = rest(at_half, u[1])
        nb = rest(_add(at_half, h2(_combine((1.0, na), (-1.0, n0)))), u[1])
        free = _add(z, p1(f0))
        nc = rest(_add(free, p2(_combine((2.0, nb), (-2.0, n0)))), u[2])
        second = p2(_combine((-3.0, n0), (2.0, na), (2.0, nb), (-1.0, nc)))
        third = p3(_combine((4.0, n0), (-4.0, na), (-4.0, nb), (4.0, nc)))
        return _add(free, second, third)

    return advance


def all_nodes(advance: Step, z0: Float[Array, " n"], effort: Float[Array, "steps ..."]) -> Float[Array, "nodes n"]:
    """States at all steps + 1 nodes."""

    def body(z: list[Array], u: Array) -> tuple[list[Array], list[Array]]:
        z = advance(z, u)
        return z, z

    _, zs = jax.lax.scan(body, [z0[i] for i in range(z0.shape[0])], effort)
    return jnp.concatenate([z0[None], jnp.stack(zs, axis=-1)])
