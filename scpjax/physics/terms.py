"""Terms of a closure: monomials in what an actuator's states are, each relative to its reference.

Far beyond what was seen a power of it would run away: a temperature, displacement or drive counts for `FARTHEST` times
its reference, the greatest in the recordings, at most.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import jax.numpy as jnp

from scpjax.parameter import Parameter, weight
from scpjax.physics.mechanism import Side, Values, View

REFERENCES = {"T": ("reference_temperature", "K"), "x": ("reference", "m"), "v": ("velocity_scale", "m/s")}
_DRIVE = "effort_scale"
FARTHEST = 1.5


@dataclass(frozen=True)
class Term:
    """``T^i x^j |v|^k u^l``: powers of temperature excess, displacement, velocity, effort; ``odd`` keeps v's sign."""

    name: str
    temperature: int = 0
    displacement: int = 0
    velocity: int = 0
    effort: int = 0
    odd: bool = False

    @property
    def variables(self) -> tuple[str, ...]:
        """What it depends on, in the words of reports."""
        powers = zip(
            ("temperature", "displacement", "velocity", "drive"),
            (self.temperature, self.displacement, self.velocity, self.effort),
            strict=True,
        )
        return tuple(n for n, k in powers if k)

    def value(self, p: Values, view: View) -> Side:
        """Its dimensionless value."""
        out = jnp.ones_like(view.temperature)
        for relative, power in (
            (view.temperature / p.reference_temperature, self.temperature),
            (view.displacement / p.reference, self.displacement),
            (view.effort / p.effort_scale, self.effort),
        ):
            for _ in range(power):
                out = out * jnp.clip(relative, -FARTHEST, FARTHEST)
        if self.velocity:
            speed = view.velocity / p.velocity_scale
            for _ in range(self.velocity - self.odd):
                out = out * jnp.sqrt(speed**2 + 1e-6)
            out = out * speed if self.odd else out
        return out

    def unit_value(self, references: dict[str, float]) -> float:
        """Product of the references: what a coefficient per SI unit is divided by."""
        return math.prod(
            references[name] ** power
            for name, power in (
                ("reference_temperature", self.temperature),
                ("reference", self.displacement),
                ("velocity_scale", self.velocity),
                (_DRIVE, self.effort),
            )
        )


def coefficients(terms: tuple[Term, ...], spread: float = 3.0) -> tuple[Parameter, ...]:
    """One coefficient per term, null 0, then the references (fixed) that they are relative to."""
    free = tuple(weight(t.name, f"c({t.name})", f"weight of the term {t.name}", spread) for t in terms)
    fixed = tuple(
        Parameter(
            name=name,
            symbol=name,
            unit=unit,
            description=f"what {symbol} is relative to",
            typical=1.0,
            bounds=(1e-300, 1e300),
            null=1.0,
            fixed=True,
        )
        for symbol, (name, unit) in ({**REFERENCES, "u": (_DRIVE, "drive")}).items()
    )
    return free + fixed


def total(terms: tuple[Term, ...], p: Values, view: View) -> Side:
    """Sum of the terms with their coefficients."""
    out = jnp.zeros_like(view.temperature)
    for t in terms:
        out = out + getattr(p, t.name) * t.value(p, view)
    return out
