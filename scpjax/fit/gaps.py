"""Samples that were skipped while the drive changed: when, inside the gap, did it change?

A held drive that jumps during a gap leaves the heat put in uncertain by what the jump brings in the meantime, far
more than the noise of a thermometer. The share of the gap that passed before the change is estimated from what the
outputs did afterwards, beside the parameters, by Gauss-Newton steps on pre-whitened residuals (so that physics that
the model leaves out, which is slow, does not pass for a mistimed jump). Where no output may be looked at, in a
prediction, the drive is what it is on average over all shares.

A drive that was on its way before the gap or after it (a ramp, a sine) goes on smoothly within, by Hermite's cubic with
the slopes at both ends; by how much it bulges beside that is estimated in place of a time. In a gap about as long as a
drive stands between two jumps it may have stood anywhere: what it was on average is estimated.
"""

from __future__ import annotations

from dataclasses import dataclass

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from scipy.interpolate import CubicHermiteSpline

from scpjax.compiled import quickly_compiled
from scpjax.fit.data import Data
from scpjax.fit.problem import Space, Trial, binned_residuals, sensitivities, unpack
from scpjax.physics.structure import DriveKind
from scpjax.recordings.recording import Recording
from scpjax.simulate.drive import SQUARED, grid_of

PRIOR = 0.29  # standard deviation of a share that may be anything from 0 to 1
_ALIKE = 3.0  # ratio of two successive changes of a drive, up to which it is on its way
_BULGE = 0.125  # of what a drive would go on by in a gap with the slopes at its ends: how far it may leave the cubic
_SOON = 0.5  # of the time between two jumps, up to which a gap is taken to hold one at most
_NOISY = 0.3  # of the changes of a drive: with more turns than that it carries noise
_JUMP = 0.25  # of a drive's standard deviation, from which a change is none of noise
_CLOCK = 0.8  # of the samples of a clock that skips some follow the one before after its period


@dataclass(frozen=True)
class Gap:
    """Nodes ``start`` to ``end`` of recording ``recording``, between which the effort went ``before`` to ``after``
    (s,), and of which ``sides`` this is (None: all); there the drive jumps, or goes on with ``slopes`` [per node] at
    these ends, or, with a ``spread`` alone, stood anywhere up to ``most``. ``spread``: standard deviation [of the
    effort] of how far in the middle it may leave that course, or of where it stood.
    """

    recording: int
    start: int
    end: int
    before: np.ndarray
    after: np.ndarray
    sides: tuple[int, ...] | None = None
    slopes: tuple[float, float] | None = None
    spread: float = 0.0
    most: float = np.inf

    def course(self, share: float) -> np.ndarray:
        """Effort (end - start, s) of the steps within: of drives that jump, before and after that share of the gap;
        of others (share - 1/2)/`PRIOR` of their spread off what is most likely.
        """
        cells, length = np.arange(self.end - self.start)[:, None], self.end - self.start
        beside = self.spread * (share - 0.5) / PRIOR
        if self.slopes is not None:
            q, ends = cells / length, np.stack([self.before, self.after])
            slopes = np.broadcast_to(length * np.array(self.slopes)[:, None], ends.shape)
            smooth = CubicHermiteSpline([0.0, 1.0], ends, slopes)(q[:, 0]) + 4.0 * beside * q * (1.0 - q)
            return np.maximum(smooth, np.minimum(np.minimum(self.before, self.after), 0.0))
        if self.spread:
            return np.broadcast_to(0.5 * (self.before + self.after) + beside, (length, len(self.before)))
        old = np.clip(share * length - cells, 0.0, 1.0)
        return old * self.before + (1 - old) * self.after

    @property
    def bounds(self) -> tuple[float, float]:
        """Within which a share is kept: a drive that stood somewhere did so between 0 and its most."""
        if self.slopes is not None or not self.spread or self.sides is None:
            return 0.0, 1.0
        before, after = (float(x[self.sides[0]]) for x in (self.before, self.after))
        middle, lowest = 0.5 * (before + after), min(before, after, 0.0)
        return 0.5 - PRIOR * (middle - lowest) / self.spread, 0.5 + PRIOR * (self.most - middle) / self.spread


def find_gaps(data: Data) -> tuple[Gap, ...]:
    """Gaps of held recordings during which the drive changed, or may have."""
    if not data.grids.constant:
        return ()
    found = []
    effort, at, fraction = (np.asarray(x) for x in (data.grids.effort, data.grids.at, data.grids.fraction))
    seen = np.asarray(data.weights).sum(axis=2) > 0
    for i in range(effort.shape[0]):
        if not seen[i].any():  # it only makes up the number
            continue
        nodes = at[i][: np.flatnonzero(seen[i])[-1] + 1]
        if np.any(fraction[i] > 0):
            continue  # stamps off the grid: not a clock that skips
        usual = int(np.median(np.diff(nodes)))
        inside = nodes[nodes < effort.shape[1]]
        drives = [_Drive.of(inside, effort[i, :, 0, j]) for j in range(effort.shape[3])]
        for k in np.flatnonzero(np.diff(nodes) > usual):
            a, b = int(nodes[k]), int(nodes[k + 1])
            if b < effort.shape[1]:
                found += _gaps_at(i, a, b, int(k), nodes, effort[i, :, 0], drives)
    return tuple(found)


@dataclass(frozen=True)
class _Drive:
    """How one drive of a recording goes: nodes between two jumps or turns, and standard deviation and greatest value
    [of the effort]."""

    turn: float
    spread: float
    most: float

    @staticmethod
    def of(nodes: np.ndarray, values: np.ndarray) -> _Drive:
        v = values[nodes]
        steps, spread = np.diff(v), float(np.std(v))
        moved = steps[np.abs(steps) > 1e-9 * max(np.max(np.abs(v)), 1e-300)]
        turns = len(moved)
        if turns > 0.5 * len(steps):  # always on its way
            turns = int(np.sum(moved[1:] * moved[:-1] < 0))
            if turns > _NOISY * len(steps):  # or measured, with noise
                turns = int(np.sum(np.abs(steps) > _JUMP * spread))
        return _Drive((nodes[-1] - nodes[0]) / (turns + 1), spread, float(np.max(v)))

    def anywhere(self, length: int) -> float:
        """Standard deviation of where it may have been within a gap."""
        return self.spread * min(1.0, length / self.turn) ** 2


def _gaps_at(i: int, a: int, b: int, k: int, nodes: np.ndarray, effort: np.ndarray, drives: list[_Drive]) -> list[Gap]:
    """One gap for all the drives that jump in it, and one for each of the others."""
    before, after, jumping, found = effort[a], effort[b], [], []
    for j, drive in enumerate(drives):
        slopes, free = slopes_at(nodes, effort[:, j], k), drive.anywhere(b - a)
        if any(slopes):
            spread = max(_BULGE * (b - a) * float(np.sum(np.abs(slopes))), free)
            found.append(Gap(i, a, b, before, after, (j,), slopes, spread))
        elif b - a > _SOON * drive.turn:
            found.append(Gap(i, a, b, before, after, (j,), None, free, drive.most))
        elif abs(after[j] - before[j]) > 1e-9 * max(np.max(np.abs(effort)), 1e-300):
            jumping.append(j)
    if jumping:
        found.insert(0, Gap(i, a, b, before, after, tuple(jumping)))
    return found


def slopes_at(nodes: np.ndarray, values: np.ndarray, k: int) -> tuple[float, float]:
    """Slopes per node of a drive before and after the gap that follows the k-th sample; ``nodes`` (n,) of the samples,
    ``values`` by node. Both 0 unless it was on its way on one side, by two successive changes that are alike, and that
    or at rest on the other.
    """
    found = []
    for three in (nodes[max(k - 2, 0) : k + 1], nodes[k + 1 : k + 4]):
        inside = three[three < len(values)]
        if len(inside) < 3:
            return 0.0, 0.0
        first, second = np.diff(values[inside]) / np.diff(inside)
        alike = first * second > 0 and 1 / _ALIKE < first / second < _ALIKE
        if not alike and (first != 0 or second != 0):
            return 0.0, 0.0
        found.append(float(second if len(found) == 0 else first))
    return found[0], found[1]


def fill(effort: np.ndarray, gaps: tuple[Gap, ...], shares: np.ndarray) -> np.ndarray:
    """Effort (r, steps, 3, s) with the drive of each gap changing after its share of the gap, or as `Gap.course` has
    it."""
    out = np.array(effort)
    for gap, share in zip(gaps, shares, strict=True):
        course = gap.course(float(share))[:, None, :]
        for j in range(out.shape[3]) if gap.sides is None else gap.sides:
            out[gap.recording, gap.start : gap.end, :, j] = course[..., j]
    return out


def bridged(recording: Recording, drive: DriveKind) -> tuple[Recording, np.ndarray]:
    """A recording with the samples that its clock skipped, and which (n,) of its samples are those of the file;
    ``drive`` is what kind its inputs are of.

    The effort at these goes from that before the gap to that after it along a line: the mean of one that changes at any
    tick between, each as likely. That of a drive on its way goes on smoothly (`slopes_at`). Recordings that are not
    held, or have no such clock, are given as they are.
    """
    time, there = np.asarray(recording.time), np.arange(len(recording.time))
    _, _, at, fraction = grid_of(time)
    if recording.hold != "zero_order" or np.any(fraction > 0) or not _CLOCK < np.mean(np.diff(at) == 1) < 1.0:
        return recording, there
    ticks = np.arange(at[-1] + 1)
    outputs = np.full((len(ticks), recording.outputs.shape[1]), np.nan)
    outputs[at] = np.where(recording.weights > 0, recording.outputs, np.nan)
    inputs = np.empty((len(ticks), recording.inputs.shape[1]))
    for j, values in enumerate(np.asarray(recording.inputs).T):
        squared = drive in SQUARED and bool(np.all(values >= 0))
        inputs[:, j] = np.sqrt(_bridge(at, values**2)) if squared else _bridge(at, values)
    return recording.with_samples(np.interp(ticks, at, time), inputs, outputs, None), at


def _bridge(at: np.ndarray, values: np.ndarray) -> np.ndarray:
    """Values at every tick from those at the ticks ``at``."""
    out = np.interp(np.arange(at[-1] + 1), at, values)
    by_tick = out.copy()
    for k in np.flatnonzero(np.diff(at) > 1):
        slopes = np.array(slopes_at(at, by_tick, int(k)))
        if np.any(slopes != 0):
            a, b = int(at[k]), int(at[k + 1])
            inside = np.arange(a + 1, b)
            smooth = CubicHermiteSpline([a, b], values[k : k + 2], slopes)(inside)
            out[inside] = np.maximum(smooth, min(values[k], values[k + 1], 0.0))
    return out


@quickly_compiled
def _responses(efforts: jax.Array, trial: Trial, data: Data, space: Space) -> jax.Array:
    model, local_values = unpack(trial.free, trial, space)

    def one(effort: jax.Array):
        return binned_residuals(model, eqx.tree_at(lambda d: d.grids.effort, data, effort), space.locals, local_values)

    return jax.vmap(one)(efforts)


@quickly_compiled
def _parameter_columns(trial: Trial, data: Data, space: Space) -> jax.Array:
    _, columns = sensitivities(trial.free[trial.index], trial, data, space)
    return columns[: data.target.size].reshape(*data.target.shape, -1)


def improve(data: Data, gaps: tuple[Gap, ...], shares: np.ndarray, trial: Trial, space: Space) -> np.ndarray:
    """Shares (gaps,) after one Gauss-Newton step beside the trial's moving entries, kept within their bounds."""
    if not gaps:
        return shares
    by_recording = [[g for g, gap in enumerate(gaps) if gap.recording == i] for i in range(data.target.shape[0])]
    most = max(len(mine) for mine in by_recording)
    width = 8 * -(-most // 8)
    base = fill(np.asarray(data.grids.effort), gaps, shares)
    delta = np.where(shares > 0.5, -0.25, 0.25)
    efforts = np.repeat(base[None], width + 1, axis=0)
    for place in range(most):  # recordings do not see each other: one gap of each is moved at a time
        moved = shares.copy()
        for mine in by_recording:
            if place < len(mine):
                moved[mine[place]] += delta[mine[place]]
        efforts[place + 1] = fill(np.asarray(data.grids.effort), gaps, moved)
    answers = np.asarray(_responses(jnp.asarray(efforts), trial, data, space))
    columns = np.asarray(_parameter_columns(trial, data, space))
    whiten = _whitener(answers[0], np.isfinite(np.asarray(data.norm)))
    parameters = [whiten(columns[..., j]).ravel() for j in range(columns.shape[-1])]
    changes = []
    for g, gap in enumerate(gaps):
        own = np.zeros_like(answers[0])
        place = by_recording[gap.recording].index(g) + 1
        own[gap.recording] = (answers[place] - answers[0])[gap.recording] / delta[g]
        changes.append(whiten(own).ravel())
    matrix = np.column_stack(parameters + changes)
    prior = np.concatenate([np.full(len(parameters), 1e-6), np.full(len(gaps), 1 / PRIOR)])
    scale = np.hypot(np.linalg.norm(matrix, axis=0), prior)  # a gap without effect must not outweigh the rest
    lhs = np.vstack([matrix / scale, np.diag(prior / scale)])
    pull = np.concatenate([np.zeros(len(parameters)), (0.5 - shares) / PRIOR])
    rhs = np.concatenate([-whiten(answers[0]).ravel(), pull])
    step = np.linalg.lstsq(lhs, rhs, rcond=None)[0] / scale
    low, high = np.array([gap.bounds for gap in gaps]).T
    return np.clip(shares + step[len(parameters) :], low, high)


def _whitener(residual: np.ndarray, there: np.ndarray):
    """e_k - rho e_{k-1} along time, rho the first autocorrelation of each output's residuals."""
    rho = np.zeros(residual.shape[2])
    for j in range(residual.shape[2]):
        pairs = there[:, 1:, j] & there[:, :-1, j]
        if pairs.any():
            a, b = residual[:, 1:, j][pairs], residual[:, :-1, j][pairs]
            rho[j] = np.clip(np.sum(a * b) / (np.sum(b**2) + 1e-12), 0.0, 0.995)

    def apply(x: np.ndarray) -> np.ndarray:
        x = np.where(there, x, 0.0)
        out = x.copy()
        out[:, 1:] -= rho * x[:, :-1]
        return out

    return apply
