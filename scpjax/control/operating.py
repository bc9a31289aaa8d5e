"""Where a plant comes to rest under a constant effort, its linear systems about there, and how far it can go."""

from __future__ import annotations

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from scpjax.control.plant import Difference, Plant, model_step
from scpjax.physics.model import Model


def operating_point(
    model: Model, effort: Float[Array, " sides"] | None = None, *, settle: float = 50.0, steps: int = 4000
) -> Float[Array, " states"]:
    """State at which a model rests under a constant effort (rest at none), by Newton from a long simulation.

    ``settle`` is how many of its slowest time constants the simulation lasts.
    """
    s = model.structure
    if effort is None:
        return jnp.zeros(s.n_states, model.theta.dtype)
    poles = np.linalg.eigvals(np.asarray(model.linearise()[0]))
    slowest = -max((p.real for p in poles if p.real < 0), default=-1.0)
    step = model_step(model, settle / slowest / steps)
    parts = tuple(effort[i] for i in range(len(s.sides)))
    z, _ = jax.lax.scan(lambda z, _: (step.advance(z, parts, 0.0), None), step.initial, None, length=steps)
    state = jnp.stack(step.states(z))
    for _ in range(2):  # to rounding, where the balances are smooth
        a, _ = model.linearise(state, effort)
        state = state - jnp.linalg.lstsq(a, model.rates(state, effort))[0]
    return state


def linear_parts(plant: Plant, effort: Float[Array, " sides"] | None = None) -> list[tuple[Array, Array, Array]]:
    """(A, b, c) from the effort of each side to the position; jax arrays, differentiable."""
    parts, at = [], 0
    for k, model in enumerate(plant.models()):
        sides = len(model.structure.sides)
        mine = None if effort is None else effort[at : at + sides]
        z = operating_point(model, mine)
        u = jnp.zeros(sides, model.theta.dtype) if mine is None else mine
        a, b = model.linearise(z, mine)
        sign = -1.0 if k else 1.0
        radius = model.structure.pulley_radius if sides == 2 else None
        c = jax.jacfwd(model.observe)(z, u)[-1] * sign * (1.0 if radius else plant.scale())
        parts += [(a, b[:, j], c) for j in range(sides)]
        at += sides
    return parts


def dead_times(plant: Plant) -> list[Array]:
    """Dead time [s] of the drive of each side, 0 where there is none; beside `linear_parts`, which have none."""
    return [jnp.asarray(model.delay(), float) for model in plant.models() for _ in model.structure.sides]


def reach(plant: Plant, high: float | Array) -> tuple[float, float]:
    """Angles [rad] at which the plant comes to rest under the greatest effort [V^2] of either side alone."""
    ends = []
    for side in range(plant.sides):
        effort = jnp.zeros(plant.sides).at[side].set(high)
        ends.append(_rest_position(plant, effort))
    low = min(ends) if len(ends) > 1 else 0.0
    return min(low, 0.0), max(ends)


def _rest_position(plant: Plant, effort: Float[Array, " sides"]) -> float:
    total, at = 0.0, 0
    for k, model in enumerate(plant.models()):
        sides = len(model.structure.sides)
        mine = effort[at : at + sides]
        seen = float(model.observe(operating_point(model, mine), mine)[-1])
        slack = plant.slack(model) if isinstance(plant, Difference) else None
        seen = seen if slack is None else max(seen - float(slack), 0.0)
        total += (-seen if k else seen) * (1.0 if sides == 2 else float(plant.scale()))
        at += sides
    return total
