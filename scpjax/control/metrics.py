"""What a response is worth: errors as in thesis 4.4.3, step figures, effort, energy, temperature, saturation."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, fields
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from scpjax.control.errors import ControlError
from scpjax.control.loop import Loop, Response
from scpjax.physics.balances import Balances

DEGREES = 180 / math.pi


def rmse(error: Float[Array, " n"]) -> Float[Array, ""]:
    """Root of the mean squared error, in its unit."""
    return jnp.sqrt(jnp.mean(error**2))


def mae(error: Float[Array, " n"]) -> Float[Array, ""]:
    """Mean absolute error, in its unit."""
    return jnp.mean(jnp.abs(error))


@dataclass(frozen=True, kw_only=True)
class Metrics:
    """Figures of one response. Angles [rad], times [s], efforts [V^2]; those that it has not are NaN.

    - ``peak_error``: greatest reference less greatest angle; negative where the angle goes beyond.
    - ``delay``: the time of the greatest reference less that of the greatest angle, within one period: negative for a
      lag, as in Table 4.15; ``phase`` is the same as an angle of the period [rad].
    - ``section_error``: largest difference of the extremes of reference and angle over equivalent sections.
    - ``effort``: mean over time of the sum over sides; ``energy`` [J] into the wires; ``hottest`` [K].
    - ``saturated``: share of the time in which some command lay above what the drive can give.
    """

    rmse: float
    mae: float
    max_error: float
    section_error: float
    peak_error: float
    delay: float
    phase: float
    effort: float
    energy: float
    hottest: float
    saturated: float


def measure(
    response: Response, *, loop: Loop | None = None, section: float | None = None, skip: float = 0.0
) -> Metrics:
    """Figures of a response.

    ``section`` [s] is the length of equivalent sections (half a period of a sine, one level of a stair): the period
    is twice that. ``skip`` [s] at the beginning is left out of ``section_error``, as in Table 4.16. Without ``loop``
    there is no energy.
    """
    error = np.asarray(response.error)
    time, reference, angle = (np.asarray(v) for v in (response.time, response.reference, response.angle))
    effort, asked = np.asarray(response.effort), np.asarray(response.asked)
    temperature = np.asarray(response.temperature)
    period = None if section is None else 2 * section
    peak, delay = peak_of(time, reference, angle, period) if period else (math.nan, math.nan)
    return Metrics(
        rmse=float(np.sqrt(np.mean(error**2))),
        mae=float(np.mean(np.abs(error))),
        max_error=float(np.max(np.abs(error))),
        section_error=math.nan if section is None else section_error(time, reference, angle, section, skip=skip),
        peak_error=peak,
        delay=delay,
        phase=2 * math.pi * delay / period if period else math.nan,
        effort=float(np.mean(effort.sum(axis=1))),
        energy=math.nan if loop is None else float(energy(loop, response)),
        hottest=float(temperature.max()) if temperature.size else math.nan,
        saturated=float(np.mean(np.any(asked > effort, axis=1))),
    )


def peak_of(
    time: Float[np.ndarray, " n"], reference: Float[np.ndarray, " n"], angle: Float[np.ndarray, " n"], period: float
) -> tuple[float, float]:
    """(greatest reference - greatest angle, its time - the angle's), the latter between 0 and minus one period.

    Of all periods the one with the greatest angle counts: with that rule all rows of Table 4.15 come out.
    """
    at = int(np.argmax(angle))
    before = (time <= time[at] + 1e-9) & (time > time[at] - period + 1e-9)
    top = int(np.flatnonzero(before)[np.argmax(reference[before])])
    return float(reference.max() - angle.max()), float(time[top] - time[at])


def section_error(
    time: Float[np.ndarray, " n"],
    reference: Float[np.ndarray, " n"],
    angle: Float[np.ndarray, " n"],
    section: float,
    *,
    skip: float = 0.0,
) -> float:
    """Largest difference between the extremes of reference and angle, section by section.

    In each section the extreme on that side counts to which the reference moved: up from the mean of the section
    before it (from 0 for the first) the greatest value, down the least; both where the mean is the same. A last
    section that the end cuts off counts where the angle has its extreme before the end: it is on its way back.
    """
    index = ((time - time[0]) / section + 1e-9).astype(int)
    worst, before, size = 0.0, 0.0, float(np.ptp(reference))
    for i in range(index[-1] + 1):
        inside = (index == i) & (time - time[0] >= skip)
        if inside.sum() < 2:
            continue
        cut = time[index == i][-1] - time[0] < (i + 1) * section - 1.5 * (time[1] - time[0])
        mean = float(reference[index == i].mean())
        moved = mean - before
        extremes = (np.max, np.min) if abs(moved) < 1e-3 * size else (np.max,) if moved > 0 else (np.min,)
        for extreme in extremes:
            if cut and angle[inside][-1] == extreme(angle[inside]):
                continue
            worst = max(worst, abs(float(extreme(reference[inside]) - extreme(angle[inside]))))
        before = mean
    return worst


def energy(loop: Loop, response: Response) -> Float[Array, ""]:
    """Energy [J] into the wires: the models' electric power under the efforts applied, at the states' temperatures.

    Power is that of the mean voltage; a PWM drive that switches a battery of V_s draws V_s / V as much (thesis 3.3.5
    handles PWM values as mean voltages).
    """
    return jnp.sum(power(loop, response)) * (response.time[1] - response.time[0])


def power(loop: Loop, response: Response) -> Float[Array, " n"]:
    """Electric power [W] of all sides at every sample."""
    total = jnp.zeros_like(response.time)
    at = 0
    for model in loop.plant.models():
        sides = len(model.structure.sides)
        columns = slice(at, at + sides)
        at += sides
        if not model.structure.thermal:
            continue
        warm = response.temperature[:, columns] - model.ambient
        balances, n = model.balances(), model.structure.n_states
        rest = jnp.zeros(n - sides)

        def of(t: Array, u: Array, balances: Balances = balances, rest: Array = rest) -> Array:
            return balances.heat_flows(list(jnp.concatenate([t, rest])), u)[0]

        total = total + jax.vmap(of)(warm, response.effort[:, columns])
    return total


@dataclass(frozen=True, kw_only=True)
class StepFigures:
    """``rise`` 10 to 90 % [s], ``settling`` into 2 % [s], ``overshoot`` [share], ``final`` value."""

    rise: float
    settling: float
    overshoot: float
    final: float


def step_figures(
    time: Float[np.ndarray, " n"] | Sequence[float],
    values: Float[np.ndarray, " n"] | Sequence[float],
    *,
    final: float | None = None,
) -> StepFigures:
    """Step figures of a response that was recorded, by python-control's `step_info`.

    **Raises** `ControlError` where the response does not end near its final value: there is nothing to settle into.
    """
    import control

    y, t = np.asarray(values, float), np.asarray(time, float)
    end = float(y[-1]) if final is None else final
    if not np.all(np.isfinite(y)) or end == 0 or abs(y[-1] - end) > 0.2 * abs(end):
        raise ControlError("the response does not settle at its final value", mend="run it longer, or is it unstable?")
    return figures_of(control.step_info(y, T=t, yfinal=end))


def figures_of(info: Any) -> StepFigures:
    """What python-control's `step_info` found."""
    return StepFigures(
        rise=float(info["RiseTime"]),
        settling=float(info["SettlingTime"]),
        overshoot=float(info["Overshoot"]) / 100,
        final=float(info["SteadyStateValue"]),
    )


def as_rows(metrics: Metrics) -> list[tuple[str, float, str]]:
    """(words, value, unit) of every figure that a response has, in the units people read."""
    words = {
        "rmse": ("RMSE", "deg"),
        "mae": ("Mean absolute error", "deg"),
        "max_error": ("Largest error", "deg"),
        "section_error": ("Largest error between equivalent extremes", "deg"),
        "peak_error": ("Error between the greatest values", "deg"),
        "delay": ("Delay of the greatest value", "s"),
        "phase": ("Phase", "deg"),
        "effort": ("Mean effort", "V²"),
        "energy": ("Energy", "J"),
        "hottest": ("Peak temperature", "°C"),
        "saturated": ("Time in saturation", "%"),
    }
    rows = []
    for f in fields(metrics):
        value = getattr(metrics, f.name)
        if math.isnan(value):
            continue
        name, unit = words[f.name]
        scaled = {"deg": value * DEGREES, "°C": value - 273.15, "%": 100 * value}.get(unit, value)
        rows.append((name, scaled, unit))
    return rows
