"""What is told of an effect that a fleet shares, or does not."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field

from scpjax.fit.result import Estimate

APART = 0.01
"""P-value of the same values in all, below which some have others."""
HAS_IT, HAS_NOT, OPEN = "has it", "not with these values", "cannot be told"
"""What is said of an actuator in which a shared effect was not named."""


@dataclass(frozen=True)
class Sharing:
    """What a fleet shares; ``left_out``: why an actuator, or an effect in it, could not be asked, by what that is."""

    effects: tuple[SharedEffect, ...] = ()
    left_out: Mapping[str, str] = field(default_factory=dict)


@dataclass(frozen=True)
class Elsewhere:
    """A shared effect in an actuator in which it was not named: ``says`` whether it `HAS_IT`, by the ``evidence`` of
    all its samples, BIC of what was fitted and twice the log likelihood of what was held out: none of the shared values
    is fitted there. ``held_out_gain``: share by which the held-out RMS misfit falls; ``in_place_of``: what was named
    there and could stand in for it; ``why`` it cannot be told, where it was not asked.
    """

    says: str
    evidence: float = 0.0
    held_out_gain: float = 0.0
    in_place_of: str = ""
    why: str = ""


@dataclass(frozen=True)
class SharedEffect:
    """An effect under one law in several actuators. ``actuators``: those that the same values serve, ``apart``: those
    that have it with values of their own. ``delta_bic``: of the same values against each its own; ``p``: of values that
    differ as much or more if all had the same (likelihood ratio). ``held_out``: RMS misfit of the held-out stretches of
    all in units of the noise, each with its own values and with the shared ones. ``references``: what ``parameters``
    are stated for.
    """

    name: str
    law: str
    actuators: tuple[str, ...]
    apart: tuple[str, ...]
    parameters: dict[str, Estimate]
    delta_bic: float
    p: float
    held_out: tuple[float, float]
    references: Mapping[str, float] = field(default_factory=dict)
    elsewhere: Mapping[str, Elsewhere] = field(default_factory=dict)

    @property
    def is_shared(self) -> bool:
        """Whether there is more evidence for the same values than for each its own, nor are they unlikely."""
        return self.delta_bic > 0 and self.p >= APART

    @property
    def differs(self) -> bool:
        """Whether the same values in all are unlikely."""
        return self.p < APART

    @property
    def says(self) -> str:
        """What is shared, or not, in a sentence."""
        what = f"{self.name} ({self.law})" if self.law else self.name
        if self.differs:
            return f"{what} differs from actuator to actuator: one set of values does not serve all ({self._evidence})."
        if not self.is_shared:
            return f"{what}: whether one set of values serves all cannot be told ({self._evidence})."
        values = ", ".join(
            f"{e.symbol or k} = {e.value:.3g} ({e.low:.3g} to {e.high:.3g}) {'' if e.unit == '1' else e.unit}".rstrip()
            for k, e in self.parameters.items()
        )
        beside = f"; with values of its own in {', '.join(self.apart)}" if self.apart else ""
        out = f"{what}: one set of values serves {len(self.actuators)} actuators, {values} ({self._evidence}){beside}."
        if where := self.having(HAS_IT):
            out += f" By these values it is also in {', '.join(where)}."
        if where := self.having(HAS_NOT):
            out += f" With these values it is not in {', '.join(where)}."
        return out

    @property
    def _evidence(self) -> str:
        chance = "p < 0.001" if self.p < 1e-3 else f"p = {self.p:.2g}"
        return f"BIC {self.delta_bic:+.3g} for it, {chance}"

    def having(self, says: str) -> tuple[str, ...]:
        """Actuators of which that is said; of one in which something else was named, in the place of what."""
        found = {name: e for name, e in self.elsewhere.items() if e.says == says}
        instead = {n: f" (in the place of {e.in_place_of})" if e.in_place_of else "" for n, e in found.items()}
        return tuple(f"{name}{instead[name]}" for name in found)
