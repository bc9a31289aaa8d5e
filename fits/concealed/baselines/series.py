"""Recordings as the baselines see them: an even grid, squared volts in, measured columns out, stretches held out."""

from __future__ import annotations

import tomllib
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
from scipy.ndimage import median_filter

PERIOD = 0.1  # s, of the grid
HELD = ((0.25, 0.35), (0.60, 0.70), (0.90, 1.0))  # shares of every given file on which hyperparameters are chosen
FAR = 10.0  # a free run that leaves the range by this factor has diverged


@dataclass(frozen=True)
class Series:
    """One recording on the grid: inputs u (n, inputs) [V^2], mean over the cell to come; outputs y (n, columns).

    ``rest``: outputs of an actuator at rest. ``times`` and ``measured`` (m, columns) are the samples themselves, on
    which errors are counted. Units of outputs are those of the file.
    """

    u: np.ndarray
    y: np.ndarray
    names: tuple[str, ...]
    rest: np.ndarray
    times: np.ndarray
    measured: np.ndarray

    @property
    def held(self) -> np.ndarray:
        """Which points of the grid are held out (n,)."""
        share = np.arange(len(self.u)) / len(self.u)
        return np.any([(share >= a) & (share < b) for a, b in HELD], axis=0)

    def start(self, noise: np.ndarray) -> np.ndarray:
        """Outputs at the start: rest, unless the first sample is clearly elsewhere (over four times the noise)."""
        first = self.measured[0]
        return np.where(np.abs(first - self.rest) > 4 * noise, first, self.rest)

    def rmse(self, run: np.ndarray) -> np.ndarray:
        """RMSE of a run (n, columns) on the grid against the samples, by column; inf where it diverged."""
        if not np.all(np.isfinite(run)):
            return np.full(len(self.names), np.inf)
        grid = np.arange(len(run)) * PERIOD
        said = np.column_stack([np.interp(self.times, grid, run[:, j]) for j in range(run.shape[1])])
        return np.sqrt(np.mean((said - self.measured) ** 2, axis=0))


def read_series(path: str | Path) -> Series:
    """Read a CSV onto the grid: the drive averaged over each cell to come, outputs over half a cell to either side."""
    path = Path(path)
    with path.open(encoding="utf-8") as f:
        header = f.readline().strip().split(",")
    table = np.loadtxt(path, delimiter=",", skiprows=1)
    t = table[:, 0] - table[0, 0]
    drives = [i for i, c in enumerate(header) if c.startswith("voltage")]
    outputs = [i for i in range(1, len(header)) if i not in drives]
    grid = np.arange(0.0, t[-1] + 1e-6, PERIOD)
    u = np.column_stack([_mean_ahead(t, table[:, i] ** 2, grid) for i in drives])
    y = np.column_stack([_mean_about(t, _without_wild(table[:, i]), grid) for i in outputs])
    room = tomllib.loads(path.with_suffix(".toml").read_text(encoding="utf-8"))["environment"]["ambient_degC"]
    names = tuple(header[i] for i in outputs)
    rest = np.array([room if n.startswith("temperature") else 0.0 for n in names])
    return Series(u, y, names, rest, t, table[:, outputs])


def _mean_ahead(t: np.ndarray, x: np.ndarray, grid: np.ndarray) -> np.ndarray:
    """Mean over [g, g + PERIOD) of a value held from each sample to the next, the last one for ever."""
    last = max(t[-1], grid[-1]) + PERIOD
    times = np.append(t, last)
    total = np.concatenate([[0.0], np.cumsum(x * np.diff(times))])
    return np.diff(np.interp(np.append(grid, grid[-1] + PERIOD), times, total)) / PERIOD


def _mean_about(t: np.ndarray, x: np.ndarray, grid: np.ndarray) -> np.ndarray:
    """Mean over [g - PERIOD/2, g + PERIOD/2] of a value that runs straight from sample to sample."""
    total = np.concatenate([[0.0], np.cumsum(0.5 * (x[1:] + x[:-1]) * np.diff(t))])
    low, high = np.maximum(grid - PERIOD / 2, t[0]), np.minimum(grid + PERIOD / 2, t[-1])
    inside = np.maximum(high - low, 1e-9)
    return np.where(high > low, (np.interp(high, t, total) - np.interp(low, t, total)) / inside, np.interp(grid, t, x))


def _without_wild(x: np.ndarray) -> np.ndarray:
    """Samples over five robust deviations from the median of nine replaced by it (Hampel's filter)."""
    middle = median_filter(x, 9, mode="nearest")
    off = np.abs(x - middle)
    return np.where(off > 5 * 1.4826 * max(float(np.median(off)), 1e-12), middle, x)


def misfit(series: Sequence[Series], runs: Sequence[np.ndarray], noise: np.ndarray) -> float:
    """Mean square over squared noise of free runs on the held-out stretches, of the worst column; inf if diverged."""
    if not all(np.all(np.isfinite(r)) for r in runs):
        return np.inf
    off = np.concatenate([((r - s.y) / noise)[s.held] for s, r in zip(series, runs, strict=True)])
    return float(np.max(np.mean(off**2, axis=0)))


def trials(s: Series) -> list[Series]:
    """Drives to try a model on before it is trusted: each input, and all, held at four powers for 80 s each."""
    n, inputs = round(80 / PERIOD), s.u.shape[1]
    patterns = [*np.eye(inputs), np.ones(inputs)] if inputs > 1 else [np.ones(1)]
    powers = np.repeat([0.5, 1.0, 0.25, 0.0], n)[:, None] * np.max(s.u, axis=0)
    return [replace(s, u=powers * p) for p in patterns]


def settles(runs: Sequence[np.ndarray], rest: np.ndarray, span: np.ndarray) -> bool:
    """Whether runs under such drives stay within six times the range that was seen."""
    return all(bool(np.all(np.abs((r - rest) / span) < 6.0)) for r in runs)


def span_of(series: Sequence[Series]) -> np.ndarray:
    """Greatest distance of each output from rest."""
    return np.maximum(np.max(np.abs(np.concatenate([s.y - s.rest for s in series])), axis=0), 1e-9)


def terms(variables: int, degree: int) -> np.ndarray:
    """Exponents (terms, variables) of all monomials up to a degree, the constant first."""
    found = [np.zeros(variables, int)]
    frontier = [(found[0], 0)]
    for _ in range(degree):
        grown = []
        for powers, first in frontier:
            for i in range(first, variables):
                more = powers.copy()
                more[i] += 1
                grown.append((more, i))
        found += [p for p, _ in grown]
        frontier = grown
    return np.array(found)


def factors(powers: np.ndarray) -> np.ndarray:
    """Monomials (terms, degree) as indices of what is multiplied; the last index stands for 1."""
    variables, degree = powers.shape[1], max(1, int(powers.sum(axis=1).max()))
    out = np.full((len(powers), degree), variables)
    for i, row in enumerate(powers):
        picked = np.repeat(np.arange(variables), row)
        out[i, : len(picked)] = picked
    return out


def monomials(z: np.ndarray, index: np.ndarray) -> np.ndarray:
    """Values (..., terms) of monomials at z (..., variables)."""
    one = np.ones((*z.shape[:-1], 1))
    whole = np.concatenate([z, one], axis=-1)
    out = whole[..., index[:, 0]]
    for column in index.T[1:]:
        out = out * whole[..., column]
    return out


@dataclass(frozen=True)
class Judged:
    """What a baseline came to: what was chosen, kept-file RMSE {file: {column: rmse}}, seconds."""

    chosen: dict[str, object]
    kept: dict[str, dict[str, float]]
    seconds: float

    def plain(self) -> Mapping[str, object]:
        """For JSON; a run that diverged is None."""
        kept = {f: {c: v if np.isfinite(v) else None for c, v in row.items()} for f, row in self.kept.items()}
        return {"chosen": self.chosen, "kept": kept, "seconds": self.seconds}
