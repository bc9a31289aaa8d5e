"""Levenberg-Marquardt on many trials at once, in one compiled call."""

from __future__ import annotations

import ctypes
import gc
from collections.abc import Sequence
from pathlib import Path

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import optimistix as optx
from jaxtyping import Array, Float

from scpjax.abreast import abreast
from scpjax.compiled import forget, quickly_compiled
from scpjax.fit.data import Data
from scpjax.fit.ends import End, Ends, key_of
from scpjax.fit.marquardt import Marquardt
from scpjax.fit.problem import Space, Trial, residuals_of, sensitivities, simulated


class Solution(eqx.Module):
    """Where a trial ended. ``cost`` is the sum of squared binned residuals and of the priors'."""

    free: Float[Array, " all+1"]
    cost: Float[Array, ""]
    steps: Array
    converged: Array
    residual: Float[Array, " m"]  # there, as of `residuals`
    jacobian: Float[Array, "m moving"]  # there, by the moving entries


_CEILING = 400  # steps, whatever is asked for


def solve_one(
    trial: Trial,
    data: Data,
    space: Space,
    *,
    max_steps: int | Array = 40,
    tolerance: float | Array = 1e-3,
    robust: float = 0.0,
) -> Solution:
    """Levenberg-Marquardt from one start, forward sensitivities (as many as entries move).

    Stops when a step changes half the sum of squares by less than ``tolerance`` (1e-3 is a thousandth of what a
    single standard deviation makes). ``robust`` > 0 is the residual, in standard deviations, beyond which the
    pseudo-Huber loss grows linearly.
    """

    solution = optx.least_squares(
        lambda x, _: sensitivities(x, trial, data, space, robust=robust),
        Marquardt(tolerance=tolerance, limit=max_steps),
        trial.free[trial.index],
        has_aux=True,
        max_steps=_CEILING,
        throw=False,
    )
    return Solution(
        free=trial.free.at[trial.index].set(solution.value),
        cost=jnp.sum(solution.state.residual**2),
        steps=solution.stats["num_steps"],
        converged=solution.stats["num_steps"] < max_steps,
        residual=solution.state.residual,
        jacobian=solution.state.jacobian,
    )


def solve(
    trials: Trial,
    data: Data,
    space: Space,
    *,
    max_steps: int = 40,
    tolerance: float = 1e-3,
    robust: float = 0.0,
) -> Solution:
    """All trials (leading axis) on the same data, each by a call of one compiled program, as many abreast as there are
    cores.

    In one call, side by side, they would all take as many steps as the slowest, and a Jacobian for every step that is
    rejected.
    """
    most, enough = jnp.asarray(np.asarray(max_steps)), jnp.asarray(np.asarray(tolerance))

    def one(i: int) -> Solution:
        return jax.tree.map(np.asarray, _solve(pick(trials, i), data, space, most, enough, robust))

    found = abreast(one, range(trials.free.shape[0]))
    return jax.tree.map(lambda *leaves: np.stack(leaves), *found)


@quickly_compiled
def _solve(trial: Trial, data: Data, space: Space, max_steps: Array, tolerance: Array, robust: float) -> Solution:
    return solve_one(trial, data, space, max_steps=max_steps, tolerance=tolerance, robust=robust)


def solve_fleet(
    trials: Trial,
    data: Data,
    spaces: Space,
    *,
    max_steps: int = 40,
    tolerance: float = 1e-3,
    robust: float = 0.0,
) -> Solution:
    """One trial for each actuator of a fleet, each on its own data, abreast; all arguments have a leading axis."""
    return _solve_fleet(trials, data, spaces, jnp.asarray(max_steps), jnp.asarray(tolerance), robust)


@quickly_compiled
def _solve_fleet(
    trials: Trial, data: Data, spaces: Space, max_steps: Array, tolerance: Array, robust: float
) -> Solution:
    def one(trial: Trial, mine: Data, space: Space) -> Solution:
        return solve_one(trial, mine, space, max_steps=max_steps, tolerance=tolerance, robust=robust)

    return jax.vmap(one)(trials, data, spaces)


@quickly_compiled
def outputs_of(trial: Trial, data: Data, space: Space) -> Float[Array, "r n y"]:
    """Simulated outputs of a trial at its free vector."""
    return simulated(trial.free, trial, data, space)


def evaluate(trials: Trial, data: Data, space: Space) -> Solution:
    """Residuals and Jacobians of trials (leading axis) where they stand: the solver's first step, no program more."""
    return solve(trials, data, space, max_steps=1)


def solve_all(
    trials: Sequence[Trial], data: Data, space: Space, *, max_steps: int, tolerance: float = 1e-3
) -> tuple[list[Trial], np.ndarray, np.ndarray]:
    """(trials where they ended, costs (trials,), inf where none is finite, whether at rest there). Those that were
    fitted to these data before, or are among them twice, are not again.
    """
    keys = [key_of(trial, space) for trial in trials]
    found_before = {key: _ENDS.find(data, key, max_steps, tolerance) for key in keys}
    ends = {key: end for key, end in found_before.items() if end is not None}
    new = {key: trial for key, trial in zip(keys, trials, strict=True) if key not in ends}
    if new:
        found = solve(stack([*new.values()]), data, space, max_steps=max_steps, tolerance=tolerance)
        for i, key in enumerate(new):
            rested, steps = bool(found.converged[i]), int(found.steps[i])
            ends[key] = End(np.array(found.free[i]), float(found.cost[i]), rested, steps, max_steps, tolerance)
            _ENDS.keep(data, key, ends[key])
    told = [ends[key] for key in keys]
    done = [eqx.tree_at(lambda t: t.free, trial, end.free.copy()) for trial, end in zip(trials, told, strict=True)]
    cost = np.array([end.cost for end in told])
    return done, np.where(np.isfinite(cost), cost, np.inf), np.array([end.rested for end in told])


_ENDS = Ends()


def binned_of(trials: Sequence[Trial], data: Data, space: Space) -> np.ndarray:
    """Binned residuals (trials, r, k, y) of trials where they stand; 0 where a bin is empty."""
    flat = np.asarray(evaluate(stack(trials), data, space).residual)
    return flat[:, : data.target.size].reshape(-1, *data.target.shape)


_MAPPED = 20_000  # pieces of memory; Linux gives a process 65,530, and every compiled program takes about a thousand


def make_room() -> None:
    """Drop all compiled programs where the process holds so many that it might not get memory for more."""
    maps = Path("/proc/self/maps")
    if maps.exists() and maps.read_bytes().count(b"\n") > _MAPPED:
        forget()
        gc.collect()
        trim = getattr(ctypes.CDLL(None), "malloc_trim", None)  # glibc keeps what was freed, gigabytes of it
        if trim is not None:
            trim(0)


_FORWARD = 16  # simulations in one call, side by side


def residuals_at(values: np.ndarray, laws: np.ndarray, data: Data, space: Space) -> np.ndarray:
    """Binned residuals (m, r, k, y) at physical values (m, all) and laws (m, mechanisms): simulations only."""

    def some(i: int) -> np.ndarray:
        part, kept = values[i : i + _FORWARD], laws[i : i + _FORWARD]
        fill = ((0, _FORWARD - len(part)), (0, 0))
        theta, which = (jnp.asarray(np.pad(x, fill, "edge")) for x in (part, kept))
        return np.asarray(_forward(theta, which, data, space))[: len(part)]

    return np.concatenate(abreast(some, range(0, len(values), _FORWARD)))


@quickly_compiled
def _forward(values: Array, laws: Array, data: Data, space: Space) -> Float[Array, "m r k y"]:
    return residuals_of(values, laws, data, space)


def stack(trials: Sequence[Trial]) -> Trial:
    """Trials side by side."""
    return jax.tree.map(lambda *leaves: np.stack(leaves), *trials)


def pick(trials: Trial, i: int | Array) -> Trial:
    """One of stacked trials."""
    return jax.tree.map(lambda leaf: leaf[i], trials)
