"""Hypotheses and the trials that fit them: mechanisms added to a base model, from several starts."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from scpjax.diagnose.holdout import Split
from scpjax.fit.data import Data
from scpjax.fit.fit import refine
from scpjax.fit.problem import CEILING, Trial
from scpjax.fit.setup import Setup
from scpjax.fit.solve import ABREAST, batches, binned_of, evaluate, solve_all, stack
from scpjax.parameter import Parameter
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


def moving_parameters(setup: Setup, names: Sequence[str], laws: np.ndarray) -> np.ndarray:
    """Entries that move when these mechanisms are in, under these laws (mechanisms,)."""
    active = setup.base_active.copy()
    free = {m.name: m.free_parameters(int(law)) for m, law in zip(setup.structure.mechanisms, laws, strict=True)}
    for slot in setup.structure.slots:
        if slot.mechanism in names and slot.parameter in free[slot.mechanism]:
            active[slot.index] = True
    return active


def widest(setup: Setup, most: int) -> int:
    """Places enough for the base and the ``most`` mechanisms with the most parameters."""
    counts = sorted((sum(not p.fixed for p in m.parameters) for m in candidates(setup)), reverse=True)
    return int(setup.base_active.sum()) + sum(counts[:most])


def trials_with(setup: Setup, state: State, added: Mechanism, width: int) -> list[tuple[int, Trial]]:
    """(law, trial) for every law and start of a mechanism added to a hypothesis."""
    names = (*state.names, added.name)
    now = np.asarray(setup.space.values(state.trial.free, state.trial.fixed, state.trial.active))
    which = next(i for i, m in enumerate(setup.structure.mechanisms) if m.name == added.name)
    out = []
    laws = range(len(added.laws))
    if added.name == "resistance_temperature":  # the drive says which law holds
        laws = [1 if setup.structure.drive == "current" else 0]
    for law in laws:
        for start in added.starts:
            value = now.copy()
            for k, p in enumerate(added.parameters):
                i = setup.structure.index[f"{added.name}.{p.name}"]
                value[i] = setup.fixed[i] if p.fixed else start[k] * _unit(setup, p)
            vector = np.asarray(state.trial.laws).copy()
            vector[which] = law
            active = moving_parameters(setup, names, vector)
            out.append((law, setup.trial(value, active, vector, width)))
    return out


def _unit(setup: Setup, p: Parameter) -> float:
    """What a start of a parameter is a multiple of."""
    return {"response": setup.scales.response, "duration": setup.scales.duration}.get(p.time, 1.0)


def start_value(setup: Setup, m: Mechanism, p: Parameter) -> float:
    """Where a parameter of a mechanism starts, by its first start."""
    return m.starts[0][m.parameters.index(p)] * _unit(setup, p)


def residual_on(trial: Trial, data: Data, setup: Setup) -> np.ndarray:
    """Binned residuals (r, k, y) of one trial."""
    return binned_of([trial], data, setup.space)[0]


_BEHIND, _LITTLE = 0.02, 2.0  # of the leader's promise, and in all, less than which a start is not worth going on from
_FEW, _NEARLY = 12, 0.2  # steps of all; of the leader's gain after them, with less than which one is left there
_TOLERANCE = 0.02  # half the fall of the sum of squares in one step with which a trial has come to rest


def screen(setup: Setup, state: State, split: Split, trials: Sequence[Trial]) -> np.ndarray:
    """What each trial promises: fall of the sum of squares (trials,), by a score test along its own effect.

    With ``d`` what a mechanism at its start changes and ``r`` the residuals, both after all that the parameters of the
    present hypothesis can imitate is taken out of them (by its Jacobian), an effect ``alpha`` times as strong would
    take (d r)^2 / d^2 away if the simulation were linear in it. An effect of the wrong sign promises nothing.
    """
    here = evaluate(stack([state.trial]), split.train, setup.space)
    residual, jacobian = np.asarray(here.residual[0]), np.asarray(here.jacobian[0])
    imitated, _ = np.linalg.qr(jacobian[:, np.any(jacobian != 0, axis=0)])
    clean = lambda x: x - (x @ imitated) @ imitated.T  # noqa: E731
    parts = [np.asarray(evaluate(stack(part), split.train, setup.space).residual) for part in batches(trials)]
    changed = clean(np.concatenate(parts)[: len(trials)] - residual)
    along = -changed @ clean(residual)
    size = np.sum(changed**2, axis=1)
    gain = np.where((along > 0) & (size > 0), along**2 / np.where(size > 0, size, 1.0), 0.0)
    return np.where(np.isfinite(gain), gain, 0.0)


def promising(gain: np.ndarray, labels: Sequence[tuple[str, int]]) -> list[int]:
    """Which trials to fit: the best start of every law of a mechanism, then second ones; none that is far behind the
    leader, but whole batches, which cost no more.
    """
    order = [int(i) for i in np.argsort(-gain)]
    first = [next(i for i in order if labels[i] == label) for label in dict.fromkeys(labels[i] for i in order)]
    queue = first + [i for i in order if i not in first]
    least = max(_BEHIND * gain[order[0]], _LITTLE)
    worth = int(np.sum(gain >= least))
    queue.sort(key=lambda i: bool(gain[i] < least))  # stable
    return queue[: max(-(-worth // ABREAST), 1) * ABREAST]


def fit_promising(
    setup: Setup,
    state: State,
    split: Split,
    trials: Sequence[Trial],
    labels: Sequence[tuple[str, int]],
    max_steps: int,
) -> dict[int, State]:
    """By trial, the hypotheses with one mechanism more that were worth fitting."""
    chosen = promising(screen(setup, state, split, trials), labels)
    solved, cost = fit_leading(setup, split, [trials[i] for i in chosen], state.cost, max_steps)
    residuals = binned_of(solved, split.whole, setup.space)
    # a trial that blew up (its residuals are cut off) explains nothing
    residuals[np.any(np.abs(residuals) >= CEILING, axis=(1, 2, 3))] = 10.0 * state.residual
    names = [(*state.names, labels[i][0]) for i in chosen]
    return {i: State(n, t, r, float(c)) for i, n, t, r, c in zip(chosen, names, solved, residuals, cost, strict=True)}


def fit_leading(
    setup: Setup, split: Split, trials: Sequence[Trial], before: float, max_steps: int
) -> tuple[list[Trial], np.ndarray]:
    """(trials, costs) after a few steps of all; those that nearly lead by then, or have yet to return, come to rest."""
    fit = lambda these, steps: solve_all(  # noqa: E731
        these, split.train, setup.space, max_steps=steps, tolerance=_TOLERANCE
    )
    solved, cost, rest = fit(trials, _FEW)
    gain = before - cost  # below 0: its first steps were too bold, and it has yet to come back
    leading = [i for i in np.flatnonzero(~rest) if gain[i] < 0 or gain[i] > _NEARLY * np.max(gain)]
    if leading and max_steps > _FEW:
        better, lower, _ = fit([solved[i] for i in leading], max_steps - _FEW)
        for i, trial, c in zip(leading, better, lower, strict=True):
            solved[i], cost[i] = trial, c
    return solved, cost


def afresh(setup: Setup, state: State, split: Split, width: int) -> State:
    """A hypothesis come to rest, from where it stands and from the base parameters that the data suggested at first.

    Without the mechanism the base parameters were bent to imitate it, and a fit need not find the way back.
    """
    now = np.asarray(setup.space.values(state.trial.free, state.trial.fixed, state.trial.active))
    added = np.isin([s.mechanism for s in setup.structure.slots], state.names)
    keep = np.concatenate([added, np.zeros(len(now) - len(added), bool)])
    laws = np.asarray(state.trial.laws)
    active = moving_parameters(setup, state.names, laws)
    begun = [setup.trial(np.where(keep, now, start), active, laws, width) for start in setup.starts]
    found = [refine(setup, split.train, trial) for trial in (state.trial, *begun)]
    trial, _, cost = min(found, key=lambda f: f[2] if np.isfinite(f[2]) else np.inf)
    return State(state.names, trial, residual_on(trial, split.whole, setup), cost)


def without(setup: Setup, state: State, name: str, split: Split, width: int) -> State:
    """The hypothesis with one of its mechanisms taken out, fitted again."""
    names = tuple(n for n in state.names if n != name)
    laws = np.asarray(state.trial.laws)
    now = np.asarray(setup.space.values(state.trial.free, state.trial.fixed, state.trial.active))
    trial = setup.trial(now, moving_parameters(setup, names, laws), laws, width)
    trial, _, cost = refine(setup, split.train, trial)
    return State(names, trial, residual_on(trial, split.whole, setup), cost)
