"""A black box: polynomial NARX, y(t) = p(y(t - P), y(t - 2P), ..., u over the last P, ...), ridge regression.

Billings, Nonlinear System Identification (2013), ch. 2-3. A step P spans several points of the grid, so there is a
regression for every point and a free run for every phase. One-step regression on noisy outputs is biased: they may be
smoothed, and the best few are regressed again on their own free runs (output error by pseudo-linear regression: Ljung,
10.4). Whatever predicts the held-out stretches best, free-running, is kept and fitted again to all that was given.
"""

from __future__ import annotations

import itertools
import time
from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
from scipy.ndimage import uniform_filter1d

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
    terms,
    trials,
)

STEPS = (2, 5, 10)  # points of the grid to a step
LAGS = ((1, 1), (2, 2), (3, 2), (4, 4))  # of outputs, of inputs
DEGREES = (1, 2, 3)
RIDGES = (1e-8, 1e-6, 1e-4)
MOST_TERMS = 200
REFINED = 8  # candidates that are regressed on their own free runs
ROUNDS = 4


@dataclass(frozen=True)
class Narx:
    """A model: outputs are counted from rest in units of their span, inputs in units of the greatest."""

    step: int
    smooth: int  # points that regressors are averaged over
    lags: tuple[int, int]
    degree: int
    ridge: float
    weights: np.ndarray  # (terms, outputs)
    index: np.ndarray
    rest: np.ndarray
    span: np.ndarray
    most: np.ndarray
    rounds: int = 0

    def inputs(self, s: Series) -> np.ndarray:
        """Lagged inputs (n, lags * inputs) of every point: means over the last step, the one before it, ..."""
        u = s.u / self.most
        reach = self.step * self.lags[1]
        total = np.concatenate([np.zeros((reach + 1, u.shape[1])), np.cumsum(u, axis=0)])[: reach + len(u)]
        edges = [total[reach - i * self.step : reach - i * self.step + len(u)] for i in range(self.lags[1] + 1)]
        return np.concatenate([(a - b) / self.step for a, b in itertools.pairwise(edges)], axis=1)

    def run(self, s: Series, start: np.ndarray) -> np.ndarray:
        """Free run (n, outputs): it sees the inputs and where it starts."""
        n, m, (na, _) = len(s.u), self.step, self.lags
        blocks = -(-(n - 1) // m)
        u = np.zeros((blocks * m, len(self.most) * self.lags[1]))
        u[: n - 1] = self.inputs(s)[1:]
        y = np.empty(((na + blocks) * m, len(self.rest)))
        y[: na * m] = (start - self.rest) / self.span
        for b in range(blocks):
            at = (na + b) * m
            past = [y[at - i * m : at - i * m + m] for i in range(1, na + 1)]
            now = monomials(np.concatenate([*past, u[b * m : b * m + m]], axis=1), self.index) @ self.weights
            if not np.all(np.abs(now) < FAR):
                return np.full((n, len(self.rest)), np.nan)
            y[at : at + m] = now
        return y[na * m - 1 : na * m - 1 + n] * self.span + self.rest


def regressors(model: Narx, s: Series, past: np.ndarray, start: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """(monomials, wanted) of all points but the first, with ``past`` (n, outputs) as the outputs before."""
    m, (na, _) = model.step, model.lags
    y = (np.concatenate([np.tile(start, (na * m, 1)), past[1:]]) - model.rest) / model.span
    n = len(past) - 1
    lagged = [y[(na - i) * m : (na - i) * m + n] for i in range(1, na + 1)]
    z = np.concatenate([*lagged, model.inputs(s)[1:]], axis=1)
    return monomials(z, model.index), (s.y[1:] - model.rest) / model.span


def fit(model: Narx, series: Sequence[Series], pasts: Sequence[np.ndarray], noise: np.ndarray, every: bool) -> Narx:
    """Ridge regression on the stretches that are not held out (or on all)."""
    gram, right, number = np.zeros((len(model.index),) * 2), 0.0, 0
    for s, past in zip(series, pasts, strict=True):
        a, b = regressors(model, s, past, s.start(noise))
        if not every:
            a, b = a[~s.held[1:]], b[~s.held[1:]]
        gram, right, number = gram + a.T @ a, right + a.T @ b, number + len(a)
    return replace(model, weights=np.linalg.solve(gram + model.ridge * number * np.eye(len(gram)), right))


def candidates(series: Sequence[Series]) -> list[Narx]:
    """Every combination that is not too large."""
    rest, span = series[0].rest, span_of(series)
    most = np.maximum(np.max(np.concatenate([s.u for s in series]), axis=0), 1e-9)
    out = []
    for step, lags, degree, ridge in itertools.product(STEPS, LAGS, DEGREES, RIDGES):
        index = factors(terms(len(rest) * lags[0] + len(most) * lags[1], degree))
        if len(index) <= MOST_TERMS:
            weights = np.zeros((len(index), len(rest)))
            smooths = (1, step) if step > 2 else (1,)
            out += [Narx(step, w, lags, degree, ridge, weights, index, rest, span, most) for w in smooths]
    return out


def choose(series: Sequence[Series], noise: np.ndarray) -> tuple[Narx, float]:
    """The model whose free runs predict the held-out stretches best and which can be trusted, and that misfit."""
    tried: list[tuple[float, Narx]] = []
    for model in candidates(series):
        found = fit(model, series, [_smoothed(s, model) for s in series], noise, False)
        tried.append((judge_runs(found, series, noise), found))
    tried.sort(key=lambda t: t[0])
    for _, model in tried[:REFINED]:
        current = model
        for round_ in range(1, ROUNDS + 1):
            runs = [current.run(s, s.start(noise)) for s in series]
            if not all(np.all(np.isfinite(r)) for r in runs):
                break
            current = replace(fit(current, series, runs, noise, False), rounds=round_)
            tried.append((judge_runs(current, series, noise), current))
    tried.sort(key=lambda t: t[0])
    best = next((t for t in tried if trusted(t[1], series[0])), tried[0])
    return best[1], best[0]


def _smoothed(s: Series, model: Narx) -> np.ndarray:
    return uniform_filter1d(s.y, model.smooth, axis=0, mode="nearest") if model.smooth > 1 else s.y


def trusted(model: Narx, s: Series) -> bool:
    """Whether it settles under other drives."""
    return settles([model.run(t, s.rest) for t in trials(s)], model.rest, model.span)


def judge_runs(model: Narx, series: Sequence[Series], noise: np.ndarray) -> float:
    """Misfit of free runs on the held-out stretches."""
    return misfit(series, [model.run(s, s.start(noise)) for s in series], noise)


def finish(model: Narx, series: Sequence[Series], noise: np.ndarray) -> Narx:
    """Fitted again to everything, as often on its own free runs as when it was chosen."""
    current = fit(model, series, [_smoothed(s, model) for s in series], noise, True)
    for _ in range(model.rounds):
        runs = [current.run(s, s.start(noise)) for s in series]
        if not all(np.all(np.isfinite(r)) for r in runs):
            return model
        current = fit(current, series, runs, noise, True)
    return current


def judge(given: Sequence[str | Path], kept: Sequence[str | Path], noise: np.ndarray) -> Judged:
    """Learn from the given files, run freely on the kept ones."""
    began = time.monotonic()
    series = [read_series(f) for f in given]
    chosen, left = choose(series, noise)
    final = finish(chosen, series, noise)
    # what fits everything does not always run freely
    if judge_runs(final, series, noise) > 2 * left or not trusted(final, series[0]):
        final = chosen
    errors = {}
    for file in kept:
        s = read_series(file)
        errors[Path(file).stem] = dict(zip(s.names, s.rmse(final.run(s, s.start(noise))).tolist(), strict=True))
    what: dict[str, object] = {"step_s": final.step * PERIOD, "lags": list(final.lags), "degree": final.degree}
    what |= {"ridge": final.ridge, "smooth": final.smooth, "rounds": final.rounds, "held_out_misfit": left**0.5}
    return Judged(what, errors, time.monotonic() - began)
