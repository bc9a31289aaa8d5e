"""State feedback with integral action and an observer, and internal-model control: what the literature of thesis
2.4.2 used beside PID.

Both see a joint as one net effort: what is positive drives the agonist, what is negative the antagonist. Their
models run on what was really applied, so that limits wind nothing up.
"""

from __future__ import annotations

from typing import Any

import equinox as eqx
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from scpjax.control.analysis import side_systems
from scpjax.control.block import Block, sampled
from scpjax.control.controller import SUPPLY_V, Command, Controller, Scalar, check_number, scalar
from scpjax.control.plant import Plant
from scpjax.control.strategies import inverse_plant


def split(net: Scalar, high: Scalar, sides: int) -> tuple[Command, Scalar]:
    """Commands of a net effort [V^2], and the net effort that the limits leave of it."""
    asked = (net, -net)[:sides]
    effort = tuple(jnp.clip(u, 0.0, high) for u in asked)
    return Command(effort, asked), effort[0] - (effort[1] if sides == 2 else 0.0)


class LQI(Controller):
    """``v = -K x - k_i z`` with the state x from an observer and z the integral of the error.

    ``x' = a x + b v + l (y - c x)``; the integral stands still while the limits are reached and it would push on.
    """

    block: Block
    feedback: Float[Array, " n"]
    integral: Array
    observer: Float[Array, " n"]
    high: Array = eqx.field(converter=scalar)
    count: int = eqx.field(static=True)

    @property
    def sides(self) -> int:
        return self.count

    def initial(self) -> tuple[Array, Scalar]:
        return self.block.initial(), jnp.zeros(())

    def step(
        self, state: tuple[Array, Scalar], measurement: Scalar, reference: Scalar, dt: Scalar
    ) -> tuple[tuple[Array, Scalar], Command]:
        x, z = state
        error = reference - measurement
        net = -(self.feedback @ x) - self.integral * z
        command, applied = split(net, self.high, self.count)
        push = dt * error
        z = z + jnp.where((applied != net) & (-self.integral * push * net > 0), 0.0, push)
        b = self.block
        x = b.a @ x + b.b * applied + self.observer * (measurement - b.c @ x)
        return (x, z), command


def design_lqi(
    plant: Plant,
    *,
    dt: float,
    error: float = 1.0,
    integral: float = 100.0,
    effort: float = 1e-6,
    noise: float = 1e-3,
    high: float = SUPPLY_V**2,
) -> LQI:
    """LQI for a plant linearised at rest, with weights of the squared angle [rad], its integral and the net effort.

    ``noise`` is how large the sensor's variance [rad^2] is held to be beside that of an effort of 1 V^2: small means
    a quick observer. Gains by python-control's `dlqr` and `dlqe`.

    **Raises** `ControlError` for weights that are not positive.
    """
    import control

    for name, value in (("error", error), ("integral", integral), ("effort", effort), ("noise", noise)):
        check_number(value, name, positive=True)
    block = sampled(side_systems(plant)[0], dt, "zoh")
    a, b, c = (np.asarray(m, float) for m in (block.a, block.b, block.c))
    n = len(b)
    whole = np.block([[a, np.zeros((n, 1))], [-dt * c[None], np.ones((1, 1))]])
    drive = np.concatenate([b, [0.0]])[:, None]
    weight = np.zeros((n + 1, n + 1))
    weight[:n, :n] = error * np.outer(c, c)
    weight[n, n] = integral
    gain = np.asarray(control.dlqr(whole, drive, weight, [[effort]])[0])[0]
    observer = np.asarray(control.dlqe(a, b[:, None], c[None], [[1.0]], [[noise]])[0])[:, 0]
    return LQI(
        block=block,
        feedback=jnp.asarray(gain[:n]),
        integral=jnp.asarray(gain[n]),
        observer=jnp.asarray(a @ observer),
        high=high,
        count=plant.sides,
    )


class IMC(Controller):
    """Internal-model control: the inverse of the plant behind a low-pass acts on the reference less what the model
    does not explain (Garcia, Morari, Ind. Eng. Chem. Process Des. Dev. 21 (1982) 308)."""

    model: Block
    inverse: Block
    high: Array = eqx.field(converter=scalar)
    count: int = eqx.field(static=True)

    @property
    def sides(self) -> int:
        return self.count

    def initial(self) -> tuple[Array, Array]:
        return self.model.initial(), self.inverse.initial()

    def step(
        self, state: tuple[Array, Array], measurement: Scalar, reference: Scalar, dt: Scalar
    ) -> tuple[tuple[Array, Array], Command]:
        x, memory = state
        unexplained = measurement - self.model.c @ x
        memory, net = self.inverse.step(memory, reference - unexplained)
        command, applied = split(net, self.high, self.count)
        return (self.model.step(x, applied)[0], memory), command


def design_imc(plant: Plant, *, dt: float, corner: float = 2.0, high: float = SUPPLY_V**2) -> IMC:
    """IMC for a plant linearised at rest, with a low-pass of that ``corner`` [rad/s] as its closed loop."""
    model: Any = sampled(side_systems(plant)[0], dt, "zoh")
    return IMC(model=model, inverse=inverse_plant(plant, corner=corner, dt=dt), high=high, count=plant.sides)
