"""Hypotheses and the trials that fit them: mechanisms added to a base model, from several starts."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from scpjax.diagnose.holdout import Split
from scpjax.fit.data import Data
from scpjax.fit.fit import refine
from scpjax.fit.problem import Trial
from scpjax.fit.setup import Setup
from scpjax.fit.solve import binned_of, solve_all
from scpjax.physics.mechanism import Mechanism


@dataclass(frozen=True)
class State:
    """A hypothesis fitted to the training part: its mechanisms (with laws) and binned residuals on all data."""

    names: tuple[str, ...]
    trial: Trial
    residual: np.ndarray  # (r, k, y) over training and held-out samples
    cost: float

    def laws(self, setup: Setup) -> dict[str, str]:
        """Law of each mechanism named."""
        return {
            m.name: m.laws[int(self.trial.laws[i])]
            for i, m in enumerate(setup.structure.mechanisms)
            if m.name in self.names
        }


def candidates(setup: Setup) -> tuple[Mechanism, ...]:
    """The left-out mechanisms that were put into the structure: those that can act and be seen."""
    return tuple(m for m in setup.structure.mechanisms if not m.is_base)


def moving_parameters(setup: Setup, names: Sequence[str]) -> np.ndarray:
    """Entries that move when these mechanisms are in."""
    active = setup.base_active.copy()
    for slot in setup.structure.slots:
        if slot.mechanism in names and not slot.parameter.fixed:
            active[slot.index] = True
    return active


def widest(setup: Setup, most: int) -> int:
    """Places enough for the base and the ``most`` mechanisms with the most parameters."""
    counts = sorted((sum(not p.fixed for p in m.parameters) for m in candidates(setup)), reverse=True)
    return int(setup.base_active.sum()) + sum(counts[:most])


def trials_with(setup: Setup, state: State, added: Mechanism, width: int) -> list[tuple[int, Trial]]:
    """(law, trial) for every law and start of a mechanism added to a hypothesis."""
    names = (*state.names, added.name)
    active = moving_parameters(setup, names)
    now = np.asarray(setup.space.values(state.trial.free, state.trial.fixed, state.trial.active))
    which = next(i for i, m in enumerate(setup.structure.mechanisms) if m.name == added.name)
    out = []
    laws = range(len(added.laws))
    if added.name == "resistance_temperature":  # the drive says which law holds
        laws = [1 if setup.structure.drive == "current" else 0]
    for law in laws:
        for start in added.starts:
            value = now.copy()
            for p, s in zip(added.parameters, start, strict=True):
                i = setup.structure.index[f"{added.name}.{p.name}"]
                unit = {"response": setup.scales.response, "duration": setup.scales.duration}.get(p.time, 1.0)
                value[i] = setup.fixed[i] if p.fixed else s * unit
            vector = np.asarray(state.trial.laws).copy()
            vector[which] = law
            out.append((law, setup.trial(value, active, vector, width)))
    return out


def residual_on(trial: Trial, data: Data, setup: Setup) -> np.ndarray:
    """Binned residuals (r, k, y) of one trial."""
    return binned_of([trial], data, setup.space)[0]


_SECOND = 4  # mechanisms that may go on from two starts


_SCREEN = 12  # steps after which a start that is behind is left behind; the first few may all be too bold


def two_stages(
    setup: Setup, split: Split, trials: Sequence[Trial], labels: Sequence[tuple[str, int]], max_steps: int
) -> tuple[list[Trial], np.ndarray]:
    """A few steps for all; then on with the best start of every law, and the second best of leading mechanisms."""
    solved, cost = solve_all(trials, split.train, setup.space, max_steps=_SCREEN)
    order = [int(i) for i in np.argsort(cost)]
    first = dict.fromkeys(labels[i] for i in order)
    chosen = [next(i for i in order if labels[i] == label) for label in first]
    for name in list(dict.fromkeys(labels[i][0] for i in order))[:_SECOND]:
        second = [i for i in order if labels[i][0] == name][1:2]
        chosen += [i for i in second if i not in chosen]
    better, lower = solve_all([solved[i] for i in chosen], split.train, setup.space, max_steps=max_steps)
    for i, trial, c in zip(chosen, better, lower, strict=True):
        if c <= cost[i]:
            solved[i], cost[i] = trial, c
    return solved, cost


def without(setup: Setup, state: State, name: str, split: Split, width: int) -> State:
    """The hypothesis with one of its mechanisms taken out, fitted again."""
    names = tuple(n for n in state.names if n != name)
    active = moving_parameters(setup, names)
    now = np.asarray(setup.space.values(state.trial.free, state.trial.fixed, state.trial.active))
    trial = setup.trial(now, active, np.asarray(state.trial.laws), width)
    trial, _, cost = refine(setup, split.train, trial)
    return State(names, trial, residual_on(trial, split.whole, setup), cost)
