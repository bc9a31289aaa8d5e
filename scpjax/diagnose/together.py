"""Which of a few mechanisms, taken together, do the recordings ask for? Beside a base of the user's own.

Such a base is often crude (two linear tanks) and has few mechanisms beside it, of which several are at work and none
shows alone. So sets of them grow side by side, the best few of every size, and the set chosen is then thinned out: what
stays earns its place beside the others. One model holds them all, so that it is compiled once.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from scpjax.diagnose.holdout import Split
from scpjax.diagnose.result import Ranked
from scpjax.diagnose.select import Choice, Comparison, Evidence, Progress, compare, probabilities
from scpjax.diagnose.trials import (
    State,
    at_noise,
    at_rest,
    fit_leading,
    grown,
    laws_of,
    moving_parameters,
    starts_with,
    width,
)
from scpjax.fit.problem import CEILING, Trial
from scpjax.fit.setup import Setup, carry
from scpjax.fit.solve import binned_of, make_room
from scpjax.physics.mechanism import Mechanism

_KEPT = 4  # sets of each size
_STEPS = 60


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
) -> Choice:
    """The set of at most ``most`` mechanisms with most evidence, each of which is missed when it is taken out."""
    candidates = [m for m in catalogue.structure.mechanisms if not m.is_base]
    beam = [_Set(frozenset(), base, compare(base, base, "", "", split, rules, 0))]
    seen: dict[frozenset[str], _Set] = {}
    for size in range(1, min(most, len(candidates)) + 1):
        if progress:
            progress(f"sets of {size}", 0.15 + 0.5 * (size - 1) / most)
        make_room()
        new: dict[frozenset[str], _Set] = {}
        for kept in beam:
            for m in candidates:
                if m.name not in kept.names:
                    found = _with(base, kept, m, catalogue, split, rules)
                    if found.names not in new or found.state.cost < new[found.names].state.cost:
                        new[found.names] = found
        seen |= new
        beam = sorted(new.values(), key=lambda s: -s.gain.delta_bic)[:_KEPT]
        if at_noise(beam[0].state, split):
            break
    able = [s for s in seen.values() if s.gain.accepted]
    if not able:
        return Choice(base, _ranked(base, base, candidates, seen, catalogue, split, rules)[0], {}, {})
    best = _thinned(max(able, key=lambda s: s.gain.delta_bic), base, catalogue, split, rules)
    ranking, chance = _ranked(base, best.state, candidates, seen, catalogue, split, rules, best.names)
    state = _alone(base, best, catalogue, split)
    return Choice(state, ranking, {n: chance[n] for n in state.names}, dict.fromkeys(state.names, ()))


def _trial(setup: Setup, value: np.ndarray, laws: np.ndarray, names: frozenset[str]) -> Trial:
    """A trial within the model of all in which only the mechanisms named act and move."""
    active = moving_parameters(setup, laws)
    for slot in setup.structure.slots:
        if slot.parameter.null is not None and slot.mechanism not in names:
            active[slot.index] = False
    return setup.trial(value, active, laws, width(setup))


def _with(base: State, kept: _Set, m: Mechanism, catalogue: Setup, split: Split, rules: Evidence) -> _Set:
    """A set with one mechanism more, from its starts: beside what was fitted, and beside what the base started from."""
    names = kept.names | {m.name}
    trials = []
    for start in starts_with(kept.state, m, catalogue):
        trials.append(_trial(catalogue, start.value, start.laws, names))
        for begun in catalogue.starts[:3]:
            own = [s.mechanism in names for s in catalogue.structure.slots]
            mine = np.concatenate([own, np.zeros(len(begun) - len(own), bool)])
            trials.append(_trial(catalogue, np.where(mine, start.value, begun), start.laws, names))
    return _fitted(base, names, trials, m.name, catalogue, split, rules)


def _fitted(
    base: State,
    names: frozenset[str],
    trials: Sequence[Trial],
    added: str,
    catalogue: Setup,
    split: Split,
    rules: Evidence,
) -> _Set:
    solved, cost = fit_leading(catalogue, split, trials, float(np.inf), _STEPS)
    order = np.argsort(cost)
    residual = binned_of([solved[int(order[0])]], split.whole, catalogue.space)[0]
    if np.any(np.abs(residual) >= CEILING):  # it blew up: it explains nothing
        residual = 10.0 * np.abs(base.residual)
    state = State(catalogue, solved[int(order[0])], residual, float(cost[order[0]]))
    extra = int(np.asarray(state.trial.active).sum()) - int(np.asarray(base.trial.active).sum())
    law = "" if not added else state.laws[added]
    return _Set(names, state, compare(base, state, added, law, split, rules, extra))


def _without(base: State, s: _Set, name: str, catalogue: Setup, split: Split, rules: Evidence) -> _Set:
    """A set less one mechanism, fitted again from where it stands and from where the base started."""
    names = s.names - {name}
    laws, now = np.asarray(s.state.trial.laws), s.state.values
    own = [slot.mechanism in names for slot in catalogue.structure.slots]
    mine = np.concatenate([own, np.zeros(len(now) - len(own), bool)])
    begun = [now, *(np.where(mine, now, start) for start in catalogue.starts[:3])]
    return _fitted(base, names, [_trial(catalogue, v, laws, names) for v in begun], "", catalogue, split, rules)


def _missed(
    base: State, s: _Set, name: str, catalogue: Setup, split: Split, rules: Evidence
) -> tuple[Comparison, _Set]:
    """How much a set loses without one of its mechanisms; and what is left."""
    less = _without(base, s, name, catalogue, split, rules)
    active = [int(np.asarray(x.state.trial.active).sum()) for x in (s, less)]
    law = s.state.laws[name]
    return compare(less.state, s.state, name, law, split, rules, active[0] - active[1]), less


def _thinned(s: _Set, base: State, catalogue: Setup, split: Split, rules: Evidence) -> _Set:
    """The set without what it does not miss, least missed first."""
    while len(s.names) > 1:
        lost = [_missed(base, s, name, catalogue, split, rules) for name in sorted(s.names)]
        spare = [(c, less) for c, less in lost if not c.accepted]
        if not spare:
            break
        s = min(spare, key=lambda found: found[0].delta_bic)[1]
    return s


def _ranked(
    base: State,
    state: State,
    candidates: Sequence[Mechanism],
    seen: dict[frozenset[str], _Set],
    catalogue: Setup,
    split: Split,
    rules: Evidence,
    names: frozenset[str] = frozenset(),
) -> tuple[tuple[Ranked, ...], dict[str, float]]:
    """Evidence for each mechanism alone (round 1) and for each beside all others that were chosen (round 2)."""
    alone = [seen[frozenset({m.name})].gain for m in candidates]
    p = probabilities(alone)
    out = [Ranked(c.added, c.delta_bic, c.held_out_gain, p[c.added], c.law, 1) for c in alone]
    chance: dict[str, float] = {}
    chosen = _Set(names, state, compare(base, state, "", "", split, rules, 0))
    for m in candidates if names else ():
        if m.name in names:
            c = _missed(base, chosen, m.name, catalogue, split, rules)[0]
        else:
            more = _with(base, chosen, m, catalogue, split, rules)
            c = compare(state, more.state, m.name, more.gain.law, split, rules, len(m.free_parameters(0)))
        chance[m.name] = probabilities([c])[m.name]
        out.append(Ranked(m.name, c.delta_bic, c.held_out_gain, chance[m.name], c.law, 2))
    return tuple(sorted(out, key=lambda r: (r.round, -r.delta_bic))), chance


def _alone(base: State, s: _Set, catalogue: Setup, split: Split) -> State:
    """A set in a model of its own, that holds nothing else."""
    chosen = [m for m in catalogue.structure.mechanisms if m.name in s.names]
    problem = grown(base.setup, *chosen)
    null = np.asarray(problem.starts[0])[: len(problem.structure.slots)]
    value = carry(catalogue.structure, problem.structure, s.state.values, null)
    laws = laws_of(catalogue, np.asarray(s.state.trial.laws), problem)
    trial = problem.trial(value, moving_parameters(problem, laws), laws, width(problem))
    return at_rest(problem, split, [trial])
