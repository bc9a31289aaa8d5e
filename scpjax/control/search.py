"""A search without derivatives, many points abreast: a Sobol screening, then niches that compete.

Loops that saturate have many optima, and chatter makes some of them rough. The best screened points that lie apart
each become a niche: an evolution strategy with Gaussian steps around its elite; the weaker niches are given up round
by round (successive halving), so that one broad but poor basin does not take all.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np
from jaxtyping import Float

Evaluate = Callable[[Float[np.ndarray, "s p"]], Float[np.ndarray, " s"]]


@dataclass(frozen=True)
class Round:
    """``niches`` stay, each with ``children`` new points in each of ``generations``."""

    niches: int
    children: int
    generations: int


@dataclass(frozen=True, kw_only=True)
class SearchOptions:
    """``screened`` points, then the ``rounds``; steps shrink from ``first`` to ``last`` (in ln of a gain).

    ``apart`` is how far niches begin from each other, as a share of the box; ``elite`` how many points of a niche
    have children. The defaults take 128 + 416 evaluations.
    """

    screened: int = 128
    rounds: tuple[Round, ...] = (Round(8, 12, 3), Round(4, 16, 2))
    first: float = 0.7
    last: float = 0.2
    apart: float = 0.15
    elite: int = 4
    seed: int = 0

    @property
    def evaluations(self) -> int:
        """How many points are evaluated, the given one not counted."""
        return self.screened + sum(r.niches * r.children * r.generations for r in self.rounds)


@dataclass
class Niche:
    """Points (m, p) of one region and their values (m,)."""

    points: np.ndarray
    values: np.ndarray

    @property
    def best(self) -> float:
        return float(self.values.min())


def search(
    evaluate: Evaluate, given: Float[np.ndarray, " p"], low: np.ndarray, high: np.ndarray, options: SearchOptions
) -> tuple[list[Niche], list[float]]:
    """The niches that were left, best first, and the best value after the screening and each generation.

    Values that are not finite count as infinite.
    """
    from scipy.stats import qmc

    rng = np.random.default_rng(options.seed)
    seeded: dict[str, Any] = {"seed": options.seed}  # scipy calls it rng from 1.15 on, and knows both names
    draws = qmc.Sobol(len(low), **seeded).random(options.screened) if options.screened else np.zeros((0, len(low)))
    points = np.concatenate([np.clip(given, low, high)[None], low + (high - low) * draws])
    values = _finite(evaluate(points))
    path = [float(values.min())]
    count = options.rounds[0].niches if options.rounds else 2
    niches = [Niche(points[[i]], values[[i]]) for i in _apart(points, values, (high - low) * options.apart, count)]
    total, done = sum(r.generations for r in options.rounds), 0
    for r in options.rounds:
        niches = sorted(niches, key=lambda n: n.best)[: r.niches]
        for _ in range(r.generations):
            size = options.first * (options.last / options.first) ** (done / max(total - 1, 1))
            _generation(niches, evaluate, rng, size, r.children, options.elite, low, high)
            path.append(min(path[-1], min(n.best for n in niches)))
            done += 1
    return sorted(niches, key=lambda n: n.best), path


def _generation(
    niches: list[Niche],
    evaluate: Evaluate,
    rng: np.random.Generator,
    size: float,
    children: int,
    elite: int,
    low: np.ndarray,
    high: np.ndarray,
) -> None:
    """New points around the elite of every niche, all evaluated at once."""
    born = []
    for niche in niches:
        parents = niche.points[np.argsort(niche.values)[:elite]]
        which = np.minimum(*rng.integers(len(parents), size=(2, children)))  # the better ones more often
        steps = size * rng.standard_normal((children, len(low)))
        born.append(_reflected(parents[which] + steps, low, high))
    values = _finite(evaluate(np.concatenate(born)))
    for niche, points, found in zip(niches, born, np.split(values, len(niches)), strict=True):
        niche.points = np.concatenate([niche.points, points])
        niche.values = np.concatenate([niche.values, found])


def _reflected(points: np.ndarray, low: np.ndarray, high: np.ndarray) -> np.ndarray:
    points = np.where(points < low, 2 * low - points, points)
    return np.clip(np.where(points > high, 2 * high - points, points), low, high)


def _apart(points: np.ndarray, values: np.ndarray, apart: np.ndarray, count: int) -> list[int]:
    """The best points of which no two are neighbours."""
    kept: list[int] = []
    for i in np.argsort(values):
        if len(kept) < count and all(np.linalg.norm((points[i] - points[k]) / apart) > 1 for k in kept):
            kept.append(int(i))
    return kept


def _finite(values: np.ndarray) -> np.ndarray:
    return np.where(np.isfinite(values), values, np.inf)
