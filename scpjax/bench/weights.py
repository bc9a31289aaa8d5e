"""A series of weights, hung on one actuator by hand one after another: its stiffness (thesis 4.3.2, Figure 4.8) and how
far it lifts each (4.1.2, Table 4.5)."""

from __future__ import annotations

import csv
import io
import math
import os
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from matplotlib.figure import Figure
from scipy import stats
from scipy.constants import g

from scpjax.bench.errors import BenchError
from scpjax.bench.rig import Rig
from scpjax.bench.wiring import FULL
from scpjax.report import page, plot
from scpjax.report.numbers import number

_LOOK_S = 3.0
_END_COUNTS = 12
_BENT = 0.01  # chance below which a line is not straight


@dataclass(frozen=True)
class Standing:
    """Where the weight stands: ``counts`` of the position sensor, and the position ``m`` [m] with its error."""

    counts: float
    m: float
    error: float


@dataclass(frozen=True)
class Hung:
    """A weight of ``mass`` [kg], cold at ``position`` +- ``error`` [m] (less is longer) on the sensor's first scale.

    ``lift`` [m]: the highest it was lifted under ``volts``, None where it was not driven.
    """

    mass: float
    position: float
    error: float
    lift: float | None = None
    volts: float = 0.0


@dataclass(frozen=True)
class Stiffness:
    """``value`` [N/m] of a line through weights and positions, with its 95 % interval; ``unloaded`` [m], where the line
    meets no weight. ``straight``: whether the readings' errors allow a line; ``by_scatter``: whether its error is that
    of the points about it, or, with two weights, only that of the readings."""

    value: float
    std: float
    low: float
    high: float
    unloaded: float
    straight: bool
    by_scatter: bool

    @property
    def says(self) -> str:
        """One sentence."""
        text = f"stiffness {number(self.value, 4)} N/m (95 %: {number(self.low)} to {number(self.high)})"
        if not self.by_scatter:
            text += ", from two weights: a third would show whether it is one number"
        elif not self.straight:
            text += "; the points are no straight line: the stiffness changes with the load, or the fibre crept"
        return text


def stand(rig: Rig, path: str | os.PathLike[str]) -> Standing:
    """Position over 3 s, recorded; its error holds the noise, half a step of the sensor and what it still moves.

    **Raises** `BenchError` without a position sensor, for echoes that are lost, and at the end of a potentiometer.
    """
    law = rig.wiring.position
    if law.source == "none":
        raise BenchError("no position sensor is fitted", mend="a series of weights needs one; see [position]")
    rig.record(path, title="standing under a weight")
    try:
        raw = np.array([rig.wiring.measured(sample) for _, sample in rig.samples(_LOOK_S)])
    finally:
        rig.end_recording()
    raw = raw[np.isfinite(raw)]
    if len(raw) < 4:
        raise BenchError("the position sensor does not answer", mend="look at its wires")
    mean, half = float(np.mean(raw)), len(raw) // 2
    counts = law.zero + mean / law.per_count
    if law.source == "potentiometer" and not _END_COUNTS < counts < FULL - _END_COUNTS:
        mend = "turn the pulley so that every weight stays on the scale, or take others"
        raise BenchError("the position sensor is at its end", where=rig.device.name, mend=mend)
    moved = abs(float(np.mean(raw[half:]) - np.mean(raw[:half]))) / 2
    error = math.hypot(float(np.std(raw, ddof=1)) / math.sqrt(len(raw)), abs(law.per_count) / math.sqrt(12), moved)
    return Standing(counts, mean, error)


def check_weights(weights: Sequence[float]) -> None:
    """**Raises** `BenchError` for a series from which no stiffness follows."""
    for mass in weights:
        if not (math.isfinite(mass) and mass > 0):
            raise BenchError(
                f"{mass:g} kg is no weight", where="--weights", mend="give kilograms above 0: 0.05,0.1,0.15"
            )
    if len(set(weights)) < 2:
        raise BenchError("one weight gives no stiffness", where="--weights", mend="give two or more that differ")


def stiffness(series: Sequence[Hung]) -> Stiffness:
    """Straight line of positions over forces, weighted by the readings' errors; its slope is one over the stiffness.

    **Raises** `BenchError` where the weights do not draw the actuator out by more than the error.
    """
    check_weights([h.mass for h in series])
    force = g * np.array([h.mass for h in series])
    at, error = np.array([h.position for h in series]), np.array([h.error for h in series])
    columns = np.stack([np.ones(len(series)), -force], axis=1) / error[:, None]
    (unloaded, slope), *_ = np.linalg.lstsq(columns, at / error, rcond=None)
    off = at / error - columns @ np.array([unloaded, slope])
    free = len(series) - 2
    spread = float(off @ off)
    straight = free == 0 or float(stats.chi2.sf(spread, free)) > _BENT
    scale = max(1.0, math.sqrt(spread / free)) if free else 1.0
    std = scale * math.sqrt(float(np.linalg.inv(columns.T @ columns)[1, 1]))
    reach = std * float(stats.t.ppf(0.975, free) if free and scale > 1 else stats.norm.ppf(0.975))
    if slope - reach <= 0:
        mend = "take weights that differ more, and look whether the pulley turns the right way (the sign of per_count)"
        raise BenchError(
            "the weights do not draw the actuator out by more than the error", where="--weights", mend=mend
        )
    k = 1.0 / slope
    return Stiffness(k, std * k * k, 1 / (slope + reach), 1 / (slope - reach), float(unloaded), straight, free > 0)


def table(series: Sequence[Hung]) -> str:
    """The series as CSV: mass, force, position and its error, volts, lift."""
    out = io.StringIO()
    write = csv.writer(out, lineterminator="\n")
    write.writerow(("mass_kg", "force_N", "position_mm", "error_mm", "voltage_V", "lift_mm"))
    for h in series:
        lift = "" if h.lift is None else f"{1e3 * h.lift:.4f}"
        write.writerow(
            (
                f"{h.mass:g}",
                f"{g * h.mass:.5g}",
                f"{1e3 * h.position:.4f}",
                f"{1e3 * h.error:.4f}",
                f"{h.volts:g}",
                lift,
            )
        )
    return out.getvalue()


def figure(series: Sequence[Hung], found: Stiffness) -> Figure:
    """Force over extension, with the line (as Figure 4.8); and lift over weight (as Table 4.5)."""
    made = plot.new_figure(8.6, 3.0)
    left, right = made.subplots(1, 2)
    force = g * np.array([h.mass for h in series])
    out = 1e3 * (found.unloaded - np.array([h.position for h in series]))
    ends = np.array([0.0, 1.08 * force.max()])
    left.plot(1e3 * ends / found.value, ends, color=plot.EXTENDED, lw=1.4, label=f"{number(found.value, 4)} N/m")
    error = [1e3 * h.error for h in series]
    left.errorbar(out, force, xerr=error, fmt="o", color=plot.MEASURED, ms=4.5, lw=1.2, label="measured")
    left.set(xlabel="Extension by the weight, cold (mm)", ylabel="Weight (N)", ylim=(0, None), xlim=(0, None))
    left.legend(frameon=False, fontsize=8)
    lifted = [h for h in series if h.lift is not None]
    lift = [1e3 * (h.lift or 0.0) for h in lifted]
    right.plot([1e3 * h.mass for h in lifted], lift, "o", color=plot.MEASURED, ms=4.5)
    right.set(xlabel="Weight (g)", ylabel="Lift (mm)", ylim=(0, 1.2 * max(lift, default=1.0)), xlim=(0, None))
    for axis in (left, right):
        plot.style(axis)
    made.tight_layout()
    return made


def section(series: Sequence[Hung], found: Stiffness, image: bytes, says: Sequence[str]) -> str:
    """A section of a report."""
    rows = [
        (
            number(1e3 * h.mass, 4),
            number(g * h.mass),
            f"{number(1e3 * (found.unloaded - h.position))} ± {number(1e3 * h.error, 1)}",
            "" if h.lift is None else number(1e3 * h.lift),
        )
        for h in series
    ]
    head = ("Weight (g)", "Force (N)", "Extension, cold (mm)", "Lift (mm)")
    words = f"{found.says[:1].upper()}{found.says[1:]}."
    held = "It is held in the fit below: its error is also one of the force per kelvin, which is not in that interval."
    caption = "Left: what the weight draws out when cold, and the line whose slope is the stiffness. Right: the lift."
    return page.section(
        "A series of weights",
        page.text(f"{words} {held}"),
        page.table(head, rows, (0, 1, 2, 3)),
        page.figure(image, caption),
        page.bullets(list(says)),
    )


def to_json(series: Sequence[Hung], found: Stiffness) -> dict[str, Any]:
    """Plain values."""
    return {
        "schema": "scpjax.weights/1",
        "stiffness_N_per_m": {"value": found.value, "std": found.std, "ci95": [found.low, found.high]},
        "straight": found.straight,
        "weights": [
            {
                "mass_kg": h.mass,
                "force_N": g * h.mass,
                "position_m": h.position,
                "position_std_m": h.error,
                "voltage_V": h.volts,
                "lift_m": h.lift,
            }
            for h in series
        ],
    }
