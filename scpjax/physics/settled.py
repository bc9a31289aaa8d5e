"""In which state would a system of the user's own stand still and show given readings?"""

from __future__ import annotations

from collections.abc import Callable, Mapping

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from scpjax.physics.model import Model

_STEPS, _HALVINGS = 30, 12
_SAME = 1e-9


def settled(model: Model, readings: Mapping[int, float]) -> Float[Array, " states"]:
    """State of a system that stands still under a constant drive and shows ``readings`` (by output index, SI).

    Damped Newton steps on the rates of the system's states and the readings together, in the states and the drive:
    first without what the linear core leaves out, then with it. Zero states where nothing was read. Where no state
    meets all of it, that which does best.
    """
    system = model.structure.system
    assert system is not None, "only a base of the user's own settles"
    n = len(system.states)
    if not readings:
        return model.initial()
    index = jnp.asarray(list(readings))
    target = jnp.asarray(list(readings.values()), model.theta.dtype)

    def misfit(x: Array, core: bool) -> Array:
        z, effort = model.initial(own=x[:n], effort=x[n]), x[n:]
        parts = [z[i] for i in range(z.shape[0])]
        rates = jnp.stack(model.balances(core=core).rates(parts, effort)[:n])
        return jnp.concatenate([rates, model.observe(z, effort)[index] - target])

    x = np.zeros(n + 1)
    for core in (True, False):
        x = _newton(lambda x, core=core: misfit(x, core), x)
    return model.initial(own=jnp.asarray(x[:n]), effort=float(x[n]))


def _newton(function: Callable[[Array], Array], x: np.ndarray) -> np.ndarray:
    """Where a function comes nearest to zero from ``x``, each of its parts in units of what it was at first."""
    both = jax.jit(lambda x: (function(x), jax.jacfwd(function)(x)))
    value, jacobian = (np.asarray(v) for v in both(jnp.asarray(x)))
    if not (np.all(np.isfinite(value)) and np.all(np.isfinite(jacobian))):
        return x
    scale = 1.0 / np.maximum(np.max(np.abs(jacobian), axis=1), 1e-300)
    for _ in range(_STEPS):
        step = np.linalg.lstsq(jacobian * scale[:, None], -value * scale, rcond=1e-12)[0]
        for halving in range(_HALVINGS):
            ahead = x + step * 0.5**halving
            new, slope = (np.asarray(v) for v in both(jnp.asarray(ahead)))
            finite = np.all(np.isfinite(new)) and np.all(np.isfinite(slope))
            if finite and np.linalg.norm(new * scale) < np.linalg.norm(value * scale):
                break
        else:
            break
        moved = float(np.max(np.abs(ahead - x)))
        x, value, jacobian = ahead, new, slope
        if moved <= _SAME * (1.0 + float(np.max(np.abs(x)))):
            break
    return x
