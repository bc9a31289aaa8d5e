"""Which of a few mechanisms, taken together, do the recordings ask for? Beside a base of the user's own.

Such a base is often crude (two linear tanks) and has few mechanisms beside it, of which several are at work and none
shows alone. So sets of them grow side by side, the best few of every size, and the set chosen is then thinned out: what
stays earns its place beside the others. One model holds them all, so that it is compiled once.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from scpjax.diagnose.choice import Choice, Progress
from scpjax.diagnose.evidence import Comparison, Evidence, compare, equals, probabilities
from scpjax.diagnose.holdout import Split
from scpjax.diagnose.hypothesis import State, grown, laws_of, moving, moving_parameters, starts_with, width
from scpjax.diagnose.patience import Patience
from scpjax.diagnose.remainder import at_noise
from scpjax.diagnose.result import Ranked
from scpjax.diagnose.trials import at_rest, fit_leading
from scpjax.fit.problem import CEILING, Trial
from scpjax.fit.setup import Setup, carry
from scpjax.fit.solve import binned_of, make_room
from scpjax.physics.mechanism import Mechanism

_KEPT = 4  # sets of each size
_STEPS = 60
_SURE = 2  # size of the sets that are tried however long it takes


@dataclass(frozen=True)
class _Task:
    """What is searched: the base as fitted, and the model of all mechanisms that it may leave out."""

    base: State
    split: Split
    rules: Evidence
    catalogue: Setup


@dataclass(frozen=True)
class _Set:
    """A set of mechanisms fitted within the model of all."""

    names: frozenset[str]
    state: State
    gain: Comparison  # over the base


def choose_together(
    base: State,
    split: Split,
    rules: Evidence,
    catalogue: Setup,
    *,
    most: int = 5,
    progress: Progress | None = None,
    patience: Patience | None = None,
) -> Choice:
    """The set of at most ``most`` mechanisms with most evidence, each of which is missed when it is taken out; out of
    ``patience`` of at most two.
    """
    patience = patience or Patience()
    task = _Task(base, split, rules, catalogue)
    candidates = [m for m in catalogue.structure.mechanisms if not m.is_base]
    beam = [_Set(frozenset(), base, compare(base, base, "", "", split, rules, 0))]
    seen: dict[frozenset[str], _Set] = {}
    for size in range(1, min(most, len(candidates)) + 1):
        if size > _SURE and patience.over():
            break
        if progress:
            progress(f"sets of {size}", 0.15 + 0.4 * (size - 1) / most)
        make_room()
        new: dict[frozenset[str], _Set] = {}
        for kept in beam:
            for m in candidates:
                if m.name not in kept.names:
                    found = _with(task, kept, m)
                    if found.names not in new or found.state.cost < new[found.names].state.cost:
                        new[found.names] = found
        seen |= new
        beam = sorted(new.values(), key=lambda s: -s.gain.delta_bic)[:_KEPT]
        if at_noise(beam[0].state, split):
            break
    able = [s for s in seen.values() if s.gain.accepted]
    alone = _by_itself(candidates, seen)
    if not able:
        return Choice(base, alone, {}, {})
    if progress:
        progress("what the best set can do without", 0.55)
    best = _thinned(task, max(able, key=lambda s: s.gain.delta_bic))
    if progress:
        progress("what could stand in for what", 0.65)
    beside, chance, equivalents = _beside(task, best, candidates)
    return Choice(_alone(task, best), (*alone, *beside), chance, equivalents)


def _trial(setup: Setup, value: np.ndarray, laws: np.ndarray, names: frozenset[str]) -> Trial:
    """A trial within the model of all in which only the mechanisms named act and move."""
    active = moving_parameters(setup, laws)
    for slot in setup.structure.slots:
        if slot.parameter.null is not None and slot.mechanism not in names:
            active[slot.index] = False
    return setup.trial(value, active, laws, width(setup))


def _begun(task: _Task, value: np.ndarray, names: frozenset[str]) -> list[np.ndarray]:
    """Where a fit may begin: as ``value`` says, and with the base as the data suggested at first."""
    own = [s.mechanism in names for s in task.catalogue.structure.slots]
    mine = np.concatenate([own, np.zeros(len(value) - len(own), bool)])
    return [value, *(np.where(mine, value, start) for start in task.catalogue.starts[:3])]


def _with(task: _Task, kept: _Set, m: Mechanism) -> _Set:
    """A set with one mechanism more, from its starts: beside what was fitted, and beside what the base started from."""
    names = kept.names | {m.name}
    trials = [
        _trial(task.catalogue, value, start.laws, names)
        for start in starts_with(kept.state, m, task.catalogue)
        for value in _begun(task, start.value, names)
    ]
    return _fitted(task, names, trials, kept.state.cost, m.name)


def _fitted(task: _Task, names: frozenset[str], trials: Sequence[Trial], before: float, added: str = "") -> _Set:
    """The best of some trials of a set; ``before`` is the cost of the set that they come from."""
    catalogue, base = task.catalogue, task.base
    solved, cost = fit_leading(catalogue, task.split, trials, before, _STEPS)
    best = int(np.argmin(cost))
    residual = binned_of([solved[best]], task.split.whole, catalogue.space)[0]
    if np.any(np.abs(residual) >= CEILING):  # it blew up: it explains nothing
        residual = 10.0 * np.abs(base.residual)
    state = State(catalogue, solved[best], residual, float(cost[best]))
    law = state.laws[added] if added else ""
    extra = moving(state) - moving(base)
    return _Set(names, state, compare(base, state, added, law, task.split, task.rules, extra))


def _compared(task: _Task, before: _Set, after: _Set, name: str) -> Comparison:
    """Evidence for the mechanism by which one set goes beyond another."""
    extra = moving(after.state) - moving(before.state)
    return compare(before.state, after.state, name, after.state.laws[name], task.split, task.rules, extra)


def _missed(task: _Task, s: _Set, name: str) -> tuple[Comparison, _Set]:
    """How much a set loses without one of its mechanisms; and what is left, fitted again."""
    names = s.names - {name}
    laws = np.asarray(s.state.trial.laws)
    trials = [_trial(task.catalogue, value, laws, names) for value in _begun(task, s.state.values, names)]
    less = _fitted(task, names, trials, s.state.cost)
    return _compared(task, less, s, name), less


def _thinned(task: _Task, s: _Set) -> _Set:
    """The set without what it does not miss, least missed first."""
    while len(s.names) > 1:
        lost = [_missed(task, s, name) for name in sorted(s.names)]
        spare = [(c, less) for c, less in lost if not c.accepted]
        if not spare:
            break
        s = min(spare, key=lambda found: found[0].delta_bic)[1]
    return s


def _by_itself(candidates: Sequence[Mechanism], seen: dict[frozenset[str], _Set]) -> tuple[Ranked, ...]:
    """Evidence for each mechanism alone: round 1."""
    alone = [seen[frozenset({m.name})].gain for m in candidates]
    return _in_order(alone, probabilities(alone), 1)


def _in_order(found: Sequence[Comparison], p: dict[str, float], round_: int) -> tuple[Ranked, ...]:
    ranked = [Ranked(c.added, c.delta_bic, c.held_out_gain, p[c.added], c.law, round_) for c in found]
    return tuple(sorted(ranked, key=lambda r: -r.delta_bic))


def _beside(
    task: _Task, s: _Set, candidates: Sequence[Mechanism]
) -> tuple[tuple[Ranked, ...], dict[str, float], dict[str, tuple[str, ...]]]:
    """Evidence for each mechanism beside all others that were chosen (round 2); probabilities of those chosen, and what
    could stand in for each: it is taken out, and every other one put in its place.
    """
    others = [m for m in candidates if m.name not in s.names]
    found: list[Comparison] = []
    p: dict[str, float] = {}
    equivalents: dict[str, tuple[str, ...]] = {}
    for name in sorted(s.names):
        own, less = _missed(task, s, name)
        swapped = [_compared(task, less, _with(task, less, m), m.name) for m in others]
        equivalents[name] = equals(own, swapped, less.state, task.split)
        share = probabilities([own, *swapped])
        p[name] = share[name] + sum(share[e] for e in equivalents[name])
        found.append(own)
    chance = dict(p)
    for m in others:
        more = _compared(task, s, _with(task, s, m), m.name)
        p[m.name] = probabilities([more])[m.name]
        found.append(more)
    return _in_order(found, p, 2), chance, equivalents


def _alone(task: _Task, s: _Set) -> State:
    """A set in a model of its own, that holds nothing else."""
    catalogue = task.catalogue
    chosen = [m for m in catalogue.structure.mechanisms if m.name in s.names]
    problem = grown(task.base.setup, *chosen)
    null = np.asarray(problem.starts[0])[: len(problem.structure.slots)]
    value = carry(catalogue.structure, problem.structure, s.state.values, null)
    laws = laws_of(catalogue, np.asarray(s.state.trial.laws), problem)
    trial = problem.trial(value, moving_parameters(problem, laws), laws, width(problem))
    return at_rest(problem, task.split, [trial])
