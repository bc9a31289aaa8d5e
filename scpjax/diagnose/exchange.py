"""What was named first was chosen before the rest was known: is another better in its place now?"""

from __future__ import annotations

from collections.abc import Sequence

from scpjax.diagnose.holdout import Split
from scpjax.diagnose.result import Ranked
from scpjax.diagnose.rivals import swapped
from scpjax.diagnose.select import Choice, Evidence, is_better, prune
from scpjax.diagnose.trials import at_noise

_MOST = 2  # tried in the place of a name


def exchanged(choice: Choice, split: Split, rules: Evidence) -> Choice:
    """The choice with names in whose place another, with evidence in the same round, does better beside the rest.

    Where the misfit is down to the noise, or nothing else was named, nothing is exchanged.
    """
    for name in choice.state.names:
        state = best = choice.state
        if len(state.names) < 2 or at_noise(state, split):
            break
        if name not in state.names:
            continue
        for other in accepted_beside(choice.ranking, name, rules):
            if other in state.names:
                continue
            after = prune(next(iter(swapped(state, name, other, split).values())), split, rules)
            if other in after.names and is_better(after, best, split, rules):
                best = after
        if best is not state:
            chance = dict.fromkeys(best.names, choice.probability[name]) | choice.probability
            choice = Choice(
                best,
                choice.ranking,
                {n: chance[n] for n in best.names},
                {n: choice.equivalents.get(n, ()) for n in best.names},
            )
    return choice


def accepted_beside(ranking: Sequence[Ranked], name: str, rules: Evidence) -> list[str]:
    """Mechanisms with evidence in the round in which a name was the best; most first, as many as are tried."""
    for round_ in sorted({r.round for r in ranking}):
        mine = sorted((r for r in ranking if r.round == round_), key=lambda r: -r.delta_bic)
        if mine[0].name == name:
            return [r.name for r in mine[1:] if r.delta_bic > rules.bic and r.held_out_gain > 0.0][:_MOST]
    return []
