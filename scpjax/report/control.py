"""What a tuning leaves on disk: figures before and after, margins, and one page."""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import jax.numpy as jnp
import numpy as np
from matplotlib.figure import Figure

from scpjax.control.analysis import LoopFigures, figures, loop_response
from scpjax.control.errors import ControlError
from scpjax.control.loop import Loop, Response
from scpjax.control.metrics import as_rows, measure
from scpjax.control.objective import Objective, describe
from scpjax.control.tune import Tuned
from scpjax.control.verdict import Verdict
from scpjax.report import page, pieces, plot
from scpjax.report.numbers import number


@dataclass(frozen=True, kw_only=True)
class TuningReport:
    """A tuning and what it was made from; loops and responses before and after."""

    tuned: Tuned
    loops: tuple[Loop, Loop]
    responses: tuple[Response, Response]
    verdict: Verdict
    objective: Objective
    command: str = ""
    spread: float | None = None
    title: str = ""


def write_tuning(report: TuningReport, out: Path) -> Path:
    """Write ``tuning.json``, figures and ``report.html`` into a folder; the page's path."""
    linear = [_figures(loop) for loop in report.loops]
    shapes = {
        "tracking": plot.png(tracking_figure(report.responses)),
        "bode": plot.png(bode_figure(report.loops)),
        "search": plot.png(search_figure(report.tuned)),
    }
    pieces.write_figures(out, shapes)
    pieces.write_json(out / "tuning.json", tuning_json(report, linear))
    return pieces.write_page(out, f"Tuning: {report.title}", _body(report, linear, shapes))


def _figures(loop: Loop) -> LoopFigures | None:
    try:
        return figures(loop)
    except ControlError:
        return None


def tuning_json(report: TuningReport, linear: list[LoopFigures | None]) -> dict[str, Any]:
    """The numbers of a tuning, schema ``scpjax.tuning/1``; angles in degrees."""
    t = report.tuned
    return {
        "schema": "scpjax.tuning/1",
        "gains": dict(t.gains),
        "given": dict(t.given),
        "objective": {"before": t.before, "after": t.value, "terms": describe(report.objective)},
        "stability": report.verdict.stability,
        "reach_deg": [math.degrees(v) for v in report.verdict.reach],
        "says": list(report.verdict.says),
        "at_bound": list(t.at_bound),
        "metrics": {
            when: {words: value for words, value, _ in as_rows(measure(r, loop=loop))}
            for when, r, loop in zip(("before", "after"), report.responses, report.loops, strict=True)
        },
        "linear": dict(zip(("before", "after"), map(_linear_json, linear), strict=True)),
        "loops": t.loops,
        "seconds": t.seconds,
        "spread": report.spread,
    }


def _linear_json(f: LoopFigures | None) -> dict[str, Any] | None:
    if f is None:
        return None
    step = None if f.step is None else dataclasses.asdict(f.step)
    return {
        "stable": f.stable,
        "gain_margin_dB": f.gain_margin_dB,
        "phase_margin_deg": math.degrees(f.phase_margin),
        "bandwidth_rad_per_s": f.bandwidth,
        "sensitivity_peak": f.sensitivity,
        "step": step,
    }


# -- figures ---------------------------------------------------------------------------------------------------------


def tracking_figure(responses: tuple[Response, Response]) -> Figure:
    """Reference and angle before and after, error, and the voltages after."""
    figure = plot.new_figure(8.6, 5.6)
    grid = {"height_ratios": [3.0, 1.4, 1.6], "hspace": 0.16}
    axes = figure.subplots(3, 1, sharex=True, gridspec_kw=grid)
    figure.subplots_adjust(left=0.1, right=0.985, top=0.93, bottom=0.09)
    time = np.asarray(responses[0].time)
    degrees = lambda v: np.degrees(np.asarray(v))  # noqa: E731
    axes[0].plot(*plot.envelope(time, degrees(responses[0].reference)), color=plot.MEASURED, lw=1.4, alpha=0.6,
                 label="reference")  # fmt: skip
    for response, colour, label in zip(responses, (plot.BASE, plot.EXTENDED), ("before", "after"), strict=True):
        axes[0].plot(*plot.envelope(time, degrees(response.angle)), color=colour, lw=1.2, label=label)
        axes[1].plot(*plot.envelope(time, degrees(response.error)), color=colour, lw=0.9)
    names = ("agonist", "antagonist")
    for side, colour in zip(range(responses[1].effort.shape[1]), (plot.DRIVE, "#c08bb0"), strict=False):
        volts = np.asarray(responses[1].voltage)[:, side]
        axes[2].plot(*plot.envelope(time, volts), color=colour, lw=0.9, label=names[side])
    for axis, label in zip(axes, ("Angle\n(°)", "Error\n(°)", "Voltage after\n(V)"), strict=True):
        axis.set_ylabel(label)
        plot.style(axis)
    axes[2].set_ylim(0, max(axes[2].get_ylim()[1], 0.1))
    plot.legend_above(axes[2])
    axes[2].set_xlabel("Time (s)")
    axes[2].set_xlim(time[0], time[-1])
    figure.legend(*axes[0].get_legend_handles_labels(), loc="upper right", ncols=3, frameon=False, fontsize=8.5,
                  bbox_to_anchor=(0.99, 1.0))  # fmt: skip
    figure.align_ylabels(axes)
    return figure


def bode_figure(loops: tuple[Loop, Loop]) -> Figure:
    """Open and closed loop, magnitude, before and after."""
    figure = plot.new_figure(8.6, 3.1)
    axes = figure.subplots(1, 2)
    figure.subplots_adjust(left=0.09, right=0.985, top=0.89, bottom=0.17, wspace=0.22)
    omega = np.geomspace(1e-2, 1e2, 500)
    for loop, colour, label in zip(loops, (plot.BASE, plot.EXTENDED), ("before", "after"), strict=True):
        try:
            open_ = np.asarray(loop_response(loop, jnp.asarray(omega)))
        except ControlError:
            continue
        for axis, values in ((axes[0], open_), (axes[1], open_ / (1 + open_))):
            axis.semilogx(omega, 20 * np.log10(np.abs(values)), color=colour, lw=1.3, label=label)
    for axis, title in zip(axes, ("Open loop", "Closed loop"), strict=True):
        axis.axhline(0, color=plot.FAINT, lw=0.8)
        axis.set_title(title, fontsize=8.5, loc="left", color=plot.TEXT)
        axis.set_xlabel("Frequency (rad/s)")
        plot.style(axis)
        axis.set_xlim(omega[0], omega[-1])
    axes[0].set_ylabel("Magnitude (dB)")
    axes[1].set_ylim(-60, 20)
    axes[1].legend(frameon=False, fontsize=8)
    return figure


def search_figure(tuned: Tuned) -> Figure:
    """Best objective on the way, as a share of what it was."""
    figure = plot.new_figure(8.6, 2.3)
    axis = figure.subplots()
    figure.subplots_adjust(left=0.09, right=0.985, top=0.95, bottom=0.21)
    share = tuned.path / tuned.before if tuned.before > 0 else tuned.path
    axis.plot(np.arange(len(share)), share, color=plot.EXTENDED, lw=1.3, marker="o", ms=3)
    axis.axhline(1.0, color=plot.BASE, lw=1, ls="--")
    axis.set_xlabel("Screening, generations, then steps with derivatives")
    axis.set_ylabel("Objective / before")
    plot.style(axis)
    return figure


# -- the page --------------------------------------------------------------------------------------------------------


def _body(report: TuningReport, linear: list[LoopFigures | None], shapes: dict[str, bytes]) -> list[str]:
    t = report.tuned
    before, after = (measure(r, loop=loop) for r, loop in zip(report.responses, report.loops, strict=True))
    stable = report.verdict.stability == "stable"
    badge, colour = ("stable", "adequate") if stable else (report.verdict.stability, "unexplained")
    gain = 1 - after.rmse / before.rmse
    says = (
        f"The joint follows with an RMSE of {number(math.degrees(after.rmse))}° instead of "
        f"{number(math.degrees(before.rmse))}°."
        if t.improved and not gain <= 0
        else "Better by the objective, not by the RMSE alone." if t.improved
        else "Nothing better than the given gains was found; they are kept."
    )  # fmt: skip
    facts = [(n, number(t.given[n]), number(t.gains[n])) for n in ("Kp", "Ki", "Kd", "N")]
    units = {"Kp": "Kp, V²/°", "Ki": "Ki, V²/(° s)", "Kd": "Kd, V² s/°", "N": "N, rad/s"}
    old = {words: value for words, value, _ in as_rows(before)}
    new = {words: value for words, value, _ in as_rows(after)}
    units_of = {words: unit for words, _, unit in (*as_rows(before), *as_rows(after))}
    rows = [
        (words, *(f"{number(x[words], 3)} {unit}" if words in x else "–" for x in (old, new)))
        for words, unit in units_of.items()
    ]
    notes = list(report.verdict.says)
    if t.at_bound:
        notes.append(f"At the end of the range that was searched: {', '.join(t.at_bound)}.")
    if report.spread is not None:
        notes.append(
            f"Tuned for many plants whose parameters differ by {100 * report.spread:.0f} %; drawn is the given one."
        )
    curves = "Reference (grey), angle before (orange) and after (blue), error, and the voltages after."
    linear_says = "Both controllers at work, no limits, thesis (4.14) and (4.15)."
    took = f"{t.loops} loops in {number(t.seconds, 2)} s; a tangent counts as a loop."
    head = ("", "Before", "After")
    return [
        pieces.heading("Tuning", badge, colour, says, report.title),
        page.facts([(units[n], old, new) for n, old, new in facts]),
        page.bullets(notes),
        page.section("Before and after", page.figure(shapes["tracking"], curves), page.table(head, rows, (1, 2))),
        page.section(
            "Linear loop",
            page.text(linear_says, "small soft"),
            page.table(head, _linear_rows(linear), (1, 2)),
            page.figure(shapes["bode"], "Magnitude of open and closed loop."),
        ),
        page.section("Search", page.figure(shapes["search"], took), _terms(report.objective)),
        _again(report),
    ]


def _linear_rows(linear: list[LoopFigures | None]) -> list[tuple[str, str, str]]:
    def cells(read: Callable[[LoopFigures], str]) -> tuple[str, str]:
        one, two = ("–" if f is None else read(f) for f in linear)
        return one, two

    step = lambda f, name, scale, unit: "–" if f.step is None else f"{number(scale * getattr(f.step, name))} {unit}"  # noqa: E731
    return [
        ("Stable", *cells(lambda f: "yes" if f.stable else "no")),
        ("Gain margin", *cells(lambda f: f"{number(f.gain_margin_dB)} dB")),
        ("Phase margin", *cells(lambda f: f"{number(math.degrees(f.phase_margin))}°")),
        ("Bandwidth", *cells(lambda f: f"{number(f.bandwidth)} rad/s")),
        ("Sensitivity peak", *cells(lambda f: number(f.sensitivity))),
        ("Rise, 10 to 90 %", *cells(lambda f: step(f, "rise", 1, "s"))),
        ("Settling into 2 %", *cells(lambda f: step(f, "settling", 1, "s"))),
        ("Overshoot", *cells(lambda f: step(f, "overshoot", 100, "%"))),
    ]


def _terms(objective: Objective) -> str:
    rows = [
        (name, number(weight), ", ".join(f"{k} {number(v)}" for k, v in options.items()) or "–")
        for name, weight, options in describe(objective)
    ]
    over = {"mean": "the mean", "worst": "the worst", "cvar": f"the mean of the worst {100 * objective.tail:.0f} %"}
    return page.table(("Term", "Weight", "Options"), rows, (1,)) + page.text(
        f"Of several responses {over[objective.over]} counts.", "small soft"
    )


def _again(report: TuningReport) -> str:
    line = page.text("Run again with:") + f"<pre>{page.escape(report.command)}</pre>" if report.command else ""
    return page.section("How to make this again", line)
