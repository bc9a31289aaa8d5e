"""Recordings side by side, padded, ready for a compiled program.

Everything with a shape is padded so that recordings run abreast in one compiled program; padding has weight 0.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Mapping, Sequence

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from scpjax.errors import FitError
from scpjax.physics.structure import Structure
from scpjax.recordings.recording import Recording
from scpjax.simulate.drive import Grid, make_grid
from scpjax.units import parse_column


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

    def with_order(self, order: int) -> Data:
        """The same data, simulated by another order of the integrator."""
        return dataclasses.replace(self, order=order)

    def finer(self, factor: int) -> Data:
        """The same data, simulated by steps shorter by a whole factor. A drive that is not held goes within each step
        along the parabola through its start, middle and end, as it did.
        """
        g = self.grids
        effort = jnp.repeat(jnp.asarray(g.effort), factor, axis=1)
        if not g.constant:
            s = (np.arange(factor)[:, None] + np.array([0.0, 0.5, 1.0])) / factor  # (part, node)
            through = np.stack([(1 - s) * (1 - 2 * s), 4 * s * (1 - s), s * (2 * s - 1)], axis=-1)
            parts = jnp.einsum("pnm,rkms->rkpns", through, jnp.asarray(g.effort))
            effort = parts.reshape(effort.shape)
        at = np.asarray(g.at) * factor + np.floor(np.asarray(g.fraction) * factor).astype(int)
        grids = Grid(
            effort,
            jnp.asarray(g.step) / factor,
            jnp.asarray(at),
            jnp.asarray(np.asarray(g.fraction) * factor % 1.0),
            g.constant,
        )
        return dataclasses.replace(self, grids=grids, bin=self.bin * factor).with_weights(self.weights)

    def by_recording(self) -> Data:
        """Which axis of each leaf counts recordings, as `jax.vmap` takes it: the first, or None."""
        everywhere = eqx.tree_at(lambda d: (d.sigma, d.colour), self, (None, None))
        return jax.tree.map(lambda _: 0, everywhere)

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


QUANTITIES = ("temperature", "displacement", "angle", "force")
"""What a column is of by its name; one of another name is whatever a model gives last."""


def outputs_among(structure: Structure, stems: Sequence[str]) -> dict[int, int]:
    """Of columns with these stems by output of the model (its index) the first one that is of it. Where none is of any,
    the first with a name of its own (``response``, ``level``) stands for the last output.
    """
    found: dict[int, int] = {}
    for place, stem in enumerate(stems):
        if stem in structure.outputs:
            found.setdefault(structure.outputs.index(stem), place)
    own = [place for place, stem in enumerate(stems) if stem.split("_")[0] not in QUANTITIES]
    return found or {len(structure.outputs) - 1: place for place in own[:1]}


def sigma_by_output(structure: Structure, noise: Mapping[str, float]) -> dict[int, float]:
    """Noise by output index, SI, from noise per column in its unit."""
    parsed = [parse_column(column, allow_unknown=True) for column in noise]
    sigma = [value * abs(unit.scale) for value, (_, unit) in zip(noise.values(), parsed, strict=True)]
    return {j: sigma[place] for j, place in outputs_among(structure, [stem for stem, _ in parsed]).items()}


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
        only = recording.output_channels[0].stem
        found = [(j, only) for j in outputs_among(structure, [only])]
    if not found:
        raise FitError(
            f"no column among {[c.column for c in recording.output_channels]} is an output of the model "
            f"{structure.name}, which gives {list(structure.outputs)}",
            where=recording.metadata.path,
            mend="choose another model with --model or another column with --response",
        )
    return found
