"""Error bars, and what the data leave open, from the Jacobian at a solution."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from scpjax.fit.data import Data
from scpjax.fit.problem import Space, Trial
from scpjax.fit.result import Estimate
from scpjax.fit.solve import evaluate, stack

_OPEN = 1.5  # standard deviation of a direction in ln(value) beyond which the data are said to leave it open
_LIMIT = 0.995  # of the way from the middle to the end of the bounds, beyond which a value stands at its limit
_DETERMINED = 0.25  # standard deviation of a parameter, of half the range of its bounds, below which it is known


@dataclass(frozen=True)
class Uncertainty:
    """Covariance of the moving entries (``free`` scale), per-entry standard deviation, and open directions; in units of
    the noise's, the ``variance`` of the residuals, and by how much (``inflation``) their colour adds to it.
    """

    keys: tuple[str, ...]
    covariance: np.ndarray
    std_free: np.ndarray
    rank: int
    open_directions: tuple[str, ...]
    inflation: float
    variance: float


def correlation_time(residual: np.ndarray, there: np.ndarray) -> float:
    """1 + 2 sum of autocorrelations, the factor by which coloured residuals carry less information than white ones.

    ``residual`` (r, k, y) binned; the sum runs to the first lag whose autocorrelation is not positive (Geyer 1992's
    initial positive sequence, over single lags), and is 1 where the first lies within its sampling error.
    """
    worst = 1.0
    for j in range(residual.shape[2]):
        x = np.where(there[..., j], residual[..., j], 0.0)
        n = there[..., j].sum()
        if n < 16:
            continue
        variance = np.sum(x**2) / n
        total = 0.0
        for lag in range(1, x.shape[1] // 2):
            rho = np.sum(x[:, lag:] * x[:, :-lag]) / n / (variance + 1e-300)
            if rho < 2.0 / np.sqrt(n):
                break
            total += rho
        worst = max(worst, 1.0 + 2.0 * total)
    return worst


def uncertainty(
    trial: Trial,
    data: Data,
    space: Space,
    *,
    coloured: bool = True,
    at: tuple[np.ndarray, np.ndarray] | None = None,
) -> Uncertainty:
    """Uncertainty of a trial at its solution.

    Gauss-Newton covariance, scaled by the residual variance and, with ``coloured``, by their correlation time.
    ``at`` holds residuals and Jacobian there when a solver has left them. Outputs say nothing of what they have no
    finite derivative by (0 in a Jacobian from a solver); what none of them tells of, its prior alone bounds, or the
    range that it may have.
    """
    if at is None:
        here = evaluate(stack([trial]), data, space)
        at = np.asarray(here.residual[0]), np.asarray(here.jacobian[0])
    r, jac = at
    index = np.asarray(trial.index)
    real = index < space.size
    jac = jac[:, real]
    n = data.target.size
    jac = np.where(np.all(np.isfinite(jac), axis=0) | (np.arange(len(r)) >= n)[:, None], jac, 0.0)
    there = np.array(np.isfinite(np.asarray(data.norm)))
    binned = r[:n].reshape(there.shape)
    for j in np.flatnonzero(np.any(np.asarray(data.colour) != 0, axis=1)):
        there[..., j] &= binned[..., j] != 0
    dof = max(int(there.sum()) - int(real.sum()), 1)
    variance = float(np.sum(binned**2)) / dof
    factor = correlation_time(binned, there) if coloured else 1.0
    weight = np.concatenate([np.full(n, 1 / np.sqrt(max(variance, 1e-300) * factor)), np.ones(len(r) - n)])
    information = (jac * weight[:, None]).T @ (jac * weight[:, None])
    unseen = np.flatnonzero(np.diag(information) == 0.0)  # nor bounded by a prior: anywhere within its bounds
    information[unseen, unseen] = np.minimum(np.asarray(space.bounds.half)[index[real][unseen]], 1e6) ** -2.0
    covariance = np.linalg.pinv(information, rcond=1e-14, hermitian=True)
    keys = tuple(space.keys[i] for i in index[real])
    rank, words = _open_directions(jac[:n] * weight[:n, None], keys, trial, space, index[real])
    return Uncertainty(keys, covariance, np.sqrt(np.maximum(np.diag(covariance), 0)), rank, words, factor, variance)


def _open_directions(
    jac: np.ndarray, keys: tuple[str, ...], trial: Trial, space: Space, index: np.ndarray
) -> tuple[int, tuple[str, ...]]:
    """(rank, sentences): combinations of parameters that the data alone do not bound."""
    mine = [i for i, k in enumerate(keys) if not k.startswith("recording_")]
    log = np.asarray(space.bounds.log)[index]
    free = np.asarray(trial.free)[index]
    inner = np.where(log, 1 - np.tanh(free / np.asarray(space.bounds.half)[index]) ** 2, 1.0)
    scaled = jac[:, mine] / np.maximum(inner[mine], 1e-9)
    others = [i for i in range(len(keys)) if i not in mine]
    if others:  # initial states are estimated too: what they can imitate does not count
        q, _ = np.linalg.qr(jac[:, others])
        scaled = scaled - q @ (q.T @ scaled)
    values, vectors = np.linalg.eigh(scaled.T @ scaled)
    sentences = []
    for value, vector in zip(values, vectors.T, strict=True):
        if value > 1 / _OPEN**2:
            continue
        involved = [keys[mine[i]] for i in np.argsort(-np.abs(vector)) if abs(vector[i]) > 0.25]
        if len(involved) == 1:
            sentences.append(f"{involved[0]} is not determined by these recordings")
        elif involved:
            sentences.append(f"{', '.join(involved)} are determined only in combination, not each by itself")
    return int(np.sum(values > 1 / _OPEN**2)), tuple(sentences)


def at_limit(trial: Trial, space: Space) -> np.ndarray:
    """Which parameters, of those that have bounds on both sides, a trial has at the end of them."""
    bounds = space.bounds
    return np.asarray(bounds.finite) & (np.abs(np.tanh(trial.free[:-1] / np.asarray(bounds.half))) > _LIMIT)


def held_back(trial: Trial, space: Space, u: Uncertainty) -> tuple[str, ...]:
    """Keys of the moving parameters at the end of their bounds though the data determine them: they ask for more."""
    free, half = trial.free[:-1], np.asarray(space.bounds.half)
    flattened = 1.0 - np.tanh(free / half) ** 2  # by the bounds: a standard deviation of a free entry is not
    ends, position = at_limit(trial, space), {k: i for i, k in enumerate(space.keys)}
    moving = [(key, position[key], std) for key, std in zip(u.keys, u.std_free, strict=True)]
    return tuple(key for key, i, std in moving if ends[i] and std * flattened[i] < _DETERMINED * half[i])


def estimates(trial: Trial, space: Space, u: Uncertainty) -> dict[str, Estimate]:
    """Estimates by key of the moving parameters (initial states left out), 95 % intervals on the natural scale."""
    out = {}
    bounds = space.bounds
    free = trial.free[:-1]
    value, slope = np.asarray(bounds.to_value(free)), np.asarray(bounds.slope(free))
    log, half = np.asarray(bounds.log), np.asarray(bounds.half)
    limit = at_limit(trial, space)
    position = {k: i for i, k in enumerate(space.keys)}
    for key, std_free in zip(u.keys, u.std_free, strict=True):
        if key.startswith("recording_"):
            continue
        i = position[key]
        std = float(abs(slope[i]) * std_free)
        if limit[i]:  # the bounds flatten the slope: without them, but no wider than they are
            std = float(min(std_free, half[i]) * (value[i] if log[i] else 1.0))
        reach = 1.96 * std
        if log[i]:
            ratio = np.exp(min(reach / value[i], 700.0))
            low, high = value[i] / ratio, value[i] * ratio
        else:
            low, high = value[i] - reach, value[i] + reach
        p = space.structure.slots[i].parameter
        out[key] = Estimate(
            float(value[i]),
            std,
            space.structure.unit_of(p),
            float(low),
            float(high),
            p.description,
            p.symbol,
            bool(limit[i]),
        )
    return out
