"""The chosen hypothesis fitted once more, to all data, by steps that are short enough."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from scpjax.diagnose.holdout import Split
from scpjax.diagnose.hypothesis import State, residual_on
from scpjax.diagnose.patience import ENDLESS, Patience
from scpjax.fit.colour import Whitener
from scpjax.fit.data import Data
from scpjax.fit.fit import refine
from scpjax.fit.problem import CEILING, Trial
from scpjax.fit.solve import outputs_of
from scpjax.physics.mechanism import Mechanism

_RESOLVED = 0.1  # of the noise of a sample, by which predictions may change where steps are halved
_HIGHER = 4  # order of the integrator
_FINE = 8  # parts of a step, at most, by which a hypothesis is refitted first
_FINEST = 32  # and at most, where what it then predicts still changes
_MOST_STEPS = 4_000_000  # of all recordings, simulated at once
_LONGER = 3.0  # times as long as by twice as long steps, that a fit may take
_UNRESOLVED = (
    "the samples are far apart for what moves here: with {parts} steps a sample the last fit's predictions still "
    "changed by {off:.2g} times the noise when steps were halved, so its parameters may be off; record at a higher rate"
)
_TOO_LATE = (
    "the samples are far apart for what moves here: by steps half as long the last fit's predictions change by "
    "{off:.2g} times the noise, so its parameters may be off; it was too late to fit it by shorter ones "
    "(--minutes gives longer)"
)
_UNTOLD = (
    "what moves here asked for {parts} steps a sample in the last fit; whether those were short enough was not tried, "
    "on so many samples"
)
_UNSTABLE = (
    "what was found fits by the errors of steps as long as a sample: by shorter ones its predictions blow up. It is "
    "told as it was found; do not rely on its parameters, and record at a higher rate"
)
_BLOWS_UP = (
    "the samples are far apart for what moves here: the last fit was made with {parts} steps a sample, and by half as "
    "long ones its predictions blow up. Do not rely on its parameters, and record at a higher rate"
)
_FARTHER = 1.05
"""Ratio of RMS misfits, from which a fit to coloured residuals is off: of a model that is right, such a fit misses the
samples by its parameters' errors more, which are a small part of the noise."""


def resolved(state: State, parts: Split, patience: Patience = ENDLESS) -> tuple[Split, State, tuple[str, ...]]:
    """The data, and the hypothesis fitted to their training part, by steps that are short enough; both as they are
    where theirs are, or where it fits by the errors of long steps alone and blows up by shorter ones. And a note of
    that, or where no steps tried were short enough.

    Where what acts on the force has states of its own, such as hysteresis, a step as long as a sample may err by more
    than the noise, and parameters fitted with it make up for that only under drives like those given. A higher order
    comes first: where a weight rings within a sample it does more than several times as many steps. Late by
    ``patience`` nothing is refitted, and the note is of that.
    """
    if not any(m.may_need_short_steps for m in state.setup.structure.mechanisms):
        return parts, state, ()
    own = state.setup.data
    if parts.whole.bin > own.bin or parts.whole.order > own.order:  # it was fitted by shorter steps before
        return _by_still_shorter(parts, state, parts, 1, patience)
    first, given, coarse = 0.0, parts, _outputs(state, parts, 1)
    parts = _of_higher_order(parts, state)
    if parts is not given:
        before, coarse = coarse, _outputs(state, parts, 1)
        first = _change(before, coarse, parts)
        if first < _RESOLVED:
            return given, state, ()
    factor = 1
    while factor < _FINE:
        fine = _outputs(state, parts, 2 * factor)
        off = _change(coarse, fine, parts)
        first = first or off
        if off < _RESOLVED:
            break
        factor, coarse = 2 * factor, fine
    if factor == 1 and parts is given:
        return parts, state, ()
    if patience.late("the last fit by shorter steps"):
        blown = np.any(np.abs(residual_on(state.trial, parts.whole.finer(factor), state.setup)) >= CEILING)
        return given, state, (_UNSTABLE if blown else _TOO_LATE.format(off=first),)
    began = patience.passed()
    finer, refitted = fitted_finer(state, parts, factor)
    if refitted is None:
        return given, state, (_UNSTABLE,)
    return _by_still_shorter(finer, refitted, parts, factor, patience, patience.passed() - began)


def _of_higher_order(parts: Split, state: State) -> Split:
    """The data by the integrator's fourth order; as they are where that is theirs, or where a mechanism knows better
    than an integrator where a step takes its states (`Mechanism.carried`), which goes with the second.
    """
    carries = any(type(m).carried is not Mechanism.carried for m in state.setup.structure.mechanisms)
    if carries or parts.whole.order == _HIGHER:
        return parts
    return replace(parts, train=parts.train.with_order(_HIGHER), whole=parts.whole.with_order(_HIGHER))


def _by_still_shorter(
    finer: Split, state: State, parts: Split, factor: int, patience: Patience, seconds: float = 0.0
) -> tuple[Split, State, tuple[str, ...]]:
    """What was fitted by steps shorter by a ``factor`` (``finer``) in some ``seconds``, fitted again by half as long
    ones until what that changes is little, while ``patience`` allows what it may take; and a note where it never is.
    """
    before = parts.whole.bin // state.setup.data.bin
    steps = int(np.prod(np.shape(parts.whole.grids.effort)[:2]))
    while True:
        if 2 * factor * steps > _MOST_STEPS:
            return finer, state, (_UNTOLD.format(parts=before * factor),)
        off = _change(_outputs(state, parts, factor), _outputs(state, parts, 2 * factor), parts)
        if off < _RESOLVED:
            return finer, state, ()
        blown = _BLOWS_UP.format(parts=before * factor)
        unresolved = _UNRESOLVED.format(parts=before * factor, off=off) if np.isfinite(off) else blown
        if before * factor >= _FINEST or not patience.allows(_LONGER * seconds):
            return finer, state, (unresolved,)
        began = patience.passed()
        again, refitted = fitted_finer(state, parts, 2 * factor)
        if refitted is None:
            return finer, state, (blown,)
        finer, state, factor, seconds = again, refitted, 2 * factor, patience.passed() - began


def _outputs(state: State, parts: Split, factor: int) -> np.ndarray:
    """Predictions (r, n, y) of a hypothesis by steps shorter by a factor."""
    return np.asarray(outputs_of(state.trial, parts.whole.finer(factor), state.setup.space))


def _change(coarse: np.ndarray, fine: np.ndarray, parts: Split) -> float:
    """RMS by which predictions (r, n, y) differ, in units of the noise, in the column where it is greatest."""
    there = np.where(np.asarray(parts.whole.weights) > 0, 1.0, 0.0)
    square = np.sum(there * ((fine - coarse) / np.asarray(parts.whole.sigma)) ** 2, axis=(0, 1))
    return float(np.sqrt(np.max(square / np.maximum(there.sum(axis=(0, 1)), 1))))


def fitted_finer(state: State, parts: Split, factor: int) -> tuple[Split, State | None]:
    """The data, and a hypothesis fitted to their training part, by steps shorter by a factor; None for the hypothesis
    where it blows up.
    """
    finer = replace(parts, train=parts.train.finer(factor), whole=parts.whole.finer(factor))
    trial, _, cost = refine(state.setup, finer.train, state.trial)
    residual = residual_on(trial, finer.whole, state.setup)
    if np.any(np.abs(residual) >= CEILING):
        return finer, None
    return finer, State(state.setup, trial, residual, cost)


def fitted_to_all(parts: Split, state: State, patience: Patience = ENDLESS) -> tuple[Trial, Data]:
    """The hypothesis fitted to all data, by generalised least squares where its residuals stay coloured, unless it is
    late by ``patience``.

    The colour is believed if the held-out stretches, filtered by it, are predicted no worse by a training fit that
    uses it than by one that does not; and not where the fit to all data then misses the samples by a twentieth more:
    what the filter takes out, such as a sensor's offset, nothing holds there.
    """
    setup, there = state.setup, parts.is_train | parts.is_held
    white = Whitener.learn(state.residual, there)
    trial, _, _ = refine(setup, parts.whole, state.trial)
    filter_ = "the last fits' filter for coloured residuals"
    if white.is_white or patience.late(filter_):
        return trial, parts.whole
    uncoloured = trial
    trained, _, _ = refine(setup, parts.train.with_colour(white.colour), state.trial)
    plain, filtered = (white(r, parts.is_held)[0] for r in (state.residual, residual_on(trained, parts.whole, setup)))
    if filtered > plain * (1 + 1e-3) or patience.late(filter_):
        return trial, parts.whole
    data = parts.whole
    for turn in range(2):
        if turn and patience.late(filter_):
            break
        data = parts.whole.with_colour(white.colour)
        trial, _, _ = refine(setup, data, trial)
        white = Whitener.learn(residual_on(trial, parts.whole, setup), there)
    before, after = (np.sum(residual_on(t, parts.whole, setup)[there] ** 2) for t in (uncoloured, trial))
    return (trial, data) if after < _FARTHER**2 * before else (uncoloured, parts.whole)
