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

_RESOLVED = 0.1  # of the noise of a sample, by which predictions may change where steps are halved
_FINEST = 8  # parts of a step, at most
_UNRESOLVED = (
    "the samples are far apart for what moves here: with {parts} steps a sample the last fit's predictions still "
    "changed by {off:.2g} times the noise when steps were halved, so its parameters may be off; record at a higher rate"
)
_TOO_LATE = (
    "the samples are far apart for what moves here: by steps half as long the last fit's predictions change by "
    "{off:.2g} times the noise, so its parameters may be off; it was too late to fit it by shorter ones "
    "(--minutes gives longer)"
)
_UNSTABLE = (
    "what was found fits by the errors of steps as long as a sample: by shorter ones its predictions blow up. It is "
    "told as it was found; do not rely on its parameters, and record at a higher rate"
)
_FARTHER = 1.05
"""Ratio of RMS misfits, from which a fit to coloured residuals is off: of a model that is right, such a fit misses the
samples by its parameters' errors more, which are a small part of the noise."""


def resolved(state: State, parts: Split, patience: Patience = ENDLESS) -> tuple[Split, State, tuple[str, ...]]:
    """The data, and the hypothesis fitted to their training part, by steps that are short enough; both as they are
    where theirs are, or where it fits by the errors of long steps alone and blows up by shorter ones. And a note of
    that, or where no steps tried were short enough.

    Where what acts on the force has states of its own, such as hysteresis, a step as long as a sample may err by more
    than the noise, and parameters fitted with it make up for that only under drives like those given. Late by
    ``patience`` nothing is refitted, and the note is of that.
    """
    if not any(m.may_need_short_steps for m in state.setup.structure.mechanisms):
        return parts, state, ()
    sigma, space = np.asarray(parts.whole.sigma), state.setup.space
    there = np.where(np.asarray(parts.whole.weights) > 0, 1.0, 0.0)
    factor, first, coarse, off = 1, 0.0, np.asarray(outputs_of(state.trial, parts.whole, space)), 0.0
    while factor < _FINEST:
        fine = np.asarray(outputs_of(state.trial, parts.whole.finer(2 * factor), space))
        change = np.sum(there * ((fine - coarse) / sigma) ** 2, axis=(0, 1)) / np.maximum(there.sum(axis=(0, 1)), 1)
        off = float(np.sqrt(np.max(change)))
        first = first or off
        if off < _RESOLVED:
            break
        factor, coarse = 2 * factor, fine
    if factor == 1:
        return parts, state, ()
    if patience.late("the last fit by shorter steps"):
        blown = np.any(np.abs(residual_on(state.trial, parts.whole.finer(factor), state.setup)) >= CEILING)
        return parts, state, (_UNSTABLE if blown else _TOO_LATE.format(off=first),)
    notes = () if off < _RESOLVED else (_UNRESOLVED.format(parts=factor, off=off),)
    finer, refitted = fitted_finer(state, parts, factor)
    return (parts, state, (_UNSTABLE,)) if refitted is None else (finer, refitted, notes)


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
