"""Loops as python-control systems: thesis (4.12)-(4.15), margins, step figures, bandwidth, sensitivity.

Saturation and anti-windup are left out (thesis 4.4.2): both controllers of a pair are taken to be at work, so the
loop gain is that of the two together, (4.14). A nonlinear model is linearised about an operating point by autodiff
(`scpjax.control.operating`). A dead time of the drive is exact in `loop_response` and `sensitivity_peak`, in systems
of python-control it is a Padé approximation of order 5.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Complex, Float

from scpjax.control.controller import Controller, Scalar
from scpjax.control.errors import ControlError
from scpjax.control.loop import Loop
from scpjax.control.metrics import StepFigures, figures_of
from scpjax.control.operating import dead_times, linear_parts
from scpjax.control.pid import PID, Pair
from scpjax.control.plant import Plant
from scpjax.control.state_space import minimal_polynomials

if TYPE_CHECKING:
    import control


def controllers(controller: Controller) -> tuple[PID, ...]:
    """The PIDs of a controller, side by side. **Raises** `ControlError` where it is made of something else."""
    if isinstance(controller, Pair):
        return controller.agonist, controller.antagonist
    if isinstance(controller, PID):
        return (controller,)
    raise ControlError(f"{type(controller).__name__} is no PID or Pair", mend="analyse the PID inside it")


def pid_transfer(pid: PID) -> control.TransferFunction:
    """Controller, error [rad] to command [V^2], thesis (4.13)."""
    import control

    kp, ki, kd, n = (float(v) for v in (pid.kp, pid.ki, pid.kd, pid.n))
    return control.TransferFunction([kp + kd * n, ki + n * kp, n * ki], [1.0, n, 0.0])


def side_systems(plant: Plant, effort: Float[Array, " sides"] | None = None) -> list[control.StateSpace]:
    """Linear systems from the effort of each side [V^2] to the position [rad], about an operating point."""
    import control

    systems = []
    for (a, b, c), delay in zip(linear_parts(plant, effort), dead_times(plant), strict=True):
        system = control.StateSpace(np.asarray(a), np.asarray(b)[:, None], np.asarray(c)[None], [[0.0]])
        if float(delay) > 0:
            system = control.series(control.tf2ss(*control.pade(float(delay), _PADE)), system)
        systems.append(system)
    return systems


_PADE = 5  # order


def open_loop(loop: Loop, effort: Float[Array, " sides"] | None = None) -> control.StateSpace:
    """Open loop, reference to angle, thesis (4.14): the sum over sides of controller times plant."""
    import control

    pids = controllers(loop.controller)
    systems = side_systems(loop.plant, effort)
    total = None
    for pid, system in zip(pids, systems, strict=True):
        branch = control.series(control.tf2ss(pid_transfer(pid)), system)
        total = branch if total is None else control.parallel(total, branch)
    if total is None:
        raise ControlError("a loop without sides", mend="give it a plant")
    return total


def closed_loop(loop: Loop, effort: Float[Array, " sides"] | None = None) -> control.StateSpace:
    """Closed loop, reference to angle, thesis (4.15)."""
    import control

    closed: Any = control.feedback(open_loop(loop, effort), 1)
    return closed


@dataclass(frozen=True, kw_only=True)
class LoopFigures:
    """Linear figures of a loop; NaN where the closed loop is unstable.

    ``gain_margin`` [share], ``phase_margin`` [rad], ``bandwidth`` [rad/s] (-3 dB of the closed loop),
    ``sensitivity`` (greatest \\|1 / (1 + L)\\|), ``poles`` of the closed loop [1/s].
    """

    stable: bool
    gain_margin: float
    phase_margin: float
    bandwidth: float
    sensitivity: float
    step: StepFigures | None
    poles: np.ndarray

    @property
    def gain_margin_dB(self) -> float:
        """Gain margin in decibel."""
        return 20 * math.log10(self.gain_margin) if self.gain_margin > 0 else math.nan


def figures(loop: Loop, effort: Float[Array, " sides"] | None = None) -> LoopFigures:
    """Margins, bandwidth, sensitivity and step figures of a loop by python-control.

    **Raises** `ControlError` for a controller that is no PID or Pair.
    """
    import control

    open_, closed = _transfers(loop, effort)
    poles = np.asarray(closed.poles(), dtype=np.complex128)
    stable = bool(np.all(poles.real < 0))
    gain, phase, *_ = control.margin(open_)
    if not stable:
        bad = math.nan
        return LoopFigures(
            stable=False, gain_margin=float(gain), phase_margin=math.radians(float(phase)), bandwidth=bad,
            sensitivity=bad, step=None, poles=poles,
        )  # fmt: skip
    step = _step_of(closed)
    return LoopFigures(
        stable=True,
        gain_margin=float(gain),
        phase_margin=math.radians(float(phase)),
        bandwidth=_bandwidth_of(closed, poles),
        sensitivity=float(sensitivity_peak(loop, effort=effort)),
        step=step,
        poles=poles,
    )


def _transfers(
    loop: Loop, effort: Float[Array, " sides"] | None
) -> tuple[control.TransferFunction, control.TransferFunction]:
    """(4.14) and (4.15) without what two like branches have twice, so that figures see each mode once.

    All controllers integrate: 1/s stands before the sum, and branches with the same other poles are added up.
    """
    import control

    branches: list[tuple[np.ndarray, np.ndarray]] = []
    for pid, system in zip(controllers(loop.controller), side_systems(loop.plant, effort), strict=True):
        a, b, c = (np.asarray(m, float) for m in (system.A, system.B, system.C))
        numerator, denominator = minimal_polynomials(a, b, c, 0.0)
        over = np.polymul(np.asarray(pid_transfer(pid).num[0][0], float), numerator)
        under = np.polymul([1.0, float(pid.n)], denominator)
        alike = [k for k, (_, u) in enumerate(branches) if u.shape == under.shape and np.allclose(u, under, rtol=1e-9)]
        if alike:
            branches[alike[0]] = np.polyadd(branches[alike[0]][0], over), under
        else:
            branches.append((over, under))
    top, bottom = np.zeros(1), np.array([1.0, 0.0])
    for k, (over, under) in enumerate(branches):
        bottom = np.polymul(bottom, under)
        for j, (_, other) in enumerate(branches):
            over = over if j == k else np.polymul(over, other)
        top = np.polyadd(top, over)
    if top[-1] == 0 and top.size > 1:  # no integral gain
        top, bottom = top[:-1], bottom[:-1]
    return control.TransferFunction(top, bottom), control.TransferFunction(top, np.polyadd(bottom, top))


def _bandwidth_of(closed: control.TransferFunction, poles: np.ndarray) -> float:
    """First frequency [rad/s] at which the gain is 3 dB below that at rest; infinite where it never is.

    On a grid that spans the poles: python-control's bisection does not find it for every loop.
    """
    sizes = np.abs(poles)
    omega = np.geomspace(1e-2 * sizes.min(), 1e2 * sizes.max(), 20_000)
    gain = np.abs(np.asarray(closed(1j * omega))) / abs(float(np.real(closed(0)))) - 10 ** (-3 / 20)
    below = np.flatnonzero(gain < 0)
    if not below.size or below[0] == 0:
        return math.inf if not below.size else float(omega[0])
    k = int(below[0])
    share = gain[k - 1] / (gain[k - 1] - gain[k])
    return float(omega[k - 1] * (omega[k] / omega[k - 1]) ** share)


def _step_of(closed: control.TransferFunction) -> StepFigures:
    """Step figures by python-control's `step_info` of the response at times that suit its slowest and fastest mode.

    The modes' sum is exact at any time; a uniform grid, which python-control takes by itself, cannot show a rise of a
    second before a tail of hours, as a small Ki makes it.
    """
    import control

    system: Any = control.ss(closed)
    modes, vectors = np.linalg.eig(np.asarray(system.A))
    weights = (np.asarray(system.C) @ vectors)[0] * np.linalg.solve(vectors, np.asarray(system.B))[:, 0] / modes
    rates = np.abs(np.real(modes))
    time = np.concatenate([[0.0], np.geomspace(1e-3 / np.abs(modes).max(), 12 / rates.min(), 40_000)])
    values = float(system.D[0, 0]) + np.real(np.expm1(np.outer(time, modes)) @ weights)
    final = float(system.D[0, 0]) - float(np.real(weights.sum()))
    return figures_of(control.step_info(values, T=time, yfinal=final))


_FREQUENCIES = np.geomspace(1e-3, 1e3, 1200)  # rad/s


def loop_response(
    loop: Loop, omega: Float[Array, " w"], effort: Float[Array, " sides"] | None = None
) -> Complex[Array, " w"]:
    """Open loop L(i omega), in jax: differentiable in gains and plants."""
    s = 1j * omega
    total = jnp.zeros(omega.shape, complex)
    parts = linear_parts(loop.plant, effort)
    for pid, (a, b, c), delay in zip(controllers(loop.controller), parts, dead_times(loop.plant), strict=True):
        over, under = _polynomials(a, b, c)
        plant = jnp.polyval(over.astype(complex), s) / jnp.polyval(under.astype(complex), s)
        total = total + jnp.exp(-s * delay) * plant * (pid.kp + pid.ki / s + pid.kd * pid.n * s / (s + pid.n))
    return total


def _polynomials(a: Array, b: Array, c: Array) -> tuple[Array, Array]:
    """Numerator and denominator of c (s - a)^-1 b by the method of Faddeev and Le Verrier; differentiable.

    For the few states of these plants it is a thousandth of the work of a solution at every frequency.
    """
    n = a.shape[0]
    eye = jnp.eye(n, dtype=a.dtype)
    matrix, over, under = eye, [c @ b], [jnp.ones((), a.dtype)]
    for k in range(1, n + 1):
        product = a @ matrix
        under.append(-jnp.trace(product) / k)
        matrix = product + under[-1] * eye
        over.append(c @ matrix @ b)
    return jnp.stack(over[:n]), jnp.stack(under)


def sensitivity_peak(loop: Loop, *, effort: Float[Array, " sides"] | None = None) -> Scalar:
    """Greatest absolute value of 1 / (1 + L(i omega)); its inverse is the distance of L from -1. Differentiable.

    An unstable loop has none; `UNSTABLE` stands for it. Stability is told by how often L goes round -1 (Nyquist), so
    it takes a plant that is stable by itself.
    """
    apart = 1 + loop_response(loop, jnp.asarray(_FREQUENCIES), effort)
    turned = jnp.angle(apart[0]) + jnp.sum(jnp.angle(apart[1:] / apart[:-1]))
    stable = jnp.abs(jax.lax.stop_gradient(turned)) < jnp.pi
    return jnp.where(stable, jnp.max(1 / jnp.abs(apart)), UNSTABLE)


UNSTABLE = 1e3
"""What `sensitivity_peak` gives for an unstable loop."""
