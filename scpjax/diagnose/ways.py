"""A way that a selection may go, and a round on it: every mechanism is tried beside what the way has named."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, replace

import numpy as np

from scpjax.diagnose.candidates import try_all
from scpjax.diagnose.evidence import Comparison, Evidence, at_its_least, equals, probabilities
from scpjax.diagnose.holdout import Split
from scpjax.diagnose.hypothesis import State
from scpjax.diagnose.laws import other_laws
from scpjax.diagnose.own import ROOM, own_room, released
from scpjax.diagnose.patience import Patience
from scpjax.diagnose.pruning import prune
from scpjax.diagnose.remainder import at_noise, no_scale
from scpjax.diagnose.result import Ranked
from scpjax.diagnose.trials import afresh
from scpjax.diagnose.worth import worthwhile
from scpjax.fit.setup import Setup

_CLOSE = 20.0  # difference of BIC (10 nats) up to which two mechanisms are close
_BEHIND = 10.0  # difference of BIC (5 nats) from which a mechanism is behind another
_CLEARLY = 0.9  # of the held-out misfit, that one may leave which predicts clearly better
WAYS = 2  # gone at a time
_ATTEMPTS = 4  # names tried for them
_CONTENDERS = 3  # for the first name, which are tried beside it whatever they promise there


@dataclass(frozen=True)
class Search:
    """What is searched, and by which rules."""

    base: State
    split: Split
    rules: Evidence
    catalogue: Setup
    max_steps: int
    patience: Patience


@dataclass(frozen=True)
class Branch:
    """A way the selection may go: what was named on it, by which evidence.

    ``tried``: by name, all that was compared in the round in which it was named. ``own``: how likely names are that
    were not chosen in a round. ``together``: two that were added at once.
    """

    state: State
    ranking: tuple[Ranked, ...] = ()
    tried: dict[str, tuple[Comparison, ...]] = field(default_factory=dict)
    own: dict[str, float] = field(default_factory=dict)
    equivalents: dict[str, tuple[str, ...]] = field(default_factory=dict)
    ended: bool = False  # nothing more is asked for
    together: tuple[str, ...] = ()

    def chance(self, name: str) -> float:
        """How likely a name is, with its equivalents, against what was compared with it. What is named as well was no
        rival: both are there.
        """
        if name in self.own:
            return self.own[name]
        rivals = [c for c in self.tried[name] if c.added == name or c.added not in self.state.names]
        p = probabilities(rivals)
        return p[name] + sum(p.get(e, 0.0) for e in self.equivalents.get(name, ()))


@dataclass(frozen=True)
class Tried:
    """A round on a way: what was tried, and what may be added to it, most evidence first."""

    way: Branch
    ranking: tuple[Ranked, ...]
    tried: tuple[Comparison, ...]
    accepted: list[Comparison]
    best: float  # evidence of what has most, worth it or not

    @property
    def ends(self) -> bool:
        """Whether nothing more is to be named: beyond a first, nothing that is behind what is too small for one."""
        return not self.accepted or (bool(self.way.state.names) and self.best - self.accepted[0].delta_bic > _BEHIND)


def try_round(search: Search, way: Branch, round_: int, tell: Callable[[str, int], None]) -> Tried:
    """Every mechanism tried beside what a way has named, in its round ``round_``."""
    split, rules = search.split, search.rules
    far = no_scale(way.state, split)  # what laws leave that are never quite right says little of what is held out
    able = [r for r in way.ranking if r.round == 1 and r.delta_bic > rules.bic and (far or r.held_out_gain > 0.0)]
    first = [r for r in able if r.name not in way.state.names]
    tried = try_all(
        way.state,
        split,
        rules,
        search.catalogue,
        max_steps=search.max_steps,
        tell=lambda text: tell(text, round_),
        contenders=[r.name for r in sorted(first, key=lambda r: -r.delta_bic)[:_CONTENDERS]],
        patience=search.patience,
    )
    p = probabilities(tried)
    ranked = (Ranked(c.added, c.delta_bic, c.held_out_gain, p[c.added], c.law, round_) for c in tried)
    accepted = [c for c in tried if c.accepted and worthwhile(way.state, c.state, search.base, split, rules)]
    best = max((c.delta_bic for c in tried if c.accepted), default=0.0)
    return Tried(way, (*way.ranking, *ranked), tuple(tried), accepted, best)


def one_more(search: Search, found: Tried, ways: int = WAYS) -> list[Branch]:
    """A branch with one mechanism more: the best one, and where that does not reach the noise one that predicts the
    held-out stretches better still, or is close. One that is pruned as soon as it is fitted afresh, alone or with what
    was named before, is none, nor a rival of what is named in its place, but the others stay where it led them, if that
    is closer. Out of patience only the best one is followed.
    """
    out: list[Branch] = []
    closest = found.way.state
    first: Comparison | None = None
    left, attempts = [] if found.ends else list(found.accepted), 0
    while left and attempts < _ATTEMPTS and len(out) < ways:
        if out and (at_noise(out[0].state, search.split) or search.patience.over()):
            break
        attempts += 1
        c = left[0] if first is None else _second(left, first, search.split)
        if c is None:
            break
        left = [o for o in left if o is not c]
        way = named(search, found, c)
        if set(way.state.names) <= set(found.way.state.names):
            closest = min(closest, way.state, key=lambda s: s.cost)
            others = [o for o in found.accepted if o is not c]
            found = replace(found, tried=tuple(o for o in found.tried if o is not c), accepted=others)
            continue
        first = first or c
        out.append(way)
    if len(out) == 1 < ways and not (at_noise(out[0].state, search.split) or search.patience.over()):
        trusted = _on_trust(search, found, out[0].state)
        out += [named(search, found, trusted, pruned=False)] if trusted else []
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


def _on_trust(search: Search, found: Tried, first: State) -> Comparison | None:
    """A first name with about as much evidence in what was fitted as the one with most, which led to ``first``, that is
    not accepted, where the noise is no scale for what that leaves: there it may be bent to imitate what else is
    missing, and predict better beside that. None where there is none such; on its way all named is judged together.
    """
    rules = search.rules
    if found.way.state.names or not no_scale(first, search.split):
        return None
    least = max(rules.bic, found.accepted[0].delta_bic - _CLOSE)
    able = [c for c in found.tried if not c.accepted and c.delta_bic > least]
    return next((c for c in able if c.added not in first.names and not at_its_least(c.state, c.added)), None)


def _held_out(state: State, split: Split) -> float:
    """RMS of the held-out residuals, in units of the noise."""
    return float(np.sqrt(np.mean(state.residual[split.is_held] ** 2)))


def named(search: Search, found: Tried, c: Comparison, *, pruned: bool = True) -> Branch:
    """The way with one of what may be added to it; where it is to be ``pruned``, without what is not missed then."""
    split, rules, way = search.split, search.rules, found.way
    like = equals(c, found.accepted, way.state, split)
    state = afresh(c.state, split)
    state = other_laws(state, c.added, split, rules, search.base, search.patience)
    whole, state = state, prune(state, split, rules, search.base) if pruned else state
    if len(state.names) == 1 < len(whole.names):  # beside others it may not have been asked for its law
        state = other_laws(state, state.names[0], split, rules, search.base, search.patience)
    tried, own = way.tried | {c.added: found.tried}, {n: p for n, p in way.own.items() if n != c.added}
    return Branch(state, found.ranking, tried, own, way.equivalents | {c.added: like})


def with_own_room(search: Search, found: Tried) -> list[Branch]:
    """The way with a room that has a course of its own in each recording, where there is evidence for one."""
    c = own_room(found.way.state, search.split, search.rules)
    if c is None or not worthwhile(found.way.state, c.state, search.base, search.split, search.rules):
        return []
    tried = (c, *(o for o in found.tried if o.added != ROOM))
    last, law = found.ranking[-1].round, f"{c.law}, by recording"
    ranked = Ranked(c.added, c.delta_bic, c.held_out_gain, probabilities(tried)[c.added], law, last)
    with_it = replace(found, ranking=(*found.ranking, ranked), tried=tried, accepted=[c, *found.accepted])
    way = named(search, with_it, c)
    return [way] if ROOM in way.state.names else []


def with_own_values(search: Search, way: Branch) -> Branch | None:
    """The way with a parameter of its mechanisms that has a value of its own in each recording, if there is evidence
    for one.
    """
    state = released(way.state, search.split, search.rules)
    return None if state is None else replace(way, state=state)
