"""A closure that is one mechanism, fitted beyond a hypothesis with all that moves in it."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from scpjax.diagnose.evidence import Comparison, Evidence, compare
from scpjax.diagnose.holdout import Split
from scpjax.diagnose.hypothesis import State, residual_on
from scpjax.diagnose.trials import fit_leading
from scpjax.fit.setup import Setup

_STEPS = 60


@dataclass(frozen=True)
class Found:
    """What was found: the hypothesis that holds it, and the evidence."""

    state: State
    evidence: Comparison


def _moving_with(state: State, problem: Setup, keys: Sequence[str]) -> np.ndarray:
    """What moves (parameters,) of a problem that holds a hypothesis and more: what moved in it, and ``keys``."""
    old, at = state.setup.structure, problem.structure.index
    moving = np.asarray(state.trial.active)
    active = np.zeros(problem.space.size, bool)
    active[len(problem.structure.slots) :] = moving[len(old.slots) :]
    for slot in old.slots:
        active[at[slot.key]] = moving[old.index[slot.key]]
    active[[at[key] for key in keys]] = True
    return active


def fitted_beyond(
    state: State,
    split: Split,
    rules: Evidence,
    problem: Setup,
    begun: Sequence[tuple[np.ndarray, np.ndarray]],
    keys: Sequence[str],
) -> Found | None:
    """The best fit of ``problem``, which holds ``state`` and a closure with the parameters ``keys``, from some (values,
    laws); None where it is not better than without.
    """
    active = _moving_with(state, problem, keys)
    trials = [problem.trial(value, active, laws, int(active.sum())) for value, laws in begun]
    solved, cost = fit_leading(problem, split, trials, state.cost, _STEPS)
    best = int(np.argmin(cost))
    after = State(problem, solved[best], residual_on(solved[best], split.whole, problem), float(cost[best]))
    evidence = compare(state, after, "closure", "", split, rules, len(keys))
    return Found(after, evidence) if evidence.accepted else None
