"""What a selection ended with."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field

from scpjax.diagnose.hypothesis import State
from scpjax.diagnose.result import Ranked

Progress = Callable[[str, float], None]


@dataclass(frozen=True)
class Choice:
    """How it ended: the hypothesis chosen, all that was tried, and what could stand in for what.

    ``given_up``: names that came nearest and are none, and the share of the misfit that they left; ``overstretched``:
    those of them that asked for more than their laws or nature allow, and of which parameters, or of what; ``outdone``:
    something learned explains what they do, and better. ``free``: the name of a mechanism that a learned curve is,
    which the hypothesis does not hold. ``settled``: every name was set against what could stand in its place,
    as far as there was time.
    ``rang``: what was learned beyond it, or in its place, was left out, as it rings within the bins. ``together``: two
    names that were tried at once in place of one.
    """

    state: State
    ranking: tuple[Ranked, ...]
    probability: dict[str, float]
    equivalents: dict[str, tuple[str, ...]]
    given_up: tuple[tuple[str, ...], float] = ((), 0.0)
    overstretched: dict[str, tuple[str, ...]] = field(default_factory=dict)
    outdone: bool = False
    free: str = ""
    settled: bool = False
    rang: bool = False
    together: tuple[str, ...] = ()

    def with_only(self, state: State) -> Choice:
        """The choice with fewer names, those of ``state``."""
        chance = {n: self.probability[n] for n in state.names}
        return Choice(state, self.ranking, chance, {n: self.equivalents.get(n, ()) for n in state.names})
