"""What is known of a parameter before any data: unit, bounds, null value, prior; and the maps to and from
the unconstrained numbers that a least-squares solver moves."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

import equinox as eqx
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
    ``time`` says that values and bounds are multiples of a time scale of the recording.
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

    def __post_init__(self) -> None:
        low, high = self.bounds
        if not low < high:
            raise ValueError(f"{self.name}: bounds {self.bounds} are not in order")
        if not self.fixed and not low <= self.typical <= high:
            raise ValueError(f"{self.name}: typical {self.typical} lies outside the bounds {self.bounds}")
        if self.scale == "log" and not self.fixed and low <= 0:
            raise ValueError(f"{self.name}: a log-scaled parameter needs a positive lower bound")


class Bounded(eqx.Module):
    """Vectorised map between physical values and unconstrained ones, for a whole parameter vector.

    An entry with finite bounds follows ``inner = mid + half tanh(free / half)``, with unit slope in the middle, where
    ``inner`` is ln(value) on log scale and the value itself on linear scale; an unbounded linear entry is
    ``value = scale * free``.
    """

    log: Bool[Array, " p"]
    finite: Bool[Array, " p"]
    mid: Float[Array, " p"]
    half: Float[Array, " p"]
    scale: Float[Array, " p"]

    def __init__(self, low: np.ndarray, high: np.ndarray, log: np.ndarray, scale: np.ndarray):
        log = np.asarray(log, bool)
        finite = np.isfinite(low) & np.isfinite(high)
        low = np.where(log, np.log(np.where(log, low, 1.0)), np.where(finite, low, -1.0))
        high = np.where(log, np.log(np.where(log, high, 2.0)), np.where(finite, high, 1.0))
        self.log, self.finite = jnp.asarray(log), jnp.asarray(finite)
        self.mid, self.half = jnp.asarray((low + high) / 2), jnp.asarray((high - low) / 2)
        self.scale = jnp.asarray(np.asarray(scale, float))

    def to_inner(self, free: Float[Array, " p"]) -> Float[Array, " p"]:
        """Unconstrained to the scale on which priors are natural: ln(value) or value."""
        bounded = self.mid + self.half * jnp.tanh(free / self.half)
        return jnp.where(self.finite, bounded, self.scale * free)

    def to_value(self, free: Float[Array, " p"]) -> Float[Array, " p"]:
        """Unconstrained to physical."""
        inner = self.to_inner(free)
        return jnp.where(self.log, jnp.exp(jnp.where(self.log, inner, 0.0)), inner)

    def inner_of(self, value: Float[Array, " p"] | np.ndarray) -> Float[Array, " p"]:
        """Physical to ln(value) or value."""
        return jnp.where(self.log, jnp.log(jnp.where(self.log, jnp.maximum(value, 1e-300), 1.0)), value)

    def to_free(self, value: Float[Array, " p"] | np.ndarray, margin: float = 1e-3) -> Float[Array, " p"]:
        """Physical to unconstrained; values at or beyond a bound are moved just inside it."""
        inner = self.inner_of(value)
        share = jnp.clip((inner - self.mid) / self.half, -1 + margin, 1 - margin)
        return jnp.where(self.finite, self.half * jnp.arctanh(share), inner / self.scale)

    def slope(self, free: Float[Array, " p"]) -> Float[Array, " p"]:
        """d(value)/d(free), entry by entry: for error bars."""
        inner = jnp.where(self.finite, 1 - jnp.tanh(free / self.half) ** 2, self.scale)
        return jnp.where(self.log, inner * self.to_value(free), inner)
