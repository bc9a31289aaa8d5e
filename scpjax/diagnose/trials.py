"""Trials of a hypothesis brought to rest: from several starts, under every law, and with one mechanism less."""

from __future__ import annotations

import itertools
from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from scpjax.abreast import abreast
from scpjax.diagnose.holdout import Split
from scpjax.diagnose.hypothesis import State, from_their_starts, moved, owned_by, reduced, residual_on, trial_at, unit
from scpjax.diagnose.remainder import at_noise
from scpjax.fit.problem import CEILING, Trial
from scpjax.fit.setup import Setup, laws_that_can_act, restructured, what_there_is
from scpjax.fit.solve import solve_all
from scpjax.physics.catalogue import applicable

SAME = 0.5  # RMS difference of predictions, in units of the noise, up to which they are the same
_BY_STEPS = 0.25  # of what a closure changes, that may be due to the integrator's steps
FEW, NEARLY = 12, 0.2  # steps of all; of the leader's gain after them, with less than which one is left there
HOPELESS = 4.0
"""Sum of squares, in units of that of what it should replace, from which a hypothesis is tried no further."""
_LEADS = 0.95  # the same, in a hurry
_CLOSE, _AT_MOST = 2.0, 8  # sum of squares after a few steps, in units of the least; trials within that, that go on
TOLERANCE = 0.02  # half the fall of the sum of squares in one step with which a trial has come to rest
_ORDER = 1e-3  # RMS difference of predictions, in units of the noise, up to which the order of two names is none


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


def at_rest(setup: Setup, split: Split, trials: Sequence[Trial], *, max_steps: int = 60) -> State:
    """The best of some trials of one problem, come to rest."""
    solved, cost, _ = solve_all(trials, split.train, setup.space, max_steps=max_steps, tolerance=TOLERANCE)
    i = int(np.argmin(cost))
    return State(setup, solved[i], residual_on(solved[i], split.whole, setup), float(cost[i]))


def afresh(state: State, split: Split, *, own: bool = True) -> State:
    """A hypothesis come to rest, from where it stands and from the base parameters that the data suggested at first;
    away from the noise also from where its mechanisms start (``own``). As it is where it has come from there.

    Without the mechanism the base parameters were bent to imitate it, and a fit need not find the way back. Nor need
    that of a mechanism which was bent to imitate another, before that one was there.
    """
    own = own and not at_noise(state, split)
    if state.anew and not own:
        return state
    setup = state.setup
    now, laws = state.values, np.asarray(state.trial.laws)
    keep = owned_by(setup, state.names, len(now))
    begun = [np.where(keep, now, start) for start in setup.starts[:3]]
    if own:
        begun += from_their_starts(setup, laws)
    found = _leading_at_rest(setup, split, [state.trial, *(trial_at(setup, value, laws) for value in begun)])
    return replace(found, anew=True)


def _leading_at_rest(setup: Setup, split: Split, trials: Sequence[Trial], nearly: float = NEARLY) -> State:
    """As `at_rest`, of those only that after a few steps ``nearly`` lead."""
    solved, cost, rest = solve_all(trials, split.train, setup.space, max_steps=FEW, tolerance=TOLERANCE)
    worst = float(np.max(cost[np.isfinite(cost)], initial=0.0))
    solved, cost = go_on(setup, split, solved, cost, rest, worst, worst - float(np.min(cost)), 60 - FEW, nearly)
    i = int(np.argmin(cost))
    return State(setup, solved[i], residual_on(solved[i], split.whole, setup), float(cost[i]))


def without(state: State, name: str, split: Split) -> State:
    """The hypothesis with one of its mechanisms taken out, fitted again from where it stands and, as the base may have
    been bent beside that mechanism, from the base parameters that the data suggested at first.
    """
    setup = reduced(state.setup, name)
    value, laws = moved(state, setup)
    begun = np.where(owned_by(setup, state.names, len(value)), value, np.asarray(setup.starts[0]))
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


def under_law(state: State, name: str, law: str, split: Split) -> State | None:
    """As `under_every_law`, under one of them; None where it cannot act."""
    setup, m = state.setup, state.setup.structure.mechanism(name)
    if not applicable(m, what_there_is(setup.structure, setup.recordings), m.laws.index(law)):
        return None
    return at_rest(setup, split, _at_every_start(state, name, m.laws.index(law)))


def _law_by_law(state: State, name: str) -> list[list[Trial]]:
    """Of each law that can act and is sought from the one it has, `_at_every_start`."""
    m = state.setup.structure.mechanism(name)
    able = laws_that_can_act(state.setup, m, m.laws.index(state.laws[name]))
    return [_at_every_start(state, name, law) for law in able]


def _at_every_start(state: State, name: str, law: int) -> list[Trial]:
    """One of the mechanisms under a law at every start and all else where it stands."""
    setup, m = state.setup, state.setup.structure.mechanism(name)
    null, where = np.asarray(setup.starts[0]), setup.structure.where
    free, laws = m.free_parameters(law), np.asarray(state.trial.laws).copy()
    laws[setup.structure.mechanisms.index(m)] = law
    begun = []
    for start in m.starts:
        value = state.values
        for p, own in zip(m.parameters, start, strict=True):
            if not p.fixed:
                i = where[f"{name}.{p.name}"]
                value[i] = own * unit(setup, p) if p in free else null[i]
        begun.append(trial_at(setup, value, laws))
    return begun


def under_both_their_laws(state: State, pair: tuple[str, str], split: Split) -> list[State]:
    """The hypothesis with two of its mechanisms under every pair of their laws, from where they start beside the base
    that the data suggested at first, all others as they stand: what is closest after a few steps, come to rest.
    """
    setup, where = state.setup, state.setup.structure.where
    ms = [setup.structure.mechanism(name) for name in pair]
    which = [setup.structure.mechanisms.index(m) for m in ms]
    others = [name for name in state.names if name not in pair]
    kept = owned_by(setup, others, len(state.values))
    begun = np.where(kept, state.values, np.asarray(setup.starts[0]))
    trials = []
    for each in itertools.product(*(laws_that_can_act(setup, m, m.laws.index(state.laws[m.name])) for m in ms)):
        laws = np.asarray(state.trial.laws).copy()
        laws[which] = each
        for start in (0, -1):
            value = begun.copy()
            for m, law in zip(ms, each, strict=True):
                for p in m.free_parameters(law):
                    value[where[f"{m.name}.{p.name}"]] = m.starts[start][m.parameters.index(p)] * unit(setup, p)
            trials.append(trial_at(setup, value, laws))
    solved, cost, _ = solve_all(trials, split.train, setup.space, max_steps=FEW, tolerance=TOLERANCE)
    closest = [int(i) for i in np.argsort(cost)[:_AT_MOST] if cost[i] <= _CLOSE * np.min(cost)]
    return abreast(lambda i: at_rest(setup, split, [solved[i]]), closest)


def in_order(state: State, first: str, split: Split) -> State:
    """The hypothesis with one of its mechanisms told of first; as it was, where it then predicts something else (what
    one mechanism makes of a drive or a reading, the next one takes up).
    """
    structure = state.setup.structure
    ordered = sorted(structure.mechanisms, key=lambda m: 0 if m.is_base else 1 if m.name == first else 2)
    if tuple(ordered) == tuple(structure.mechanisms):
        return state
    setup = restructured(state.setup, replace(structure, mechanisms=tuple(ordered)))
    trial = trial_at(setup, *moved(state, setup))
    residual = residual_on(trial, split.whole, setup)
    there = split.is_train | split.is_held
    if not np.sqrt(np.mean((residual - state.residual)[there] ** 2)) < _ORDER:
        return state
    return State(setup, trial, residual, float(np.sum(residual[split.is_train] ** 2)))


def integrable(state: State, split: Split, before: State | None = None) -> bool:
    """Whether the integrator of the higher order (or, where that is theirs, with steps half as long) predicts the
    same, within half the noise or, of what was added to
    ``before``, within a quarter of what that changed: a force that changes steeply with velocity may fit by the errors
    of the steps alone.
    """
    whole = split.whole
    data = whole.with_order(4) if whole.order == 2 else whole.finer(2)
    other = residual_on(state.trial, data, state.setup)
    there = split.is_train | split.is_held
    cut_off = np.any(np.abs(other[there]) >= CEILING)
    far = lambda a: float(np.sqrt(np.mean((a - state.residual)[there] ** 2)))  # noqa: E731
    return not cut_off and far(other) < max(SAME, 0.0 if before is None else _BY_STEPS * far(before.residual))
