"""Smooth stand-ins for kinks and steps, exactly zero at zero; kinks by square roots, which cost little in a loop."""

from __future__ import annotations

import jax.numpy as jnp
from jaxtyping import Array

_FLOOR = 1e-30  # under a root, so that its derivative is finite where all else there is zero


def root(square: Array) -> Array:
    """sqrt, finite with its derivatives at 0."""
    return jnp.sqrt(square + _FLOOR)


def clipped(x: Array, limit: Array, width: Array) -> Array:
    """x between -limit and limit, which it does not leave; the corners are rounded over ``width``. 0 for limit 0."""
    square = width * width
    return 0.5 * (root((x + limit) ** 2 + square) - root((x - limit) ** 2 + square))


def ramp(x: Array, corner: Array, width: Array) -> Array:
    """x - corner beyond the corner and 0 before it, rounded over ``width``; less its value at x = 0."""
    past, square = x - corner, width * width
    return 0.5 * (x + root(past * past + square) - root(corner * corner + square))


def rise(x: Array, corner: Array, width: Array) -> Array:
    """From 0 to 1 about the corner, half of it within 0.55 ``width`` to either side; less its value at x = 0."""
    return 0.5 * (jnp.tanh((x - corner) / width) + jnp.tanh(corner / width))
