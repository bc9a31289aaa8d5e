"""Is the loop stable, and can it get where it is asked to? In words, before figures that would mean nothing."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Literal

import jax
import numpy as np
from jaxtyping import Float

from scpjax.control.errors import ControlError
from scpjax.control.loop import Loop, Response, run
from scpjax.control.operating import reach
from scpjax.control.pid import PID, Pair

Stability = Literal["stable", "oscillates", "diverges"]
_LONGEST = 30_000  # samples
_TURNS = 25.0  # of the slowest time constant
_STILL = 0.05  # of the step: what may remain of a swing
_QUIET = 0.002  # of the step: what is not worth a word


@dataclass(frozen=True)
class Verdict:
    """``stability`` of the loop, its ``reach`` (low, high) [rad], whether the reference is ``within`` it; in words."""

    stability: Stability
    reach: tuple[float, float]
    within: bool
    says: tuple[str, ...]

    @property
    def good(self) -> bool:
        """Stable, and the reference can be reached."""
        return self.stability == "stable" and self.within


def judge(loop: Loop, reference: Float[np.ndarray, " n"], *, dt: float = 0.02) -> Verdict:
    """Judge a loop on its way to a constant angle, with all its limits, and whether a reference [rad] can be reached.

    A loop whose swing does not die out, though the plant's slowest time constant has passed 25 times, oscillates.
    """
    low, high = _reach(loop)
    target = 0.5 * min(float(np.max(np.abs(reference))), high) or 0.5 * high
    stability, period, swing = settle(loop, target, dt=dt)
    top, bottom = float(np.max(reference)), float(np.min(reference))
    within = top <= high and bottom >= low
    says = []
    if stability == "diverges":
        says.append("The loop is unstable: its angle grows without bound.")
    if stability == "oscillates":
        every = f" about every {period:.2g} s" if math.isfinite(period) else ""
        says.append(f"The loop is unstable: at a constant reference it keeps swinging{every}; lower Kp, Ki or Kd.")
    if stability == "stable" and swing > _QUIET * abs(target):
        says.append(
            f"A swing of {math.degrees(swing):.2g} deg never dies out at a constant reference: the voltages go to and "
            "fro between their limits; a bound on the sensitivity peak gives a calmer loop."
        )
    if not within:
        says.append(
            f"The reference runs from {math.degrees(bottom):.1f} to {math.degrees(top):.1f} deg, out of reach: "
            f"the joint comes to rest between {math.degrees(low):.1f} and {math.degrees(high):.1f} deg at full drive."
        )
    return Verdict(stability, (low, high), within, tuple(says))


def settle(loop: Loop, target: float, *, dt: float = 0.02) -> tuple[Stability, float, float]:
    """Stability of the loop at a constant reference [rad]; period [s] and size [rad] of what goes on swinging."""
    slowest = 0.0
    for model in loop.plant.models():
        rates = np.abs(np.linalg.eigvals(np.asarray(model.linearise()[0])).real)
        slowest = max(slowest, float(np.max(1 / rates[rates > 1e-6], initial=0.0)))
    n = int(np.clip(_TURNS * (slowest or 10.0) / dt, 1000, _LONGEST))
    angle = np.asarray(jax.jit(lambda m, r: run(m, r, dt=dt).angle)(loop, np.full(n, target)))
    if not np.all(np.isfinite(angle)) or np.max(np.abs(angle)) > 1e3 * abs(target):
        return "diverges", math.nan, math.inf
    third, last = angle[n // 2 : 3 * n // 4], angle[3 * n // 4 :]
    swing = float(np.ptp(last))
    above = last > (last.max() + last.min()) / 2
    rises = np.flatnonzero(above[1:] & ~above[:-1])
    if len(rises) < 2 or swing < 0.5 * np.ptp(third):
        return "stable", math.nan, 0.0
    period = float(np.mean(np.diff(rises)) * dt)
    return ("oscillates" if swing > _STILL * abs(target) else "stable"), period, swing


def _reach(loop: Loop) -> tuple[float, float]:
    pid = loop.controller.agonist if isinstance(loop.controller, Pair) else loop.controller
    high = pid.high if isinstance(pid, PID) else 3.7**2
    return reach(loop.plant, high)


def check_finite(response: Response) -> None:
    """Refuse a response that left the numbers. **Raises** `ControlError` that says when."""
    angle = np.asarray(response.angle)
    bad = ~np.isfinite(angle)
    if bad.any():
        when = float(response.time[int(np.argmax(bad))])
        raise ControlError(f"the loop is unstable: its angle is not finite from {when:g} s on", mend="lower the gains")
