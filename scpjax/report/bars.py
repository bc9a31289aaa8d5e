"""Figures of shares and values: where the misfit lies, what was tried, how a fleet spreads."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.ticker import SymmetricalLogLocator

from scpjax.diagnose.result import Location, Ranked
from scpjax.fit.result import Estimate
from scpjax.physics.catalogue import catalogue
from scpjax.report.numbers import unit as pretty_unit
from scpjax.report.plot import BASE, DRIVE, EXTENDED, FAINT, GRID, TEXT, new_figure, style

_WIDTH = 8.6


def misfit(location: Location, recordings: Sequence[str], ends: Mapping[str, tuple[float, float]]) -> Figure:
    """Where the misfit lies: by window on each recording's time axis, by regime, and what it depends on."""
    windows = [w for w in location.windows if w.recording in ends]
    named = [r for r in recordings if any(w.recording == r for w in windows)]
    regimes = {k: v for k, v in location.regimes.items() if np.isfinite(v)}
    depends = [(v.replace("_", " "), s) for v, s in location.depends_on[:6]]
    upper = 0.34 * len(named) if named else 0.0
    lower = 0.27 * max(len(regimes), len(depends))
    height = (upper + 0.78 if upper else 0.0) + (lower + 0.78 if lower else 0.0)
    figure = new_figure(_WIDTH, max(height, 1.0))

    def place(left: float, width: float, bottom: float, tall: float) -> Axes:  # in inches
        total = figure.get_figheight()
        return figure.add_axes((left / _WIDTH, bottom / total, width / _WIDTH, tall / total))

    if upper:
        _windows(place(1.15, 7.25, height - upper - 0.28, upper), windows, named, ends)
    if regimes:
        _bars(place(1.15, 2.7, 0.5, lower), regimes, "Share of the misfit, by regime (%)")
    if depends:
        title = "Share of the residual explained by this alone (%)"
        _bars(place(5.35, 3.05, 0.5, lower), dict(depends), title)
    return figure


def ranking(ranked: Sequence[Ranked], named: Sequence[str], titles: Mapping[str, str]) -> Figure:
    """What was tried: evidence (fall of the BIC) and gain on held-out data; the named ones in colour."""
    figure = new_figure(_WIDTH, 0.27 * len(ranked) + 0.85)
    evidence, gain = figure.subplots(1, 2, sharey=True, gridspec_kw={"wspace": 0.06, "width_ratios": [1.35, 1]})
    total = figure.get_figheight()
    figure.subplots_adjust(left=0.345, right=0.975, top=1 - 0.1 / total, bottom=0.55 / total)
    at = np.arange(len(ranked))[::-1]
    colours = [EXTENDED if r.name in named else FAINT for r in ranked]
    deltas = np.array([r.delta_bic if np.isfinite(r.delta_bic) else 0.0 for r in ranked])
    evidence.barh(at, deltas, color=colours, height=0.62)
    evidence.set_xscale("symlog", linthresh=10, linscale=0.6)
    evidence.xaxis.set_major_locator(SymmetricalLogLocator(base=10, linthresh=10))
    evidence.axvline(0, color=TEXT, lw=0.8)
    evidence.set_xlabel("Evidence for it: fall of the BIC")
    evidence.set_yticks(at, [titles.get(r.name, r.name) for r in ranked])
    evidence.set_ylim(-0.7, len(ranked) - 0.3)
    gains = np.array([100 * r.held_out_gain if np.isfinite(r.held_out_gain) else 0.0 for r in ranked])
    gain.barh(at, np.maximum(gains, -20), color=colours, height=0.62)
    gain.axvline(0, color=TEXT, lw=0.8)
    gain.set_xlim(min(-2.0, max(gains.min(initial=0), -20)), 102 if gains.max(initial=0) > 50 else None)
    gain.set_xlabel("Held-out misfit that it removes (%)")
    for axis in (evidence, gain):
        style(axis, grid="x")
        axis.tick_params(axis="y", length=0, labelsize=8.5)
    return figure


def spread(
    values: Mapping[str, Sequence[Estimate | None]], names: Sequence[str], shared: Mapping[str, Estimate] | None = None
) -> Figure:
    """Every parameter over a fleet, with its 95 % interval; log axes for positive ones that spread widely. Bands where
    values are ``shared``.
    """
    columns = min(len(values), 2) or 1
    rows = -(-len(values) // columns) or 1
    height = 2.0 * rows + 0.25
    figure = new_figure(_WIDTH, height)
    axes = figure.subplots(rows, columns, squeeze=False)
    figure.subplots_adjust(left=0.1, right=0.985, top=1 - 0.28 / height, bottom=0.5 / height, hspace=0.62, wspace=0.3)
    for axis in axes.ravel()[len(values) :]:
        axis.set_axis_off()
    for axis, (key, estimates) in zip(axes.ravel(), values.items(), strict=False):
        _spread_of(axis, key, estimates, names)
        if shared and key in shared:
            axis.axhspan(shared[key].low, shared[key].high, color=EXTENDED, alpha=0.15, lw=0)
            axis.axhline(shared[key].value, color=EXTENDED, lw=1)
    return figure


def _spread_of(axis: Axes, key: str, estimates: Sequence[Estimate | None], names: Sequence[str]) -> None:
    few = len(names) <= 30
    present = [(i, e) for i, e in enumerate(estimates) if e is not None and np.isfinite(e.value)]
    at, v = np.array([i for i, _ in present]), np.array([e.value for _, e in present])
    low, high = (np.array([getattr(e, end) for _, e in present]) for end in ("low", "high"))
    if len(v) and _is_log(key) and v.min() > 0:
        low, high = np.clip(low, v / 10, v), np.clip(high, v, v * 10)
        if high.max() > 10 * low.min():
            axis.set_yscale("log")
    axis.vlines(at, low, high, color=EXTENDED, alpha=0.45, lw=2 if few else 1)
    axis.plot(at, v, "o", color=EXTENDED, ms=4 if few else 2)
    if len(v):
        axis.axhline(float(np.median(v)), color=BASE, lw=1, ls="--")
    axis.set_title(key.replace("_", " ").replace(".", ": "), fontsize=9, loc="left", color=TEXT)
    axis.set_ylabel(pretty_unit(present[0][1].unit) or "–" if present else "–")
    axis.set_xlim(-0.7, len(names) - 0.3)
    style(axis, grid="y")
    axis.tick_params(labelsize=7.5)
    if few:
        long = max(map(len, names), default=0) > 4
        axis.set_xticks(range(len(names)), list(names), rotation=25 if long else 0, ha="right" if long else "center")
    else:
        axis.set_xlabel("Actuator")


def _is_log(key: str) -> bool:
    """Whether a parameter is one of those that are positive by nature."""
    mechanism, _, rest = key.partition(".")
    parameters = catalogue()[mechanism].parameters if mechanism in catalogue() else ()
    name = rest.split(" (")[0].split("@")[0]  # of a fleet with its law, of what differs by recording with that
    return any(p.name == name and p.scale == "log" for p in parameters)


def _windows(axis: Axes, windows: Sequence[Any], named: Sequence[str], ends: Mapping[str, tuple[float, float]]) -> None:
    most = max(w.share for w in windows)
    for row, name in enumerate(reversed(named)):
        start, end = ends[name]
        axis.barh(row, end - start, left=start, height=0.5, color=GRID, lw=0)
        for w in windows:
            if w.recording == name:
                strength = 0.3 + 0.7 * w.share / most
                axis.barh(row, w.end_s - w.start_s, left=w.start_s, height=0.5, color=BASE, alpha=strength, lw=0)
                middle = (w.start_s + w.end_s) / 2
                axis.text(
                    middle,
                    row,
                    f"{100 * w.share:.0f}%",
                    ha="center",
                    va="center",
                    fontsize=6.5,
                    color="black",
                )
    axis.set_yticks(range(len(named)), [n if len(n) < 18 else n[:16] + "…" for n in reversed(named)])
    axis.set_ylim(-0.5, len(named) - 0.5)
    axis.set_xlabel("Time (s)")
    axis.set_title("Windows that hold most of the misfit", fontsize=8.5, loc="left", color=TEXT)
    style(axis, grid="x")


def _bars(axis: Axes, values: Mapping[str, float], title: str) -> None:
    at = np.arange(len(values))[::-1]
    shares = [100 * v for v in values.values()]
    axis.barh(at, shares, color=DRIVE, height=0.6)
    axis.set_yticks(at, list(values))
    axis.set_xlim(0, max(*shares, 1.0) * 1.05)
    axis.set_title(title, fontsize=8.5, loc="left", color=TEXT)
    style(axis, grid="x")
