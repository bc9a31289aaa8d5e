"""The least-squares problem of one actuator: its recordings side by side, its parameters, its residuals.

Everything with a shape is padded so that recordings run abreast in one compiled program; padding has weight 0.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float, Int

from scpjax.errors import FitError
from scpjax.parameter import Bounded
from scpjax.physics.model import Model
from scpjax.physics.structure import Structure
from scpjax.recordings.recording import Recording
from scpjax.simulate.drive import Grid, make_grid
from scpjax.simulate.simulate import at_samples, node_states, stepper

CEILING = 1e7
"""Binned residuals are cut off there, in standard deviations."""


class Data(eqx.Module):
    """Recordings abreast. r recordings, n samples, s sides, y outputs of the model; k bins of ``bin`` steps each.

    The samples of a bin are summed as the simulation passes: ``at_start`` and ``at_end`` are what the outputs at the
    two ends of each step contribute, ``target`` the same sum of the recorded values, ``norm`` its standard deviation.
    """

    grids: Grid  # leaves with a leading axis r
    outputs: Float[Array | np.ndarray, "r n y"]  # SI
    weights: Float[Array | np.ndarray, "r n y"]  # 0 or 1 (or the user's), 0 in the padding
    sigma: Float[Array | np.ndarray, " y"]  # noise standard deviation by which each output is weighted
    ambient: Float[Array | np.ndarray, " r"]
    start_effort: Float[Array | np.ndarray, "r s"]
    at_start: Float[Array | np.ndarray, "r steps y"]
    at_end: Float[Array | np.ndarray, "r steps y"]
    target: Float[Array | np.ndarray, "r k y"]
    norm: Float[Array | np.ndarray, "r k y"]
    colour: Float[
        Array | np.ndarray, "y 3"
    ]  # autoregressive coefficients by which residuals are filtered; 0: not at all
    bin: int = eqx.field(static=True)
    order: int = eqx.field(static=True)

    def with_weights(self, weights: np.ndarray | Array) -> Data:
        """The same data with other weights (held-out samples: 0)."""
        parts = _sums(self.grids, np.asarray(self.outputs), np.asarray(weights), np.asarray(self.sigma), self.bin)
        where = lambda d: (d.weights, d.at_start, d.at_end, d.target, d.norm)  # noqa: E731
        return eqx.tree_at(where, self, (jnp.asarray(weights), *(jnp.asarray(x) for x in parts)))

    def with_effort(self, effort: np.ndarray) -> Data:
        """The same data driven by another effort (r, steps, 3, s)."""
        return eqx.tree_at(lambda d: d.grids.effort, self, jnp.asarray(effort))

    def with_colour(self, colour: np.ndarray) -> Data:
        """The same data with residuals filtered by autoregressive coefficients (y, 3): generalised least squares."""
        return eqx.tree_at(lambda d: d.colour, self, jnp.asarray(colour))

    @property
    def used_bins(self) -> int:
        """Number of bins that hold a sample: the residuals that carry information."""
        return int(np.sum(np.isfinite(np.asarray(self.norm))))


def _sums(
    grids: Grid, outputs: np.ndarray, weights: np.ndarray, sigma: np.ndarray, bin: int
) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
    r, _n, y = outputs.shape
    steps = np.asarray(grids.effort).shape[1]
    at, fraction = np.asarray(grids.at), np.asarray(grids.fraction)
    start, end = np.zeros((r, steps, y)), np.zeros((r, steps, y))
    target, square = np.zeros((r, steps, y)), np.zeros((r, steps, y))
    for i in range(r):
        step = np.minimum(at[i], steps - 1)
        share = np.where(at[i] == step, fraction[i], 1.0)[:, None]
        np.add.at(start[i], step, weights[i] * (1 - share))
        np.add.at(end[i], step, weights[i] * share)
        np.add.at(target[i], step, weights[i] * outputs[i])
        np.add.at(square[i], step, weights[i] ** 2)
    fold = lambda x: x.reshape(r, steps // bin, bin, y).sum(axis=2)  # noqa: E731
    norm = np.sqrt(fold(square)) * sigma
    return start, end, fold(target), np.where(norm > 0, norm, np.inf)


@dataclass(frozen=True)
class Locals:
    """What is estimated for each recording: the state it began in."""

    temperature: bool  # K above ambient, per side
    displaced: bool  # m from equilibrium, and velocity m/s

    def count(self, structure: Structure) -> int:
        return self.temperature * len(structure.sides) + 2 * self.displaced

    def names(self, structure: Structure) -> tuple[str, ...]:
        """Names of the entries for one recording."""
        names = [f"initial_temperature{'_' + s if s else ''}" for s in structure.sides] if self.temperature else []
        return tuple(names + (["initial_displacement", "initial_velocity"] if self.displaced else []))


def initial_state(model: Model, locals_: Locals, values: Float[Array, " l"], effort: Float[Array, " s"]) -> Array:
    """State at the first sample from the local values of one recording."""
    s = len(model.structure.sides)
    warm = values[:s] if locals_.temperature else 0.0
    displaced, velocity = (values[-2], values[-1]) if locals_.displaced else (0.0, 0.0)
    return model.initial(warm, displaced, velocity, effort)


def predict_outputs(
    model: Model, data: Data, locals_: Locals, local_values: Float[Array, "r l"]
) -> Float[Array, "r n y"]:
    """Simulated outputs at the samples of every recording."""

    def one(grid: Grid, ambient: Array, effort: Array, values: Array) -> Array:
        m = eqx.tree_at(lambda m_: m_.ambient, model, ambient)
        z0 = initial_state(m, locals_, values, effort)
        states, efforts = node_states(m, grid, z0, order=data.order)
        return at_samples(jax.vmap(m.observe)(states, efforts), grid)

    return jax.vmap(one)(data.grids, jnp.asarray(data.ambient), jnp.asarray(data.start_effort), local_values)


def binned_residuals(
    model: Model, data: Data, locals_: Locals, local_values: Float[Array, "r l"]
) -> Float[Array, "r k y"]:
    """(simulated - recorded) summed over bins, so scaled that white noise of std sigma gives unit variance."""

    def one(
        grid: Grid,
        ambient: Array,
        effort: Array,
        values: Array,
        at_start: Array,
        at_end: Array,
        target: Array,
        norm: Array,
    ) -> Array:
        m = eqx.tree_at(lambda m_: m_.ambient, model, ambient)
        z0 = initial_state(m, locals_, values, effort)
        advance, drive = stepper(m, grid, order=data.order)
        observe = m.balances().observe
        n_y, bins = at_start.shape[1], target.shape[0]
        fold = lambda x: x.reshape(bins, data.bin, *x.shape[1:])  # noqa: E731
        ends = (lambda u: (u, u)) if drive.ndim == 2 else (lambda u: (u[0], u[2]))

        def step(carry: Any, xs: Any) -> Any:
            z, y, total = carry
            u, ws, we = xs
            z = advance(z, u)
            y_end = observe(z, ends(u)[1])
            total = [t + ws[i] * y[i] + we[i] * y_end[i] for i, t in enumerate(total)]
            return (z, y_end, total), None

        def one_bin(carry: Any, xs: Any) -> Any:
            zero = [jnp.zeros_like(carry[1][i]) for i in range(n_y)]
            (z, y, total), _ = jax.lax.scan(step, (*carry, zero), xs)
            return (z, y), total

        z = [z0[i] for i in range(z0.shape[0])]
        first = observe(z, ends(drive[0])[0])
        _, totals = jax.lax.scan(one_bin, (z, first), (fold(drive), fold(at_start), fold(at_end)))
        return (jnp.stack(totals, axis=-1) - target) / norm

    return jax.vmap(one)(
        data.grids,
        jnp.asarray(data.ambient),
        jnp.asarray(data.start_effort),
        local_values,
        *(jnp.asarray(x) for x in (data.at_start, data.at_end, data.target, data.norm)),
    )


def whitened(residual: Float[Array, "r k y"], data: Data) -> Float[Array, "r k y"]:
    """Residuals through the filter of ``data.colour``; bins whose predecessors are empty fall out of a coloured one."""
    there = jnp.isfinite(data.norm)
    filtered, whole = residual, there
    for lag in (1, 2, 3):
        before = jnp.pad(residual[:, :-lag], ((0, 0), (lag, 0), (0, 0)))
        filtered = filtered - data.colour[:, lag - 1] * before
        whole &= jnp.pad(there[:, :-lag], ((0, 0), (lag, 0), (0, 0)))
    coloured = jnp.any(data.colour != 0, axis=1)
    return jnp.where(coloured, jnp.where(whole, filtered, 0.0), residual)


def pack(
    structure: Structure,
    recordings: Sequence[Recording],
    sigma: np.ndarray,
    *,
    ambient: Sequence[float],
    bin: int = 1,
    order: int = 2,
    substeps: int = 1,
    pad_to: int = 256,
) -> Data:
    """Recordings side by side, padded to multiples of ``pad_to`` so that like recordings share a program."""
    grids = [make_grid(structure, r, ambient=a, substeps=substeps) for r, a in zip(recordings, ambient, strict=True)]
    constant = all(g.constant for g in grids)
    bin = bin * substeps
    unit = int(np.lcm(pad_to, bin))
    steps = unit * -(-max(g.steps for g in grids) // unit)
    n = max(steps // substeps + 1, max(r.n for r in recordings))
    ny = len(structure.outputs)
    outputs = np.zeros((len(recordings), n, ny))
    weights = np.zeros_like(outputs)
    for i, r in enumerate(recordings):
        for j, stem in columns(structure, r):
            outputs[i, : r.n, j] = r.output(stem)
            weights[i, : r.n, j] = r.weight(stem)
    padded = [
        Grid(
            np.pad(g.effort, ((0, steps - g.steps), (0, 0), (0, 0)), mode="edge"),
            g.step,
            np.pad(g.at, (0, n - g.at.shape[0])),
            np.pad(g.fraction, (0, n - g.at.shape[0])),
            constant,
        )
        for g in grids
    ]
    together = jax.tree.map(lambda *leaves: np.stack(leaves), *padded)
    parts = _sums(together, outputs, weights, np.asarray(sigma), bin)
    data = Data(
        together,
        outputs,
        weights,
        np.asarray(sigma),
        np.asarray(ambient, float),
        np.stack([g.effort[0, 0] for g in grids]),
        *parts,
        np.zeros((ny, 3)),
        bin=bin,
        order=order if constant else 4,
    )
    return jax.tree.map(jnp.asarray, data)


def columns(structure: Structure, recording: Recording) -> list[tuple[int, str]]:
    """(index among the model's outputs, stem in the recording) of every output both have.

    A response that is none of the model's stems (``response_V``, ``level_V``) stands for its last output.

    **Raises** `FitError` when there is none in common.
    """
    found = []
    for channel in recording.output_channels:
        if channel.stem in structure.outputs:
            found.append((structure.outputs.index(channel.stem), channel.stem))
    if not found and len(recording.output_channels) == 1:
        first = recording.output_channels[0].stem.split("_")[0]
        if first not in ("temperature", "displacement", "angle", "force"):
            return [(len(structure.outputs) - 1, recording.output_channels[0].stem)]
    if not found:
        raise FitError(
            f"no column among {[c.column for c in recording.output_channels]} is an output of the model "
            f"{structure.name}, which gives {list(structure.outputs)}",
            where=recording.metadata.path,
            mend="choose another model with --model or another column with --response",
        )
    return found


class Space(eqx.Module):
    """All that may be estimated: parameters of the structure, then the locals of each recording.

    ``free`` vectors have one more, idle entry at the end, onto which unused places of an index point.
    """

    structure: Structure = eqx.field(static=True)
    locals: Locals = eqx.field(static=True)
    n_recordings: int = eqx.field(static=True)
    bounds: Bounded
    prior_mean: Float[Array, " all"]  # on the inner scale: ln(value) or value
    prior_spread: Float[Array, " all"]  # inf: none

    @property
    def n_theta(self) -> int:
        return len(self.structure.slots)

    @property
    def size(self) -> int:
        """Length of a free vector without its idle entry."""
        return self.n_theta + self.n_recordings * self.locals.count(self.structure)

    @property
    def keys(self) -> tuple[str, ...]:
        """Name of every entry."""
        names = self.locals.names(self.structure)
        return tuple(s.key for s in self.structure.slots) + tuple(
            f"recording_{i}.{n}" for i in range(self.n_recordings) for n in names
        )

    def values(self, free: Float[Array, " all+1"], fixed: Float[Array, " all"], active: Bool[Array, " all"]) -> Array:
        """Physical values: of the active entries from ``free``, of the others from ``fixed``."""
        return jnp.where(active, self.bounds.to_value(free[:-1]), fixed)


class Trial(eqx.Module):
    """One hypothesis to fit: which entries move (``index``, padded with the idle one), from where, under which laws."""

    index: Int[Array, " moving"]
    free: Float[Array, " all+1"]
    fixed: Float[Array, " all"]
    active: Bool[Array, " all"]
    laws: Float[Array, " mechanisms"]


def residuals(moving: Float[Array, " moving"], trial: Trial, data: Data, space: Space) -> Float[Array, " m"]:
    """Binned data residuals, then those of the priors, then the idle entry's."""
    free = trial.free.at[trial.index].set(moving)
    model, local_values = unpack(free, trial, space)
    data_part = whitened(binned_residuals(model, data, space.locals, local_values), data)
    inner = space.bounds.to_inner(free[:-1])
    prior = jnp.where(
        trial.active & jnp.isfinite(space.prior_spread),
        (inner - space.prior_mean) / jnp.where(jnp.isfinite(space.prior_spread), space.prior_spread, 1.0),
        0.0,
    )
    # outside the physical domain a simulation may blow up: a large finite residual turns the solver back
    data_part = jnp.where(jnp.isfinite(data_part), jnp.clip(data_part, -CEILING, CEILING), CEILING)
    return jnp.concatenate([data_part.ravel(), prior, free[-1:]])


def simulated(free: Array, trial: Trial, data: Data, space: Space) -> Float[Array, "r n y"]:
    """Outputs of a trial at a free vector."""
    model, local_values = unpack(free, trial, space)
    return predict_outputs(model, data, space.locals, local_values)


def unpack(free: Array, trial: Trial, space: Space) -> tuple[Model, Float[Array, "r l"]]:
    """Model and local values of a trial at a free vector."""
    values = space.values(free, trial.fixed, trial.active)
    model = Model(space.structure, values[: space.n_theta], trial.laws)
    return model, values[space.n_theta :].reshape(space.n_recordings, space.locals.count(space.structure))
