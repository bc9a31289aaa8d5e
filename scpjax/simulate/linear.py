"""Linear models exactly: matrix functions for held drives, the frequency response for band-limited ones.

With zero-order or linear hold every drive kind makes an effort that is a polynomial of at most second degree
between two stamps (V^2 of a volt ramp is the parabola), so the variation of constants formula ends in the phi
functions 0 to 3.
"""

from __future__ import annotations

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Complex, Float, Int

from scpjax.errors import ModelError
from scpjax.physics.model import Model
from scpjax.recordings.recording import Recording
from scpjax.simulate.drive import band_limited, drive_values
from scpjax.simulate.drive import effort as effort_of
from scpjax.simulate.exponential import phi_functions


def simulate_exact(
    model: Model, recording: Recording, z0: Float[Array, " states"]
) -> tuple[Float[Array, "n states"], Float[Array, "n sides"]]:
    """States and efforts of a linear model at the stamps of a recording, exact for its hold.

    Differentiable, forward and reverse, in the model, in ``z0`` and in the recording's inputs. Stamps may be
    non-uniform for ``zero_order`` and ``linear``; ``band_limited`` is the interpolation of
    `scpjax.simulate.drive.band_limited` and its drive the effort that the interpolated column makes.

    **Raises** `ModelError` for a model with mechanisms that are not linear, and for a band-limited hold on
    non-uniform stamps.
    """
    if not model.structure.is_linear:
        raise ModelError(f"{model!r} is not linear", mend="use Exponential or Adaptive")
    values = jnp.asarray(drive_values(model.structure, recording), model.theta.dtype)
    supply = recording.metadata.supply_V or 3.7
    if recording.hold == "band_limited":
        if not recording.is_uniform:
            raise ModelError("a band-limited hold needs uniform time stamps", mend="resample the recording first")
        return _band_limited(model, values, recording.time, z0, supply)
    if recording.is_uniform:
        gaps, which = np.array([recording.period]), None
    else:
        gaps, which = np.unique(np.diff(recording.time), return_inverse=True)
    return _held(model, values, gaps, which, z0, supply, linear=recording.hold == "linear")


def _held(
    model: Model,
    values: Float[Array, "n sides"],
    gaps: Float[np.ndarray, " distinct"],
    which: Int[np.ndarray, " n-1"] | None,
    z0: Float[Array, " states"],
    supply: float,
    *,
    linear: bool,
) -> tuple[Array, Array]:
    """Zero-order or linear hold; ``gaps[which[i]]`` [s] (or ``gaps[0]``) lies between stamps i and i + 1."""
    efforts = _effort(model, values, supply)
    powers = efforts[:-1, :, None]  # coefficients of 1, s, s^2 with s from 0 to 1 over the gap
    if linear:
        middle = (values[:-1] + values[1:]) / 2
        middle = _effort(model, middle, supply)
        bend = 2 * (efforts[:-1] - 2 * middle + efforts[1:])
        powers = jnp.stack([efforts[:-1], efforts[1:] - efforts[:-1] - bend, bend], axis=-1)
    return _propagate(model, powers, jnp.asarray(gaps, model.theta.dtype), which, z0), efforts


def _effort(model: Model, values: Array, supply: float) -> Array:
    return jnp.asarray(effort_of(model.structure.drive, values, ambient=model.ambient, supply=supply))


@jax.jit
def _propagate(
    model: Model,
    powers: Float[Array, "n-1 sides powers"],
    gaps: Float[Array, " distinct"],
    which: Int[Array, " n-1"] | None,
    z0: Float[Array, " states"],
) -> Float[Array, "n states"]:
    """z(h) = phi_0 z + h sum_j j! phi_(j+1) B u_j for an effort sum_j u_j s^j over a gap h."""
    a, b = model.linearise()

    def matrices(h: Array) -> tuple[Array, Array]:
        p0, *phis = phi_functions(a * h)
        gains = [h * j * p @ b for p, j in zip(phis, (1.0, 1.0, 2.0), strict=True)]
        return p0, jnp.stack(gains[: powers.shape[-1]], axis=-1)

    if which is None:
        p0, gain = matrices(gaps[0])
        return _recur(p0, jnp.einsum("isp,nsp->ni", gain, powers), z0)
    p0, gain = jax.vmap(matrices)(gaps)
    return _recur(p0[which], jnp.einsum("nisp,nsp->ni", gain[which], powers), z0)


def _recur(p0: Float[Array, "... n n"], pushes: Float[Array, "m n"], z0: Float[Array, " n"]) -> Float[Array, "m+1 n"]:
    """z_(i+1) = p0 z_i + pushes_i, with one p0 or one for each step."""
    varying = p0.ndim == 3

    def body(z: Array, x: tuple[Array | None, Array]) -> tuple[Array, Array]:
        matrix, push = x
        z = jnp.sum((p0 if matrix is None else matrix) * z, axis=-1) + push
        return z, z

    _, zs = jax.lax.scan(body, z0, (p0 if varying else None, pushes), unroll=4)
    return jnp.concatenate([z0[None], zs])


def _band_limited(
    model: Model,
    values: Float[Array, "n sides"],
    time: np.ndarray,
    z0: Float[Array, " states"],
    supply: float,
) -> tuple[Array, Array]:
    """Particular solution sum_k G(i w_k) U_k exp(i w_k t), and a free one from what ``z0`` leaves."""
    n, squares = values.shape[0], model.structure.drive in ("voltage", "pwm", "current")
    factor = 2 if squares else 1  # squaring doubles the band
    if squares:
        values = jnp.asarray(band_limited(values, time, np.linspace(time[0], time[-1], factor * (n - 1) + 1)))
    efforts = _effort(model, values, supply)
    h = jnp.asarray((time[-1] - time[0]) / (n - 1), model.theta.dtype)
    return _spectral(model, efforts, h, z0, factor=factor), efforts[::factor]


def _spectral_core(
    model: Model, efforts: Float[Array, "m sides"], h: Array, z0: Float[Array, " states"], *, factor: int
) -> Float[Array, "n states"]:
    a, b = model.linearise()
    length = 2 * (efforts.shape[0] - 1)
    spectrum = jnp.fft.rfft(jnp.concatenate([efforts, efforts[-2:0:-1]]), axis=0)
    omega = 2 * jnp.pi * jnp.arange(length // 2 + 1) * factor / (length * h)

    def respond(w: Array, u: Array) -> Complex[Array, " states"]:
        return jnp.linalg.solve(1j * w * jnp.eye(a.shape[0]) - a, b @ u)

    steady = jnp.fft.irfft(jax.vmap(respond)(omega, spectrum), n=length, axis=0)
    steady = steady[: efforts.shape[0] : factor]
    p0, *_ = phi_functions(a * h)
    free = _recur(p0, jnp.zeros_like(steady[1:]), z0 - steady[0])
    return steady + free


_spectral = jax.jit(_spectral_core, static_argnames="factor")
