"""Gains by differentiating an objective through the whole saturated loop, from many starts at once.

First a search without derivatives, many loops abreast (`scpjax.control.search`), then a walk along the narrow valleys
that saturation makes (`scpjax.control.valley`), then the best points go on by a Levenberg-Marquardt method in ln(gain),
kept within bounds by projection. With four gains the cheapest derivative is
forward: a loop and its tangents run abreast in one scan. They also give a generalised Gauss-Newton matrix, J' H J with
the objective's own second derivative H in the response (Schraudolph, Neural Computation 14 (2002) 1723).
"""

from __future__ import annotations

import math
import time as clock
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import Any, NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from scpjax.compiled import quickly_compiled
from scpjax.control.controller import Controller, Scalar
from scpjax.control.errors import ControlError
from scpjax.control.loop import Response
from scpjax.control.problem import BOUNDS, EXTRA, Problem, gains_of, with_gains
from scpjax.control.search import SearchOptions, search
from scpjax.control.valley import WalkOptions, walk


@dataclass(frozen=True, kw_only=True)
class TuneOptions:
    """``free`` names what is tuned and its ``bounds``; after the ``search`` and the ``walk`` (None for none) the best
    ``refined`` points go on for ``steps`` steps with derivatives. With the defaults 1196 loops at most, tangents
    counted as loops.
    """

    free: tuple[str, ...] = ("Kp", "Ki", "Kd", "N")
    bounds: Mapping[str, tuple[float, float]] = field(default_factory=lambda: {**BOUNDS, **EXTRA})
    search: SearchOptions = field(default_factory=SearchOptions)
    walk: WalkOptions | None = field(default_factory=WalkOptions)
    refined: int = 1
    steps: int = 10
    seed: int = 0

    def __post_init__(self) -> None:
        if not self.free:
            raise ControlError("nothing to tune", mend="name gains in free")
        for name in self.free:
            low, high = self.bounds.get(name, (math.nan, math.nan))
            if not 0 < low < high < math.inf:
                raise ControlError(f"{name} cannot be tuned between {low:g} and {high:g}", mend="give 0 < low < high")
        if self.refined < 0 or self.steps < 1:
            raise ControlError(f"{self.refined} points refined in {self.steps} steps", mend="give 0 points or more")


class Point(NamedTuple):
    """A point of the search with its derivatives: ``at`` is ln(value) of what is free."""

    at: Float[Array, " p"]
    value: Scalar
    slope: Float[Array, " p"]
    bend: Float[Array, "p p"]


def value_at(problem: Problem, free: tuple[str, ...], at: Float[Array, " p"]) -> Scalar:
    """Objective at ln(values) of what is ``free``."""
    return problem.value(_controller(problem, free, at))


def value_and_gradient(problem: Problem, free: tuple[str, ...], at: Float[Array, " p"]) -> tuple[Scalar, Array]:
    """Objective and its gradient in ln(values) by tangents abreast."""
    push = lambda v: jax.jvp(lambda p: value_at(problem, free, p), (at,), (v,))  # noqa: E731
    return jax.vmap(push, out_axes=(None, 0))(jnp.eye(len(free), dtype=at.dtype))


def values_and_gradients(
    problem: Problem, free: tuple[str, ...], points: Float[Array, "s p"]
) -> tuple[Float[Array, " s"], Float[Array, "s p"]]:
    """Objective and its gradient at many points abreast; the tangents lie outermost, which is the quicker order."""
    look = lambda x: jax.vmap(lambda at: value_at(problem, free, at))(x)  # noqa: E731
    push = lambda v: jax.jvp(look, (points,), (jnp.broadcast_to(v, points.shape),))  # noqa: E731
    values, slopes = jax.vmap(push, out_axes=(None, 0))(jnp.eye(len(free), dtype=points.dtype))
    return values, slopes.T


def point_at(problem: Problem, free: tuple[str, ...], at: Float[Array, " p"]) -> Point:
    """Objective, gradient and generalised Gauss-Newton matrix in ln(values)."""

    def trajectory(p: Array) -> tuple[Controller, Response]:
        controller = _controller(problem, free, p)
        return controller, problem.responses(controller)

    push = lambda v: jax.jvp(trajectory, (at,), (v,))  # noqa: E731
    made, tangents = jax.vmap(push, out_axes=(None, 0))(jnp.eye(len(free), dtype=at.dtype))
    leaves, form = jax.tree.flatten(made)
    moves = jax.tree.leaves(tangents)
    floats = [i for i, x in enumerate(leaves) if jnp.issubdtype(x.dtype, jnp.floating)]

    def worth(parts: list[Array]) -> Scalar:
        whole = list(leaves)
        for i, part in zip(floats, parts, strict=True):
            whole[i] = part
        return problem.worth(*jax.tree.unflatten(form, whole))

    parts, ways = [leaves[i] for i in floats], [moves[i] for i in floats]
    value, slope = jax.value_and_grad(worth)(parts)
    bent = jax.vmap(lambda v: jax.jvp(jax.grad(worth), (parts,), (v,))[1])(ways)
    gradient: Any = sum(jnp.tensordot(w, s, axes=s.ndim) for w, s in zip(ways, slope, strict=True))
    bend: Any = sum(jnp.tensordot(w, b, axes=[list(range(1, w.ndim))] * 2) for w, b in zip(ways, bent, strict=True))
    return Point(at, value, gradient, (bend + bend.T) / 2)


def _controller(problem: Problem, free: tuple[str, ...], at: Array) -> Controller:
    return with_gains(problem.loop.controller, dict(zip(free, jnp.exp(at), strict=True)))


def _move(point: Point, damping: Scalar, low: Array, high: Array) -> Array:
    """Levenberg-Marquardt step within bounds: what would leave them ends there, and the rest is solved again."""
    diagonal = jnp.diag(point.bend)
    scale = jnp.maximum(diagonal, 1e-3 * jnp.max(jnp.abs(diagonal)) + 1e-12)
    matrix = point.bend + damping * jnp.diag(scale)
    at, slope = point.at, point.slope
    down, up = jnp.maximum(low - at, -_FARTHEST), jnp.minimum(high - at, _FARTHEST)
    ended = jnp.where((at <= low) & (slope > 0), down, jnp.where((at >= high) & (slope < 0), up, jnp.nan))
    step = jnp.zeros_like(at)
    for _ in range(at.shape[0]):
        held = ~jnp.isnan(ended)
        known = jnp.where(held, ended, 0.0)
        reduced = jnp.where(held[:, None] | held[None, :], jnp.diag(scale), matrix)
        free = -jnp.linalg.solve(reduced, jnp.where(held, 0.0, slope + matrix @ known))
        step = jnp.where(held, known, free)
        ended = jnp.where(held, ended, jnp.where(step < down, down, jnp.where(step > up, up, jnp.nan)))
    return jnp.clip(at + jnp.clip(step, down, up), low, high)


_FARTHEST = 1.5  # of one step, in ln(gain)


@quickly_compiled
def _refine(
    problem: Problem, free: tuple[str, ...], starts: Float[Array, "k p"], low: Array, high: Array, steps: int
) -> tuple[Point, Float[Array, "steps k"]]:
    """``steps`` steps from each start; an evaluation each."""

    def one(carry: tuple[Point, Scalar], _: None) -> tuple[tuple[Point, Scalar], Scalar]:
        best, damping = carry
        found = point_at(problem, free, _move(best, damping, low, high))
        good = jnp.all(jnp.isfinite(found.slope)) & (found.value < best.value)
        better = jnp.where(jnp.isinf(best.value), damping, damping / 5)
        best = jax.tree.map(lambda a, b: jnp.where(good, a, b), found, best)
        return (best, jnp.clip(jnp.where(good, better, damping * 10), 1e-8, 1e8)), best.value

    def from_start(at: Array) -> tuple[Point, Array]:
        # nothing is known yet: a slope of zero makes the first step stay, and anything is better than infinity
        nothing = Point(at, jnp.asarray(jnp.inf), jnp.zeros_like(at), jnp.eye(at.shape[0]))
        (best, _), path = jax.lax.scan(one, (nothing, jnp.asarray(1e-2)), None, length=steps)
        return best, path

    point, path = jax.vmap(from_start)(starts)
    return point, path.T


@dataclass(frozen=True, kw_only=True)
class Tuned:
    """A controller that is at least as good as the one given.

    ``value`` and ``before`` are the objective after and before, ``loops`` how many loops were run (a tangent counts
    as one), ``seconds`` the time that took, ``path`` (steps, refined) the best values on the way.
    """

    controller: Controller
    gains: Mapping[str, float]
    given: Mapping[str, float]
    value: float
    before: float
    loops: int
    seconds: float
    path: np.ndarray
    at_bound: tuple[str, ...]

    @property
    def improved(self) -> bool:
        """Whether something better than what was given was found."""
        return not self.value >= self.before  # also than gains under which the loop does not stay finite


def tune(problem: Problem, options: TuneOptions | None = None) -> Tuned:
    """Tune the controller of a problem's loop; never worse than it was given.

    **Raises** `ControlError` where the objective is not finite at any start.
    """
    o = TuneOptions() if options is None else options
    began = clock.perf_counter()
    given = gains_of(problem.loop.controller)
    for name in o.free:
        if name not in given:
            raise ControlError(f"the controller has no {name}", mend=f"it has {', '.join(given)}")
    low, high = (np.log([o.bounds[n][i] for n in o.free]) for i in (0, 1))
    mine = np.log([max(abs(given[n]), 1e-12) for n in o.free])
    before = float(_given_value(problem))
    count = _Counter(problem, o.free)
    niches, path = search(count, mine, low, high, replace(o.search, seed=o.search.seed + o.seed))
    if not np.isfinite(path[-1]):
        raise ControlError("the objective is finite for none of the starts", mend="check the plant and the bounds")
    starts, values = np.stack([n.points[np.argmin(n.values)] for n in niches]), np.array([n.best for n in niches])
    if o.walk is not None:
        starts, values, more = walk(count, starts, values, low, high, o.walk, seed=o.seed)
        path += more
    starts = starts[: max(o.refined, 1)]
    at, value, refined = starts[0], values[0], 0
    if o.refined:
        point, steps = _refine(problem, o.free, jnp.asarray(starts), jnp.asarray(low), jnp.asarray(high), o.steps)
        path += np.minimum(np.min(steps, axis=1), path[-1]).tolist()
        found, refined = np.where(np.isfinite(point.value), point.value, np.inf), len(starts) * o.steps
        if found.min() <= value:
            at, value = np.asarray(point.at)[int(np.argmin(found))], found.min()
    better = bool(not value >= before)  # than gains under which the loop does not stay finite, all that does is better
    controller = with_gains(problem.loop.controller, dict(zip(o.free, np.exp(at).tolist(), strict=True)))
    controller = controller if better else problem.loop.controller
    edge = (np.abs(at - low) < 1e-6) | (np.abs(at - high) < 1e-6)
    runs = 1 + count.points + refined * (1 + len(o.free))
    return Tuned(
        controller=controller,
        gains=gains_of(controller),
        given=given,
        value=float(value) if better else before,
        before=before,
        loops=runs * problem.loops,
        seconds=clock.perf_counter() - began,
        path=np.array(path),
        at_bound=tuple(n for n, e in zip(o.free, edge, strict=True) if e and better),
    )


_FEW, _ABREAST = 8, 128


class _Counter:
    """Values of many points, few or many abreast, so that two compiled functions serve all; counts them.

    What is not finite counts as infinite.
    """

    def __init__(self, problem: Problem, free: tuple[str, ...]):
        self.problem, self.free, self.points = problem, free, 0

    def __call__(self, points: Float[np.ndarray, "s p"]) -> Float[np.ndarray, " s"]:
        self.points += len(points)
        abreast = max((_FEW if len(points) <= _FEW else _ABREAST) // self.problem.loops, 1)
        values = []
        for i in range(0, len(points), abreast):
            part = points[i : i + abreast]
            padded = np.concatenate([part, np.repeat(part[-1:], abreast - len(part), axis=0)])
            values.append(np.asarray(values_at(self.problem, self.free, jnp.asarray(padded)))[: len(part)])
        found = np.concatenate(values)
        return np.where(np.isfinite(found), found, np.inf)


@quickly_compiled
def values_at(problem: Problem, free: tuple[str, ...], points: Float[Array, "s p"]) -> Float[Array, " s"]:
    """Objective at each of many points, ln(values) of what is ``free``."""
    return jax.vmap(lambda at: value_at(problem, free, at))(points)


@quickly_compiled
def _given_value(problem: Problem) -> Scalar:
    return problem.value(problem.loop.controller)


def responses_before_and_after(problem: Problem, tuned: Tuned) -> tuple[Response, Response]:
    """Responses of the given and the tuned controller, leading axis as in `Problem.responses`."""
    make = eqx.filter_jit(lambda p, c: p.responses(c))
    return make(problem, problem.loop.controller), make(problem, tuned.controller)


def as_table(tuned: Tuned, free: Sequence[str] = ("Kp", "Ki", "Kd", "N")) -> list[tuple[str, float, float]]:
    """(name, before, after) of the gains."""
    return [(name, tuned.given[name], tuned.gains[name]) for name in free]
