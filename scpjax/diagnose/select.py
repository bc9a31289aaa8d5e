"""Which left-out mechanisms do the recordings ask for? Every one is tried, and chosen on data held out from fitting."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, replace
from functools import partial

import numpy as np
from scipy.special import expit

from scpjax.abreast import abreast, meanwhile
from scpjax.diagnose.candidates import try_all
from scpjax.diagnose.evidence import Comparison, Evidence, ahead, compare, equals, is_better, probabilities, worthwhile
from scpjax.diagnose.holdout import Split
from scpjax.diagnose.laws import other_laws
from scpjax.diagnose.own import ROOM, own_room, released
from scpjax.diagnose.patience import Patience
from scpjax.diagnose.result import Ranked
from scpjax.diagnose.screen import ready_beside_names
from scpjax.diagnose.trials import FAR, State, afresh, at_noise, in_order, without
from scpjax.fit.setup import Setup

Progress = Callable[[str, float], None]

_CLOSE = 20.0  # difference of BIC (10 nats) up to which two mechanisms are close
_BEHIND = 10.0  # difference of BIC (5 nats) from which a mechanism is behind another
_CLEARLY = 0.9  # of the held-out misfit, that one may leave which predicts clearly better
_SURE = 2  # rounds that are gone however long they take: without a second name a first one is often given up
_WAYS = 2  # gone at a time
_ATTEMPTS = 4  # names tried for them
_OTHERS = 2  # gone where the best one ends away from the noise
_CONTENDERS = 3  # for the first name, which are tried beside it whatever they promise there


@dataclass(frozen=True)
class Choice:
    """How it ended: the hypothesis chosen, all that was tried, and what could stand in for what.

    ``given_up``: names that came nearest and are none, and the share of the held-out misfit that they left;
    ``overstretched``: those of them that asked for more than their laws allow; ``outdone``: something learned explains
    what they do, and better.
    ``free``: the name of a mechanism that a learned curve is, which the hypothesis does not hold. ``settled``: every
    name was set against what could stand in its place.
    """

    state: State
    ranking: tuple[Ranked, ...]
    probability: dict[str, float]
    equivalents: dict[str, tuple[str, ...]]
    given_up: tuple[tuple[str, ...], float] = ((), 0.0)
    overstretched: tuple[str, ...] = ()
    outdone: bool = False
    free: str = ""
    settled: bool = False

    def with_only(self, state: State) -> Choice:
        """The choice with fewer names, those of ``state``."""
        chance = {n: self.probability[n] for n in state.names}
        return Choice(state, self.ranking, chance, {n: self.equivalents.get(n, ()) for n in state.names})


@dataclass(frozen=True)
class _Search:
    """What is searched, and by which rules."""

    base: State
    split: Split
    rules: Evidence
    catalogue: Setup
    max_steps: int
    patience: Patience


@dataclass(frozen=True)
class _Branch:
    """A way the selection may go: what was named on it, by which evidence.

    ``tried``: by name, all that was compared in the round in which it was named. ``own``: how likely names are that
    were not chosen in a round.
    """

    state: State
    ranking: tuple[Ranked, ...] = ()
    tried: dict[str, tuple[Comparison, ...]] = field(default_factory=dict)
    own: dict[str, float] = field(default_factory=dict)
    equivalents: dict[str, tuple[str, ...]] = field(default_factory=dict)
    ended: bool = False  # nothing more is asked for

    def chance(self, name: str) -> float:
        """How likely a name is, with its equivalents, against what was compared with it. What is named as well was no
        rival: both are there.
        """
        if name in self.own:
            return self.own[name]
        rivals = [c for c in self.tried[name] if c.added == name or c.added not in self.state.names]
        p = probabilities(rivals)
        return p[name] + sum(p.get(e, 0.0) for e in self.equivalents.get(name, ()))


def choose(
    base: State,
    split: Split,
    rules: Evidence,
    catalogue: Setup,
    *,
    max_steps: int = 40,
    progress: Progress | None = None,
    enough: Callable[[State], bool] | None = None,
    mend: Callable[[Choice], Choice] | None = None,
    patience: Patience | None = None,
) -> Choice:
    """Forward selection with pruning, from the base hypothesis; ``catalogue`` is the problem with every candidate.
    ``enough(first)`` says whether to end with the first name; out of ``patience`` neither a third round nor another way
    is begun, nor another round on such a way.

    Where two mechanisms are close and neither reaches the noise, both ways are gone one round further. Where the way
    ends away from the noise and ``mend`` does not bring it there, others that had evidence in the first round are gone
    too: one mechanism that imitates two can be ahead of both.
    """
    search = _Search(base, split, rules, catalogue, max_steps, patience or Patience())

    def tell(text: str, round_: int) -> None:
        if progress:
            progress(f"round {round_}: trying {text}", 0.15 + 0.2 * (round_ - 1))

    branches = [_Branch(base)]
    rounds: list[list[_Tried]] = []
    leaders: list[_Branch] = []
    rooms: list[_Branch] = []  # that begin with a room which differs by recording
    for round_ in range(1, rules.most + 1):
        if len(leaders) >= _SURE and search.patience.over():
            break
        tell("every mechanism", round_)
        rounds.append([_tried(search, way, round_, tell) for way in branches])
        with meanwhile(partial(_for_more, search, rounds)):
            further = [b for found in rounds[-1] for b in _one_more(search, found)]
        if not any(at_noise(b.state, split) for b in further):
            tell("what may differ by recording", round_)
            with_room = [b for found in rounds[-1] for b in _with_own_room(search, found)]
            with_values = [b for way in further if not way.ended and (b := _with_own_values(search, way))]
            rooms = rooms if rounds[1:] else with_room
            further += [b for b in (*with_room, *with_values) if at_noise(b.state, split, FAR)]
        leaders.append(leader := _best(further, split, rules))
        if leader.ended or at_noise(leader.state, split):
            break
        if round_ == 1 and enough is not None and enough(leader.state):
            return _choice(leader)
        # the same names reached by another way are no way of their own
        others = (b for b in further if not b.ended and set(b.state.names) != set(leader.state.names))
        branches = [leader, *others][:_WAYS]
    choice, mend = _choice(leaders[-1]), mend or (lambda choice: choice)
    if at_noise(choice.state, split, FAR):
        return choice
    choice = mend(choice) if choice.state.names else choice
    if not at_noise(choice.state, split, FAR):
        other = _by_another_way(search, rounds[0][0], rooms, leaders, choice.state, tell)
        choice = choice if other is None else mend(_choice(other))
    strongest = next((c.added for c in rounds[0][0].accepted if c.added in choice.state.names), None)
    return choice if strongest is None else replace(choice, state=in_order(choice.state, strongest, split))


def _for_more(search: _Search, rounds: Sequence[Sequence[_Tried]]) -> None:
    """Have the program that rounds after the first need compiled where there will be one, as it seems."""
    if len(rounds) > 1 or search.rules.most < 2:
        return
    ((first,),) = rounds
    if not (first.ends or any(at_noise(c.state, search.split) for c in first.accepted)):
        ready_beside_names(search.catalogue)


def _choice(leader: _Branch) -> Choice:
    names = leader.state.names
    chance = {n: leader.chance(n) for n in names}
    return Choice(leader.state, leader.ranking, chance, {n: leader.equivalents.get(n, ()) for n in names})


def _best(branches: Sequence[_Branch], split: Split, rules: Evidence) -> _Branch:
    leader = branches[0]
    for b in branches[1:]:
        if is_better(b.state, leader.state, split, rules):
            leader = b
    return leader


@dataclass(frozen=True)
class _Tried:
    """A round on a way: what was tried, and what may be added to it, most evidence first."""

    way: _Branch
    ranking: tuple[Ranked, ...]
    tried: tuple[Comparison, ...]
    accepted: list[Comparison]
    best: float  # evidence of what has most, worth it or not

    @property
    def ends(self) -> bool:
        """Whether nothing more is to be named: beyond a first, nothing that is behind what is too small for one."""
        return not self.accepted or (bool(self.way.state.names) and self.best - self.accepted[0].delta_bic > _BEHIND)


def _tried(search: _Search, way: _Branch, round_: int, tell: Callable[[str, int], None]) -> _Tried:
    split, rules = search.split, search.rules
    able = [r for r in way.ranking if r.round == 1 and r.delta_bic > rules.bic and r.held_out_gain > 0.0]
    first = [r for r in able if r.name not in way.state.names]
    tried = try_all(
        way.state,
        split,
        rules,
        search.catalogue,
        max_steps=search.max_steps,
        tell=lambda text: tell(text, round_),
        contenders=[r.name for r in sorted(first, key=lambda r: -r.delta_bic)[:_CONTENDERS]],
    )
    p = probabilities(tried)
    ranked = (Ranked(c.added, c.delta_bic, c.held_out_gain, p[c.added], c.law, round_) for c in tried)
    accepted = [c for c in tried if c.accepted and worthwhile(way.state, c.state, search.base, split, rules.worth)]
    best = max((c.delta_bic for c in tried if c.accepted), default=0.0)
    return _Tried(way, (*way.ranking, *ranked), tuple(tried), accepted, best)


def _one_more(search: _Search, found: _Tried, ways: int = _WAYS) -> list[_Branch]:
    """A branch with one mechanism more: the best one, and where that does not reach the noise one that predicts the
    held-out stretches better still, or is close. One that is pruned as soon as it is fitted afresh is none, but the
    others stay where it led them, if that is closer.
    """
    out: list[_Branch] = []
    closest = found.way.state
    first: Comparison | None = None
    left = [] if found.ends else found.accepted[:_ATTEMPTS]
    while left and len(out) < ways and not (out and at_noise(out[0].state, search.split)):
        c = left[0] if first is None else _second(left, first, search.split)
        if c is None:
            break
        left = [o for o in left if o is not c]
        way = _named(search, found, c)
        if set(way.state.names) == set(found.way.state.names):
            closest = min(closest, way.state, key=lambda s: s.cost)
            continue
        first = first or c
        out.append(way)
    return out or [replace(found.way, state=closest, ranking=found.ranking, ended=True)]


def _second(among: Sequence[Comparison], first: Comparison, split: Split) -> Comparison | None:
    """What is worth a way of its own beside the one with most evidence: what predicts the held-out stretches clearly
    better than that, and most so; or what is close to it.

    Evidence counts what was fitted. A mechanism that imitates two at once has most of it, and predicts worse than one
    of the two.
    """
    best = min(among, key=lambda c: _held_out(c.state, split))
    if _held_out(best.state, split) < _CLEARLY * _held_out(first.state, split):
        return best
    return next((c for c in among if first.delta_bic - c.delta_bic <= _CLOSE), None)


def _held_out(state: State, split: Split) -> float:
    """RMS of the held-out residuals, in units of the noise."""
    return float(np.sqrt(np.mean(state.residual[split.is_held] ** 2)))


def _named(search: _Search, found: _Tried, c: Comparison) -> _Branch:
    """The way with one of what may be added to it."""
    split, rules, way = search.split, search.rules, found.way
    like = equals(c, found.accepted, way.state, split)
    state = afresh(c.state, split)
    state = other_laws(state, c.added, split, rules, search.patience)
    state = prune(state, split, rules, search.base)
    tried, own = way.tried | {c.added: found.tried}, {n: p for n, p in way.own.items() if n != c.added}
    return _Branch(state, found.ranking, tried, own, way.equivalents | {c.added: like})


def _with_own_room(search: _Search, found: _Tried) -> list[_Branch]:
    """The way with a room that has a course of its own in each recording, where there is evidence for one."""
    c = own_room(found.way.state, search.split, search.rules)
    if c is None or not worthwhile(found.way.state, c.state, search.base, search.split, search.rules.worth):
        return []
    tried = (c, *(o for o in found.tried if o.added != ROOM))
    last, law = found.ranking[-1].round, f"{c.law}, by recording"
    ranked = Ranked(c.added, c.delta_bic, c.held_out_gain, probabilities(tried)[c.added], law, last)
    with_it = replace(found, ranking=(*found.ranking, ranked), tried=tried, accepted=[c, *found.accepted])
    way = _named(search, with_it, c)
    return [way] if ROOM in way.state.names else []


def _with_own_values(search: _Search, way: _Branch) -> _Branch | None:
    """The way with a parameter of its mechanisms that has a value of its own in each recording, if there is evidence
    for one.
    """
    state = released(way.state, search.split, search.rules)
    return None if state is None else replace(way, state=state)


def _by_another_way(
    search: _Search,
    first: _Tried,
    rooms: Sequence[_Branch],
    leaders: Sequence[_Branch],
    best: State,
    tell: Callable[[str, int], None],
) -> _Branch | None:
    """The best of ways that begin with another name of the first round, or with one of ``rooms``, each gone on for as
    long as it leads what led at its length; None where none is better than ``best``, where the search has come to.
    A room that differs by recording can take many forms: with it the noise has to be reached.

    What speaks for the name with which such a way begins is all that the way has ahead of what led before.
    """
    split, rules = search.split, search.rules
    leader: _Branch | None = None
    others = [c for c in first.accepted if c.added not in leaders[0].state.names][:_OTHERS]
    ways = [(ROOM, lambda room=room: room) for room in rooms]
    ways += [(c.added, lambda c=c: _named(search, first, c)) for c in others]
    for name, begin in ways:
        if search.patience.over():
            break
        way = begin()
        for round_ in range(2, rules.most + 1):
            if search.patience.over():
                break
            (way,) = _one_more(search, _tried(search, way, round_, tell), ways=1)
            if way.ended or not is_better(way.state, leaders[min(round_, len(leaders)) - 1].state, split, rules):
                break
            if at_noise(way.state, split):
                break
        if way.state.setup.structure.own and not at_noise(way.state, split, FAR):
            continue
        if is_better(way.state, best, split, rules) and _earned(search, best, way.state):
            own = float(expit(ahead(way.state, best, split, rules) / 2))
            leader, best = replace(way, own={name: own}), way.state
        if at_noise(best, split):
            break
    return leader


def _earned(search: _Search, before: State, after: State) -> bool:
    """Whether names beyond all those of another hypothesis are worth it, as they have to be when they are added."""
    if not set(before.names) < set(after.names):
        return True
    return worthwhile(before, after, search.base, search.split, search.rules.worth)


def prune(state: State, split: Split, rules: Evidence, base: State | None = None) -> State:
    """Take out what is not missed: what a later mechanism has made superfluous, and the last one where it only led the
    others to a better fit. With ``base`` what is not worth it beside it is not missed either.
    """
    whole = state
    bare = dict(zip(whole.names, abreast(lambda name: without(whole, name, split), whole.names), strict=True))
    for name in whole.names:
        fewer = bare[name] if state is whole else without(state, name, split)
        m = state.setup.structure.mechanism(name)
        extra = state.setup.structure.count_free(name, m.laws.index(state.laws[name]))
        missed = compare(fewer, state, name, "", split, rules, extra).accepted
        if not missed or not (base is None or worthwhile(fewer, state, base, split, rules.worth)):
            state = fewer
    return state
