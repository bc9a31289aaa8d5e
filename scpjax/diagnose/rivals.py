"""Which hypotheses do the present recordings leave close, so that a further experiment should separate them?"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field

import numpy as np

from scpjax.diagnose.experiment import propose
from scpjax.diagnose.holdout import Split
from scpjax.diagnose.hypothesis import State, grown, residual_on, starts_with, trial_at
from scpjax.diagnose.profiles import Limits
from scpjax.diagnose.proposal import NextExperiment
from scpjax.diagnose.result import Ranked
from scpjax.diagnose.trials import fit_leading, without
from scpjax.physics.catalogue import mechanism

_CLOSE = 20.0  # difference of BIC (10 nats) up to which two hypotheses are close
_HINT = 6.0  # gain in BIC from which something that was not named is worth a look
_MOST = 2  # mechanisms that rival the best
_LAWS = 3  # hypotheses that rival it: their laws
_STEPS = 40


@dataclass(frozen=True)
class Outcome:
    """What a diagnosis ended with: hypotheses fitted to the training part, and how others did.

    ``chosen`` holds what was named; ``learned`` a closure beyond it, where there is one. ``ranking`` compares, round by
    round, each mechanism added to what had been named before; ``equivalents`` are those that did as well by name,
    ``nameless`` those that no mechanism is, by what they say.
    """

    base: State
    chosen: State
    learned: State | None
    ranking: Sequence[Ranked]
    equivalents: Mapping[str, Sequence[str]]
    nameless: Mapping[str, State] = field(default_factory=dict)


def next_experiment(
    outcome: Outcome,
    split: Split,
    limits: Limits | None = None,
    tell: Callable[[str], None] | None = None,
    *,
    only_equivalents: bool = False,
) -> NextExperiment | None:
    """The experiment that separates what a diagnosis left close; None where nothing is, or none within the limits can.

    Close are: a mechanism named and its equivalents, terms that no mechanism is among them; with ``only_equivalents``
    nothing else. Else also the runner-up of its round less than 20 behind in BIC; a closure and the mechanism that did
    best; and, where nothing was named, a mechanism that gained more than 6.

    **Raises** `FitError` for limits that leave no experiment.
    """
    found = rivals(outcome, split, only_equivalents=only_equivalents)
    if len(found) < 2:
        return None
    return propose(list(found.values()), split.whole, labels=list(found), limits=limits, tell=tell)


def rivals(outcome: Outcome, split: Split, *, only_equivalents: bool = False) -> dict[str, State]:
    """The best hypothesis and those close to it, by what sets them apart; the best first and alone if none is."""
    chosen = outcome.chosen
    if outcome.learned is not None:
        top = _best_named(outcome)
        if only_equivalents or top is None:
            return {"closure": outcome.learned}
        named = chosen if chosen.names else added(outcome.base, top, split)
        return {"closure": outcome.learned, " + ".join(named.names): named}
    if not chosen.names:
        hints = [r for r in outcome.ranking if r.round == 1 and r.delta_bic > _HINT]
        if only_equivalents or not hints:
            return {"base model": chosen}
        name = max(hints, key=lambda r: r.delta_bic).name
        return {"base model": chosen, name: added(chosen, name, split)}
    instead = {n: [o for o in outcome.equivalents.get(n, ()) if o not in chosen.names] for n in chosen.names}
    if sum(map(bool, instead.values())) > 1:
        return _for_several(chosen, instead, split)
    for name, equivalent in sorted(instead.items(), key=lambda item: not item[1]):
        others = equivalent
        if not others and outcome.nameless:  # beside a single name
            return {name: chosen} | dict(list(outcome.nameless.items())[:_MOST])
        if not others and not only_equivalents:
            others = [o for o in _behind(outcome.ranking, name) if o not in chosen.names]
        if others:
            laws = [swapped(chosen, name, o, split) for o in others[:_MOST]]
            return {name: chosen} | _merged(laws)
    return {" + ".join(chosen.names): chosen}


def _for_several(chosen: State, instead: Mapping[str, Sequence[str]], split: Split) -> dict[str, State]:
    """Where several names have equivalents: the first of each, by what it stands for from the second on."""
    out: dict[str, State] = {}
    for name, others in [(n, o) for n, o in instead.items() if o][:_MOST]:
        label = f"{others[0]} (for {name})" if out else others[0]
        out = out or {name: chosen}
        out[label] = swapped(chosen, name, others[0], split)[others[0]]
    return out


def _best_named(outcome: Outcome) -> str | None:
    """The mechanism that gained most in the first round, if it gained anything."""
    first = [r for r in outcome.ranking if r.round == 1 and r.delta_bic > 0]
    return max(first, key=lambda r: r.delta_bic).name if first else None


def _behind(ranking: Sequence[Ranked], name: str) -> list[str]:
    """Mechanisms close behind a name, in the round in which it was best; closest first."""
    for round_ in sorted({r.round for r in ranking}):
        mine = sorted((r for r in ranking if r.round == round_), key=lambda r: -r.delta_bic)
        if mine[0].name == name:
            return [r.name for r in mine[1:] if r.delta_bic > 0 and mine[0].delta_bic - r.delta_bic < _CLOSE]
    return []


def _merged(found: Sequence[dict[str, State]]) -> dict[str, State]:
    """The best law of every mechanism, then further ones, closest fit first, as many as are to be separated."""
    best = dict(next(iter(each.items())) for each in found)
    more = sorted((s.cost, label, s) for each in found for label, s in list(each.items())[1:])
    return best | {label: s for _, label, s in more[: max(_LAWS - len(best), 0)]}


def by_law(state: State, name: str, split: Split, *, close: float = _CLOSE) -> dict[str, State]:
    """A hypothesis with one mechanism more, from the start that fit best, under the law that fits best (by the name
    alone) and under those whose sum of squares is so ``close`` to it (with the law in brackets).
    """
    m = mechanism(name)
    problem = grown(state.setup, m)
    starts = starts_with(state, m, problem)
    trials = [trial_at(problem, s.value, s.laws) for s in starts]
    solved, cost = fit_leading(problem, split, trials, state.cost, _STEPS)
    out: dict[str, State] = {}
    seen: set[int] = set()
    for i in np.argsort(cost, kind="stable"):
        law = starts[i].law
        if law in seen or cost[i] > cost.min() + close or not np.isfinite(cost[i]):
            continue
        seen.add(law)
        residual = residual_on(solved[i], split.whole, problem)
        out[f"{name} ({m.laws[law]})" if out else name] = State(problem, solved[i], residual, float(cost[i]))
    return out


def added(state: State, name: str, split: Split) -> State:
    """A hypothesis with one mechanism more, under the law and from the start that fit best."""
    return by_law(state, name, split)[name]


def swapped(state: State, out: str, name: str, split: Split) -> dict[str, State]:
    """A hypothesis with one of its mechanisms in the place of another, by law as of `by_law`."""
    return by_law(without(state, out, split), name, split)
