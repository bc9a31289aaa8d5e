"""From recorded drive columns to the effort at the nodes of a simulation grid, as the hold of the recording says.

All of it is differentiable in the recorded values and in the dead time.
"""

from __future__ import annotations

import equinox as eqx
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float, Int

from scpjax.errors import ModelError
from scpjax.parameter import Numbers, namespace
from scpjax.physics.structure import DriveKind, Structure
from scpjax.recordings.recording import Hold, Recording

SQUARED: tuple[DriveKind, ...] = ("voltage", "pwm", "current")
"""Drives of which the square is applied."""

_KINDS: dict[str, DriveKind] = {"voltage": "voltage", "pwm": "pwm", "current": "current", "power": "power"}


def drive_kind(stem: str, model: str) -> DriveKind:
    """Kind of drive that a column of that stem is for a preset: ``voltage_agonist`` is a voltage."""
    first = stem.split("_")[0]
    if first == "temperature" and model == "tm":
        return "temperature"
    return _KINDS.get(first, "gain")


def effort(kind: DriveKind, value: Array | np.ndarray, *, ambient: Array | float = 0.0, supply: float = 3.7):
    """What the drive applies: V^2 for volts, (supply pwm/255)^2, A^2, W, K above ambient, or the column itself.

    PWM stands for the mean voltage as in the thesis (section 3.3.5).
    """
    if kind == "voltage" or kind == "current":
        return value**2
    if kind == "pwm":
        return (supply * value / 255.0) ** 2
    if kind == "temperature":
        return value - ambient
    return value


def drive_values(structure: Structure, recording: Recording) -> Float[Numbers, "n sides"]:
    """The recording's drive columns in the order of the model's sides.

    **Raises** `ModelError` when the recording has not one drive per side.
    """
    stems = [c.stem for c in recording.input_channels]
    if structure.sides == ("",):
        if len(stems) != 1:
            raise ModelError(
                f"{len(stems)} drive columns {stems} for one actuator",
                where=recording.metadata.path,
                mend="choose one with --drive COLUMN, or the model aaa for a joint",
            )
        return recording.inputs
    order = []
    for side in structure.sides:
        found = [i for i, stem in enumerate(stems) if stem.endswith(f"_{side}")]
        if len(found) != 1:
            raise ModelError(
                f"no drive column for the {side}",
                where=recording.metadata.path,
                mend=f"a joint needs a column such as voltage_{side}_V",
            )
        order.append(found[0])
    return recording.inputs[:, np.array(order)]


def recorded_effort(
    structure: Structure, recording: Recording, *, ambient: Array | float = 0.0
) -> Float[Numbers, "n sides"]:
    """What the recording's drives apply by `effort`, with its supply (3.7 V where it does not say).

    **Raises** `ModelError` when the recording has not one drive per side.
    """
    supply = recording.metadata.supply_V or 3.7
    return effort(structure.drive, drive_values(structure, recording), ambient=ambient, supply=supply)


class Grid(eqx.Module):
    """A uniform simulation grid over one recording: ``nodes = steps + 1`` instants ``step`` apart.

    ``effort`` holds the drive at start, middle and end of each step; sample i of the recording lies at node ``at[i]``
    plus ``fraction[i]`` of a step.
    """

    effort: Float[Numbers, "steps 3 sides"]
    step: Float[Numbers, ""]
    at: Int[Array | np.ndarray, " n"]
    fraction: Float[Numbers, " n"]
    constant: bool = eqx.field(static=True)

    @property
    def steps(self) -> int:
        return self.effort.shape[0]


def grid_of(
    time: np.ndarray, *, step: float | None = None, substeps: int = 1
) -> tuple[float, int, np.ndarray, np.ndarray]:
    """(step, steps, at, fraction) of a uniform grid that covers ``time``.

    The step is the greatest that puts all stamps on nodes when there is one (uniform recordings, skipped samples),
    else the median sampling interval; divided by ``substeps``.
    """
    gaps = np.diff(time)
    base = float(np.median(gaps)) if step is None else step
    # the mean over the recording is a sharper estimate of the period than any one gap of rounded stamps
    counts = np.maximum(np.round(gaps / base), 1)
    refined = float((time[-1] - time[0]) / counts.sum())
    position = (time - time[0]) / refined
    if np.max(np.abs(position - np.round(position))) < 0.02:
        base, position = refined, np.round(position)
    else:
        position = (time - time[0]) / base
    position = position * substeps
    steps = max(int(np.ceil(position[-1] - 1e-9)), 1)
    at = np.minimum(np.floor(position + 1e-9).astype(int), steps)
    return base / substeps, steps, at, np.clip(position - at, 0.0, 1.0)


def make_grid(
    structure: Structure,
    recording: Recording,
    *,
    ambient: float | Array,
    step: float | None = None,
    substeps: int = 1,
) -> Grid:
    """Simulation grid of a recording for a model; differentiable in the inputs where they are jax arrays."""
    values = drive_values(structure, recording)
    supply = recording.metadata.supply_V or 3.7
    h, steps, at, fraction = grid_of(recording.time, step=step, substeps=substeps)
    nodes = node_values(values, recording.time, h, steps, recording.hold, recording.is_uniform)
    if recording.hold == "zero_order":  # the mean of what is applied, not of the volts, is what heats
        applied = effort(structure.drive, values, ambient=ambient, supply=supply)
        held = held_means(applied, recording.time, h, steps)
        at_nodes = namespace(held).repeat(held[:, None, :], 3, axis=1)
    else:
        at_nodes = effort(structure.drive, nodes, ambient=ambient, supply=supply)
    return Grid(at_nodes, np.asarray(h), at, fraction, recording.hold == "zero_order")


def held_means(values: Float[Numbers, "n s"], time: np.ndarray, step: float, steps: int) -> Float[Numbers, "steps s"]:
    """Mean over each step of values held from each stamp to the next (the last one on to the end)."""
    xp = namespace(values)
    gaps = np.diff(time)[:, None]
    total = xp.concatenate([xp.zeros_like(values[:1]), xp.cumsum(values[:-1] * gaps, axis=0)])
    edges = time[0] + step * np.arange(steps + 1)
    left = np.clip(np.searchsorted(time, edges + 1e-9 * step, side="right") - 1, 0, len(time) - 1)
    integral = total[left] + values[left] * np.maximum(edges - time[left], 0.0)[:, None]
    return xp.diff(integral, axis=0) / step


def node_values(
    values: Float[Numbers, "n s"], time: np.ndarray, step: float, steps: int, hold: Hold, uniform: bool
) -> Float[Numbers, "steps 3 s"]:
    """Drive column at start, middle and end of each step."""
    edges = time[0] + step * 0.5 * np.arange(2 * steps + 1)
    if hold == "band_limited":
        if not uniform:
            raise ModelError("a band-limited hold needs uniform time stamps", mend="resample the recording first")
        fine = band_limited(values, time, edges)
    else:
        left = np.clip(np.searchsorted(time, edges, side="right") - 1, 0, len(time) - 2)
        share = np.clip((edges - time[left]) / (time[left + 1] - time[left]), 0.0, 1.0)
        fine = values[left] + share[:, None] * (values[left + 1] - values[left])
    return namespace(values).stack([fine[:-1:2], fine[1::2], fine[2::2]], axis=1)


def band_limited(values: Float[Numbers, "n s"], time: np.ndarray, at: np.ndarray) -> Float[Numbers, "m s"]:
    """Trigonometric interpolation of uniform samples, continued evenly beyond both ends.

    The even continuation has no jump, so nothing rings at the ends as it would with a periodic one. ``at`` must be
    uniform with a whole number of points per sampling period.
    """
    xp, n = namespace(values), values.shape[0]
    factor = round((time[-1] - time[0]) / (n - 1) / (at[1] - at[0]))
    even = xp.concatenate([values, values[-2:0:-1]])
    spectrum = xp.fft.rfft(even, axis=0)
    length = (2 * n - 2) * factor
    nyquist = spectrum[-1:] * (0.5 if factor > 1 else 1.0)
    beyond = xp.zeros((length // 2 + 1 - spectrum.shape[0], values.shape[1]), spectrum.dtype)
    padded = xp.concatenate([spectrum[:-1], nyquist, beyond])
    return (xp.fft.irfft(padded, n=length, axis=0) * factor)[: len(at)]


def delayed(
    nodes: Float[Array, "steps 3 s"], step: Array, delay: Array, constant: bool, before: Float[Array, " s"]
) -> Float[Array, "steps 3 s"]:
    """The effort ``delay`` [s] later; ``before`` the recording began.

    Held efforts are shifted through their running integral, which makes the result differentiable in the delay.
    """
    steps = nodes.shape[0]
    if constant:
        held = nodes[:, 0, :]
        total = jnp.concatenate([jnp.zeros_like(held[:1]), jnp.cumsum(held, axis=0)])  # in units of a step
        integral = _at(total, jnp.arange(steps + 1) - delay / step, before=before)
        return jnp.repeat(jnp.diff(integral, axis=0)[:, None, :], 3, axis=1)
    fine = jnp.concatenate([nodes[:, :2, :].reshape(2 * steps, -1), nodes[-1:, 2, :]])
    position = jnp.arange(2 * steps + 1) - 2 * delay / step
    shifted = jnp.where(position[:, None] < 0, before, _at(fine, position, before=jnp.zeros_like(fine[0])))
    return jnp.stack([shifted[:-1:2], shifted[1::2], shifted[2::2]], axis=1)


def _at(values: Array, position: Array, before: Array) -> Array:
    """Linear interpolation at fractional indices; left of 0 it goes on with slope ``before``."""
    left = jnp.clip(jnp.floor(position), 0, values.shape[0] - 2).astype(int)
    share = jnp.minimum(position - left, 1.0)[:, None]
    inside = values[left] + jnp.maximum(share, 0.0) * (values[left + 1] - values[left])
    return inside + jnp.minimum(share, 0.0) * before
