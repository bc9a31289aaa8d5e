"""Figures: no global state, units on every axis, colours that all eyes tell apart. Here: curves over time."""

from __future__ import annotations

import io
from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure
from matplotlib.ticker import MaxNLocator

from scpjax.fit.result import Trace
from scpjax.report.numbers import column as words_of

MEASURED, BASE, EXTENDED, DRIVE, HELD = "#3b3b3b", "#d55e00", "#0072b2", "#6b7785", "#eef0f3"
GRID, TEXT, FAINT = "#e3e6ea", "#2b3036", "#a9b1ba"
_POINTS = 1500


def png(figure: Figure, dpi: int = 150) -> bytes:
    """The figure as a PNG file."""
    target = io.BytesIO()
    FigureCanvasAgg(figure)
    figure.savefig(target, format="png", dpi=dpi, facecolor="white")
    return target.getvalue()


def envelope(x: np.ndarray, y: np.ndarray, points: int = _POINTS) -> tuple[np.ndarray, np.ndarray]:
    """Least and greatest value of ``y`` in each of ``points / 2`` stretches, in order; all of a short signal.

    A line through them looks as the line through all samples does. NaN are left out, and a stretch of nothing
    else stays a gap.
    """
    n = len(x)
    if n <= points:
        return x, y
    edges = np.linspace(0, n, points // 2 + 1).astype(int)
    wide = int(np.max(np.diff(edges)))
    at = np.minimum(edges[:-1, None] + np.arange(wide), edges[1:, None] - 1)  # of each stretch, its last one repeated
    part = y[at]
    low, high = (
        np.take_along_axis(at, np.argmin(np.where(np.isnan(part), np.inf, sign * part), axis=1)[:, None], axis=1)
        for sign in (1.0, -1.0)
    )
    index = np.unique(np.concatenate([low, high]))
    return x[index], y[index]


def overlay(traces: Sequence[Trace], *, noise: Mapping[str, float], labels: tuple[str, str]) -> Figure:
    """One recording: each column measured, before and after, with its residuals beneath, and the drive last.

    The stretches held out from fitting are shaded. ``labels`` name the two curves; where both are the same
    (a fit) only the second is drawn.
    """
    both = any(not np.array_equal(t.base, t.extended) for t in traces)
    ratios = [3.0, 1.3] * len(traces) + [0.9]
    figure = new_figure(8.6, 0.75 * sum(ratios) + 0.55)
    axes = figure.subplots(
        len(ratios), 1, sharex=True, gridspec_kw={"height_ratios": ratios, "hspace": 0.16}, squeeze=False
    )[:, 0]
    figure.subplots_adjust(
        left=0.1, right=0.985, top=1 - 0.34 / figure.get_figheight(), bottom=0.46 / figure.get_figheight()
    )
    for i, trace in enumerate(traces):
        _signal(axes[2 * i], trace, both, labels)
        _residual(axes[2 * i + 1], trace, both, noise.get(trace.column))
    _drive(axes[-1], traces[0])
    shaded = any(t.held_out.any() for t in traces)
    handles, names = axes[0].get_legend_handles_labels()
    if shaded:
        from matplotlib.patches import Patch

        handles, names = [*handles, Patch(color=HELD)], [*names, "held out from fitting"]
    figure.legend(
        handles,
        names,
        loc="upper right",
        bbox_to_anchor=(0.99, 1.0),
        ncols=len(names),
        frameon=False,
        fontsize=8.5,
    )
    for axis in axes:
        style(axis)
        for start, end in _stretches(traces[0]):
            axis.axvspan(start, end, color=HELD, lw=0, zorder=0)
        axis.set_xlim(traces[0].time[0], traces[0].time[-1])
    axes[-1].set_xlabel("Time (s)")
    figure.align_ylabels(axes)
    return figure


def new_figure(width: float, height: float) -> Figure:
    return Figure(figsize=(width, height))


def style(axis: Axes, grid: str = "both") -> None:
    for side in ("top", "right"):
        axis.spines[side].set_visible(False)
    for side in ("left", "bottom"):
        axis.spines[side].set_color(FAINT)
    axis.tick_params(colors=TEXT, labelsize=8, color=FAINT)
    axis.xaxis.label.set(color=TEXT, fontsize=8.5)
    axis.yaxis.label.set(color=TEXT, fontsize=8.5)
    which: Any = grid
    axis.grid(True, axis=which, color=GRID, lw=0.6)
    axis.set_axisbelow(True)


def _axis_label(name: str) -> str:
    words, unit = words_of(name)
    return f"{words}\n({unit})" if unit else words


def _signal(axis: Axes, trace: Trace, both: bool, labels: tuple[str, str]) -> None:
    measured = np.where(trace.weights > 0, trace.measured, np.nan)
    axis.plot(*envelope(trace.time, measured), color=MEASURED, lw=1.6, alpha=0.55, label="measured")
    if both:
        axis.plot(*envelope(trace.time, trace.base), color=BASE, lw=1.2, ls=(0, (4, 1.6)), label=labels[0])
    axis.plot(*envelope(trace.time, trace.extended), color=EXTENDED, lw=1.2, label=labels[1])
    axis.set_ylabel(_axis_label(trace.column))
    axis.yaxis.set_major_locator(MaxNLocator(5))


def _residual(axis: Axes, trace: Trace, both: bool, noise: float | None) -> None:
    seen = trace.weights > 0
    curves = [(trace.base, BASE)] if both else []
    curves += [(trace.extended, EXTENDED)]
    if noise:
        axis.axhspan(-2 * noise, 2 * noise, color="#cfd6de", lw=0, zorder=0.5, alpha=0.7)
    for values, colour in curves:
        residual = np.where(seen, trace.measured - values, np.nan)
        axis.plot(*envelope(trace.time, residual), color=colour, lw=0.8, alpha=0.9)
    unit = words_of(trace.column)[1]
    axis.set_ylabel(f"Residual\n({unit})" if unit else "Residual")
    axis.yaxis.set_major_locator(MaxNLocator(3, symmetric=True))


def _drive(axis: Axes, trace: Trace) -> None:
    shades = (DRIVE, "#c08bb0")
    for i, name in enumerate(trace.drive_columns):
        axis.plot(*envelope(trace.time, trace.drive[:, i]), color=shades[i % 2], lw=1.0, label=name)
    words, unit = words_of(trace.drive_columns[0])
    axis.set_ylabel(f"{words.split()[0]}\n({unit})" if unit else words)
    axis.yaxis.set_major_locator(MaxNLocator(3))
    if len(trace.drive_columns) > 1:
        names = [words_of(n)[0].split(maxsplit=1)[-1] for n in trace.drive_columns]
        legend_above(axis, names)


def legend_above(axis: Axes, names: list[str] | None = None) -> None:
    """Names of the curves of a low panel (their labels, without ``names``), in room made for them above the curves."""
    low, high = axis.get_ylim()
    axis.set_ylim(low, high + 0.45 * (high - low))
    names = names or axis.get_legend_handles_labels()[1]
    axis.legend(names, loc="upper right", ncols=2, frameon=False, fontsize=7.5, borderaxespad=0.0)


def _stretches(trace: Trace) -> list[tuple[float, float]]:
    """Start and end of every stretch that was held out."""
    edges = np.flatnonzero(np.diff(np.concatenate([[0], trace.held_out.astype(int), [0]])))
    last = len(trace.time) - 1
    return [
        (float(trace.time[a]), float(trace.time[min(b, last)])) for a, b in zip(edges[::2], edges[1::2], strict=True)
    ]
