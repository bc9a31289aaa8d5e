"""A walk along the floor of a narrow valley, without derivatives, many lines abreast.

Where a swing's end meets a switch of the drive, an objective falls towards a cliff that a change of a gain by one part
in a thousand misses: the bottom lies along a surface, steep on both sides of it. Points drawn at random around one on
the bottom almost never lie on it, so a search that compares them does not see that the bottom itself slopes. Here every
trial steps along the surface, is led back to its bottom by a line search across it, and only then compared. What was
found so far tells how the surface bends and where it falls.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field

import numpy as np
from jaxtyping import Float

Evaluate = Callable[[Float[np.ndarray, "s p"]], Float[np.ndarray, " s"]]
Points = Float[np.ndarray, "k p"]
Values = Float[np.ndarray, " k"]


@dataclass(frozen=True, kw_only=True)
class WalkOptions:
    """At most ``evaluations`` points; lengths in ln of a gain.

    Walks from ``several`` points take ``rounds`` rounds, then the best goes on alone. Each round has ``trials`` steps,
    ``step`` long at first; a line search spans the share ``across`` of the step and ends at ``tolerance``. The way
    across a valley is that in which the objective changes over ``probe``.
    """

    evaluations: int = 600
    several: int = 2
    rounds: int = 2
    trials: int = 3
    step: float = 0.25
    longest: float = 0.8
    across: float = 0.25
    tolerance: float = 2e-3
    probe: float = 0.05


@dataclass
class _Walk:
    at: np.ndarray
    value: float
    across: np.ndarray
    step: float
    points: list[np.ndarray] = field(default_factory=list)
    values: list[float] = field(default_factory=list)
    last: np.ndarray | None = None

    def trials(self, count: int, rng: np.random.Generator) -> list[np.ndarray]:
        """Points to be led to the bottom: as the last step, downhill, and at random."""
        along = _along(self.across)
        where = (np.array(self.points) - self.at) @ along
        off = (np.array(self.points) - self.at) @ self.across
        weight = np.exp(-0.5 * (np.linalg.norm(where, axis=1) / (1.5 * self.step)) ** 2)[:, None]
        known = len(where) > along.shape[0]
        bend = _fitted(where, off, weight, 1e-4) if known else np.zeros(along.shape[1])
        fall = _fitted(where, np.array(self.values) - self.value, weight, 1e-3 * self.step**2)
        found = []
        for k in range(count):
            move = self.step * rng.standard_normal(along.shape[1])
            if k == 0 and self.last is not None:
                move = along.T @ self.last
            elif k == 1 and known and np.any(fall):
                move = -1.5 * self.step * fall / np.linalg.norm(fall)
            found.append(self.at + along @ move + self.across * (bend @ move))
        return found

    def take(self, points: Points, values: Values, longest: float) -> None:
        """Go to the best of the trials if it is better; longer steps then, shorter ones otherwise."""
        finite = np.isfinite(values)
        self.points += list(points[finite])
        self.values += values[finite].tolist()
        k = int(np.argmin(values))
        if values[k] < self.value:
            self.last, self.at, self.value = points[k] - self.at, points[k], float(values[k])
            self.step = min(1.3 * self.step, longest)
        else:
            self.last, self.step = None, 0.7 * self.step


def walk(
    evaluate: Evaluate,
    starts: Points,
    values: Values,
    low: np.ndarray,
    high: np.ndarray,
    options: WalkOptions,
    *,
    seed: int = 0,
) -> tuple[Points, Values, list[float]]:
    """Where walks from the first ``several`` starts ended, best first, their values, and the best after each round.

    Values that are not finite must be infinite; at least one start is finite.
    """
    o, rng, p = options, np.random.default_rng(seed), starts.shape[1]
    some = np.flatnonzero(np.isfinite(values))[: o.several]
    starts, values = starts[some], values[some]
    first = p + 2 + _sections(o.step, o.tolerance)
    if o.evaluations < len(starts) * first:
        return starts, values, []
    ways = _steepest(evaluate, starts, values, low, high, o.probe)
    bottom, least = across(evaluate, starts, values, ways, low, high, 0.5 * o.step, o.tolerance)
    walks = [_Walk(x, float(v), w, o.step, [x], [float(v)]) for x, v, w in zip(bottom, least, ways, strict=True)]
    used, path, done = len(starts) * first, [float(least.min())], 0
    while p > 1:
        walks.sort(key=lambda w: w.value)
        active = walks if done < o.rounds else walks[:1]
        span = o.across * min(w.step for w in active)
        cost = len(active) * o.trials * (3 + _sections(2 * span, o.tolerance))
        if used + cost > o.evaluations:
            break
        points = np.clip(np.concatenate([w.trials(o.trials, rng) for w in active]), low, high)
        ways = np.repeat([w.across for w in active], o.trials, axis=0)
        bottom, least = across(evaluate, points, evaluate(points), ways, low, high, span, o.tolerance)
        for k, w in enumerate(active):
            mine = slice(k * o.trials, (k + 1) * o.trials)
            w.take(bottom[mine], least[mine], o.longest)
            if w.step * o.across < o.tolerance:  # nothing better near by: look farther again
                w.step = o.step
        used, done = used + cost, done + 1
        path.append(min(w.value for w in walks))
    walks.sort(key=lambda w: w.value)
    return np.array([w.at for w in walks]), np.array([w.value for w in walks]), path


def across(
    evaluate: Evaluate,
    points: Points,
    values: Values,
    ways: Points,
    low: np.ndarray,
    high: np.ndarray,
    span: float,
    tolerance: float,
) -> tuple[Points, Values]:
    """The least along a line through each point, all lines abreast: a bracket, then golden sections.

    Kiefer, Proc. Amer. Math. Soc. 4 (1953) 502. Never worse than the point; bounds are kept by cutting off.
    """
    place = lambda t: np.clip(points + t[:, None] * ways, low, high)  # noqa: E731
    look = lambda t: evaluate(place(t))  # noqa: E731
    end = np.full(len(points), span)
    left, right = look(-end), look(end)
    down, up = (left < values) & (left <= right), (right < values) & (right < left)
    a = np.where(down, -2 * span, np.where(up, 0.0, -span))
    b = np.where(down, 0.0, np.where(up, 2 * span, span))
    at = np.where(down, -span, np.where(up, span, 0.0))
    best = np.minimum(values, np.minimum(left, right))
    for _ in range(_sections(2 * span, tolerance)):
        lower = at - a > b - at
        new = np.where(lower, at - _GOLDEN * (at - a), at + _GOLDEN * (b - at))
        found = look(new)
        better = found < best
        a, b = (
            np.where(better & ~lower, at, np.where(~better & lower, new, a)),
            np.where(better & lower, at, np.where(~better & ~lower, new, b)),
        )
        at, best = np.where(better, new, at), np.where(better, found, best)
    return place(at), best


_GOLDEN = (3 - np.sqrt(5)) / 2


def _sections(length: float, tolerance: float) -> int:
    """Golden sections that bring a length down to the tolerance."""
    return max(int(np.ceil(np.log(length / tolerance) / -np.log(1 - _GOLDEN))), 0)


def _steepest(
    evaluate: Evaluate, points: Points, values: Values, low: np.ndarray, high: np.ndarray, probe: float
) -> Points:
    """Unit vectors along which the objective changes most over ``probe``: no derivative, which chatter would spoil."""
    k, p = points.shape
    sign = np.where(points + probe > high, -probe, probe)
    moved = points[:, None, :] + sign[:, :, None] * np.eye(p)
    change = evaluate(np.clip(moved, low, high).reshape(-1, p)).reshape(k, p) - values[:, None]
    slope = np.where(np.isfinite(change), change, 0.0) / sign
    size = np.linalg.norm(slope, axis=1, keepdims=True)
    return np.where(size > 0, slope / np.where(size > 0, size, 1.0), np.eye(p)[0])


def _along(way: np.ndarray) -> np.ndarray:
    """Unit vectors (p, p - 1) at right angles to one."""
    basis, _ = np.linalg.qr(np.column_stack([way, np.eye(len(way))]))
    return basis[:, 1 : len(way)]


def _fitted(where: np.ndarray, values: np.ndarray, weight: np.ndarray, ridge: float) -> np.ndarray:
    """Slope of a plane through the origin by weighted least squares."""
    weighted = (where * weight).T
    return np.linalg.solve(weighted @ where + ridge * np.eye(where.shape[1]), weighted @ values)
