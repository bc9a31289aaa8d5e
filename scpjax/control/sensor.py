"""What the controller sees of the joint: noise, quantisation, delay, slower sampling."""

from __future__ import annotations

from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array, Float, PRNGKeyArray

from scpjax.control.controller import Scalar, check_number, scalar
from scpjax.control.errors import ControlError

Line = tuple[Array, ...]


class Sensor(eqx.Module):
    """A reading of the angle (potentiometer of section 3.3.2, thesis).

    - ``noise``: standard deviation [rad] of white noise, drawn anew for every reading.
    - ``quantum``: step [rad] of the converter; 0 for none. Gradients pass as if it were not there.
    - ``delay``: whole samples of the loop that a reading is old.
    - ``every``: the controller acts at every so many samples of the loop and holds its command in between.

    **Raises** `ControlError` for negative or not finite values.
    """

    noise: Array = eqx.field(converter=scalar)
    quantum: float = eqx.field(static=True)
    delay: int = eqx.field(static=True)
    every: int = eqx.field(static=True)

    def __init__(self, *, noise: Any = 0.0, quantum: float = 0.0, delay: int = 0, every: int = 1):
        self.noise, self.quantum, self.delay, self.every = noise, quantum, delay, every

    def __check_init__(self) -> None:
        check_number(self.noise, "the sensor noise", not_negative=True)
        check_number(self.quantum, "the quantum", not_negative=True)
        if self.delay < 0:
            raise ControlError(f"a delay of {self.delay} samples", mend="give 0 or more")
        if self.every < 1:
            raise ControlError(f"the controller acts every {self.every} samples", mend="give 1 or more")

    def draw(self, key: PRNGKeyArray, n: int) -> Float[Array, " n"]:
        """Noise [rad] of ``n`` readings."""
        return self.noise * jax.random.normal(key, (n,), self.noise.dtype)

    def initial(self, position: Scalar) -> Line:
        """Readings on their way, before the first sample: the position at rest."""
        return (position,) * self.delay

    def read(self, line: Line, position: Scalar, noise: Scalar | float) -> tuple[Line, Scalar]:
        """Readings on their way after the sample, and the one that arrives."""
        seen = position + noise
        if self.quantum > 0:
            seen = seen + jax.lax.stop_gradient(self.quantum * jnp.round(seen / self.quantum) - seen)
        line = (*line, seen)
        return line[1:], line[0]
