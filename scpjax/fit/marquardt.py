"""Levenberg-Marquardt as a solver of `optimistix`, for functions whose Jacobian comes with their value."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import lineax as lx
import optimistix as optx
from jaxtyping import Array, Bool, Float, Int

_DAMPING = 1e-2  # of the first step, beside the squares of the scaled columns, which are at most 1
_LEAST = 1e-2  # of the longest column, as which a shorter one counts
_STUCK = 12  # steps refused one after the other


class Factored(eqx.Module):
    """``Q R = J / scale`` of the last step that was accepted: R, Q^T residual, and the scale."""

    triangle: Float[Array, "n n"]
    right: Float[Array, " n"]
    scale: Float[Array, " n"]


class ScaledDescent(optx.AbstractDescent[Array, Any, Factored]):
    """The step p of ``(J^T J + D^2 / step_size) p = -J^T r``, damped in proportion to how much each parameter moves
    the residuals, so that a fit is as quick in any units (Marquardt; J. J. Moré, Lecture Notes in Mathematics 630
    (1978) 105).

    ``D`` holds the longest that each column of J has been, and no column counts as less than a hundredth of the
    longest: else parameters that hardly matter would be thrown far.
    """

    def init(self, y: Array, f_info_struct: Any) -> Factored:
        return Factored(jnp.eye(y.shape[0], dtype=y.dtype), jnp.zeros_like(y), jnp.zeros_like(y))

    def query(self, y: Array, f_info: Any, state: Factored) -> Factored:
        jacobian = f_info.jac.as_matrix()
        length = jnp.linalg.norm(jacobian, axis=0)
        scale = jnp.maximum(state.scale, jnp.maximum(length, _LEAST * jnp.max(length)))
        scale = jnp.where(scale > 0, scale, 1.0)
        r, right = _triangle(jacobian / scale, f_info.residual)
        return Factored(r, right, scale)

    def step(self, step_size: Array, state: Factored) -> tuple[Array, optx.RESULTS]:
        n = state.scale.shape[0]
        damping = jnp.sqrt(_DAMPING / step_size) * jnp.eye(n, dtype=state.scale.dtype)
        r, right = _triangle(
            jnp.concatenate([state.triangle, damping]), jnp.concatenate([state.right, jnp.zeros_like(state.right)])
        )
        along = jax.scipy.linalg.solve_triangular(r, right)
        return -along / state.scale, optx.RESULTS.successful


def _triangle(a: Float[Array, "m n"], b: Float[Array, " m"]) -> tuple[Float[Array, "n n"], Float[Array, " n"]]:
    """``R`` and ``Q^T b`` of ``Q R = a``, both from the triangle of ``[a b]``: ``Q`` is not worked out.

    Nor may it be, where many are side by side (`jax.vmap`): a batch of matrices is shared out among XLA's threads by
    one of them, which waits for the others; with a second batch that does not wait for the first, such as ``Q`` beside
    the next triangle, two cores wait for each other for ever (jaxlib 0.10.2).
    """
    m, n = a.shape
    short = max(n + 1 - m, 0)  # rows that are lacking
    r = jnp.linalg.qr(jnp.pad(jnp.concatenate([a, b[:, None]], axis=1), ((0, short), (0, 0))), mode="r")
    return r[:n, :n], r[:n, n]


class _State(eqx.Module):
    trying: Float[Array, " n"]
    residual: Float[Array, " m"]  # where it stands
    jacobian: Float[Array, "m n"]
    search: Any
    descent: Factored
    first: Bool[Array, ""]
    ended: Bool[Array, ""]
    steps: Int[Array, ""]
    refused: Int[Array, ""]  # one after the other


class Marquardt(optx.AbstractLeastSquaresSolver):
    """Least squares of a function that returns its residuals and, as its auxiliary output, their Jacobian.

    `optimistix.LevenbergMarquardt` damps all parameters alike, and linearises the function itself, which for a
    simulation means keeping every step of it (``python benchmarks/solver.py``). This stops when the cost does:
    parameters that the data leave open drift for ever without changing what is predicted, and a test on their steps
    never ends there.


    ``tolerance``: half the fall of the sum of squares in one step with which it is at rest, beside ``rtol`` of it;
    ``limit``: steps at most.
    """

    tolerance: float | Array
    limit: int | Array
    rtol: float = 1e-6
    atol: float = 0.0
    norm: Callable[[Any], Array] = optx.max_norm
    descent: ScaledDescent = ScaledDescent()
    search: optx.ClassicalTrustRegion = optx.ClassicalTrustRegion(high_cutoff=0.75)

    def init(
        self, fn: Any, y: Array, args: Any, options: Any, f_struct: Any, aux_struct: Any, tags: frozenset[object]
    ) -> _State:
        residual, jacobian = (jnp.zeros(s.shape, s.dtype) for s in (f_struct, aux_struct))
        info = _info(residual, jacobian)
        zero, no = jnp.array(0), jnp.array(False)
        search, descent = self.search.init(y, info), self.descent.init(y, info)
        return _State(y, residual, jacobian, search, descent, jnp.array(True), no, zero, zero)

    def step(
        self, fn: Any, y: Array, args: Any, options: Any, state: _State, tags: frozenset[object]
    ) -> tuple[Array, _State, Array]:
        residual, jacobian = fn(state.trying, args)
        here, there = _info(state.residual, state.jacobian), _info(residual, jacobian)
        step_size, accept, _, search = self.search.step(state.first, y, state.trying, here, there, state.search)
        before, after = 0.5 * jnp.sum(state.residual**2), 0.5 * jnp.sum(residual**2)
        still = accept & ~state.first & (jnp.abs(before - after) < self.tolerance + self.rtol * after)
        y, residual, jacobian = (
            jnp.where(accept, new, old)
            for new, old in ((state.trying, y), (residual, state.residual), (jacobian, state.jacobian))
        )
        descent = jax.lax.cond(
            accept, lambda: self.descent.query(y, _info(residual, jacobian), state.descent), lambda: state.descent
        )
        along, _ = self.descent.step(step_size, descent)
        steps, refused = state.steps + 1, jnp.where(accept, 0, state.refused + 1)
        ended = still | (refused > _STUCK) | (steps >= self.limit)
        return (
            y,
            _State(y + along, residual, jacobian, search, descent, jnp.array(False), ended, steps, refused),
            jacobian,
        )

    def terminate(
        self, fn: Any, y: Array, args: Any, options: Any, state: _State, tags: frozenset[object]
    ) -> tuple[Bool[Array, ""], optx.RESULTS]:
        return state.ended, optx.RESULTS.successful

    def postprocess(
        self,
        fn: Any,
        y: Array,
        aux: Array,
        args: Any,
        options: Any,
        state: _State,
        tags: frozenset[object],
        result: optx.RESULTS,
    ) -> tuple[Array, Array, dict[str, Any]]:
        return y, aux, {}


def _info(residual: Array, jacobian: Array) -> Any:
    return optx.FunctionInfo.ResidualJac(residual, lx.MatrixLinearOperator(jacobian))
