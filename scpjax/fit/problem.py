"""The least-squares problem of one actuator: its parameters and initial states, its residuals."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import partial
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float, Int

from scpjax.fit.data import Data
from scpjax.parameter import Bounded, namespace
from scpjax.physics.model import Model
from scpjax.physics.structure import Structure
from scpjax.simulate.drive import Grid
from scpjax.simulate.simulate import at_samples, node_states, stepper

CEILING = 1e7
"""Binned residuals are cut off there, in standard deviations."""


@dataclass(frozen=True)
class Locals:
    """What is estimated for each recording: the state it began in."""

    temperature: bool  # K above ambient, per side
    displaced: bool  # m from equilibrium
    moving: bool = False  # m/s
    own: bool = False  # all states of a base of the user's own

    def count(self, structure: Structure) -> int:
        return len(self.names(structure))

    def names(self, structure: Structure) -> tuple[str, ...]:
        """Names of the entries for one recording."""
        names = [f"initial_temperature{'_' + s if s else ''}" for s in structure.sides] if self.temperature else []
        names += ["initial_displacement"] if self.displaced else []
        names += ["initial_velocity"] if self.moving else []
        names += [f"initial_{state}" for state in structure.system.states] if self.own and structure.system else []
        return tuple(names)


def initial_state(model: Model, locals_: Locals, values: Float[Array, " l"], effort: Float[Array, " s"]) -> Array:
    """State at the first sample from the local values of one recording."""
    if model.structure.system:
        return model.initial(own=values if locals_.own else None, effort=effort)
    s = len(model.structure.sides)
    warm = values[:s] if locals_.temperature else 0.0
    at = s if locals_.temperature else 0
    displaced = values[at] if locals_.displaced else 0.0
    velocity = values[-1] if locals_.moving else 0.0
    return model.initial(warm, displaced, velocity, effort)


def predict_outputs(
    model: Model, data: Data, locals_: Locals, local_values: Float[Array, "r l"]
) -> Float[Array, "r n y"]:
    """Simulated outputs at the samples of every recording."""

    def one(grid: Grid, effort: Array, values: Array, m: Model) -> Array:
        z0 = initial_state(m, locals_, values, effort)
        states, efforts = node_states(m, grid, z0, order=data.order)
        return at_samples(jax.vmap(m.observe)(states, efforts), grid)

    return jax.vmap(one)(data.grids, jnp.asarray(data.start_effort), local_values, by_recording(model, data))


def by_recording(model: Model, data: Data) -> Model:
    """The model of every recording, in its room: leaves with a leading axis."""
    rooms = jnp.asarray(data.ambient)
    return jax.vmap(lambda i, room: _in_room(model.of_recording(i), room))(jnp.arange(rooms.shape[0]), rooms)


def _in_room(model: Model, ambient: Array) -> Model:
    return eqx.tree_at(lambda m: m.ambient, model, ambient)


def binned_residuals(
    model: Model, data: Data, locals_: Locals, local_values: Float[Array, "r l"]
) -> Float[Array, "r k y"]:
    """(simulated - recorded) summed over bins, so scaled that white noise of std sigma gives unit variance."""
    return jax.vmap(
        lambda mine, i, values: _binned(model.of_recording(i), mine, locals_, values),
        in_axes=(data.by_recording(), 0, 0),
    )(data, jnp.arange(local_values.shape[0]), local_values)


def _last(data: Data) -> Array:
    """Bins up to the last sample of the longest recording: what comes after is padding. Held-out ends are not: a model
    that blows up there should turn a solver back.
    """
    return jnp.max(data.grids.at) // data.bin + 1


def _binned(
    model: Model, data: Data, locals_: Locals, values: Float[Array, " l"], last: Array | None = None
) -> Float[Array, "k y"]:
    """`binned_residuals` of one recording: ``data`` without its leading axis, ``model`` its own. It is simulated up to
    the bin ``last``, or with its padding; where that differs between those side by side (a fleet), the padding is
    worked out and not used.
    """
    grid = data.grids
    m = _in_room(model, jnp.asarray(data.ambient))
    z0 = initial_state(m, locals_, values, jnp.asarray(data.start_effort))
    advance, drive = stepper(m, grid, z0, order=data.order)
    observe = lambda z, effort: m.balances().observe(z, effort)  # noqa: E731  # within the loop, as in `stepper`
    n_y, bins = data.at_start.shape[1], data.target.shape[0]
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
        zero = [0.0 * carry[1][i] for i in range(n_y)]  # traced once: see `scpjax.simulate.exponential`
        (z, y, total), _ = jax.lax.scan(step, (*carry, zero), xs)
        return (z, y), total

    def one_of_some(carry: Any, xs: Any) -> Any:
        place, mine = xs
        idle = lambda carry, _: (carry, [jnp.zeros_like(carry[1][i]) for i in range(n_y)])  # noqa: E731
        return jax.lax.cond(place < last, one_bin, idle, carry, mine)

    z = [z0[i] for i in range(z0.shape[0])]
    first = observe(z, ends(drive[0])[0])
    folded = (fold(drive), fold(data.at_start), fold(data.at_end))
    if last is None:
        _, totals = jax.lax.scan(one_bin, (z, first), folded)
    else:
        _, totals = jax.lax.scan(one_of_some, (z, first), (jnp.arange(bins), folded))
    return (jnp.stack(totals, axis=-1) - data.target) / data.norm


def _whitened(residual: Float[Array, "k y"], data: Data) -> Float[Array, "k y"]:
    """Residuals through the filter of ``data.colour``; bins whose predecessors are empty fall out of a coloured one.

    A simulation that blew up (outside the physical domain) gives a large finite residual, which turns a solver back.
    """
    there = jnp.isfinite(data.norm)
    filtered, whole = residual, there
    for lag in (1, 2, 3):
        before = jnp.pad(residual[:-lag], ((lag, 0), (0, 0)))
        filtered = filtered - data.colour[:, lag - 1] * before
        whole &= jnp.pad(there[:-lag], ((lag, 0), (0, 0)))
    coloured = jnp.any(data.colour != 0, axis=1)
    r = jnp.where(coloured, jnp.where(whole, filtered, 0.0), residual)
    return jnp.where(jnp.isfinite(r), jnp.clip(r, -CEILING, CEILING), CEILING)


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
    def recording_of(self) -> np.ndarray:
        """Of every entry the recording that alone depends on it (size,), -1 where all may."""
        s = self.structure
        own = [s.recordings.index(slot.recording) if slot.recording else -1 for slot in s.slots]
        return np.concatenate([own, np.repeat(np.arange(self.n_recordings), self.locals.count(s))]).astype(int)

    @property
    def keys(self) -> tuple[str, ...]:
        """Name of every entry."""
        names = self.locals.names(self.structure)
        return tuple(s.key for s in self.structure.slots) + tuple(
            f"recording_{i}.{n}" for i in range(self.n_recordings) for n in names
        )

    def values(self, free: Float[Array, " all+1"], fixed: Float[Array, " all"], active: Bool[Array, " all"]) -> Array:
        """Physical values: of the active entries from ``free``, of the others from ``fixed``."""
        value = self.bounds.to_value(free[:-1])
        return namespace(value, active).where(active, value, fixed)


_ABREAST = 4  # numbers that a processor computes with at once


class Trial(eqx.Module):
    """One hypothesis to fit: which entries move (``index``, padded with the idle one), from where, under which laws.

    ``lanes`` are the places in ``index`` that each recording depends on: not those of other recordings' own values.
    Padded with a place that is none, to a multiple of what a processor takes at once (``python benchmarks/lanes.py``).
    """

    index: Int[Array, " moving"]
    lanes: Int[Array, "r lanes"]
    free: Float[Array, " all+1"]
    fixed: Float[Array, " all"]
    active: Bool[Array, " all"]
    laws: Float[Array, " mechanisms"]


def residuals_of(values: Float[Array, "m all"], laws: Float[Array, "m mechanisms"], data: Data, space: Space) -> Array:
    """Filtered residuals (m, r, k, y) of models with these physical values under these laws."""

    def of_one(mine: Data, i: Array) -> Array:
        def of_model(value: Array, law: Array) -> Array:
            model, local_values = _parts(value, law, space)
            return _whitened(_binned(model.of_recording(i), mine, space.locals, local_values[i], last), mine)

        return jax.vmap(of_model)(values, laws)

    last = _last(data)

    # recordings outside and models inside: the inner one is the axis along which a processor computes side by side
    over = (data.by_recording(), 0)
    return jax.vmap(of_one, in_axes=over, out_axes=1)(data, jnp.arange(space.n_recordings))


def lanes_of(index: np.ndarray, space: Space, least: int = 0) -> np.ndarray:
    """`Trial.lanes` of the entries that move, ``least`` of them at least: as many whichever take the idle places."""
    whose = np.append(space.recording_of, -1)[index]
    mine = [np.flatnonzero((whose == i) | (whose < 0)) for i in range(space.n_recordings)]
    most = max(least, *(len(places) for places in mine))
    out = np.full((space.n_recordings, _ABREAST * -(-most // _ABREAST)), len(index))
    for row, places in zip(out, mine, strict=True):
        row[: len(places)] = places
    return out


def soften(r: Array, threshold: float) -> Array:
    """Residuals whose squares are the pseudo-Huber loss: r^2 -> 2 d^2 (sqrt(1 + (r/d)^2) - 1)."""
    return r * jnp.sqrt(2.0 / (jnp.sqrt(1.0 + (r / threshold) ** 2) + 1.0))


def residuals(
    moving: Float[Array, " moving"], trial: Trial, data: Data, space: Space, *, robust: float = 0.0
) -> Float[Array, " m"]:
    """Binned residuals of the data, then those of the priors, then the idle entry's.

    ``robust`` > 0 is the residual, in standard deviations, beyond which the loss of the data's grows linearly.
    """
    of_one = partial(_misfit, moving, trial, space, robust)
    of_data = jax.vmap(of_one, in_axes=(data.by_recording(), 0))(data, jnp.arange(space.n_recordings))
    return jnp.concatenate([of_data.ravel(), _beside(moving, trial, space)])


@partial(jax.jit, static_argnames=("robust",))
def sensitivities(
    moving: Float[Array, " moving"],
    trial: Trial,
    data: Data,
    space: Space,
    *,
    robust: float = 0.0,
) -> tuple[Float[Array, " m"], Float[Array, "m moving"]]:
    """`residuals` and their Jacobian by forward sensitivities, all tangents of a recording abreast with its values.

    Linearising a simulation first, as `optimistix` does, would keep every step of it in memory. The Jacobian is 0 where
    a residual has no finite derivative.
    """
    every = jnp.arange(moving.shape[0])

    def along(function: Callable[[Array], Array], places: Array) -> tuple[Array, Array]:
        directions = jax.nn.one_hot(places, moving.shape[0], dtype=moving.dtype)
        return jax.vmap(lambda e: jax.jvp(function, (moving,), (e,)), out_axes=(None, -1))(directions)

    last = _last(data)

    def of_one(mine: Data, i: Array, lanes: Array) -> tuple[Array, Array]:
        value, slopes = along(lambda x: _misfit(x, trial, space, robust, mine, i, last), lanes)
        there = jnp.any(lanes[:, None] == every, axis=0)
        lane = jnp.argmax(lanes[:, None] == every, axis=0)
        return value, jnp.where(there, slopes[..., lane], 0.0)

    over = (data.by_recording(), 0, 0)
    of_data, slopes = jax.vmap(of_one, in_axes=over)(data, jnp.arange(space.n_recordings), jnp.asarray(trial.lanes))
    others, other_slopes = along(lambda x: _beside(x, trial, space), every)
    jacobian = jnp.concatenate([slopes.reshape(-1, moving.shape[0]), other_slopes])
    return jnp.concatenate([of_data.ravel(), others]), known(jacobian)


@jax.custom_batching.custom_vmap
def known(jacobian: Float[Array, "*many m moving"]) -> Float[Array, "*many m moving"]:
    """A Jacobian, 0 where a residual has no finite derivative: it is taken to stay as it is."""
    whole = jnp.isfinite(jnp.sum(jacobian))  # nearly always; to look at every entry at every step takes time
    return jax.lax.cond(whole, lambda j: j, lambda j: jnp.where(jnp.isfinite(j), j, 0.0), jacobian)


@known.def_vmap
def _known_of_many(size: int, batched: tuple[bool], jacobians: Array) -> tuple[Array, bool]:
    """Of many side by side every entry is looked at: asked of each whether it is whole, both ways are worked out."""
    return jnp.where(jnp.isfinite(jacobians), jacobians, 0.0), batched[0]


def _misfit(
    moving: Array, trial: Trial, space: Space, robust: float, mine: Data, i: Array, last: Array | None = None
) -> Float[Array, "k y"]:
    """Filtered residuals of recording ``i``, which ``mine`` is, simulated up to the bin ``last``."""
    model, local_values = unpack(trial.free.at[trial.index].set(moving), trial, space)
    r = _whitened(_binned(model.of_recording(i), mine, space.locals, local_values[i], last), mine)
    return soften(r, robust) if robust > 0 else r


def _beside(moving: Array, trial: Trial, space: Space) -> Array:
    free = trial.free.at[trial.index].set(moving)
    return jnp.concatenate([_prior(free, trial, space), free[-1:]])


def _prior(free: Float[Array, " all+1"], trial: Trial, space: Space) -> Float[Array, " all"]:
    inner = space.bounds.to_inner(free[:-1])
    there = trial.active & jnp.isfinite(space.prior_spread)
    spread = jnp.where(jnp.isfinite(space.prior_spread), space.prior_spread, 1.0)
    return jnp.where(there, (inner - space.prior_mean) / spread, 0.0)


def simulated(free: Array, trial: Trial, data: Data, space: Space) -> Float[Array, "r n y"]:
    """Outputs of a trial at a free vector."""
    model, local_values = unpack(free, trial, space)
    return predict_outputs(model, data, space.locals, local_values)


def unpack(free: Array, trial: Trial, space: Space) -> tuple[Model, Float[Array, "r l"]]:
    """Model and local values of a trial at a free vector."""
    return _parts(space.values(free, trial.fixed, trial.active), trial.laws, space)


def _parts(values: Array, laws: Array, space: Space) -> tuple[Model, Float[Array, "r l"]]:
    model = Model(space.structure, values[: space.n_theta], laws)
    return model, values[space.n_theta :].reshape(space.n_recordings, space.locals.count(space.structure))
