"""Evidence for a mechanism, for one hypothesis over another, and that recordings cannot tell two apart."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy.special import expit

from scpjax.diagnose.folds import held_in_turn
from scpjax.diagnose.holdout import Split
from scpjax.diagnose.hypothesis import State, moving
from scpjax.diagnose.remainder import misfit, no_scale
from scpjax.diagnose.result import CLEARLY
from scpjax.diagnose.trials import SAME
from scpjax.fit.colour import Whitener

_FORM = 0.015  # of the misfit, which a law of another form may leave more than the best and be its equal
EQUIVALENTS = 3
"""Told of a mechanism, at most."""


@dataclass(frozen=True, kw_only=True)
class Evidence:
    """What it takes to be named.

    ``bic``: gain in BIC, with an effective sample size, over what was named before; ``share``: of the misfit in excess
    of the noise, in some column, that a mechanism must remove (pure BIC adds a second effect to make up for a slightly
    wrong law of the first); ``held_out``: gain in the held-out misfit, in units of what the noise makes it;
    ``worth``: of the base model's misfit in some column, what each must remove, as the law of another is never quite
    right; ``most``: mechanisms at most.
    """

    bic: float = 12.0
    share: float = 0.2
    held_out: float = 6.0
    worth: float = 0.015
    most: int = 3


@dataclass(frozen=True)
class Comparison:
    """A hypothesis with one mechanism more against the one without."""

    state: State
    added: str
    law: str
    delta_bic: float
    held_out_gain: float  # relative fall of the held-out RMS misfit
    held_out_excess: float  # fall of the held-out sum of squares, in units of what it would be by chance
    removed: float  # largest share of any column's excess misfit that went
    accepted: bool


def compare(before: State, after: State, added: str, law: str, split: Split, rules: Evidence, extra: int) -> Comparison:
    """Evidence for the mechanism by which ``after`` goes beyond ``before``.

    Where the noise is no scale for what ``before`` leaves, the stretches held out are several sets in turn: of one,
    how well a law that is never quite right happens to do there decides more than what is missing.
    """
    t, h = split.is_train, split.is_held
    white = Whitener.learn(after.residual, t)
    (sse0, n), (sse1, _) = (white(s.residual, t) for s in (before, after))
    variance = max(sse1 / max(n, 1), white.floor)
    delta_bic = (sse0 - sse1) / variance - extra * np.log(max(n, 2))
    removed = 0.0
    for j in range(t.shape[2]):
        there = (t | h)[..., j]
        if not there.any():
            continue
        a, b = (float(np.mean(s.residual[..., j][there] ** 2)) for s in (before, after))
        floor = min(1.0, b)
        if a - floor > 0.02:
            removed = max(removed, (a - b) / (a - floor))
    able = delta_bic > rules.bic and removed > rules.share and not at_its_least(after, added)
    folds = [[(s.residual, h)] for s in (before, after)]
    if (able if added else delta_bic > 0) and no_scale(before, split):
        folds = held_in_turn((before, after), split)
    held0, held1 = (sum(white(*fold)[0] for fold in each) for each in folds)
    excess_gain = (held0 - held1) / variance
    held = [sum(float(np.sum(r[there] ** 2)) for r, there in each) for each in folds]
    gain = 1.0 - np.sqrt(held[1] / max(held[0], 1e-300))
    accepted = able and excess_gain > rules.held_out and gain > 0
    return Comparison(
        after, added, law, float(delta_bic), float(gain), float(excess_gain), float(removed), bool(accepted)
    )


def at_its_least(state: State, name: str) -> bool:
    """Whether all that makes up the strength of a mechanism was fitted to the least that counts as one: the data would
    have less of it, and what it gained came with it by the way. False of what is no mechanism of the hypothesis.
    """
    if name not in state.names:
        return False
    structure = state.setup.structure
    m = structure.mechanism(name)
    free = m.free_parameters(m.laws.index(state.laws[name]))
    strengths = [p for p in free if p.null is not None and p.null < p.bounds[0]]
    value = {p.name: float(np.max(state.values[structure.where[f"{name}.{p.name}"]])) for p in strengths}
    return bool(strengths) and all(value[p.name] < _LEAST * p.bounds[0] for p in strengths)


_LEAST = 1.05  # of the lower bound of a strength, up to which it is at it


def ahead(a: State, b: State, split: Split, rules: Evidence) -> float:
    """By how much BIC, reckoned as for mechanisms, speaks for hypothesis ``a`` against ``b``."""
    return _between(b, a, split, rules).delta_bic


def chance_against(a: State, b: State, split: Split, rules: Evidence) -> float:
    """How likely hypothesis ``a`` is where ``b`` is the only other one, by BIC: 1/(1 + exp(-BIC/2))."""
    return float(expit(ahead(a, b, split, rules) / 2))


def is_better(a: State, b: State, split: Split, rules: Evidence) -> bool:
    """Whether one hypothesis has more evidence for it than another, and predicts the held-out stretches better: far
    from the noise, BIC alone takes what fits the training part by whatever means.
    """
    found = _between(b, a, split, rules)
    return found.delta_bic > 0 and found.held_out_gain > 0


def _between(before: State, after: State, split: Split, rules: Evidence) -> Comparison:
    return compare(before, after, "", "", split, rules, moving(after) - moving(before))


def probabilities(comparisons: Sequence[Comparison], *, prior_none: float = 0.5) -> dict[str, float]:
    """Posterior share of each mechanism against the others and none, from BIC differences (exp(BIC/2))."""
    if not comparisons:
        return {}
    log = np.array([0.0] + [c.delta_bic / 2 if c.accepted else min(c.delta_bic / 2, -2.0) for c in comparisons])
    log[0] += np.log(prior_none)
    log[1:] += np.log((1 - prior_none) / len(comparisons))
    share = np.exp(log - log.max())
    share /= share.sum()
    return {c.added: float(p) for c, p in zip(comparisons, share[1:], strict=True)}


def excess(state: State, split: Split) -> np.ndarray:
    """Mean square beyond what the noise makes, by column; 0 where there is none."""
    return np.maximum(misfit(state, split) - 1.0, 0.0)


def distance(a: State, b: State, split: Split) -> float:
    """RMS difference of what two hypotheses predict, in units of the noise."""
    return float(np.sqrt(np.mean((a.residual - b.residual)[split.is_train | split.is_held] ** 2)))


def are_alike(a: State, b: State, split: Split) -> bool:
    """Whether two hypotheses predict the same, within half the noise."""
    return distance(a, b, split) < SAME


def _equal(a: State, b: State, before: State, split: Split, behind: float) -> bool:
    """Whether ``a`` predicts what ``b`` does and is about as likely (BIC ``behind``), or leaves no more of the misfit
    ``before`` than the form of a law decides.
    """
    more = excess(a, split) - excess(b, split)
    return are_alike(a, b, split) and (behind < CLEARLY or not np.any(more > _FORM * excess(before, split)))


def are_equal(a: State, b: State, before: State, split: Split, rules: Evidence) -> bool:
    """Whether these recordings cannot tell two hypotheses, of which ``b`` is the better, apart."""
    return _equal(a, b, before, split, ahead(b, a, split, rules))


def equals(best: Comparison, others: Sequence[Comparison], before: State, split: Split) -> tuple[str, ...]:
    """Mechanisms that these recordings cannot tell from the best: they predict the same, within half the noise.

    And are about as likely, or explain as much to within what the form of a law decides.
    """
    found = []
    for c in others:
        if c.added == best.added or not c.accepted:
            continue
        if _equal(c.state, best.state, before, split, best.delta_bic - c.delta_bic):
            found.append((distance(c.state, best.state, split), c.added))
    return tuple(name for _, name in sorted(found)[:EQUIVALENTS])
