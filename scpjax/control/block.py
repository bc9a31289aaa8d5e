"""A linear filter inside a controller, sampled: what feedforward, compensators and internal models are made of."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any, Literal

import equinox as eqx
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from scpjax.control.controller import Scalar
from scpjax.control.errors import ControlError

if TYPE_CHECKING:
    import control


class Block(eqx.Module):
    """``x' = A x + b u``, ``y = c x + d u`` from sample to sample; made for one sampling period ``dt`` [s]."""

    a: Float[Array, "n n"]
    b: Float[Array, " n"]
    c: Float[Array, " n"]
    d: Float[Array, ""]

    def initial(self) -> Float[Array, " n"]:
        """State before the first sample."""
        return jnp.zeros_like(self.b)

    def step(self, state: Float[Array, " n"], value: Scalar) -> tuple[Float[Array, " n"], Scalar]:
        """State after the sample, and the output at it."""
        return self.a @ state + self.b * value, self.c @ state + self.d * value


def sampled(system: control.lti.LTI, dt: float, method: Literal["tustin", "zoh"] = "tustin") -> Block:
    """A block of a continuous python-control system with one input and one output, sampled every ``dt`` [s].

    **Raises** `ControlError` for an improper or unstable system and one of several inputs or outputs.
    """
    import control

    if system.ninputs != 1 or system.noutputs != 1:
        raise ControlError(f"{system.ninputs} inputs and {system.noutputs} outputs", mend="give one of each")
    if isinstance(system, control.TransferFunction) and len(system.num[0][0]) > len(system.den[0][0]):
        raise ControlError("more zeros than poles: it cannot be run", mend="put a low-pass behind it")
    whole: Any = system
    if np.any(np.asarray(whole.poles(), dtype=np.complex128).real > 0):
        raise ControlError("the filter is unstable", mend="it needs poles on the left")
    space: Any = control.ss(whole)
    balanced = _scaled(space)
    found = control.sample_system(balanced, dt, "bilinear" if method == "tustin" else "zoh")
    a, b, c, d = (jnp.asarray(np.asarray(m, float)) for m in (found.A, found.B, found.C, found.D))
    return Block(a, b[:, 0], c[0], d[0, 0])


def _scaled(system: control.StateSpace) -> control.StateSpace:
    """The same system with states of like size: a companion form of order seven spans many decades."""
    import control
    from scipy.linalg import matrix_balance

    balanced, (scale, order) = matrix_balance(np.asarray(system.A), separate=True)
    inverse = 1 / scale
    b = np.asarray(system.B)[order] * inverse[:, None] if len(order) else np.asarray(system.B)
    c = np.asarray(system.C)[:, order] * scale[None] if len(order) else np.asarray(system.C)
    return control.StateSpace(balanced, b, c, system.D)
