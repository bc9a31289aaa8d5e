"""What a controller is: a pure step from state, measurement and reference to the effort of each side.

Controllers work in the domain of the effort, V^2 for a voltage drive, in which the plants are linear (thesis 3.3.1).
`to_voltage` and `to_effort` are the only place where it is entered or left.
"""

from __future__ import annotations

import abc
from typing import Any, NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jax.core import Tracer
from jaxtyping import Array, Float

from scpjax.control.errors import ControlError

Scalar = Float[Array, ""]
State = Any  # a pytree of scalars

SUPPLY_V = 3.7
"""Battery voltage; its square is the upper limit of the thesis's saturation (3.18)."""


class Command(NamedTuple):
    """Efforts per side (V^2): ``effort`` within the limits of the drive, ``asked`` before them."""

    effort: tuple[Scalar, ...]
    asked: tuple[Scalar, ...]


def to_voltage(effort: Array) -> Array:
    """Voltage [V] that makes an effort [V^2]; nothing below 0."""
    return jnp.sqrt(jnp.maximum(effort, 0.0))


def to_effort(voltage: Array | float) -> Array:
    """Effort [V^2] of a voltage [V]."""
    return jnp.square(jnp.asarray(voltage))


class Controller(eqx.Module):
    """Base of all controllers.

    ``step`` is pure and does the same in a compiled scan, on serial hardware and, transcribed, in firmware. Units:
    measurement and reference in rad (or m for a single actuator without a pulley), efforts in V^2, ``dt`` in s.
    """

    @property
    @abc.abstractmethod
    def sides(self) -> int:
        """Number of efforts that a command holds: 1 or 2."""

    @abc.abstractmethod
    def initial(self) -> State:
        """State before the first sample."""

    @abc.abstractmethod
    def step(self, state: State, measurement: Scalar, reference: Scalar, dt: Scalar) -> tuple[State, Command]:
        """State after the sample, and the command to hold until the next one."""


def scalar(value: Any) -> Array:
    """A number as an array of the default precision."""
    return jnp.asarray(value, float)


def known(value: Any) -> np.ndarray | None:
    """The value where it is known now, None inside a transformation."""
    return (
        None
        if isinstance(value, Tracer) or not isinstance(value, int | float | np.ndarray | np.generic | jax.Array)
        else np.asarray(value)
    )


def check_number(value: Any, name: str, *, positive: bool = False, not_negative: bool = False) -> None:
    """Refuse what is not finite or has the wrong sign. **Raises** `ControlError`."""
    seen = known(value)
    if seen is None:
        return
    if not np.all(np.isfinite(seen)):
        raise ControlError(f"{name} is {_first(seen, ~np.isfinite(seen))}", mend=f"give a finite {name}")
    if positive and np.any(seen <= 0):
        raise ControlError(f"{name} is {_first(seen, seen <= 0)}", mend=f"{name} must be above 0")
    if not_negative and np.any(seen < 0):
        raise ControlError(f"{name} is {_first(seen, seen < 0)}", mend=f"{name} must not be negative")


def _first(values: np.ndarray, which: np.ndarray) -> str:
    return f"{float(np.atleast_1d(values)[np.atleast_1d(which)][0]):g}"
