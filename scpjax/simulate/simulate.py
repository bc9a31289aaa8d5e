"""Model and recording in, trajectory out."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from scpjax.errors import ModelError
from scpjax.physics.balances import Balances
from scpjax.physics.coupling import coupling
from scpjax.physics.mechanism import Mechanism
from scpjax.physics.model import Model
from scpjax.recordings.recording import Recording
from scpjax.simulate.drive import Grid, delayed, make_grid
from scpjax.simulate.exponential import Carry, Rates, Step, all_nodes, etd2, etd4


@dataclass(frozen=True, kw_only=True)
class Exponential:
    """Fixed step, linear core exact. ``order`` 2 (effort constant over a step) or 4; ``substeps`` per sample."""

    order: Literal[2, 4] = 4
    substeps: int = 1


@dataclass(frozen=True, kw_only=True)
class Adaptive:
    """diffrax with adaptive steps (Kvaerno5): the cross-check, also for stiff mechanisms."""

    rtol: float = 1e-9
    atol: float = 1e-11
    max_steps: int = 1_000_000


@dataclass(frozen=True)
class Exact:
    """Matrix exponentials for the hold of the recording; linear models only, also on non-uniform stamps."""


Method = Exponential | Adaptive | Exact


class Trajectory(eqx.Module):
    """``time`` [s] (n,), ``states`` (n, states), ``outputs`` (n, outputs) in SI and the order of the structure."""

    time: Float[Array, " n"]
    states: Float[Array, "n states"]
    outputs: Float[Array, "n outputs"]


def stepper(
    model: Model, grid: Grid, z0: Float[Array, " states"], *, order: int = 2
) -> tuple[Step, Float[Array, "steps ..."]]:
    """The map over one step of a grid, and the (delayed) effort it takes at each; jit- and vmap-friendly.

    What a dead time brings over from before the recording is the effort that kept the actuator as ``z0`` shows it.

    ``order`` 2 needs an effort that is constant over each step and is raised to 4 where it is not.
    """
    nodes, step = jnp.asarray(grid.effort), jnp.asarray(grid.step)
    if any(type(m).delay is not Mechanism.delay for m in model.structure.mechanisms):
        before = model.balances().holding(_apart(z0), nodes[0, 0])
        nodes = delayed(nodes, step, model.delay(), grid.constant, before)
    a, pattern = model.core(), coupling(model.structure)
    if order == 2 and grid.constant:
        rates, carried = _taken_apart_within(model, step)
        return etd2(rates, a, step, pattern=pattern, carried=carried), nodes[:, 0, :]
    rates, _ = _taken_apart_within(model, step / 2)
    return etd4(rates, a, step, pattern=pattern), nodes


def _taken_apart_within(model: Model, step: Array) -> tuple[Rates, Carry | None]:
    """`Balances.rates` and `Balances.carried`, if any, of balances into which the values are put where they are asked:
    XLA carries all that a loop takes from outside through it, and compiles for longer the more that is.
    """

    def rates(z: list[Array], effort: Array) -> list[Array]:
        return model.balances(step=step).rates(z, effort)

    def carried(z: list[Array], after: list[Array], effort: Array, over: Array) -> list[Array]:
        return model.balances(step=step).carried(z, after, effort, over)

    return rates, carried if model.balances().carries else None


def node_states(model: Model, grid: Grid, z0: Float[Array, " states"], *, order: int = 2) -> tuple[Array, Array]:
    """States and efforts at all nodes of a grid: (nodes, states) and (nodes, sides)."""
    advance, effort = stepper(model, grid, z0, order=order)
    states = all_nodes(advance, z0, effort)
    ends = (effort, effort[-1:]) if effort.ndim == 2 else (effort[:, 0], effort[-1:, 2])
    return states, jnp.concatenate(ends)


def at_samples(values: Float[Array, "nodes k"], grid: Grid) -> Float[Array, "n k"]:
    """Values at the recording's stamps, linear between nodes."""
    right = jnp.minimum(grid.at + 1, grid.steps)
    return values[grid.at] + grid.fraction[:, None] * (values[right] - values[grid.at])


def simulate(
    model: Model,
    recording: Recording,
    *,
    initial: Float[Array, " states"] | None = None,
    method: Method | None = None,
) -> Trajectory:
    """Simulate a model over a recording's drive, from ``initial`` (rest at ambient when not given).

    Linear models go by `Exact` and others by fourth-order `Exponential` unless a ``method`` is given.
    The drive reaches the model as the recording's hold says. Differentiable in the model, ``initial`` and the
    recording's inputs.

    **Raises** `ModelError` when the recording's drives do not fit the model, or `Exact` is asked of a nonlinear model.
    """
    z0 = model.initial() if initial is None else jnp.asarray(initial, model.theta.dtype)
    if method is None:
        own = model.structure.system
        method = Exact() if model.structure.is_linear else Exponential(substeps=own.substeps if own else 1)
    if isinstance(method, Exact):
        from scpjax.simulate.linear import simulate_exact

        if not model.structure.is_linear:
            raise ModelError(f"{model!r} is not linear", mend="use Exponential or Adaptive")
        states, efforts = simulate_exact(model, recording, z0)
    elif isinstance(method, Adaptive):
        from scpjax.simulate.adaptive import simulate_adaptive

        states, efforts = simulate_adaptive(model, recording, z0, method)
    else:
        grid = make_grid(model.structure, recording, ambient=model.ambient, substeps=method.substeps)
        at_nodes, effort_nodes = jax.jit(node_states, static_argnames="order")(model, grid, z0, order=method.order)
        states, efforts = at_samples(at_nodes, grid), at_samples(effort_nodes, grid)
    outputs = jax.vmap(model.observe)(states, efforts)
    return Trajectory(jnp.asarray(recording.time), states, outputs)


def energy_balance(model: Model, recording: Recording, *, initial: Array | None = None) -> dict[str, Array]:
    """Heat over a recording [J]: ``supplied`` = ``stored`` + ``lost``, by integrating the flows with the states.

    **Raises** `ModelError` for a model without an energy balance.
    """
    if not model.structure.thermal:
        raise ModelError("this model has no energy balance", mend="use te, plant or aaa")
    z0 = model.initial() if initial is None else jnp.asarray(initial, model.theta.dtype)
    return _heats(model, make_grid(model.structure, recording, ambient=model.ambient), z0)


@jax.jit
def _heats(model: Model, grid: Grid, z0: Array) -> dict[str, Array]:
    step, nodes = jnp.asarray(grid.step), jnp.asarray(grid.effort)
    balances, core = model.balances(step=step), model.balances(core=True)
    nodes = delayed(nodes, step, model.delay(), grid.constant, balances.holding(_apart(z0), nodes[0, 0]))

    def rates(z: list[Array], u: Array, balances: Balances = balances) -> list[Array]:
        power, lost, _ = balances.heat_flows(z[:-2], u)
        return [*balances.rates(z[:-2], u), power, lost]

    n, sides = model.structure.n_states, len(model.structure.sides)
    z_all = jnp.concatenate([z0, jnp.zeros(2, z0.dtype)])
    a = jax.jacfwd(lambda z: jnp.stack(rates([z[i] for i in range(n + 2)], jnp.zeros(sides), core)))(
        jnp.zeros_like(z_all)
    )
    dense = ((True,) * (n + 2),) * (n + 2)
    end = all_nodes(etd4(rates, a, step, pattern=dense), z_all, nodes)[-1]
    stored = [balances.heat_flows(z, nodes[i, j])[2] for z, i, j in ((z0, 0, 0), (end[:-2], -1, 2))]
    return {"supplied": end[-2], "lost": end[-1], "stored": stored[1] - stored[0]}


def _apart(z: Float[Array, " states"]) -> list[Array]:
    return [z[i] for i in range(z.shape[0])]


def numpy_outputs(trajectory: Trajectory) -> np.ndarray:
    """Outputs as a numpy array (n, outputs)."""
    return np.asarray(trajectory.outputs)
