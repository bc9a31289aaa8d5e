"""The solver of every fit beside `optimistix.LevenbergMarquardt`: the same fits of the example that ships with scpjax.

``python benchmarks/solver.py`` fits mechanisms from every start that a diagnosis tries, with both, in one run: steps,
lowest cost, seconds to trace and compile, seconds to run, and their ratios. The peer has the same forward sensitivities
(by a custom derivative; linearising the simulation itself would be slower still) and the same stopping by cost.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Sequence
from importlib import resources
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import optimistix as optx
from jaxtyping import Array

from scpjax.compiled import quick_options
from scpjax.diagnose.holdout import split
from scpjax.diagnose.hypothesis import State, grown, residual_on, starts_with, trial_at
from scpjax.fit import solve as room
from scpjax.fit.data import Data
from scpjax.fit.fit import best_start
from scpjax.fit.problem import Space, Trial, residuals, sensitivities
from scpjax.fit.setup import prepare
from scpjax.physics.catalogue import mechanism
from scpjax.recordings import read_recording

MECHANISMS = ("hysteresis", "friction", "creep", "two_node_thermal", "nonlinear_heat_loss")
STEPS, TOLERANCE = 60, 0.02


class Peer(optx.LevenbergMarquardt):
    """As it comes, but stopping with the cost."""

    def __init__(self) -> None:
        super().__init__(rtol=1e-6, atol=1e-3)

    def step(self, fn: Any, y: Any, args: Any, options: Any, state: Any, tags: Any) -> Any:
        y, new, aux = super().step(fn, y, args, options, state, tags)
        before, after = (0.5 * jnp.sum(s.f_info.residual**2) for s in (state, new))
        accepted = (new.num_accepted_steps > state.num_accepted_steps) & ~state.first_step
        still = accepted & (jnp.abs(before - after) < TOLERANCE + self.rtol * after)
        stuck = new.num_steps_since_acceptance > 12
        ended = new.terminate | still | stuck | (new.num_steps >= STEPS)
        return y, eqx.tree_at(lambda s: s.terminate, new, ended), aux


def peer(trial: Trial, data: Data, space: Space) -> tuple[Array, Array]:
    """(steps, cost) of one trial by optimistix."""

    @jax.custom_jvp
    def residual(x: Array) -> Array:
        return residuals(x, trial, data, space)

    @residual.defjvp
    def _(at: tuple[Array], along: tuple[Array]) -> tuple[Array, Array]:
        value, columns = sensitivities(at[0], trial, data, space)
        return value, columns @ along[0]

    start = trial.free[trial.index]
    options = {"jac": "fwd"}
    found = optx.least_squares(lambda x, _: residual(x), Peer(), start, options=options, max_steps=400, throw=False)
    return found.stats["num_steps"], jnp.sum(found.state.f_info.residual**2)


def ours(trial: Trial, data: Data, space: Space) -> tuple[Array, Array]:
    """(steps, cost) of one trial by `scpjax.fit.marquardt`."""
    found = room.solve_one(trial, data, space, max_steps=STEPS, tolerance=TOLERANCE)
    return found.steps, found.cost


def timed(
    solver: Callable[..., tuple[Array, Array]], trials: Sequence[Trial], data: Data, space: Space
) -> tuple[np.ndarray, np.ndarray, float, float]:
    """(steps, costs, seconds to trace and compile, seconds to run) of trials one after the other."""
    program = eqx.filter_jit(solver, compiler_options=quick_options(jax.default_backend()) or None)
    began = time.perf_counter()
    compiled = program.lower(trials[0], data, space).compile()
    built = time.perf_counter() - began
    began = time.perf_counter()
    found = [jax.block_until_ready(compiled(t, data, space)) for t in trials]
    took = time.perf_counter() - began
    return np.array([int(n) for n, _ in found]), np.array([float(c) for _, c in found]), built, took


def main() -> None:
    jax.config.update("jax_enable_x64", True)
    with resources.as_file(resources.files("scpjax") / "examples" / "demo") as folder:
        setup = prepare([read_recording(f) for f in sorted(folder.glob("*.csv"))])
    parts = split(setup.data)
    trial, _, _ = best_start(setup, parts.train)
    residual = residual_on(trial, parts.whole, setup)
    base = State(setup, trial, residual, float(np.sum(residual[parts.is_train] ** 2)))
    head = (
        "mechanism",
        "fits",
        "steps",
        "peer",
        "ratio",
        "cost",
        "peer",
        "built",
        "peer",
        "ratio",
        "run",
        "peer",
        "ratio",
    )
    print(("{:22}" + "{:>9}" * (len(head) - 1)).format(*head))
    sums = np.zeros(6)
    for name in MECHANISMS:
        problem = grown(setup, mechanism(name))
        trials = [trial_at(problem, s.value, s.laws) for s in starts_with(base, mechanism(name), problem)]
        (n0, c0, b0, r0), (n1, c1, b1, r1) = (timed(s, trials, parts.train, problem.space) for s in (ours, peer))
        sums += (n0.sum(), n1.sum(), b0, b1, r0, r1)
        print(
            f"{name:22}{len(trials):9d}{n0.sum():9d}{n1.sum():9d}{n0.sum() / n1.sum():9.2f}"
            f"{c0.min():9.0f}{c1.min():9.0f}{b0:9.2f}{b1:9.2f}{b0 / b1:9.2f}{r0:9.2f}{r1:9.2f}{r0 / r1:9.2f}",
            flush=True,
        )
    print(
        f"all: steps {sums[0] / sums[1]:.2f}, built {sums[2] / sums[3]:.2f}, run {sums[4] / sums[5]:.2f} of the peer's"
    )


if __name__ == "__main__":
    main()
