"""What is known of a parameter before any data: unit, bounds, null value, prior; and the maps to and from
the unconstrained numbers that a least-squares solver moves."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any, Literal

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float


@dataclass(frozen=True, kw_only=True)
class Parameter:
    """One scalar of a mechanism.

    ``scale="log"`` is for positive quantities (bounds must be positive; a null value of 0 lies outside them and
    is reached only by leaving the mechanism out), ``scale="linear"`` for signed ones. ``typical`` is where a search
    starts when the data say nothing better. ``spread`` is the standard deviation of the prior that a diagnosis
    uses, in units of ln(value) for log scale and of the value for linear scale; ``inf`` means none.
    ``time`` says that values and bounds are multiples of a time scale of the recording, ``strict`` that the bounds are
    those of the physics: recordings that ask for a value beyond them ask for something else.
    """

    name: str
    symbol: str
    unit: str
    description: str
    typical: float
    bounds: tuple[float, float]
    null: float | None = None
    scale: Literal["log", "linear"] = "log"
    spread: float = float("inf")
    fixed: bool = False
    time: Literal["", "response", "duration"] = ""
    strict: bool = False

    def __post_init__(self) -> None:
        low, high = self.bounds
        if not low < high:
            raise ValueError(f"{self.name}: bounds {self.bounds} are not in order")
        if not self.fixed and not low <= self.typical <= high:
            raise ValueError(f"{self.name}: typical {self.typical} lies outside the bounds {self.bounds}")
        if self.scale == "log" and not self.fixed and low <= 0:
            raise ValueError(f"{self.name}: a log-scaled parameter needs a positive lower bound")


def weight(name: str, symbol: str, description: str, spread: float = 3.0) -> Parameter:
    """A dimensionless weight of a closure: of either sign, without bounds, 0 where there is none."""
    return Parameter(
        name=name,
        symbol=symbol,
        unit="1",
        description=description,
        typical=0.0,
        bounds=(-math.inf, math.inf),
        null=0.0,
        scale="linear",
        spread=spread,
    )


Numbers = Array | np.ndarray


def namespace(*values: Any) -> Any:
    """`jax.numpy` where any value is JAX's; else `numpy`, for which nothing is compiled."""
    return jnp if any(isinstance(v, jax.Array) for v in values) else np


class Bounded(eqx.Module):
    """Vectorised map between physical values and unconstrained ones, for a whole parameter vector.

    An entry with finite bounds follows ``inner = mid + half tanh(free / half)``, with unit slope in the middle, where
    ``inner`` is ln(value) on log scale and the value itself on linear scale; an unbounded linear entry is
    ``value = scale * free``.
    """

    log: Bool[Numbers, " p"]
    finite: Bool[Numbers, " p"]
    mid: Float[Numbers, " p"]
    half: Float[Numbers, " p"]
    scale: Float[Numbers, " p"]

    def __init__(self, low: np.ndarray, high: np.ndarray, log: np.ndarray, scale: np.ndarray):
        log = np.asarray(log, bool)
        finite = np.isfinite(low) & np.isfinite(high)
        low = np.where(log, np.log(np.where(log, low, 1.0)), np.where(finite, low, -1.0))
        high = np.where(log, np.log(np.where(log, high, 2.0)), np.where(finite, high, 1.0))
        self.log, self.finite = log, finite
        self.mid, self.half = (low + high) / 2, (high - low) / 2
        self.scale = np.asarray(scale, float)

    def to_inner(self, free: Float[Numbers, " p"]) -> Float[Numbers, " p"]:
        """Unconstrained to the scale on which priors are natural: ln(value) or value."""
        xp = namespace(free, self.mid)
        bounded = self.mid + self.half * xp.tanh(free / self.half)
        return xp.where(self.finite, bounded, self.scale * free)

    def to_value(self, free: Float[Numbers, " p"]) -> Float[Numbers, " p"]:
        """Unconstrained to physical."""
        inner = self.to_inner(free)
        xp = namespace(inner)
        return xp.where(self.log, xp.exp(xp.where(self.log, inner, 0.0)), inner)

    def inner_of(self, value: Float[Numbers, " p"]) -> Float[Numbers, " p"]:
        """Physical to ln(value) or value."""
        xp = namespace(value, self.mid)
        return xp.where(self.log, xp.log(xp.where(self.log, xp.maximum(value, 1e-300), 1.0)), value)

    def to_free(self, value: Float[Numbers, " p"], margin: float = 1e-3) -> Float[Numbers, " p"]:
        """Physical to unconstrained; values at or beyond a bound are moved just inside it."""
        inner = self.inner_of(value)
        xp = namespace(inner)
        share = xp.clip((inner - self.mid) / self.half, -1 + margin, 1 - margin)
        return xp.where(self.finite, self.half * xp.arctanh(share), inner / self.scale)

    def slope(self, free: Float[Numbers, " p"]) -> Float[Numbers, " p"]:
        """d(value)/d(free), entry by entry: for error bars."""
        xp = namespace(free, self.mid)
        inner = xp.where(self.finite, 1 - xp.tanh(free / self.half) ** 2, self.scale)
        return xp.where(self.log, inner * self.to_value(free), inner)
