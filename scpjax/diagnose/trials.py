"""Hypotheses and the trials that fit them: mechanisms added to a base model, from several starts.

Every hypothesis has a model of its own that holds only what it names, which compiles and runs quickly; candidates
together are only simulated, to see which are worth fitting.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from scpjax.diagnose.holdout import Split
from scpjax.diagnose.residual import whiteness
from scpjax.fit.data import Data
from scpjax.fit.identifiability import at_limit
from scpjax.fit.problem import CEILING, Trial
from scpjax.fit.setup import Setup, carry, laws_that_can_act, restructured
from scpjax.fit.solve import binned_of, solve_all
from scpjax.parameter import Parameter
from scpjax.physics.mechanism import Mechanism


@dataclass(frozen=True)
class State:
    """A hypothesis fitted to the training part, and its binned residuals on all data."""

    setup: Setup
    trial: Trial
    residual: np.ndarray  # (r, k, y) over training and held-out samples
    cost: float

    @property
    def names(self) -> tuple[str, ...]:
        """Left-out mechanisms in its model, in the order in which they were named."""
        return tuple(m.name for m in self.setup.structure.mechanisms if not (m.is_base or m.learned))

    @property
    def laws(self) -> dict[str, str]:
        """Law of each mechanism named."""
        which = np.asarray(self.trial.laws)
        return {m.name: m.laws[int(which[i])] for i, m in enumerate(self.setup.structure.mechanisms)}

    @property
    def values(self) -> np.ndarray:
        """Physical values of all parameters and locals."""
        return np.array(self.setup.space.values(self.trial.free, self.trial.fixed, self.trial.active))


@dataclass(frozen=True)
class Start:
    """Where a fit of a mechanism under a law may begin: physical values over the grown problem."""

    mechanism: Mechanism
    law: int
    own: tuple[float, ...]  # values of the mechanism's parameters
    value: np.ndarray
    laws: np.ndarray


def grown(setup: Setup, *added: Mechanism) -> Setup:
    """The problem with more mechanisms in its model."""
    return restructured(setup, setup.structure.with_mechanisms(*added))


def alike(setup: Setup, like: Setup) -> Setup:
    """The problem with the parameters that differ by recording in another one."""
    s = like.structure
    return restructured(setup, setup.structure.with_own(s.recordings, *s.own)) if s.own else setup


def reduced(setup: Setup, name: str) -> Setup:
    """The problem without one mechanism."""
    return restructured(setup, setup.structure.without(name))


def laws_of(old: Setup, laws: np.ndarray, new: Setup) -> np.ndarray:
    """Laws over the mechanisms of another problem, 0 where new."""
    known = {m.name: float(law) for m, law in zip(old.structure.mechanisms, laws, strict=True)}
    return np.array([known.get(m.name, 0.0) for m in new.structure.mechanisms])


def moving_parameters(setup: Setup, laws: np.ndarray) -> np.ndarray:
    """Entries that move under these laws (mechanisms,)."""
    active = setup.base_active.copy()
    free = {m.name: m.free_parameters(int(law)) for m, law in zip(setup.structure.mechanisms, laws, strict=True)}
    for slot in setup.structure.slots:
        m = setup.structure.mechanism(slot.mechanism)
        if not (m.is_base or m.learned) and slot.parameter in free[slot.mechanism]:
            active[slot.index] = True
    return active


def width(setup: Setup) -> int:
    """Places enough for any laws of the mechanisms in the model."""
    s = setup.structure
    mine = [m for m in s.mechanisms if not (m.is_base or m.learned)]
    widest = (max(s.count_free(m.name, law) for law in range(len(m.laws))) for m in mine)
    return int(setup.base_active.sum()) + sum(widest)


def trial_at(setup: Setup, value: np.ndarray, laws: np.ndarray) -> Trial:
    """Everything that these laws have moving, from physical values."""
    return setup.trial(value, moving_parameters(setup, laws), laws, width(setup))


def starts_with(state: State, added: Mechanism, problem: Setup) -> list[Start]:
    """Every law and start of a mechanism added to a hypothesis, over a problem that holds it."""
    null = np.asarray(problem.starts[0])[: len(problem.structure.slots)]
    now, laws = moved(state, problem)
    which = next(i for i, m in enumerate(problem.structure.mechanisms) if m.name == added.name)
    out = []
    for law in laws_that_can_act(problem, added):
        for start in added.starts:
            value, vector = now.copy(), laws.copy()
            for k, p in enumerate(added.parameters):
                i = problem.structure.where[f"{added.name}.{p.name}"]
                value[i] = problem.fixed[i] if p.fixed else start[k] * _unit(problem, p)
                if not p.fixed and p not in added.free_parameters(law):
                    value[i] = null[i]
            vector[which] = law
            own = tuple(float(value[problem.structure.where[f"{added.name}.{p.name}"][0]]) for p in added.parameters)
            out.append(Start(added, law, own, value, vector))
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


def integrable(state: State, split: Split, before: State | None = None) -> bool:
    """Whether the integrator of the other order predicts the same, within half the noise or, of what was added to
    ``before``, within a quarter of what that changed: a force that changes steeply with velocity may fit by the errors
    of the steps alone.
    """
    data = split.whole.with_order(4 if split.whole.order == 2 else 2)
    other = residual_on(state.trial, data, state.setup)
    there = split.is_train | split.is_held
    cut_off = np.any(np.abs(other[there]) >= CEILING)
    far = lambda a: float(np.sqrt(np.mean((a - state.residual)[there] ** 2)))  # noqa: E731
    return not cut_off and far(other) < max(SAME, 0.0 if before is None else _BY_STEPS * far(before.residual))


SAME = 0.5  # RMS difference of predictions, in units of the noise, up to which they are the same
_BY_STEPS = 0.25  # of what a closure changes, that may be due to the integrator's steps
FAR = 1.15**2
"""Mean square, in units of the noise's, above which a hypothesis ends away from it."""
FEW, NEARLY = 12, 0.2  # steps of all; of the leader's gain after them, with less than which one is left there
_CHANCE = 2.5  # standard deviations of a mean of squares, which are no misfit
_LAGS, _WHITE = 4, 0.01  # between neighbours, and how likely they are by chance, above which residuals are white
_LEADS = 0.95  # the same, in a hurry
TOLERANCE = 0.02  # half the fall of the sum of squares in one step with which a trial has come to rest


def misfit(state: State, split: Split) -> np.ndarray:
    """Mean square of the residuals by column (y,), in units of the noise's; 1 where nothing was recorded."""
    there = split.is_train | split.is_held
    count = there.sum(axis=(0, 1))
    return np.where(count, np.sum(state.residual**2, axis=(0, 1), where=there) / np.maximum(count, 1), 1.0)


def at_noise(state: State, split: Split, level: float = 1.05) -> bool:
    """Whether the mean square of the residuals is down to the noise in every column, to within ``level``; or, where
    they are as white as noise is, to within what chance makes of so many samples: 2.5 standard deviations of a mean of
    squares, sqrt(2/n) each.
    """
    square, there = misfit(state, split), split.is_train | split.is_held
    chance = np.minimum(1.0 + _CHANCE * np.sqrt(2.0 / np.maximum(there.sum(axis=(0, 1)), 1)), FAR)
    above = np.flatnonzero(square >= level)
    like_noise = lambda j: whiteness(state.residual[..., j], there[..., j], _LAGS) > _WHITE  # noqa: E731
    return all(square[j] < chance[j] and like_noise(j) for j in above)


def go_on(
    setup: Setup,
    split: Split,
    solved: list[Trial],
    cost: np.ndarray,
    rest: np.ndarray,
    before: float,
    lead: float,
    steps: int,
    nearly: float = NEARLY,
) -> tuple[list[Trial], np.ndarray]:
    """Those that nearly lead after a few steps, or have yet to return, brought to rest."""
    gain = before - cost  # below 0: its first steps were too bold, and it has yet to come back
    leading = [int(i) for i in np.flatnonzero(~rest) if gain[i] < 0 or gain[i] > nearly * lead]
    if leading and steps > 0:
        better, lower, _ = solve_all(
            [solved[i] for i in leading], split.train, setup.space, max_steps=steps, tolerance=TOLERANCE
        )
        for i, trial, c in zip(leading, better, lower, strict=True):
            solved[i], cost[i] = trial, c
    return solved, cost


def fit_leading(
    setup: Setup, split: Split, trials: Sequence[Trial], before: float, max_steps: int
) -> tuple[list[Trial], np.ndarray]:
    """(trials, costs) after a few steps of all; those that nearly lead by then, or have yet to return, come to rest."""
    solved, cost, rest = solve_all(trials, split.train, setup.space, max_steps=FEW, tolerance=TOLERANCE)
    lead = float(before - np.min(cost))
    return go_on(setup, split, solved, cost, rest, before, lead, max_steps - FEW)


def moving(state: State) -> int:
    """How many parameters were fitted."""
    return int(np.asarray(state.trial.active).sum())


def at_rest(setup: Setup, split: Split, trials: Sequence[Trial], *, max_steps: int = 60) -> State:
    """The best of some trials of one problem, come to rest."""
    solved, cost, _ = solve_all(trials, split.train, setup.space, max_steps=max_steps, tolerance=TOLERANCE)
    i = int(np.argmin(cost))
    return State(setup, solved[i], residual_on(solved[i], split.whole, setup), float(cost[i]))


def afresh(state: State, split: Split, *, own: bool = True) -> State:
    """A hypothesis come to rest, from where it stands and from the base parameters that the data suggested at first;
    away from the noise also from where its mechanisms start (``own``).

    Without the mechanism the base parameters were bent to imitate it, and a fit need not find the way back. Nor need
    that of a mechanism which was bent to imitate another, before that one was there.
    """
    setup = state.setup
    now, laws = state.values, np.asarray(state.trial.laws)
    keep = _added(setup, state.names, len(now))
    begun = [np.where(keep, now, start) for start in setup.starts[:3]]
    if own and not at_noise(state, split):
        begun += from_their_starts(setup, laws)
    return _leading_at_rest(setup, split, [state.trial, *(trial_at(setup, value, laws) for value in begun)])


def _leading_at_rest(setup: Setup, split: Split, trials: Sequence[Trial], nearly: float = NEARLY) -> State:
    """As `at_rest`, of those only that after a few steps ``nearly`` lead."""
    solved, cost, rest = solve_all(trials, split.train, setup.space, max_steps=FEW, tolerance=TOLERANCE)
    worst = float(np.max(cost[np.isfinite(cost)], initial=0.0))
    solved, cost = go_on(setup, split, solved, cost, rest, worst, worst - float(np.min(cost)), 60 - FEW, nearly)
    i = int(np.argmin(cost))
    return State(setup, solved[i], residual_on(solved[i], split.whole, setup), float(cost[i]))


def from_their_starts(setup: Setup, laws: np.ndarray) -> list[np.ndarray]:
    """Values with the base as the data suggested at first and every mechanism at its first start; at its last one."""
    out: list[np.ndarray] = []
    for which in (0, -1):
        value = np.asarray(setup.starts[0]).copy()
        for m, law in zip(setup.structure.mechanisms, laws, strict=True):
            if m.is_base or m.learned:
                continue
            for p in m.free_parameters(int(law)):
                start = m.starts[which][m.parameters.index(p)]
                value[setup.structure.where[f"{m.name}.{p.name}"]] = start * _unit(setup, p)
        if not any(np.array_equal(value, other) for other in out):
            out.append(value)
    return out


def strained(state: State) -> tuple[str, ...]:
    """Names of which a parameter, other than a time, stands at the end of its bounds, as it does where the law of
    another name is wrong. Times end there where recordings are too short.
    """
    ends = at_limit(state.trial, state.setup.space) & np.asarray(state.trial.active)
    found = {s.mechanism for s in state.setup.structure.slots if ends[s.index] and not s.parameter.time}
    return tuple(n for n in state.names if n in found)


def without(state: State, name: str, split: Split) -> State:
    """The hypothesis with one of its mechanisms taken out, fitted again from where it stands and, as the base may have
    been bent beside that mechanism, from the base parameters that the data suggested at first.
    """
    setup = reduced(state.setup, name)
    value, laws = moved(state, setup)
    begun = np.where(_added(setup, state.names, len(value)), value, np.asarray(setup.starts[0]))
    return at_rest(setup, split, [trial_at(setup, value, laws), trial_at(setup, begun, laws)])


def under_every_law(state: State, name: str, split: Split, *, hurried: bool = False) -> State:
    """The hypothesis with one of its mechanisms fitted again under every law and from every start, all else from where
    it stands; the best of them. ``hurried``: what is behind after a few steps is left there.
    """
    trials = [trial for trials in _law_by_law(state, name) for trial in trials]
    return _leading_at_rest(state.setup, split, trials, _LEADS) if hurried else at_rest(state.setup, split, trials)


def under_each_law(state: State, name: str, split: Split) -> list[State]:
    """As `under_every_law`, the best under each of them."""
    return [at_rest(state.setup, split, trials) for trials in _law_by_law(state, name)]


def _law_by_law(state: State, name: str) -> list[list[Trial]]:
    """Of each law that can act, one of its mechanisms at every start and all else where it stands."""
    setup, m = state.setup, state.setup.structure.mechanism(name)
    null, where = np.asarray(setup.starts[0]), setup.structure.where
    which = setup.structure.mechanisms.index(m)
    found = []
    for law in laws_that_can_act(setup, m):
        free, laws = m.free_parameters(law), np.asarray(state.trial.laws).copy()
        laws[which] = law
        found.append([])
        for start in m.starts:
            value = state.values
            for p, own in zip(m.parameters, start, strict=True):
                if not p.fixed:
                    i = where[f"{name}.{p.name}"]
                    value[i] = own * _unit(setup, p) if p in free else null[i]
            found[-1].append(trial_at(setup, value, laws))
    return found


def in_order(state: State, first: str, split: Split) -> State:
    """The hypothesis with one of its mechanisms told of first; as it was, where it then predicts something else (what
    one mechanism makes of a drive or a reading, the next one takes up).
    """
    structure = state.setup.structure
    ordered = sorted(structure.mechanisms, key=lambda m: 0 if m.is_base else 1 if m.name == first else 2)
    setup = restructured(state.setup, replace(structure, mechanisms=tuple(ordered)))
    trial = trial_at(setup, *moved(state, setup))
    residual = residual_on(trial, split.whole, setup)
    there = split.is_train | split.is_held
    if not np.sqrt(np.mean((residual - state.residual)[there] ** 2)) < _ORDER:
        return state
    return State(setup, trial, residual, float(np.sum(residual[split.is_train] ** 2)))


_ORDER = 1e-3  # RMS difference of predictions, in units of the noise, up to which the order of two names is none


def moved(state: State, setup: Setup) -> tuple[np.ndarray, np.ndarray]:
    """(values, laws) of a hypothesis over a problem with other mechanisms; first values where new."""
    old, first = state.setup, np.asarray(setup.starts[0])[: len(setup.structure.slots)]
    value = carry(old.structure, setup.structure, state.values, first)
    return value, laws_of(old, np.asarray(state.trial.laws), setup)


def _added(setup: Setup, names: Sequence[str], count: int) -> np.ndarray:
    """Which of ``count`` values belong to mechanisms named."""
    own = np.isin([s.mechanism for s in setup.structure.slots], names)
    return np.concatenate([own, np.zeros(count - len(own), bool)])
