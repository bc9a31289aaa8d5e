"""PySINDy: sparse regression of a smoothed derivative on polynomials of the measured states and the same drive.

Brunton, Proctor, Kutz, PNAS 113 (2016); de Silva et al., JOSS 5 (2020). States are the measured columns; a displacement
also brings its velocity. Degree, threshold, smoothing and states are chosen by free runs on held-out stretches.
"""

from __future__ import annotations

import importlib.util
import itertools
import time
import warnings
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from scipy.signal import savgol_filter

from fits.concealed.baselines.series import (
    FAR,
    PERIOD,
    Judged,
    Series,
    factors,
    misfit,
    monomials,
    read_series,
    settles,
    span_of,
    trials,
)

DEGREES = (1, 2, 3)
THRESHOLDS = (0.0, 1e-3, 3e-3, 1e-2, 3e-2, 0.1)
WINDOWS = (5, 11, 25)  # points of the grid of the smoother (Savitzky, Golay), third order
ALPHA = 1e-4  # ridge of sequentially thresholded least squares


def installed() -> bool:
    """Whether PySINDy can be imported."""
    return importlib.util.find_spec("pysindy") is not None


@dataclass(frozen=True)
class Found:
    """Equations z' = weights monomials(z, u), z counted from rest, about 1; ``second``: z ends in a velocity."""

    degree: int
    threshold: float
    window: int
    second: bool
    weights: np.ndarray
    index: np.ndarray
    rest: np.ndarray
    span: np.ndarray
    most: np.ndarray
    moving: int  # column that moves, -1 for none

    def run(self, s: Series, start: np.ndarray) -> np.ndarray:
        """Free run (n, columns)."""
        z = (start - self.rest) / self.span
        if self.second:
            z = np.append(z, 0.0)
        u = s.u / self.most
        out = np.full((len(u), len(self.rest)), np.nan)
        for k in range(len(u)):
            out[k] = z[: len(self.rest)]
            z = self._step(z, u[k], PERIOD)
            if not np.all(np.abs(z[: len(self.rest)]) < FAR):
                break
        return out * self.span + self.rest

    def _rates(self, z: np.ndarray, u: np.ndarray) -> np.ndarray:
        rates = self.weights @ monomials(np.concatenate([z, u]), self.index)
        if self.second:
            rates[self.moving] = z[-1]
        return rates

    def _step(self, z: np.ndarray, u: np.ndarray, h: float) -> np.ndarray:
        """Runge-Kutta, of second order; of fourth with a velocity, which is quick."""
        a = self._rates(z, u)
        b = self._rates(z + 0.5 * h * a, u)
        if not self.second:
            return z + h * b
        c = self._rates(z + 0.5 * h * b, u)
        return z + h / 6 * (a + 2 * b + 2 * c + self._rates(z + h * c, u))


class Learner:
    """Smoothed states and their derivatives of the given files, and the search over what can be chosen."""

    def __init__(self, series: Sequence[Series], noise: np.ndarray):
        self.series, self.noise = list(series), noise
        self.rest = series[0].rest
        self.span = span_of(series)
        self.most = np.maximum(np.max(np.concatenate([s.u for s in series]), axis=0), 1e-9)
        names = series[0].names
        self.moving = next((i for i, n in enumerate(names) if not n.startswith("temperature")), -1)

    def states(self, s: Series, window: int, second: bool) -> tuple[np.ndarray, np.ndarray]:
        """(z, dz/dt) (n, states), smoothed."""
        scaled = (s.y - self.rest) / self.span

        def smooth(order: int, x: np.ndarray) -> np.ndarray:
            return np.asarray(savgol_filter(x, window, 3, deriv=order, delta=PERIOD, axis=0))

        z, rates = smooth(0, scaled), smooth(1, scaled)
        if second:
            twice = smooth(2, scaled[:, self.moving])
            z, rates = np.column_stack([z, rates[:, self.moving]]), np.column_stack([rates, twice])
        return z, rates

    def fit(self, degree: int, threshold: float, window: int, second: bool, *, everything: bool = False) -> Found:
        """One sparse regression by PySINDy."""
        import pysindy  # pyright: ignore[reportMissingImports]  # extra [baselines]

        z, rates, u = [], [], []
        for s in self.series:
            a, b = self.states(s, window, second)
            for part in [np.full(len(a), True)] if everything else _runs(~s.held):
                z.append(a[part])
                rates.append(b[part])
                u.append(s.u[part] / self.most)
        model: Any = pysindy.SINDy(
            optimizer=pysindy.STLSQ(threshold=threshold, alpha=ALPHA),
            feature_library=pysindy.PolynomialLibrary(degree=degree),
        )
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")
            model.fit(z, t=PERIOD, x_dot=rates, u=u)
        index = factors(np.asarray(model.feature_library.powers_))
        weights = np.asarray(model.coefficients())
        return Found(degree, threshold, window, second, weights, index, self.rest, self.span, self.most, self.moving)

    def judge(self, found: Found) -> float:
        """Misfit of free runs on the held-out stretches."""
        with np.errstate(all="ignore"):
            return misfit(self.series, [found.run(s, s.start(self.noise)) for s in self.series], self.noise)

    def choose(self) -> tuple[Found, float]:
        """The best on the held-out stretches."""
        orders = (False, True) if self.moving >= 0 else (False,)
        tried = []
        for degree, threshold, window, second in itertools.product(DEGREES, THRESHOLDS, WINDOWS, orders):
            found = self.fit(degree, threshold, window, second)
            tried.append((found, self.judge(found)))
        tried.sort(key=lambda t: t[1])
        return next((t for t in tried if self.settles(t[0])), tried[0])

    def settles(self, found: Found) -> bool:
        """Whether it can be trusted with other drives."""
        s = self.series[0]
        with np.errstate(all="ignore"):
            return settles([found.run(t, s.rest) for t in trials(s)], self.rest, self.span)


def _runs(keep: np.ndarray) -> list[np.ndarray]:
    """Masks of the stretches in which ``keep`` holds."""
    edges = np.flatnonzero(np.diff(keep.astype(int), prepend=0, append=0))
    out = []
    for a, b in zip(edges[::2], edges[1::2], strict=True):
        mask = np.zeros(len(keep), bool)
        mask[a:b] = True
        out.append(mask)
    return out


def judge(given: Sequence[str | Path], kept: Sequence[str | Path], noise: np.ndarray) -> Judged:
    """Learn from the given files, run freely on the kept ones."""
    began = time.monotonic()
    learner = Learner([read_series(f) for f in given], noise)
    chosen, left = learner.choose()
    final = learner.fit(chosen.degree, chosen.threshold, chosen.window, chosen.second, everything=True)
    if learner.judge(final) > 2 * left or not learner.settles(final):
        final = chosen
    errors = {}
    for file in kept:
        s = read_series(file)
        with np.errstate(all="ignore"):
            run = final.run(s, s.start(noise))
        errors[Path(file).stem] = dict(zip(s.names, s.rmse(run).tolist(), strict=True))
    what = {"degree": final.degree, "threshold": final.threshold, "window": final.window, "velocity": final.second}
    equations = int(np.count_nonzero(final.weights))
    return Judged(what | {"terms": equations, "held_out_misfit": left**0.5}, errors, time.monotonic() - began)
