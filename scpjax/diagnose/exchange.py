"""What was named first was chosen before the rest was known: is another better in its place now, or as good?"""

from __future__ import annotations

import itertools
from collections.abc import Sequence
from dataclasses import replace
from functools import partial

import numpy as np

from scpjax.abreast import abreast
from scpjax.diagnose.choice import Choice
from scpjax.diagnose.doubtful import strained
from scpjax.diagnose.evidence import EQUIVALENTS, Evidence, are_equal, is_better
from scpjax.diagnose.holdout import Split
from scpjax.diagnose.hypothesis import State, moving
from scpjax.diagnose.patience import Patience
from scpjax.diagnose.pruning import prune
from scpjax.diagnose.remainder import FAR, at_noise, leaves_much
from scpjax.diagnose.result import Ranked
from scpjax.diagnose.rivals import by_law
from scpjax.diagnose.screen import Promise, fresh, screen
from scpjax.diagnose.trials import HOPELESS, afresh, in_order, under_both_their_laws, under_every_law, without
from scpjax.fit.setup import Setup

_BY_PROMISE, _BY_RANK = 2, 1  # tried in the place of a name
_BY_PROMISE_FAR = 4  # where what is named ends away from the noise
_PASSES = 2
_NEAR = 1.3**2  # mean square, in units of the noise's, up to which names are near it
_PROMISE = 0.3  # of what the name promises beside the others, which one that is tried must promise at least

_EXCHANGE = "names set against what could stand in their place"


def exchanged(
    choice: Choice, base: State, split: Split, rules: Evidence, catalogue: Setup, patience: Patience | None = None
) -> Choice:
    """The choice with names in whose place another does better beside the rest, or predicts the same with fewer
    parameters, and as equivalents those that do as well; nothing for a single name, which its own round has compared.
    Out of ``patience`` no name is asked for where they are given up in the end; where they are told, what they are told
    as may hang on what does as well in their place. Late by it none is.

    Where they do not reach the noise, or a parameter stands at its limit, every name is asked for its law again first,
    where all stand, as it was chosen before the rest was known; away from it also with each other's, and beside the
    rest without it, and once more where that has changed.
    """
    if choice.settled or len(choice.state.names) < 2:
        return choice
    patience = patience or Patience()
    state = laws_of_two(_laws_again(choice.state, split, rules, patience), split, rules, patience)
    choice = replace(choice, state=state)
    first = choice.state.names[0]
    hopeless: set[tuple[str, str]] = set()
    stood: dict[str, State] = {}
    for _ in range(_PASSES):
        laws = choice.state.laws
        choice = _each_exchanged(choice, base, split, rules, catalogue, hopeless, stood, patience)
        if choice.state.laws == laws or not _is_far(choice.state, split):
            break
    if first in choice.state.names[1:]:
        choice = replace(choice, state=in_order(choice.state, first, split))
    return replace(choice, settled=True)


def _laws_again(state: State, split: Split, rules: Evidence, patience: Patience) -> State:
    """Every name under the law that does best beside the others, from where they stand, where they are not at the
    noise; as long as something changes, where they are away from it or one asks for more than its law allows: the law
    of another may be wrong then. Each is asked once though a search has run out of patience, as that often is all that
    is amiss; in a hurry then, and near the noise.
    """
    in_a_hurry = partial(under_every_law, hurried=True)
    stood: dict[str, State] = {}
    for turn in range(_PASSES):
        before = state
        for name in state.names:
            amiss = _is_far(state, split) or strained(state)
            if (at_noise(state, split) and not amiss) or (turn and (not amiss or patience.over())):
                return state
            if stood.get(name) is state:
                continue
            other = (under_every_law if amiss and not patience.over() else in_a_hurry)(state, name, split)
            if is_better(other, state, split, rules):
                state = other
            else:
                stood[name] = state
        if state is before:
            break
    return state


def laws_of_two(state: State, split: Split, rules: Evidence, patience: Patience) -> State:
    """What ends away from the noise, two names at a time under other laws of both where that is better: the law of each
    may be the best beside the other's wrong one.
    """
    for pair in itertools.combinations(state.names, 2):
        if not _is_far(state, split) or patience.over():
            break
        best = state
        for other in under_both_their_laws(state, pair, split):
            if is_better(other, best, split, rules):
                best = other
        if best is not state:
            state = _laws_again(best, split, rules, patience)
    return state


def _each_exchanged(
    choice: Choice,
    base: State,
    split: Split,
    rules: Evidence,
    catalogue: Setup,
    hopeless: set[tuple[str, str]],
    stood: dict[str, State],
    patience: Patience,
) -> Choice:
    """Every name exchanged in turn; ``hopeless`` collects what did so badly in whose place that it is tried no more,
    and ``stood`` in which hypothesis a name was left in its place: there it is asked for no more.
    """

    def alike(a: State, b: State) -> bool:
        return are_equal(a, b, base, split, rules)

    for name in choice.state.names:
        state = choice.state
        if len(state.names) < 2 or patience.late(_EXCHANGE):
            break
        if name not in state.names or stood.get(name) is state:
            continue
        far = _is_far(state, split)
        if far and patience.over():
            if leaves_much(base, state, split) and not at_noise(state, split, _NEAR):
                break
            far = False
        bare = without(state, name, split)
        found: dict[str, State] = {name: state}
        others = in_its_place(name, bare, choice.ranking, split, rules, catalogue, far=far)
        tried = ([name] if far else []) + [o for o in others if (name, o) not in hopeless]
        beside = partial(_beside, bare, state=state, base=base, split=split, rules=rules, patience=patience)
        for other, beside_it in zip(tried, abreast(beside, tried), strict=True):
            after = beside_it
            if after is None or after.cost > HOPELESS * state.cost:
                hopeless.add((name, other))
                continue
            same = other != name and alike(after, state)
            if same and far and not patience.over():  # the laws of the others were chosen beside what was named
                after = _laws_again(after, split, rules, patience)
            if not (same or is_better(after, state, split, rules)):
                continue
            after = prune(after, split, rules)
            if other in after.names and (other != name or is_better(after, state, split, rules)):
                found[other] = after
        best = name
        for other, after in found.items():
            simpler = moving(after) < moving(found[best]) and alike(after, found[best])
            if other != best and (simpler or is_better(after, found[best], split, rules)):
                best = other
        equal = [o for o, s in found.items() if o != best and alike(s, found[best])]
        after = found[best]
        if after is state:
            stood[name] = state
        if best != name == state.names[0]:  # in its place also in the order in which they are told of
            after = in_order(after, best, split)
        choice = _with(choice, after, name, best, equal)
    return choice


def _beside(
    bare: State, other: str, *, state: State, base: State, split: Split, rules: Evidence, patience: Patience
) -> State | None:
    """The other names with one more, fitted afresh, under the law that fits best, or where that is not better than
    ``state`` under one by which it predicts the same; None where every fit blew up, or late by ``patience``.
    """
    if patience.late(_EXCHANGE):
        return None
    found = [*by_law(bare, other, split, close=np.inf).values()]
    if not found:
        return None
    best = afresh(found[0], split)
    if is_better(best, state, split, rules):
        return best
    return next((afresh(f, split) for f in found[1:] if are_equal(f, state, base, split, rules)), best)


def _is_far(state: State, split: Split) -> bool:
    """Whether a hypothesis ends away from the noise."""
    return not at_noise(state, split, FAR)


def in_its_place(
    name: str,
    bare: State,
    ranking: Sequence[Ranked],
    split: Split,
    rules: Evidence,
    catalogue: Setup,
    *,
    far: bool = False,
) -> list[str]:
    """What may stand in the place of a name: what promises most beside the other names, ``bare``, where their fit
    stands and, as the base may have been bent there to imitate it, beside the base that the data suggested at first;
    and what had evidence when the name had most. More where all names together end ``far`` from the noise.
    """
    candidates = [m for m in catalogue.structure.mechanisms if not m.is_base and m.name not in bare.names]
    first = _as_promising(name, screen(bare, split, catalogue, candidates))[: _BY_PROMISE_FAR if far else _BY_PROMISE]
    begun = fresh(bare, split, catalogue, candidates)
    if begun is not None:
        first += [n for n in _as_promising(name, begun.promises)[:_BY_PROMISE] if n not in first]
    then = [n for n in accepted_beside(ranking, name, rules) if n not in first and n not in bare.names]
    return first + then[:_BY_RANK]


def _as_promising(name: str, promises: Sequence[Promise]) -> list[str]:
    """What promises a share worth it of what a name promises; most first."""
    gain = {p.mechanism.name: p.gain for p in promises}
    return [n for n in gain if n != name and gain[n] > _PROMISE * gain.get(name, 0.0)]


def accepted_beside(ranking: Sequence[Ranked], name: str, rules: Evidence) -> list[str]:
    """Mechanisms with evidence in the round in which a name was the best, or had most if it never was; most first."""

    def place(r: Ranked) -> tuple[bool, float]:
        return all(o.delta_bic <= r.delta_bic for o in ranking if o.round == r.round), r.delta_bic

    mine = max((r for r in ranking if r.name == name), key=place, default=None)
    if mine is None:
        return []
    beside = [r for r in ranking if r.round == mine.round and r.name != name]
    able = [r for r in beside if r.delta_bic > rules.bic and r.held_out_gain > 0.0]
    return [r.name for r in sorted(able, key=lambda r: -r.delta_bic)]


def _with(choice: Choice, state: State, name: str, best: str, alike: Sequence[str]) -> Choice:
    """The choice with ``best`` in the place of ``name``, whose probability it takes over."""
    chance = choice.probability | {best: choice.probability[name]}
    known = choice.equivalents.get(name, ()) if best == name else ()
    same = tuple(dict.fromkeys((*alike, *known)))[:EQUIVALENTS]
    equivalents = choice.equivalents | {best: tuple(n for n in same if n not in state.names)}
    return replace(
        choice,
        state=state,
        probability={n: chance[n] for n in state.names},
        equivalents={n: equivalents.get(n, ()) for n in state.names},
    )
