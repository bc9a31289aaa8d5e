"""Whether enough of the base model's misfit goes to speak of another effect, and not by the errors of long steps."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from scpjax.abreast import abreast
from scpjax.diagnose.evidence import Evidence, excess
from scpjax.diagnose.holdout import Split
from scpjax.diagnose.hypothesis import State, residual_on
from scpjax.fit.fit import refine

_PLAIN = 100.0  # mean square, in units of the noise's, that is no matter of a law's form
_PARTS = 4  # of a step, by which what little it is must go, too
_UNCHANGED = 0.1  # of what goes, by which halving the steps may move it


def worthwhile(before: State, after: State, base: State, split: Split, rules: Evidence) -> bool:
    """Whether enough of the base model's misfit goes, in some column, to speak of another effect.

    What stands out of the noise tenfold is spoken of however little of the whole it is, unless it goes by the errors
    of steps as long as the samples alone: where so much stands out, these may, too.
    """
    left, gone = excess(before, split), excess(before, split) - excess(after, split)
    if np.any(gone > rules.worth * excess(base, split)):
        return True
    plain = left > _PLAIN
    return bool(plain.any()) and _goes_by_shorter_steps(before, after, split, plain, rules.share)


def _goes_by_shorter_steps(before: State, after: State, split: Split, plain: np.ndarray, share: float) -> bool:
    """Whether ``after``, by shorter steps and fitted with them, still takes a ``share`` of what is left before it from
    a column that stands out. Nothing is fitted where halving the steps hardly moves its predictions.
    """
    there = split.is_train | split.is_held
    moved = residual_on(after.trial, split.whole.finer(2), after.setup) - after.residual
    gone = np.sum((before.residual**2 - after.residual**2)[there])
    if np.sum(moved[there] ** 2) < _UNCHANGED * gone:
        return True
    fine = replace(split, train=split.train.finer(_PARTS), whole=split.whole.finer(_PARTS))
    left, less = (excess(s, fine) for s in abreast(lambda s: _fitted(s, fine), (before, after)))
    return bool(np.any((left - less > share * left) & plain))


def _fitted(state: State, split: Split) -> State:
    trial, _, cost = refine(state.setup, split.train, state.trial)
    return State(state.setup, trial, residual_on(trial, split.whole, state.setup), cost)
