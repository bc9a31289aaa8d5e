"""Several sets of stretches held out in turn: where no law comes near the noise, it matters which one judges."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from weakref import WeakKeyDictionary

import numpy as np

from scpjax.abreast import abreast
from scpjax.diagnose.holdout import Split
from scpjax.diagnose.hypothesis import State, residual_on
from scpjax.fit.problem import Trial
from scpjax.fit.setup import Setup
from scpjax.fit.solve import evaluate, solve_all, stack
from scpjax.fit.space import null_values

_STEPS = 40  # of a fit
_NOTHING = 1e-6  # of what all data say of a parameter, below which some of them say nothing
_COARSE = 1e-4  # half the fall of the sum of squares in one step, as a share of it, with which a fit is at rest

Fold = tuple[np.ndarray, np.ndarray]
"""Residuals (r, k, y) of a fit, and which of them were held out of it."""

_KNOWN: WeakKeyDictionary[State, tuple[Split, list[Fold]]] = WeakKeyDictionary()
"""Of hypotheses that are still in use: most are compared more than once."""


def held_in_turn(states: Sequence[State], parts: Split) -> list[list[Fold]]:
    """Each of some hypotheses as it stands, and fitted anew from there with each of the other sets of stretches held
    out in place of these; without what only these say of it (`untold`).
    """

    def one(job: tuple[State, Split]) -> Fold:
        state, other = job
        setup, at_rest = state.setup, _COARSE * state.cost
        (trial,), _, _ = solve_all([state.trial], other.train, setup.space, max_steps=_STEPS, tolerance=at_rest)
        return residual_on(untold(trial, setup, other), other.whole, setup), other.is_held

    mine = {s: known[1] for s in states if (known := _KNOWN.get(s)) and known[0] is parts}
    new = [s for s in dict.fromkeys(states) if s not in mine]
    found = abreast(one, [(state, other) for state in new for other in parts.others])
    n = len(parts.others)
    for i, state in enumerate(new):
        mine[state] = [(state.residual, parts.is_held), *found[i * n : (i + 1) * n]]
        _KNOWN[state] = (parts, mine[state])
    return [mine[s] for s in states]


def untold(trial: Trial, setup: Setup, parts: Split) -> Trial:
    """A fit with what is beyond its base model at the null value, where the training part says nothing of it: such as
    the size of a drift that begins later. What it was where the fit began, the data held out had told.
    """
    beyond = [s.index for s in setup.structure.slots if not setup.structure.mechanism(s.mechanism).is_base]
    if not beyond:
        return trial
    jacobian = np.nan_to_num(np.asarray(evaluate(stack([trial]), parts.whole, setup.space).jacobian[0]))
    every = np.sum(jacobian[: parts.is_train.size] ** 2, axis=0)
    told = np.sum(jacobian[: parts.is_train.size][parts.is_train.ravel()] ** 2, axis=0)
    gone = np.intersect1d(beyond, np.asarray(trial.index)[told <= _NOTHING * every])
    if not gone.size:
        return trial
    value = np.array(setup.space.values(trial.free, trial.fixed, trial.active))
    fixed, active = np.array(trial.fixed), np.array(trial.active)
    fixed[gone], active[gone] = null_values(setup.structure, setup.scales)[gone], False
    return replace(setup, fixed=fixed).trial(value, active, np.asarray(trial.laws), len(trial.index))


def squares_in_turn(state: State, parts: Split) -> float:
    """Sum of squares of what is held out, of all sets of stretches in turn."""
    (folds,) = held_in_turn([state], parts)
    return sum(float(np.sum(residual[held] ** 2)) for residual, held in folds)
