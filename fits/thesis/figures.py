"""Pictures of the three questions."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import numpy as np
from matplotlib.figure import Figure

from fits.thesis import plant, steady, turning
from scpjax.diagnose.result import Diagnosis
from scpjax.recordings.thesis import table_4_4_recordings
from scpjax.report.plot import BASE, DRIVE, EXTENDED, MEASURED, png

MARKS = ("o", "s", "^", "D", "v", "P", "X", "<", ">")


def poles(path: Path) -> None:
    """Poles of (4.4), and of Table 4.14."""
    i = plant.implied()
    figure = Figure(figsize=(8.6, 3.2), layout="constrained")
    near, wide = figure.subplots(1, 2, width_ratios=(1.2, 1))
    found = np.array(i.poles)
    ring = np.roots([plant.ACTUATOR.mass_kg, i.damping_measured, i.k_measured])
    for axis in (near, wide):
        axis.plot(np.real(found), np.imag(found), "x", color=EXTENDED, ms=9, mew=2, label="identified, (4.4)")
        axis.plot(np.real(ring), np.imag(ring), "+", color=BASE, ms=11, mew=2, label="mass on the measured spring")
        axis.plot([-i.thermal_measured], [0], "+", color="0.45", ms=11, mew=2, label="λ/C_th as measured")
        axis.axhline(0, color="0.8", lw=0.8)
        axis.set(xlabel="real part (1/s)", ylabel="imaginary part (rad/s)")
    near.set(xlim=(-1.6, 0.1), ylim=(-1.3, 1.3), title="what was found")
    near.legend(frameon=False, fontsize=8, loc="center left")
    wide.set(xlim=(-3, 0.6), ylim=(-45, 45), title="where the weight rings")
    path.write_bytes(png(figure))


def plant_overlay(path: Path, found: Diagnosis) -> None:
    """What (4.4) does, and the plant with the measured stiffness, as it is and with what was named."""
    names = list(dict.fromkeys(t.recording for t in found.traces))
    figure = Figure(figsize=(8.6, 4.6), layout="constrained")
    for axis, name in zip(figure.subplots(len(names), 1), names, strict=True):
        t = next(t for t in found.traces if t.recording == name and t.column == "displacement_mm")
        axis.plot(t.time, t.measured, color=MEASURED, lw=0.5, alpha=0.45, label="(4.4) and noise of 10 %")
        axis.plot(t.time, t.base, color=BASE, lw=1.2, ls=(0, (4, 1.6)), label="plant with the measured k, m, β")
        axis.plot(t.time, t.extended, color=EXTENDED, lw=1.2, label="and " + " + ".join(_titles(found)))
        axis.set(title=name, xlim=(15, 75), xlabel="time (s)", ylabel="displacement (mm)")
    figure.axes[0].legend(frameon=False, fontsize=8, loc="lower right")
    path.write_bytes(png(figure))


def _titles(found: Diagnosis) -> list[str]:
    return [m.title[0].lower() + m.title[1:] for m in found.mechanisms] or ["nothing"]


def steady_laws(path: Path, laws: Sequence[steady.Law]) -> None:
    """Table 4.4 over V^2, each actuator in units of its own scale, and the laws."""
    figure = Figure(figsize=(8.6, 3.7), layout="constrained")
    points, bars = figure.subplots(1, 2, width_ratios=(1.1, 1))
    best = next(law for law in laws if law.factors == ("loss",))
    power = 2 / (1 + best.values["loss"])
    top = max(row.voltage_V.max() for row in table_4_4_recordings())
    for row, mark in zip(table_4_4_recordings(), MARKS, strict=True):
        shape = row.voltage_V**power
        scale = shape @ row.displacement_m / (shape @ shape) * top**power
        points.plot(row.voltage_V**2, row.displacement_m / scale, mark, ms=4, label=f"{row.code}", alpha=0.8)
    v = np.linspace(0, top, 200)
    points.plot(v**2, (v / top) ** power, color=EXTENDED, lw=1.5, label="loss")
    points.plot(v**2, (v / top) ** 2 * _linear_scale(power, top), color=BASE, lw=1.5, ls="--", label="x = c V²")
    points.set(xlabel="V² (V²)", ylabel="displacement / law's at 3.55 V (1)", xlim=(0, None), ylim=(0, None))
    points.legend(frameon=False, fontsize=7, ncols=2, title="actuator", title_fontsize=7)
    shown = [*laws[:12]] + [law for law in laws[12:] if len(law.factors) <= 1]
    at = np.arange(len(shown))[::-1]
    bars.barh(at, [law.bic - laws[0].bic for law in shown], color=DRIVE, height=0.6)
    bars.set_yticks(at, [law.name for law in shown], fontsize=7)
    bars.axvline(10, color=BASE, lw=1, ls=":")
    bars.set_xscale("symlog", linthresh=10)
    bars.set(xlabel="BIC above the best (beyond 10: decided)")
    path.write_bytes(png(figure))


def _linear_scale(power: float, top: float) -> float:
    """Factor of (V/top)^2 that comes closest to (V/top)^power at the voltages of the table."""
    v = np.concatenate([row.voltage_V for row in table_4_4_recordings()]) / top
    return float(v**2 @ v**power / (v**2 @ v**2))


def joint(path: Path, accounts: Sequence[tuple[str, turning.Account]]) -> None:
    """Measured angles against what each account says, table by table."""
    figure = Figure(figsize=(8.6, 3.1), layout="constrained")
    for axis, (words, account) in zip(figure.subplots(1, len(accounts), sharey=True), accounts, strict=True):
        angles = turning.said(account.values)
        for table, colour, mark in (("4.9", EXTENDED, "o"), ("4.11", BASE, "s"), ("4.12", "#009e73", "^")):
            use = table == turning.TABLES
            axis.plot(angles[use], turning.MEASURED[use], mark, color=colour, ms=5, alpha=0.8, label=f"Table {table}")
        end = max(angles.max(), turning.MEASURED.max()) * 1.05
        axis.plot([0, end], [0, end], color="0.6", lw=0.9)
        axis.set(xlabel="said (deg)", title=f"{words}\nRMSE {account.rmse:.1f}°", xlim=(0, end), ylim=(0, 22))
        axis.title.set_fontsize(8.5)
    figure.axes[0].set_ylabel("measured (deg)")
    figure.axes[0].legend(frameon=False, fontsize=8)
    path.write_bytes(png(figure))
