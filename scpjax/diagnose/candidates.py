"""A round of the selection: every mechanism of the catalogue that is not yet in, under its best law."""

from __future__ import annotations

from collections.abc import Callable, Sequence

import numpy as np

from scpjax.abreast import abreast
from scpjax.diagnose.evidence import Comparison, Evidence, compare, is_better
from scpjax.diagnose.holdout import Split
from scpjax.diagnose.hypothesis import State
from scpjax.diagnose.patience import Patience
from scpjax.diagnose.promising import fit_promising
from scpjax.diagnose.remainder import FAR, at_noise, misfit
from scpjax.diagnose.screen import fresh, screen
from scpjax.diagnose.trials import afresh
from scpjax.fit.setup import Setup
from scpjax.physics.mechanism import Mechanism

_STRAIGHT = 1.3  # mean square, in units of the noise's, up to which a base model has not been bent
_CONTESTED = 1.1  # sum of squares, in units of the least, up to which it is contested which is the closest
_MUCH = 0.5  # of the fall of the sum of squares that the closest one makes


def try_all(
    state: State,
    split: Split,
    rules: Evidence,
    catalogue: Setup,
    *,
    max_steps: int,
    tell: Callable[[str], None],
    contenders: Sequence[str] = (),
    patience: Patience | None = None,
) -> list[Comparison]:
    """Every mechanism not yet in: all its laws and starts screened, what promises something fitted (``contenders`` for
    an earlier name whatever they promise; fewer out of ``patience``); best law of each.

    The best law is the one with evidence for it: a wider one fits the training part better and may predict worse.
    """
    candidates = [m for m in catalogue.structure.mechanisms if not m.is_base and m.name not in state.names]
    promises = screen(state, split, catalogue, candidates)
    bent = np.any(misfit(state, split) > _STRAIGHT)
    begun = fresh(state, split, catalogue, candidates) if bent else None
    fitted = fit_promising(state, split, promises, begun, max_steps, tell, contenders, patience)
    fitted = contested(state, fitted, split, patience or Patience())
    out = []
    for promise in promises:
        m = promise.mechanism
        found = [
            compare(state, after, m.name, m.laws[law], split, rules, after.setup.structure.count_free(m.name, law))
            for law, after in fitted.get(m.name, {}).items()
        ]
        if found:
            out.append(_best_law(m, found, split, rules))
        else:  # it promised nothing: as it was, for more parameters
            out.append(compare(state, state, m.name, m.laws[0], split, rules, len(m.free_parameters(0))))
    return sorted(out, key=lambda c: -c.delta_bic)


def contested(
    before: State, fitted: dict[str, dict[int, State]], split: Split, patience: Patience
) -> dict[str, dict[int, State]]:
    """Hypotheses by mechanism and law; fitted afresh are those that are close to the closest fit, and the closest of
    every mechanism that gains much of what the best one does, as long as there is ``patience``. Between several
    mechanisms it may decide from which base parameters they began.
    """
    closest = {name: min(s.cost for s in laws.values()) for name, laws in fitted.items() if laws}
    if len(closest) < 2:
        return fitted
    least = min(closest.values())
    much = before.cost - _MUCH * (before.cost - least)
    if sum(cost < max(_CONTESTED * least, much) for cost in closest.values()) < 2:
        return fitted
    far = not any(at_noise(s, split, FAR) for laws in fitted.values() for s in laws.values())

    def again(name: str, s: State) -> State:
        if (s.cost >= _CONTESTED * least and not s.cost == closest[name] < much) or patience.over():
            return s
        after = afresh(s, split, own=far)
        return after if after.cost <= s.cost else s

    each = [(name, law, s) for name, laws in fitted.items() for law, s in laws.items()]
    found = abreast(lambda one: again(one[0], one[2]), each)
    out: dict[str, dict[int, State]] = {name: {} for name in fitted}
    for (name, law, _), after in zip(each, found, strict=True):
        out[name][law] = after
    return out


def _best_law(m: Mechanism, found: Sequence[Comparison], split: Split, rules: Evidence) -> Comparison:
    """The law to speak for a mechanism: of those with evidence the one with fewest parameters, unless a wider one is
    better; of equally wide ones the closer fit. A name needs strong evidence; which of its laws it is, only more.
    """
    width = lambda c: len(m.free_parameters(m.laws.index(c.law)))  # noqa: E731
    able = [c for c in found if c.accepted]
    if not able:
        return max(found, key=lambda c: c.delta_bic)
    best, *others = sorted(able, key=lambda c: (width(c), c.state.cost))
    for c in others:
        if width(c) > width(best) and is_better(c.state, best.state, split, rules):
            best = c
    return best
