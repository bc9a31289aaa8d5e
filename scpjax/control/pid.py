"""Parallel PID with filtered derivative, saturation and anti-windup: thesis (3.16)-(3.18), section 3.4.1."""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import Any, Literal, NamedTuple, get_args

import equinox as eqx
import jax.numpy as jnp
from jaxtyping import Array

from scpjax.control.controller import SUPPLY_V, Command, Controller, Scalar, check_number, known, scalar
from scpjax.control.errors import ControlError
from scpjax.recordings.thesis import TABLE_3_7

Form = Literal["forward_euler", "backward_euler", "tustin"]
AntiWindup = Literal["clamping", "back_calculation", "none"]
_SHARE = {"forward_euler": 0.0, "backward_euler": 1.0, "tustin": 0.5}  # of the newest sample in both integrals
DEGREE = math.pi / 180


class PIDState(NamedTuple):
    """``integral`` is the I term [V^2], ``filtered`` the filter's integral: the part of Kd e that has passed it."""

    integral: Scalar
    filtered: Scalar


class PID(Controller):
    """``u_c = Kp e + I + D`` limited to ``low..high`` [V^2].

    ``dI/dt = Ki e`` and ``D = N (Kd e - F)``, ``dF/dt = D``: the derivative behind a first-order low-pass of corner
    ``n`` [rad/s], thesis (4.12). Gains are in SI, V^2/rad for an angle; `per_degree` takes those of the thesis.

    - ``form``: how both integrals are taken over a sample; forward Euler is what the thesis's discrete PID does.
    - ``anti_windup``: ``clamping`` stops the integral while the command is limited and the integral would drive it
      further, (3.17); ``back_calculation`` leads the excess back with the rate ``tracking`` [1/s].
      (3.17) compares the sign of the error with that of the command. For the antagonist, whose gains are negative,
      that would let its integral run away and hold it where it should return; here the sign of ``Ki e`` stands for
      that of the error, which is the same for the agonist.
    - ``reference_weight``, ``derivative_weight``: shares of the reference that the P and the D term see; with
      ``derivative_weight = 0`` the derivative is that of the measurement.

    **Raises** `ControlError` for gains or limits that are not finite, a filter that is not positive and limits that
    are not in order.
    """

    kp: Array = eqx.field(converter=scalar)
    ki: Array = eqx.field(converter=scalar)
    kd: Array = eqx.field(converter=scalar)
    n: Array = eqx.field(converter=scalar)
    low: Array = eqx.field(converter=scalar)
    high: Array = eqx.field(converter=scalar)
    reference_weight: Array = eqx.field(converter=scalar)
    derivative_weight: Array = eqx.field(converter=scalar)
    tracking: Array = eqx.field(converter=scalar)
    form: Form = eqx.field(static=True)
    anti_windup: AntiWindup = eqx.field(static=True)

    def __init__(
        self,
        kp: Any,
        ki: Any = 0.0,
        kd: Any = 0.0,
        n: Any = 10.0,
        *,
        low: Any = 0.0,
        high: Any = SUPPLY_V**2,
        reference_weight: Any = 1.0,
        derivative_weight: Any = 1.0,
        tracking: Any = 1.0,
        form: Form = "forward_euler",
        anti_windup: AntiWindup = "clamping",
    ):
        self.kp, self.ki, self.kd, self.n = kp, ki, kd, n
        self.low, self.high = low, high
        self.reference_weight, self.derivative_weight, self.tracking = reference_weight, derivative_weight, tracking
        self.form, self.anti_windup = form, anti_windup

    def __check_init__(self) -> None:
        for name, value in (("Kp", self.kp), ("Ki", self.ki), ("Kd", self.kd)):
            check_number(value, name)
        check_number(self.n, "the filter coefficient N", positive=True)
        check_number(self.tracking, "tracking", not_negative=True)
        for name in ("reference_weight", "derivative_weight"):
            check_number(getattr(self, name), name)
        low, high = known(self.low), known(self.high)
        if low is not None and high is not None and not (low < high).all():
            raise ControlError(f"the limits {low:g} to {high:g} V^2 are not in order", mend="low must be below high")
        for name, value, words in (("form", self.form, Form), ("anti_windup", self.anti_windup, AntiWindup)):
            if value not in get_args(words):
                raise ControlError(f"no {name} {value!r}", mend=f"use one of {', '.join(get_args(words))}")

    @classmethod
    def per_degree(cls, kp: Any, ki: Any = 0.0, kd: Any = 0.0, n: Any = 10.0, **options: Any) -> PID:
        """Gains in V^2 per degree, per degree second and so on, as in Table 3.7."""
        p, i, d = (scalar(g) / DEGREE for g in (kp, ki, kd))
        return cls(p, i, d, n, **options)

    @property
    def sides(self) -> int:
        return 1

    @property
    def gains(self) -> Mapping[str, Array]:
        """Kp, Ki, Kd in V^2 per degree and N [rad/s], as in gains.toml."""
        return {"Kp": self.kp * DEGREE, "Ki": self.ki * DEGREE, "Kd": self.kd * DEGREE, "N": self.n}

    def opposite(self) -> PID:
        """The same controller with opposite gains: the antagonist of Table 3.7."""
        return eqx.tree_at(lambda c: (c.kp, c.ki, c.kd), self, (-self.kp, -self.ki, -self.kd))

    def initial(self) -> PIDState:
        return PIDState(jnp.zeros_like(self.kp), jnp.zeros_like(self.kp))

    def step(
        self, state: PIDState, measurement: Scalar, reference: Scalar, dt: Scalar, feed: Scalar | float = 0.0
    ) -> tuple[PIDState, Command]:
        """One sample; ``feed`` [V^2] is added to the command before its limits (feedforward)."""
        share = _SHARE[self.form]
        error = reference - measurement
        push = dt * self.ki * error
        derivative = self._derivative(state, measurement, reference) / (1.0 + share * self.n * dt)
        proportional = self.kp * (self.reference_weight * reference - measurement)
        asked = proportional + (state.integral + share * push) + derivative + feed
        effort = jnp.clip(asked, self.low, self.high)
        if self.anti_windup == "clamping":
            integral = state.integral + jnp.where((asked != effort) & (push * asked > 0), 0.0, push)
        elif self.anti_windup == "back_calculation":
            integral = state.integral + push + dt * self.tracking * (effort - asked)
        else:
            integral = state.integral + push
        return PIDState(integral, state.filtered + dt * derivative), Command((effort,), (asked,))

    def rates(self, state: PIDState, measurement: Scalar, reference: Scalar) -> tuple[PIDState, Command]:
        """Continuous form: time derivatives of the state and the command, thesis (3.16)-(3.18)."""
        if self.form != "forward_euler":
            raise ControlError(f"the form {self.form} has no rates", mend="use form='forward_euler'")
        moved, command = self.step(state, measurement, reference, jnp.ones_like(self.kp))
        return PIDState(*(after - before for after, before in zip(moved, state, strict=True))), command

    def _derivative(self, state: PIDState, measurement: Scalar, reference: Scalar) -> Scalar:
        return self.n * (self.kd * (self.derivative_weight * reference - measurement) - state.filtered)


def check_sampling(controller: Controller, dt: float) -> None:
    """Refuse a derivative filter that blows up by itself at samples every ``dt`` [s]: by forward Euler
    F' = (1 - N dt) F + ..., which grows from N dt = 2 on. **Raises** `ControlError`.
    """
    for pid in (controller.agonist, controller.antagonist) if isinstance(controller, Pair) else (controller,):
        if isinstance(pid, PID) and pid.form == "forward_euler" and float(pid.kd) != 0 and float(pid.n) * dt >= 2:
            raise ControlError(
                f"N = {float(pid.n):g} rad/s with a sample every {dt:g} s: the filter of the derivative blows up",
                mend=f"take N below {2 / dt:g}, a shorter dt, or form = 'tustin'",
            )


class Pair(Controller):
    """Agonist and antagonist, each with its own controller, both always at work (thesis 3.4.1, Figure 3.12)."""

    agonist: PID
    antagonist: PID

    def __init__(self, agonist: PID, antagonist: PID | None = None):
        """The antagonist has opposite gains when not given."""
        self.agonist = agonist
        self.antagonist = agonist.opposite() if antagonist is None else antagonist

    @property
    def sides(self) -> int:
        return 2

    def initial(self) -> tuple[PIDState, PIDState]:
        return self.agonist.initial(), self.antagonist.initial()

    def step(
        self,
        state: tuple[PIDState, PIDState],
        measurement: Scalar,
        reference: Scalar,
        dt: Scalar,
        feed: Scalar | float = 0.0,
    ) -> tuple[tuple[PIDState, PIDState], Command]:
        """One sample; ``feed`` [V^2] goes to the agonist and its opposite to the antagonist."""
        first, one = self.agonist.step(state[0], measurement, reference, dt, feed)
        second, two = self.antagonist.step(state[1], measurement, reference, dt, -feed)
        return (first, second), Command(one.effort + two.effort, one.asked + two.asked)


def thesis_pair(**options: Any) -> Pair:
    """The controllers of Table 3.7."""
    row = TABLE_3_7.rows[0]
    return Pair(PID.per_degree(row.Kp, row.Ki, row.Kd, row.N, **options))
