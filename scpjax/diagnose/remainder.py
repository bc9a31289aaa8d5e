"""How much of the misfit a hypothesis leaves, in units of the noise and of what the base model leaves."""

from __future__ import annotations

import numpy as np

from scpjax.diagnose.folds import squares_in_turn
from scpjax.diagnose.holdout import Split
from scpjax.diagnose.hypothesis import State
from scpjax.diagnose.residual import whiteness
from scpjax.fit.solve import outputs_of

AT_NOISE = 1.15  # ratio of residual to noise, in some column, up to which nothing more is asked for
FAR = AT_NOISE**2
"""Mean square, in units of the noise's, above which a hypothesis ends away from it."""
_CHANCE = 2.5  # standard deviations of a mean of squares, which are no misfit
_LAGS, _WHITE = 4, 0.01  # between neighbours, and how likely they are by chance, above which residuals are white
_LITTLE_LEFT = 0.05  # of the held-out misfit in excess of the noise: what names may leave unsought
MUCH = 0.2
"""Of the misfit: what names may leave that is still no matter of a law's form."""
_CLEARLY = 2.5  # ratio of residual to noise, above which names that leave much are false
_NO_SCALE = 100.0  # ratio of residual to noise, above which the noise is no scale for a law's error
_HALF = 0.5  # of the misfit: what names may leave there of what they were fitted to
_MOST = 0.25  # of the held-out misfit, up to which a closure may leave and say where it lies: half in root mean square


def misfit(state: State, split: Split) -> np.ndarray:
    """Mean square of the residuals by column (y,), in units of the noise's; 1 where nothing was recorded."""
    there = split.is_train | split.is_held
    count = there.sum(axis=(0, 1))
    return np.where(count, np.sum(state.residual**2, axis=(0, 1), where=there) / np.maximum(count, 1), 1.0)


def at_noise(state: State, split: Split, within: float = 1.05) -> bool:
    """Whether the mean square of the residuals is down to the noise in every column, to ``within``; or, where
    they are as white as noise is, to within what chance makes of so many samples: 2.5 standard deviations of a mean of
    squares, sqrt(2/n) each.
    """
    square, there = misfit(state, split), split.is_train | split.is_held
    chance = np.minimum(1.0 + _CHANCE * np.sqrt(2.0 / np.maximum(there.sum(axis=(0, 1)), 1)), FAR)
    above = np.flatnonzero(square >= within)
    like_noise = lambda j: whiteness(state.residual[..., j], there[..., j], _LAGS) > _WHITE  # noqa: E731
    return all(square[j] < chance[j] and like_noise(j) for j in above)


def level(state: State, parts: Split) -> float:
    """RMS misfit in units of the noise, in the column where it is greatest."""
    return float(np.sqrt(np.max(misfit(state, parts))))


def unexplained(state: State, there: np.ndarray) -> float:
    """Sum of squares, of the samples ``there``, beyond what the noise makes."""
    return max(float(np.sum(state.residual[there] ** 2) - there.sum()), 0.0)


def share_left(base: State, state: State, there: np.ndarray) -> float:
    """Of what the base model leaves beyond the noise, of the samples ``there``, the share that a hypothesis leaves."""
    return unexplained(state, there) / max(unexplained(base, there), 1e-300)


def no_scale(state: State, parts: Split) -> bool:
    """Whether a hypothesis is so far from the noise that this is no scale for the error of a law."""
    return level(state, parts) > _NO_SCALE


def form_at_most(base: State, state: State, parts: Split) -> bool:
    """Whether names leave so little that it may be what the true law's form differs by from theirs."""
    whole, left = (unexplained(s, parts.is_held) for s in (base, state))
    return bool(state.names) and left <= _LITTLE_LEFT * whole


def missed(base: State, state: State, parts: Split) -> float:
    """Sum of squares, beyond what the noise makes, of what a hypothesis predicts of the stretches held out. Where the
    noise is no scale for what the base model leaves: the whole sum, of several sets of stretches in turn.
    """
    return squares_in_turn(state, parts) if no_scale(base, parts) else unexplained(state, parts.is_held)


def leaves_much(base: State, state: State, parts: Split) -> bool:
    """Whether names leave so much, of what was held out or of what they were fitted to, clearly above the noise, that
    they are false. Where the noise is no scale: more than half of what they were fitted to, or no less of what is held
    out in turn than the base model does.
    """
    if level(state, parts) <= _CLEARLY:
        return False
    fitted = share_left(base, state, parts.is_train)
    held = missed(base, state, parts) / max(missed(base, base, parts), 1e-300)
    return (fitted > _HALF or held >= 1.0) if no_scale(base, parts) else max(fitted, held) > MUCH


def takes_most(base: State, state: State, parts: Split) -> bool:
    """Whether a closure beyond the base model, or a name, takes away so much of it that it says where that lies."""
    held = parts.is_held
    return unexplained(state, held) <= _MOST * unexplained(base, held)


def swings_within_bins(state: State, before: State, parts: Split) -> bool:
    """Whether a hypothesis misses the single samples by more than ``before`` does, which it was chosen beyond: the load
    may ring in it with a period that the bins, to which it was fitted, average out.
    """

    data = parts.whole

    def missed(s: State) -> float:
        error = np.asarray(outputs_of(s.trial, data, s.setup.space)) - np.asarray(data.outputs)
        return float(np.sum(np.asarray(data.weights) * (error / np.asarray(data.sigma)) ** 2))

    return not missed(state) <= missed(before)
