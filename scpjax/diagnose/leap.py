"""Two mechanisms at once: one that imitates both together may be ahead of each of them alone."""

from __future__ import annotations

from collections.abc import Callable, Sequence, Set

import numpy as np

from scpjax.diagnose.evidence import Comparison, chance_against, compare, is_better, probabilities
from scpjax.diagnose.hypothesis import State
from scpjax.diagnose.pruning import prune
from scpjax.diagnose.remainder import FAR, at_noise, level
from scpjax.diagnose.result import Ranked
from scpjax.diagnose.rivals import by_law
from scpjax.diagnose.screen import Promise, screen
from scpjax.diagnose.trials import afresh, under_every_law
from scpjax.diagnose.ways import Branch, Search, Tried

_FROM = 4  # of what may be added in a round, closest first, are tried with another one
_MUCH = 0.5  # of the sum of squares, that the other one must promise to take away
_NEAR = 3.0  # RMS misfit, in units of the noise, up to which what two leave is fitted afresh and under other laws
_HOPELESS = 4.0 * _NEAR**2  # sum of squares, in units of the noise's, that both must not promise to leave
_REST = 0.3  # of the sum of squares in excess of the noise: one more that promises to leave less may be all there is


def one_promises_the_rest(search: Search, state: State) -> bool:
    """Whether a single mechanism more promises to leave little of what a hypothesis leaves beyond the noise."""
    noise = float(search.split.is_train.sum())
    promises = _promises(search, state, state.names)
    return bool(promises) and state.cost - promises[0].gain - noise < _REST * (state.cost - noise)


def leap(search: Search, found: Tried, leader: State, against: State, tell: Callable[[str], None]) -> Branch | None:
    """The way of a round with two mechanisms more that together leave about the noise and are better than ``against``,
    to which the search has come without them; neither is what ``leader`` has added there. None where no two do, or out
    of patience.

    Of what had evidence in the round, the four closest are each paired with what promises most beside them. Pairs that
    promise to leave least are fitted first, until one is down to the noise. What speaks for either name is what the
    pair has ahead of ``against``, and of other pairs without it that came to the noise.
    """
    split, rules = search.split, search.rules
    best: tuple[State, Comparison, Promise] | None = None
    brought: list[State] = []

    def ended() -> bool:
        return (best is not None and at_noise(best[0], split)) or search.patience.over()

    def bring(fit: State, c: Comparison, promise: Promise) -> None:
        nonlocal best
        state = _brought_to_noise(search, found, fit, (promise.mechanism.name, c.added))
        if state is not None:
            brought.append(state)
            if is_better(state, against if best is None else best[0], split, rules):
                best = state, c, promise

    if search.patience.over():
        return None
    later: list[tuple[State, Comparison, Promise]] = []
    for c, promise in _pairs(search, found, leader):
        if ended():
            break
        tell(f"{c.added} and {promise.mechanism.name} at once")
        fit = _fitted(search, c, promise)
        if fit is None:
            continue
        if at_noise(fit, split, FAR):
            bring(fit, c, promise)
        else:
            later.append((fit, c, promise))
    for each in sorted(later, key=lambda f: f[0].cost):
        if ended():
            break
        bring(*each)
    if best is None:
        return None
    imitators = {*leader.names} - {*found.way.state.names}
    return _way(search, found, *best, imitators, [against, *(s for s in brought if s is not best[0])])


def _way(
    search: Search,
    found: Tried,
    state: State,
    c: Comparison,
    promise: Promise,
    imitators: Set[str],
    beaten: Sequence[State],
) -> Branch:
    """The way of a round with what a comparison has added and one mechanism more, as ``state`` has them. What it shows
    to be ``imitators`` of both were no rivals of what was named before; ``beaten`` are hypotheses that it is ahead of.
    """
    split, rules, name = search.split, search.rules, promise.mechanism.name
    extra = state.setup.structure.count_free(name, promise.mechanism.laws.index(state.laws[name]))
    last = compare(c.state, state, name, state.laws[name], split, rules, extra)
    p, round_ = probabilities([last])[name], found.ranking[-1].round + 1
    ranked = Ranked(name, last.delta_bic, last.held_out_gain, p, last.law, round_)
    tried = found.way.tried | {c.added: found.tried, name: (last,)}
    tried = {n: tuple(o for o in those if o.added not in imitators) for n, those in tried.items()}
    ahead = [(s.names, chance_against(state, s, split, rules)) for s in beaten]
    least = {n: min(lead for i, (names, lead) in enumerate(ahead) if i == 0 or n not in names) for n in (c.added, name)}
    return Branch(
        state, (*found.ranking, ranked), tried, found.way.own | least, found.way.equivalents, together=(c.added, name)
    )


def _promises(search: Search, state: State, beside: Sequence[str]) -> list[Promise]:
    """What promises something beside a hypothesis, most first; none of those named."""
    others = [m for m in search.catalogue.structure.mechanisms if not m.is_base and m.name not in beside]
    return screen(state, search.split, search.catalogue, others)


def _pairs(search: Search, found: Tried, leader: State) -> list[tuple[Comparison, Promise]]:
    """What had evidence in a round, each with what promises most beside it and was not paired with it yet; those first
    that promise to leave least. None is named by the leader, beside which all are tried in the next round. Promises are
    linear: what is left by them is no bound, but where they leave far too much nothing is tried.
    """
    out: list[tuple[float, Comparison, Promise]] = []
    pairs: set[frozenset[str]] = set()
    most = _HOPELESS * float(search.split.is_train.sum())
    others = [c for c in found.accepted if c.added not in leader.names]
    for c in sorted(others, key=lambda c: c.state.cost)[:_FROM]:
        promises = _promises(search, c.state, (*c.state.names, *leader.names))
        promise = next((p for p in promises if frozenset((c.added, p.mechanism.name)) not in pairs), None)
        left = np.inf if promise is None else c.state.cost - promise.gain
        if promise is not None and left < min(most, (1.0 - _MUCH) * c.state.cost):
            pairs.add(frozenset((c.added, promise.mechanism.name)))
            out.append((left, c, promise))
    return [(c, promise) for _, c, promise in sorted(out, key=lambda each: each[0])]


def _fitted(search: Search, c: Comparison, promise: Promise) -> State | None:
    """A mechanism beside what a comparison has added, under its closest law; None where that is nowhere near."""
    by_each = [*by_law(c.state, promise.mechanism.name, search.split, close=np.inf).values()]
    return by_each[0] if by_each and level(by_each[0], search.split) <= _NEAR else None


def _brought_to_noise(search: Search, found: Tried, fit: State, names: Sequence[str]) -> State | None:
    """Two mechanisms more fitted afresh, and each name under every law; None where that does not reach the noise with
    both.
    """
    split, rules = search.split, search.rules
    state = afresh(fit, split)
    for name in (*names, *found.way.state.names):
        if at_noise(state, split):
            break
        other = under_every_law(state, name, split, hurried=True)
        state = other if is_better(other, state, split, rules) else state
    if not at_noise(state, split, FAR):
        return None
    state = prune(state, split, rules, search.base)
    return state if {*names, *found.way.state.names} == {*state.names} else None
