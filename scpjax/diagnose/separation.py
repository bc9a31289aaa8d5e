"""How far apart are two hypotheses in an experiment, when each does its best to say what the other says?

If hypothesis i is true (at its best estimate), an experiment with drive u will show y_i(u), and hypothesis j, fitted to
it and to all that was recorded before, is left with

    T_ij(u) = min_p 1/2 |y_j(u; p) - y_i(u)|^2 + 1/2 (p - p_j)' L_j (p - p_j)

where predictions are in units of the noise, p_j is the present fit of j and L_j the information that the present
recordings and the priors hold about it. T_ij is by how much the log-likelihood ratio of i to j is expected to grow:
the criterion of T-optimum designs (Atkinson, Fedorov, Biometrika 62 (1975) 57), with what is already known counted in;
T_ij / ln 2 are bits. Its gradient by u needs no derivative of the best p (Danskin: p is at its minimum).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float
from scipy.linalg import block_diag

from scpjax.compiled import quickly_compiled
from scpjax.diagnose.hypothesis import State
from scpjax.fit.data import Data
from scpjax.fit.identifiability import correlation_time
from scpjax.fit.problem import Space, Trial, initial_state
from scpjax.fit.solve import evaluate, stack
from scpjax.physics.model import Model
from scpjax.physics.structure import Structure
from scpjax.simulate.drive import Grid, effort
from scpjax.simulate.simulate import node_states

_SHARP = 4.0  # of the power mean that stands for the least of several separations


class Rival(eqx.Module):
    """A hypothesis as it stands after the present recordings.

    What moves are its parameters that were fitted (``index`` into the free vector), how far off their mean those that
    differ by recording are in a new one (in units of ``apart``, their spread), and, last, the state in which the
    experiment begins. ``known`` (p, p) is the information about them, 1/variance on the free scale.
    """

    space: Space
    trial: Trial
    index: np.ndarray  # (parameters,)
    centre: np.ndarray  # (p,)
    known: np.ndarray  # (p, p)
    own: np.ndarray  # (own,) places of those that differ by recording, in the model of one
    apart: np.ndarray  # (own,) on the inner scale: of ln(value) or value
    log: np.ndarray  # (own,)
    ambient: Float[Array | np.ndarray, ""]
    supply: float = eqx.field(static=True)
    label: str = eqx.field(static=True)

    @property
    def structure(self):
        return self.space.structure

    def model(self, moving: Array | np.ndarray) -> Model:
        """The model at moving values (p,)."""
        n, space, trial = len(self.index), self.space, self.trial
        free = jnp.asarray(trial.free).at[self.index].set(moving[:n])
        values = space.values(free, trial.fixed, trial.active)
        model = Model(space.structure, values[: space.n_theta], trial.laws).on_average()
        mean, off = model.theta[self.own], self.apart * moving[n : n + len(self.own)]
        theta = model.theta.at[self.own].set(jnp.where(self.log, mean * jnp.exp(off), mean + off))
        return eqx.tree_at(lambda m: (m.theta, m.ambient), model, (theta, jnp.asarray(self.ambient, model.theta.dtype)))

    def begun(self, moving: Array | np.ndarray) -> Array:
        """Values of the state in which the experiment begins, as of `Locals`."""
        first, count = self.space.n_theta, self.space.locals.count(self.space.structure)
        return jnp.asarray(self.space.bounds.scale)[first : first + count] * moving[len(self.index) + len(self.own) :]


def noise_weights(state: State, data: Data, *, period: float | None = None) -> np.ndarray:
    """1 / noise of every output (y,) in a sample, SI; 0 for one that is not recorded.

    Where the residuals of the best hypothesis exceed the noise of the sensor or stay coloured, that is what the next
    experiment will be judged by: the weight falls by their level and by the root of their correlation time (in bins).
    What is coloured lasts as long whatever the ``period`` [s] of new samples (None: as recorded): quicker ones say no
    more of it.
    """
    recorded = float(np.median([r.period for r in state.setup.recordings]))
    share = 1.0 if period is None else recorded / period
    there = np.isfinite(np.asarray(data.norm))
    out = np.zeros(there.shape[2])
    for j in range(there.shape[2]):
        mine = there[..., j]
        if mine.any():
            level = max(float(np.sqrt(np.mean(state.residual[..., j][mine] ** 2))), 1.0)
            slow = correlation_time(state.residual[..., j : j + 1], there[..., j : j + 1])
            out[j] = 1.0 / (float(np.asarray(data.sigma)[j]) * level * np.sqrt(1.0 + (slow - 1.0) * share))
    return out


def room(structure: Structure, data: Data) -> float:
    """How warm it is [K] where the experiment is played: as in the warmest of the recordings, for what is heated gets
    hottest there. Of a temperature that drives it is only where the first recording began.
    """
    ambient = np.asarray(data.ambient)
    return float(np.max(ambient)) if structure.thermal else float(ambient[0])


def rival(state: State, data: Data, weights: np.ndarray, label: str) -> Rival:
    """A hypothesis fitted to ``data`` with what these say about it; initial states of theirs are integrated out.

    ``weights`` (y,) are those of `noise_weights` of samples as they were recorded.
    """
    setup, trial = state.setup, state.trial
    space, meta = setup.space, setup.recordings[0].metadata
    here = evaluate(stack([trial]), data, space)
    jac = np.asarray(here.jacobian[0])
    scale = weights * np.asarray(data.sigma)
    rows = np.concatenate([np.broadcast_to(scale, data.target.shape).ravel(), np.ones(len(jac) - data.target.size)])
    index = np.asarray(trial.index)
    real = index < space.size
    index, jac = index[real], jac[:, real] * rows[:, None]
    information = jac.T @ jac
    mine, begins = np.flatnonzero(index < space.n_theta), np.flatnonzero(index >= space.n_theta)
    mixed = information[mine][:, begins]
    others = np.linalg.pinv(information[begins][:, begins], hermitian=True)
    fitted = information[mine][:, mine] - mixed @ others @ mixed.T
    own, apart, log = _own(state)
    count = space.locals.count(space.structure)
    begun = slice(space.n_theta, space.n_theta + count)
    spread = np.asarray(space.prior_spread)[begun] / np.asarray(space.bounds.scale)[begun]
    began = np.diag(np.where(np.isfinite(spread), spread**-2.0, 0.0))
    known = np.asarray(block_diag(fitted, np.eye(len(own)), began))
    centre = np.concatenate([np.asarray(trial.free)[index[mine]], np.zeros(len(own) + count)])
    ambient = np.asarray(room(space.structure, data))
    return Rival(space, trial, index[mine], centre, known, own, apart, log, ambient, meta.supply_V or 3.7, label)


def _own(state: State) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Of what differs by recording: its places in the model of one, how far a new one may be off the mean (a standard
    deviation on the inner scale, from how far those recorded are), and whether that is a logarithm.
    """
    s = state.setup.structure
    slots = [slot for slot in s.plain.slots if f"{slot.mechanism}.{slot.parameter.name}" in s.own]
    place = np.array([slot.index for slot in slots], int)
    log = np.array([slot.parameter.scale == "log" for slot in slots], bool)
    if not slots:
        return place, np.zeros(0), log
    every = state.values[s.in_recording[:, place]]
    inner = np.where(log, np.log(np.where(log, every, 1.0)), every)
    n = len(s.recordings)
    return place, np.std(inner, axis=0, ddof=min(1, n - 1)) * np.sqrt(1 + 1 / n), log


def _said(moving: Array, r: Rival, drive: Array, step: Array, weights: Array, parts: int) -> tuple[Array, Array]:
    """Predictions in units of the noise (n, y) and temperatures of the heated nodes above ambient [K] (n, sides), by
    ``parts`` steps between two nodes.
    """
    model = r.model(moving)
    s = model.structure
    applied = jnp.asarray(effort(s.drive, drive, ambient=model.ambient, supply=r.supply))
    held = jnp.repeat(applied[:-1], parts, axis=0)
    n = drive.shape[0]
    grid = Grid(jnp.repeat(held[:, None, :], 3, axis=1), step / parts, parts * np.arange(n), np.zeros(n), True)
    z0 = initial_state(model, r.space.locals, r.begun(moving), applied[0])
    states, efforts = (x[::parts] for x in node_states(model, grid, z0, order=2))
    sides = len(s.sides)
    hot = states[:, :sides] if s.thermal else jnp.zeros((n, sides))
    return jax.vmap(model.observe)(states, efforts) * weights, hot


@quickly_compiled
def _sensitivities(
    moving: Array, r: Rival, drive: Array, step: Array, weights: Array, parts: int
) -> tuple[tuple[Array, Array], tuple[Array, Array]]:
    """What `_said` gives and its derivative by what moves, forward, all tangents abreast (last axis)."""
    function = lambda x: _said(x, r, drive, step, weights, parts)  # noqa: E731
    along = lambda e: jax.jvp(function, (moving,), (e,))  # noqa: E731
    return jax.vmap(along, out_axes=(None, -1))(jnp.eye(moving.shape[0], dtype=moving.dtype))


@quickly_compiled
def _pulled(
    moving: Array, r: Rival, drive: Array, step: Array, weights: Array, parts: int, by: tuple[Array, Array]
) -> Array:
    """Derivative by the drive (n, sides) of predictions (n, y) and temperatures (n, sides) weighted ``by``."""
    return jax.vjp(lambda u: _said(moving, r, u, step, weights, parts), drive)[1](by)[0]


@dataclass(frozen=True)
class Scene:
    """Rivals, the first of them the best, on one time grid: ``step`` [s], ``weights`` (y,) per node of it; simulated
    by ``parts`` steps between two nodes.
    """

    rivals: tuple[Rival, ...]
    weights: np.ndarray
    step: float
    parts: int = 1

    @property
    def pairs(self) -> tuple[tuple[int, int], ...]:
        """(true, fitted) of every pair with the best."""
        others = range(1, len(self.rivals))
        return tuple((0, j) for j in others) + tuple((j, 0) for j in others)

    def said(self, i: int, moving: np.ndarray, drive: np.ndarray):
        """Predictions (n, y) [noise], temperatures (n, sides) [K above ambient] of rival i, and derivatives of both."""
        step, weights = jnp.asarray(self.step), jnp.asarray(self.weights)
        values, slopes = _sensitivities(
            jnp.asarray(moving), self.rivals[i], jnp.asarray(drive), step, weights, self.parts
        )
        return tuple(np.asarray(v) for v in (*values, *slopes))

    def pulled(self, i: int, moving: np.ndarray, drive: np.ndarray, said: np.ndarray, hot: np.ndarray) -> np.ndarray:
        """Derivative by the drive (n, sides) of what rival i says, weighted by ``said`` (n, y) and ``hot``."""
        by = (jnp.asarray(said), jnp.asarray(hot))
        r, step, weights = self.rivals[i], jnp.asarray(self.step), jnp.asarray(self.weights)
        return np.asarray(_pulled(jnp.asarray(moving), r, jnp.asarray(drive), step, weights, self.parts, by))


@dataclass(frozen=True)
class Imitation:
    """Rival j at its best attempt to say what another says: ``nats`` = T, ``moving`` (p,), ``off`` (n, y) in noise."""

    nats: float
    moving: np.ndarray
    off: np.ndarray


def imitate(
    scene: Scene,
    j: int,
    target: np.ndarray,
    drive: np.ndarray,
    start: np.ndarray | None = None,
    *,
    steps: int = 8,
    tolerance: float = 1e-7,
) -> Imitation:
    """Minimise T over rival j by Levenberg-Marquardt; ``target`` (n, y) in noise, ``drive`` (n, sides).

    Stops when a step changes T by less than the share ``tolerance``.
    """
    r = scene.rivals[j]

    def at(moving: np.ndarray) -> tuple[float, np.ndarray, np.ndarray]:
        y, _, slope, _ = scene.said(j, moving, drive)
        off, away = y - target, moving - r.centre
        with np.errstate(over="ignore"):  # of what blows up
            value = 0.5 * float(np.sum(off**2)) + 0.5 * float(away @ r.known @ away)
        return value if np.isfinite(value) else np.inf, off, slope.reshape(-1, len(moving))

    now = r.centre if start is None else start
    value, off, jac = at(now)
    if not np.isfinite(value) and start is not None:
        now = r.centre
        value, off, jac = at(now)
    damping = 1e-6
    for _ in range(steps):
        if not np.isfinite(value):
            break
        hessian = jac.T @ jac + r.known
        slope = jac.T @ off.ravel() + r.known @ (now - r.centre)
        size = np.diag(hessian) + 1e-12 * np.max(np.diag(hessian))
        tried = now - np.linalg.solve(hessian + damping * np.diag(size), slope)
        after, off_, jac_ = at(tried)
        if after < value:
            still = value - after < tolerance * value
            now, value, off, jac = tried, after, off_, jac_
            damping = max(damping / 10, 1e-9)
            if still:
                break
        else:
            damping = max(10 * damping, 1e-3)
    return Imitation(value, now, off)


@dataclass(frozen=True)
class Separated:
    """Separations [nats] of every pair with a drive (n, sides), and their least.

    ``said`` (n, y) [noise] and ``hot`` (n, sides) [K above ambient] are what every rival predicts where it stands.
    """

    drive: np.ndarray
    imitations: dict[tuple[int, int], Imitation]
    said: tuple[np.ndarray, ...]
    hot: tuple[np.ndarray, ...]

    @property
    def unpredictable(self) -> tuple[int, ...]:
        """Rivals whose own prediction blows up."""
        whole = [np.all(np.isfinite(y)) and np.all(np.isfinite(h)) for y, h in zip(self.said, self.hot, strict=True)]
        return tuple(i for i, finite in enumerate(whole) if not finite)

    @property
    def least(self) -> float:
        """The smallest separation [nats], whichever rival is true; -inf where one of them says nothing of what it
        expects, which no observation could be held against.
        """
        return -np.inf if self.unpredictable else min(f.nats for f in self.imitations.values())

    @property
    def smooth(self) -> tuple[float, np.ndarray]:
        """The least as the power mean (mean T^-4)^(-1/4), and its derivative by every separation."""
        values = np.maximum(np.array([f.nats for f in self.imitations.values()]), 1e-9)
        low = float(values.min())
        least = low * float(np.mean((values / low) ** -_SHARP)) ** (-1 / _SHARP)
        return least, (values / least) ** (-_SHARP - 1) / len(values)


def separate(
    scene: Scene,
    drive: np.ndarray,
    before: Separated | None = None,
    *,
    steps: int = 8,
    tolerance: float = 1e-7,
) -> Separated:
    """Every separation with a drive (n, sides); imitations start from those ``before`` with a drive much like it."""
    drive = np.asarray(drive, float)
    y, hot = zip(*(scene.said(i, r.centre, drive)[:2] for i, r in enumerate(scene.rivals)), strict=True)
    found = {}
    for i, j in scene.pairs:
        start = before.imitations[i, j].moving if before else None
        found[i, j] = imitate(scene, j, y[i], drive, start, steps=steps, tolerance=tolerance)
    return Separated(drive, found, y, hot)


def slope(
    scene: Scene, s: Separated, by_hot: Sequence[np.ndarray], by_said: Sequence[np.ndarray] | None = None
) -> np.ndarray:
    """Derivative by the drive (n, sides) of the logarithm of the smooth least separation, plus that of temperatures and
    of predictions.

    ``by_hot`` (n, sides) weights the temperatures of every rival where it stands, ``by_said`` (n, y) its predictions.
    """
    least, shares = s.smooth
    true = [np.array(y) for y in by_said] if by_said is not None else [np.zeros_like(y) for y in s.said]
    total = np.zeros_like(s.drive)
    for ((i, j), f), share in zip(s.imitations.items(), shares / least, strict=True):
        true[i] -= share * f.off
        total += scene.pulled(j, f.moving, s.drive, share * f.off, np.zeros_like(s.hot[j]))
    for i, r in enumerate(scene.rivals):
        total += scene.pulled(i, r.centre, s.drive, true[i], by_hot[i])
    return total
