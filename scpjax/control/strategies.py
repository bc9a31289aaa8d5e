"""The alternatives of thesis 3.4.2 and 4.4.2: switching, scheduling, feedforward, a series compensator.

Those with a filter inside are designed for one plant and one sampling period by the functions at the end.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Any, NamedTuple

import equinox as eqx
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array

from scpjax.control.analysis import pid_transfer, side_systems
from scpjax.control.block import Block, sampled
from scpjax.control.controller import Command, Controller, Scalar, check_number, scalar
from scpjax.control.errors import ControlError
from scpjax.control.loop import Loop
from scpjax.control.pid import PID, Pair, PIDState
from scpjax.control.plant import Plant

if TYPE_CHECKING:
    import control

Pairs = tuple[PIDState, PIDState]


class Direction(NamedTuple):
    """The reference of the sample before, and which way it last went: 1, -1, or 0 before it moved."""

    reference: Scalar
    way: Scalar


def _turn(before: Direction, reference: Scalar) -> Direction:
    moved = reference - before.reference
    return Direction(reference, jnp.where(moved > 0, 1.0, jnp.where(moved < 0, -1.0, before.way)))


class SwitchedPair(Controller):
    """Only the actuator that turns the joint the way the reference goes is driven (thesis 3.4.2).

    While the reference rests, the one that was driven last stays on; before it first moves, both are.
    """

    pair: Pair

    @property
    def sides(self) -> int:
        return 2

    def initial(self) -> tuple[Pairs, Direction]:
        return self.pair.initial(), Direction(jnp.zeros(()), jnp.zeros(()))

    def step(
        self, state: tuple[Pairs, Direction], measurement: Scalar, reference: Scalar, dt: Scalar
    ) -> tuple[tuple[Pairs, Direction], Command]:
        inner, before = state
        direction = _turn(before, reference)
        inner, command = self.pair.step(inner, measurement, reference, dt)
        up, down = direction.way >= 0, direction.way <= 0
        on = (jnp.where(up, 1.0, 0.0), jnp.where(down, 1.0, 0.0))
        effort = tuple(u * o for u, o in zip(command.effort, on, strict=True))
        return (inner, direction), Command(effort, command.asked)


class ScheduledPair(Controller):
    """Gains of a side are zero while the reference goes the other way (the LPV scheme of thesis 3.4.2).

    Its integral then stands still, and the voltage with it.
    """

    pair: Pair

    @property
    def sides(self) -> int:
        return 2

    def initial(self) -> tuple[Pairs, Direction]:
        return self.pair.initial(), Direction(jnp.zeros(()), jnp.zeros(()))

    def step(
        self, state: tuple[Pairs, Direction], measurement: Scalar, reference: Scalar, dt: Scalar
    ) -> tuple[tuple[Pairs, Direction], Command]:
        inner, before = state
        direction = _turn(before, reference)
        shares = (jnp.where(direction.way >= 0, 1.0, 0.0), jnp.where(direction.way <= 0, 1.0, 0.0))
        scaled = [_with_share(p, s) for p, s in zip((self.pair.agonist, self.pair.antagonist), shares, strict=True)]
        inner, command = Pair(*scaled).step(inner, measurement, reference, dt)
        return (inner, direction), command


def _with_share(pid: PID, share: Scalar) -> PID:
    return eqx.tree_at(lambda p: (p.kp, p.ki, p.kd), pid, (pid.kp * share, pid.ki * share, pid.kd * share))


class FeedforwardPair(Controller):
    """Adds a ``share`` of what the inverse of the plant asks for to both commands, before their limits (3.4.2)."""

    pair: Pair
    inverse: Block
    share: Array = eqx.field(converter=scalar, default=1.0)

    @property
    def sides(self) -> int:
        return 2

    def initial(self) -> tuple[Pairs, Array]:
        return self.pair.initial(), self.inverse.initial()

    def step(
        self, state: tuple[Pairs, Array], measurement: Scalar, reference: Scalar, dt: Scalar
    ) -> tuple[tuple[Pairs, Array], Command]:
        inner, memory = state
        memory, feed = self.inverse.step(memory, reference)
        inner, command = self.pair.step(inner, measurement, reference, dt, self.share * feed)
        return (inner, memory), command


class CompensatedPair(Controller):
    """A filter between the error and both controllers: the series compensator of thesis 4.4.2."""

    pair: Pair
    compensator: Block

    @property
    def sides(self) -> int:
        return 2

    def initial(self) -> tuple[Pairs, Array]:
        return self.pair.initial(), self.compensator.initial()

    def step(
        self, state: tuple[Pairs, Array], measurement: Scalar, reference: Scalar, dt: Scalar
    ) -> tuple[tuple[Pairs, Array], Command]:
        inner, memory = state
        memory, error = self.compensator.step(memory, reference - measurement)
        inner, command = self.pair.step(inner, jnp.zeros_like(measurement), error, dt)
        return (inner, memory), command


# -- designs ---------------------------------------------------------------------------------------------------------


def plant_polynomials(plant: Plant) -> tuple[np.ndarray, np.ndarray]:
    """Numerator and denominator from the agonist's effort [V^2] to the position [rad]."""
    import control

    found = control.ss2tf(side_systems(plant)[0])
    numerator, denominator = np.real(found.num[0][0]), np.real(found.den[0][0])
    numerator = np.where(np.abs(numerator) > 1e-9 * np.max(np.abs(numerator)), numerator, 0.0)
    return np.trim_zeros(numerator, "f"), denominator


def inverse_plant(plant: Plant, *, corner: float, dt: float) -> Block:
    """Inverse of the agonist's side behind a low-pass of that ``corner`` [rad/s] and just enough order.

    **Raises** `ControlError` for a plant whose zeros would make it unstable.
    """
    import control

    check_number(corner, "the corner", positive=True)
    numerator, denominator = plant_polynomials(plant)
    order = len(denominator) - len(numerator)
    low_pass = np.real(np.poly([-corner] * order)) / corner**order
    return sampled(control.TransferFunction(denominator, np.polymul(numerator, low_pass)), dt)


def series_compensator(loop: Loop, *, bandwidth: float = 30.0, dt: float) -> Block:
    """Fourth-order compensator that brings the closed loop of a pair to a ``bandwidth`` [rad/s], about.

    The thesis says 5 Hz and does not print its compensator. This one puts zeros on the plant's poles and the
    derivative filter, poles on the controller's zeros and two far out, so that the open loop is
    ``k / (s (1 + s/p)^2)`` with p five times its crossover.

    **Raises** `ControlError` for a controller that is no pair and a plant that has not three poles and no zero.
    """
    if not isinstance(loop.controller, Pair):
        raise ControlError("the compensator is made for a pair", mend="give the loop a Pair")
    return sampled(compensator_system(loop, loop.controller.agonist, bandwidth), dt)


def compensator_system(loop: Loop, pid: PID, bandwidth: float) -> control.TransferFunction:
    """The same as a continuous system."""
    import control

    check_number(bandwidth, "the bandwidth", positive=True)
    numerator, denominator = plant_polynomials(loop.plant)
    if len(numerator) != 1 or len(denominator) != 4:
        raise ControlError("the plant has not three poles and no zero", mend="use a plant of (3.14)")
    crossover = bandwidth / _bandwidth_in_crossovers()
    far = _FAR * crossover
    gain = crossover * (1 + (crossover / far) ** 2)
    lag = np.polymul([1 / far, 1], [1 / far, 1])
    zeros = np.polymul(denominator, [1.0, float(pid.n)])
    poles = np.polymul(np.asarray(pid_transfer(pid).num[0][0]), lag)
    both = 2 * numerator[0]  # sides at work, thesis (4.14)
    return control.TransferFunction(gain / both * zeros, poles)


_FAR = 5.0  # where the last two poles of the open loop lie, in crossovers


def _bandwidth_in_crossovers() -> float:
    """Where the closed loop of k / (s (1 + s/p)^2) has fallen by 3 dB, in units of its crossover."""
    from scipy.optimize import brentq

    def above(x: float) -> float:
        loop = (1 + _FAR**-2) / (1j * x * (1 + 1j * x / _FAR) ** 2)
        return abs(loop / (1 + loop)) - 10 ** (-3 / 20)

    root: Any = brentq(above, 1.0, _FAR)
    return float(root)
