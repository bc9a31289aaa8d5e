"""Adaptive steps by diffrax: the cross-check of the other methods, and the way out for stiff mechanisms."""

from __future__ import annotations

from collections.abc import Callable

import diffrax
import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jax.core import Tracer
from jaxtyping import Array, Float

from scpjax.errors import ModelError
from scpjax.physics.model import Model
from scpjax.recordings.recording import Recording
from scpjax.simulate.drive import drive_values, effort
from scpjax.simulate.simulate import Adaptive


def simulate_adaptive(
    model: Model, recording: Recording, z0: Float[Array, " states"], method: Adaptive
) -> tuple[Float[Array, "n states"], Float[Array, "n sides"]]:
    """States and efforts of any model at the stamps of a recording, to the tolerances of ``method``.

    The drive is that of the recording's hold at ``t - delay``; before the recording, the effort that keeps the
    actuator as ``z0`` shows it. Steps end where a held drive jumps or a linear one bends.

    diffrax's ``DirectAdjoint`` serves forward and reverse mode, exact for the steps taken; reverse mode is
    slow, for a cross-check and not for a fit. Under zero-order hold the derivative with respect to a dead
    time is not seen (the jumps are where the steps end, and those are not differentiated): use `Exponential`.

    **Raises** `ModelError` when diffrax gives up, except in traced code, where the states that it did not
    reach are NaN instead.
    """
    if recording.hold == "band_limited" and not recording.is_uniform:
        raise ModelError("a band-limited hold needs uniform time stamps", mend="resample the recording first")
    values = jnp.asarray(drive_values(model.structure, recording), model.theta.dtype)
    time = jnp.asarray(recording.time, model.theta.dtype)
    states, efforts, good = _solve(model, values, time, z0, method, recording.hold, recording.metadata.supply_V or 3.7)
    if not isinstance(good, Tracer) and not bool(good):
        raise ModelError(
            f"the adaptive solver gave up on {model!r} at t = {_reached(recording.time, states):.6g} s",
            where=recording.metadata.path,
            mend="loosen rtol and atol, raise max_steps, or use Exponential",
        )
    return states, efforts


@eqx.filter_jit
def _solve(
    model: Model, values: Array, time: Array, z0: Array, method: Adaptive, hold: str, supply: float
) -> tuple[Array, Array, Array]:
    knots = time + model.delay()
    column = _column(values, knots, hold)

    def applied(t: Array) -> Array:
        return jnp.asarray(effort(model.structure.drive, column(t), ambient=model.ambient, supply=supply))

    before = model.balances().holding([z0[i] for i in range(z0.shape[0])], applied(knots[0]))

    def drive(t: Array) -> Array:
        return jnp.where(t < knots[0], before, applied(t))

    breaks = jax.lax.stop_gradient(knots)  # the very numbers that ``column`` looks up, so none lands on the wrong side
    solution = diffrax.diffeqsolve(
        diffrax.ODETerm(lambda t, z, args: model.rates(z, drive(jnp.asarray(t)))),
        diffrax.Kvaerno5(),
        t0=time[0],
        t1=time[-1],
        dt0=None,
        y0=z0,
        saveat=diffrax.SaveAt(ts=time),
        stepsize_controller=diffrax.ClipStepSizeController(
            diffrax.PIDController(rtol=method.rtol, atol=method.atol),
            step_ts=breaks if hold == "linear" else None,
            jump_ts=breaks if hold == "zero_order" else breaks[:1],
        ),
        max_steps=method.max_steps,
        adjoint=diffrax.DirectAdjoint(),
        throw=False,
    )
    good = solution.result == diffrax.RESULTS.successful
    assert solution.ys is not None
    # inf marks what was not reached; NaN cannot be taken for a state
    return jnp.where(jnp.isfinite(solution.ys), solution.ys, jnp.nan), jax.vmap(drive)(time), good


def _column(values: Float[Array, "n sides"], knots: Float[Array, " n"], hold: str) -> Callable[[Array], Array]:
    """The drive column as a function of time, its samples at ``knots``."""
    n = values.shape[0]

    def held(t: Array) -> Array:
        left = jnp.searchsorted(knots, t, side="right") - 1
        return values[jnp.clip(left, 0, n - 1)]

    def linear(t: Array) -> Array:
        left = jnp.clip(jnp.searchsorted(knots, t, side="right") - 1, 0, n - 2)
        share = jnp.clip((t - knots[left]) / (knots[left + 1] - knots[left]), 0.0, 1.0)
        return values[left] + share * (values[left + 1] - values[left])

    def smooth(t: Array) -> Array:
        share = jnp.clip((t - knots[0]) / (knots[-1] - knots[0]), 0.0, 1.0)
        return jnp.cos(jnp.pi * share * jnp.arange(n)) @ amplitudes

    if hold == "band_limited":
        ends = jnp.asarray(np.r_[1.0, np.full(n - 2, 2.0), 1.0])[:, None] / (2 * n - 2)
        amplitudes = ends * jnp.fft.rfft(jnp.concatenate([values, values[-2:0:-1]]), axis=0).real
    return {"zero_order": held, "linear": linear, "band_limited": smooth}[hold]


def _reached(time: np.ndarray, states: Array) -> float:
    """Last stamp with a state."""
    seen = np.isfinite(np.asarray(states)).all(axis=1)
    return float(time[np.flatnonzero(seen)[-1]]) if seen.any() else float(time[0])
