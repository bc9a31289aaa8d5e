"""Fixed-step exponential integrators: the stiff linear core exactly, the rest by Runge-Kutta stages.

A hanging weight rings at tens of rad/s while its heat takes minutes: the linear core ``A`` of the balances (their
Jacobian at rest) is propagated by matrix functions, so the step need only resolve what is not linear. Where nothing
is, both methods are exact for an effort that is constant over the step, and the fourth-order one for a quadratic one.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array, Float

Rates = Callable[[list[Array], Float[Array, " sides"]], list[Array]]

_TERMS = 14  # of the Taylor series; exact to rounding for a scaled norm of 1/2
_SQUARINGS = 20
_FEW = 50  # entries that may differ from zero, up to which a matrix is taken apart


def phi_functions(a: Float[Array, "n n"]) -> tuple[Array, Array, Array, Array]:
    """phi_0 = exp(a), phi_1, phi_2, phi_3 with phi_k(z) = (phi_{k-1}(z) - 1/(k-1)!) / z, for a square matrix.

    Scaling and squaring of the Taylor series: Higham, Functions of Matrices (2008), section 10.7.4.
    """
    n = a.shape[-1]
    norm = jnp.max(jnp.sum(jnp.abs(jax.lax.stop_gradient(a)), axis=-1))
    count = jnp.ceil(jnp.log2(jnp.maximum(norm, 1e-30) / 0.5))
    count = jnp.clip(count, 0, _SQUARINGS)
    x, eye = a / 2.0**count, jnp.eye(n, dtype=a.dtype)

    def horner(ps: Any, term: Array) -> tuple[Any, None]:
        return (term * eye + x @ ps[0], *ps[:2]), None

    # the last three of Horner's scheme for phi_1 are phi_3, phi_2 and phi_1
    terms = jnp.asarray([1.0 / math.factorial(j) for j in range(_TERMS + 2, 0, -1)], a.dtype)
    (p1, p2, p3), _ = jax.lax.scan(horner, (jnp.zeros_like(a),) * 3, terms)

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


class _Matrix(eqx.Module):
    """A matrix to be multiplied by vectors of which the components are kept apart.

    Batched over trials and sensitivities, every operation of a step is then one long vector loop, several times as fast
    as small matrix products. A matrix of few entries is taken apart into scalars, where it is used: XLA carries each
    scalar that a loop takes from outside through it, and compiles for longer. A loop over the columns of others takes a
    fraction of the time to compile (``python benchmarks/matrices.py``).
    """

    few: Array | None  # (..., rows, columns)
    columns: Array | None  # of many: (..., columns, rows)
    where: tuple[tuple[tuple[int, int], ...], ...] = eqx.field(static=True)  # by row: (column, place in entries)
    places: tuple[int, ...] = eqx.field(static=True)  # of the entries, row by row

    def __init__(self, matrix: Float[Array, "... n n"], pattern: Pattern):
        """``pattern`` says which entries can differ from zero; ``matrix`` may have leading axes, which a scan takes
        away.
        """
        there = [(i, j) for i, row in enumerate(pattern) for j, used in enumerate(row) if used]
        self.few, self.columns = (matrix, None) if is_small(pattern) else (None, jnp.swapaxes(matrix, -1, -2))
        self.places = tuple(i * len(pattern) + j for i, j in there)
        self.where = tuple(tuple((j, k) for k, (row, j) in enumerate(there) if row == i) for i in range(len(pattern)))

    def entries(self) -> list[Array]:
        """What can differ from zero of a matrix of few entries; none of others."""
        if self.few is None:
            return []
        assert self.few.ndim == 2, "a scan takes leading axes away first"
        apart = jax.lax.split(self.few.ravel(), (1,) * self.few.size)
        return [apart[k].reshape(()) for k in self.places]

    def __call__(self, vector: list[Array]) -> list[Array]:
        return _products((self, vector))


def is_small(pattern: Pattern) -> bool:
    """Whether matrices of a pattern are taken apart into scalars."""
    return sum(map(sum, pattern)) <= _FEW


def _products(*pairs: tuple[_Matrix, list[Array]]) -> list[Array]:
    """Sum of the products of matrices, all of one pattern, and vectors."""
    where, columns = pairs[0][0].where, [m.columns for m, _ in pairs if m.columns is not None]
    if not columns:
        apart = [(m.entries(), v) for m, v in pairs]
        return [_total([m[k] * v[j] for m, v in apart for j, k in row]) for row in where]

    def add(total: Array, xs: Any) -> tuple[Array, None]:
        return total + sum(column * x for column, x in zip(*xs, strict=True)), None

    vectors = [jnp.stack(v) for _, v in pairs]
    total, _ = jax.lax.scan(add, jnp.zeros(len(where), columns[0].dtype), (columns, vectors), unroll=2)
    return [total[i] for i in range(len(where))]


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
Carry = Callable[[list[Array], list[Array], Float[Array, " sides"], Array], list[Array]]

# XLA would work out a stage anew for every state of the next, where both are one expression: between them there is a
# loop, over the columns of a matrix or, where those are taken apart, over the stages. What such a loop carries begins
# with something that varies, though it be multiplied by 0: what varies only from its second turn on, JAX traces twice
# for every transformation, and all loops within as often again.


def etd2(rates: Rates, a: Float[Array, "n n"], step: Array, *, pattern: Pattern, carried: Carry | None = None) -> Step:
    """Second order, two evaluations a step, for an effort (sides,) that is constant over each step.

    Cox, Matthews, J. Comput. Phys. 176 (2002) 430, equation (22). ``rates`` takes and gives lists of scalars;
    ``pattern`` says which entries of functions of ``a`` can differ from zero. ``carried(before, after, effort, step)``
    gives states after a step of which some saturate within it, see `Mechanism.carried`. Returns the map over one step.
    """
    p0, p1, p2, _ = phi_functions(a * step)
    # with n = f - A z: exp(A h) z + h phi_1 n = z + h phi_1 f, and the difference of n at both ends needs no product
    # with A either, for A h phi_1 = exp(A h) - 1
    first, second, back = (_Matrix(m, pattern) for m in (p1 * step, p2 * step, -p2 @ p0 * step))

    def advance(z: list[Array], u: Array) -> list[Array]:
        def stage(y: list[Array], f: list[Array], share: Array | float) -> tuple[list[Array], list[Array]]:
            y = [place + share * change for place, change in zip(y, first(f), strict=True)]
            if carried is not None:
                y = _scalars(carried(z, y, u, share * step), a.dtype)
            return y, _scalars(rates(y, u), a.dtype)

        def again(carry: Any, share: Array) -> tuple[Any, None]:
            y, f, _ = carry
            return (*stage(y, f, share), f), None

        if is_small(pattern):  # at z itself, then where the rates there lead
            (predicted, f1, f0), _ = jax.lax.scan(again, (z, z, z), jnp.arange(2.0, dtype=a.dtype))
        else:
            f0 = _scalars(rates(z, u), a.dtype)
            predicted, f1 = stage(z, f0, 1.0)
        after = _add(predicted, _products((second, f1), (back, f0)))
        return after if carried is None else _scalars(carried(z, after, u, step), a.dtype)

    return advance


def etd4(rates: Rates, a: Float[Array, "n n"], step: Array, *, pattern: Pattern) -> Step:
    """Fourth order, four evaluations a step, effort (3, sides) given at its start, middle and end.

    Krogstad, J. Comput. Phys. 203 (2005) 72 (ETDRK4-B). Arguments and result as of `etd2`.
    """
    half = phi_functions(a * (step / 2))
    whole = double(half)
    core = _Matrix(a, pattern)
    p1, p2, p3 = (_Matrix(m, pattern) for m in (whole[1] * step, whole[2] * step, whole[3] * step))
    # y = z + (h1 or p1) f0 + (h2 or 2 p2) (n - n0), n as of the stage before; at the first stage y = z
    matrices = jnp.stack([half[1] * step / 2, whole[1] * step, half[2] * step, 2 * whole[2] * step])
    ways = _Matrix(matrices, pattern)
    shares = jnp.asarray([[0, 0, 0, 0], [1, 0, 0, 0], [1, 0, 1, 0], [0, 1, 0, 1]], a.dtype)

    def advance(z: list[Array], u: Array) -> list[Array]:
        held = core(z)

        def stage(carry: Any, xs: Any) -> tuple[Any, None]:
            f0, n, before = carry
            share, starts, effort = xs
            bent = _combine((1.0, n), (-1.0, f0), (1.0, held))

            def go(y: list[Array], way: Any) -> tuple[list[Array], None]:
                matrix, much, straight = way
                move = matrix([jnp.where(straight, v, w) for v, w in zip(f0, bent, strict=True)])
                return [place + much * change for place, change in zip(y, move, strict=True)], None

            y, _ = jax.lax.scan(go, z, (ways, share, jnp.arange(4) < 2))
            f = _scalars(rates(y, effort), a.dtype)
            f0 = [jnp.where(starts, new, old) for new, old in zip(f, f0, strict=True)]
            return (f0, _combine((1.0, f), (-1.0, core(y))), _add(before, n)), None

        nothing = [0.0 * x for x in z]
        stages = (shares, jnp.arange(4) == 0, u[jnp.asarray([0, 1, 1, 2])])
        (f0, nc, before), _ = jax.lax.scan(stage, (nothing, nothing, nothing), stages)  # before = n0 + na + nb
        n0 = _combine((1.0, f0), (-1.0, held))
        second = p2(_combine((2.0, before), (-5.0, n0), (-1.0, nc)))
        third = p3(_combine((8.0, n0), (-4.0, before), (4.0, nc)))
        return _add(z, p1(f0), second, third)

    return advance


def _scalars(values: list[Array], dtype: Any) -> list[Array]:
    return [jnp.asarray(value, dtype) for value in values]


def all_nodes(advance: Step, z0: Float[Array, " n"], effort: Float[Array, "steps ..."]) -> Float[Array, "nodes n"]:
    """States at all steps + 1 nodes."""

    def body(z: list[Array], u: Array) -> tuple[list[Array], list[Array]]:
        z = advance(z, u)
        return z, z

    _, zs = jax.lax.scan(body, [z0[i] for i in range(z0.shape[0])], effort)
    return jnp.concatenate([z0[None], jnp.stack(zs, axis=-1)])
