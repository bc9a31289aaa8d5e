"""How hot does a hypothesis expect the actuator to become?"""

from __future__ import annotations

from collections.abc import Sequence

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from scpjax.compiled import quickly_compiled
from scpjax.diagnose.hypothesis import State
from scpjax.diagnose.separation import Rival, room
from scpjax.errors import FitError
from scpjax.fit.data import Data
from scpjax.fit.problem import Space, Trial, by_recording, initial_state, unpack
from scpjax.fit.setup import Setup
from scpjax.fit.space import measured
from scpjax.physics.model import Model
from scpjax.recordings.recording import Recording
from scpjax.simulate.drive import Grid, recorded_effort
from scpjax.simulate.simulate import Exponential, node_states, simulate


def reached(state: State, data: Data) -> float:
    """Hottest that any heated part became in recordings [K above the warmest of their rooms], by a hypothesis fitted to
    them.
    """
    hottest = np.asarray(_reached(state.trial, data, state.setup.space)) + np.asarray(data.ambient)
    return float(np.max(hottest)) - room(state.setup.structure, data)


@quickly_compiled
def _reached(trial: Trial, data: Data, space: Space) -> Array:
    """By recording, K above its own room."""
    model, local_values = unpack(trial.free, trial, space)
    sides = len(space.structure.sides)

    def one(grid: Grid, effort: Array, values: Array, m: Model) -> Array:
        z0 = initial_state(m, space.locals, values, effort)
        states, _ = node_states(m, grid, z0, order=data.order)
        there = jnp.arange(states.shape[0]) <= jnp.max(grid.at)
        return jnp.max(jnp.where(there[:, None], states[:, :sides], -jnp.inf))

    return jax.vmap(one)(data.grids, jnp.asarray(data.start_effort), local_values, by_recording(model, data))


def allowed(states: Sequence[State], data: Data, hottest: float | None) -> tuple[float, ...]:
    """Greatest temperature [K above ambient] of a heated part by hypothesis; inf where nothing is heated.

    ``hottest`` [K], or None for what each hypothesis says was reached in the present recordings.

    **Raises** `FitError` as `limit`.
    """
    if hottest is None:
        heated = states[0].setup.structure.thermal
        return tuple(reached(s, data) if heated else np.inf for s in states)
    return (limit(states[0].setup, hottest),) * len(states)


def limit(setup: Setup, hottest: float) -> float:
    """A limit on temperature [K] as one above the warmest room; inf where temperature is what drives, which then stays
    below it (`driven_below`).

    **Raises** `FitError` for a limit where nothing tells of a temperature, where no thermometer sets its scale, and one
    below ambient.
    """
    if not setup.structure.thermal:
        driven_below(setup, hottest)
        return np.inf
    if not measured(setup.structure, setup.recordings)[0]:
        raise FitError(
            "a limit on temperature needs a thermometer: from volts and displacement its scale is not known",
            mend="record the temperature, or leave the limit out: the profile then stays as hot as what was recorded",
        )
    above = hottest - room(setup.structure, setup.data)
    if not above > 0:
        raise FitError(f"a limit of {hottest - 273.15:g} degC is below ambient", mend="allow a higher temperature")
    return above


def driven_below(setup: Setup, hottest: float | None) -> float:
    """The highest drive that a limit on temperature [K] leaves; inf where something is heated, of which `limit` tells.

    **Raises** `FitError` where neither the model nor its drive has a temperature that could be limited.
    """
    s = setup.structure
    if hottest is None or s.thermal:
        return np.inf
    if s.drive == "temperature":
        return hottest
    raise FitError(
        f"a limit on temperature means nothing to the model {s.name}, which has no heat balance",
        mend="leave it out, and limit the drive instead",
    )


def doubt(r: Rival, hot_slope: Float[np.ndarray, "n sides p"]) -> float:
    """Twice the greatest standard deviation of the temperatures [K] that the parameters of a rival leave open.

    ``hot_slope`` is their derivative by what moves; the state that the experiment begins in is not in doubt.
    """
    p = len(r.index) + len(r.own)
    if not p or not hot_slope.size:
        return 0.0
    rows = hot_slope[..., :p].reshape(-1, p)
    covariance = np.linalg.pinv(r.known[:p, :p], hermitian=True)
    return 2.0 * float(np.sqrt(np.max(np.sum((rows @ covariance) * rows, axis=1).clip(0.0))))


def played(r: Rival, recording: Recording, *, substeps: int = 1) -> tuple[np.ndarray, float]:
    """Outputs (n, y) in SI that a rival expects of a drive, and how hot it expects any heated part [K above ambient].

    By fourth order and ``substeps`` of every sample, apart from the search.
    """
    model = r.model(r.centre)
    start = model.initial()
    if not model.structure.thermal:
        first = np.asarray(recorded_effort(model.structure, recording, ambient=model.ambient))[0]
        start = model.initial(effort=jnp.asarray(first))
    path = simulate(model, recording, initial=start, method=Exponential(order=4, substeps=substeps))
    sides = len(model.structure.sides)
    hot = float(np.max(np.asarray(path.states)[:, :sides])) if model.structure.thermal else -np.inf
    return np.asarray(path.outputs), hot
