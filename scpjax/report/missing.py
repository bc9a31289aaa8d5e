"""What is missing before it has a name: the power, force or reading itself, and what was learned in its place."""

from __future__ import annotations

import csv
import io
from collections.abc import Sequence
from html import escape
from pathlib import Path

import numpy as np
from matplotlib.figure import Figure

from scpjax.diagnose.result import FREE, Diagnosis, Drawn, Latent
from scpjax.recordings.files import write_text
from scpjax.report import page, plot
from scpjax.report.numbers import number, percent
from scpjax.report.plot import EXTENDED, FAINT, TEXT, new_figure, style

_UNITS = {
    "temperature": ("Temperature above ambient", "K", 1.0),
    "displacement": ("Displacement", "mm", 1e3),
    "velocity": ("Velocity", "mm/s", 1e3),
    "drive": ("Drive", "as the model takes it", 1.0),
    "effort": ("Drive", "as the model takes it", 1.0),
    "time": ("Time", "s", 1.0),
    "frequency": ("Frequency", "Hz", 1.0),
}
_THOUSANDTHS = {"W": "mW", "N": "mN", "K": "mK", "mm": "µm"}
_SMALL = 0.02  # of a unit, below which thousandths of it are drawn: ticks with many zeros push the label out
_FORMS = {
    "reaction": (
        " It uses itself up, the faster the hotter it is: drying takes heat like that, and curing gives it.",
        "The rate s at which it is used up",
    ),
    "mode": (
        " Something follows the motion as a mass on a spring of its own does, and swings on: a load on a soft tendon, "
        "a lever that bends, a marker that is not fixed.",
        "How far q swings for each metre that x swings, at each frequency",
    ),
}
"""Closures with states of their own, by the end of their place: what they may be, and what is drawn of them."""
_SCALED = {
    "m": ("mm", 1e3),
    "W": ("W", 1.0),
    "N": ("N", 1.0),
    "K": ("K", 1.0),
    "rad": ("deg", 180 / np.pi),
    "1": ("1", 1.0),
}
_MOST = 4  # recordings drawn
TABLE = "missing.csv"
"""What is missing in every balance and reading, over time, for programs."""


def _words(latent: Latent) -> str:
    place = latent.place.replace("_", " ")
    return {
        "heat": "Power missing",
        "heat agonist": "Power missing, agonist",
        "heat antagonist": "Power missing, antagonist",
        "force": "Force missing",
        "drive": "Share of the drive to be added",
        "drive agonist": "Share of the drive to be added, agonist",
        "drive antagonist": "Share of the drive to be added, antagonist",
    }.get(place, f"Missing in the {place}")


def figure(latent: Latent, names: Sequence[str]) -> Figure:
    """The estimate with its 95 % band over time, recording by recording, and over what it goes with most."""
    unit, factor = _SCALED.get(latent.unit, (latent.unit, 1.0))
    if unit in _THOUSANDTHS and factor * max(float(np.max(np.abs(m))) for m in latent.mean) < _SMALL:
        unit, factor = _THOUSANDTHS[unit], 1e3 * factor
    rows = min(len(latent.time), _MOST)
    out = new_figure(8.6, 1.35 * rows + 0.75)
    grid = out.add_gridspec(
        rows, 2, width_ratios=[1.75, 1], left=0.105, right=0.985, wspace=0.24, hspace=0.5,
        top=1 - 0.27 / out.get_figheight(), bottom=0.5 / out.get_figheight(),
    )  # fmt: skip
    label = f"{_words(latent)}\n({unit})"
    for i in range(rows):
        axis = out.add_subplot(grid[i, 0])
        t, m, s = latent.time[i], factor * latent.mean[i], factor * latent.std[i]
        axis.fill_between(t, m - 1.96 * s, m + 1.96 * s, color=EXTENDED, alpha=0.22, lw=0)
        axis.plot(t, m, color=EXTENDED, lw=1.2)
        axis.axhline(0, color=TEXT, lw=0.7)
        axis.set_title(names[i], fontsize=8.5, color=TEXT, loc="left", pad=3)
        axis.set_xlim(t[0], t[-1])
        axis.set_ylabel(label if i == rows // 2 else "")
        style(axis)
        if i == rows - 1:
            axis.set_xlabel("Time (s)")
    if latent.leading:
        axis = out.add_subplot(grid[:, 1])
        leading = latent.depends_on[0][0]
        words, unit_there, k = _UNITS.get(leading, (leading.replace("_", " ").capitalize(), "SI", 1.0))
        for at, m, s in zip(latent.leading, latent.mean, latent.std, strict=True):
            sure = s < 3 * np.median(s)
            if leading in ("drive", "effort") and latent.place.startswith("drive"):
                sure &= at != 0  # a share of nothing
            axis.errorbar(
                k * at[sure], factor * m[sure], 1.96 * factor * s[sure],
                fmt="o", ms=2.4, lw=0.5, color=EXTENDED, ecolor=FAINT, alpha=0.8,
            )  # fmt: skip
        axis.axhline(0, color=TEXT, lw=0.7)
        axis.set_xlabel(f"{words} ({unit_there})")
        style(axis)
    return out


def section(d: Diagnosis, shapes: dict[str, bytes]) -> str:
    """The missing input of the balance that answers best for the misfit; nothing where nothing is missing."""
    if d.verdict == "adequate" or not d.missing:
        return ""
    best = _shown(d)
    names = list(dict.fromkeys(t.recording for t in d.traces))
    shapes["missing"] = plot.png(figure(best, names))
    follows = ", ".join(
        f"{v.replace('_', ' ')} ({percent(share)})" for v, share in best.depends_on[:3] if share >= 0.05
    )
    lead = (
        "Before any name is given: what would have to be added to each balance of the base model, or to a reading, for "
        "it to meet the recordings, as a smooth function of time. "
        f"Drawn here: {_words(best)[0].lower() + _words(best)[1:]}"
    )
    lead += f"; how much of it goes with one variable alone: {follows}." if follows else "."
    rows = [
        (_words(m), m.subsystem, percent(m.explained), number(m.evidence, 3), f"{number(m.length_s, 2)} s")
        for m in d.missing
    ]
    head = ("Where", "Balance", "Share of the misfit that it can answer for", "Evidence (nats)", "Varies over")
    caption = (
        "Estimate with its 95 % band over time, and against the variable that explains most of it. The band is of what "
        "no other values of the base model's own parameters would take up. A latent force model: a Gaussian process as "
        "an input of the base model."
    )
    return page.section(
        "What is missing, before it is named",
        page.text(lead),
        page.figure(shapes["missing"], caption),
        page.table(head, rows, (2, 3, 4)),
        page.text(f"All of them over time, with their standard deviations, in {TABLE}.", "small soft"),
    )


def write_table(d: Diagnosis, out: Path) -> None:
    """Write `TABLE`: of every place the estimate and its standard deviation, in SI, a line for each time; where nothing
    is missing, what an earlier diagnosis wrote into this folder goes.
    """
    if d.verdict == "adequate" or not d.missing:
        (out / TABLE).unlink(missing_ok=True)
        return
    names = list(dict.fromkeys(t.recording for t in d.traces))
    text = io.StringIO()
    writer = csv.writer(text, lineterminator="\n")
    writer.writerow(("place", "unit", "recording", "time_s", "mean", "std"))
    for m in d.missing:
        for name, *columns in zip(names, m.time, m.mean, m.std, strict=True):
            writer.writerows((m.place, m.unit, name, *(f"{v:.6g}" for v in at)) for at in zip(*columns, strict=True))
    write_text(out / TABLE, text.getvalue())


def _shown(d: Diagnosis) -> Latent:
    here = [m for m in d.missing if m.subsystem == d.location.subsystem]
    return (here or list(d.missing))[0]


def learned(d: Diagnosis, shapes: dict[str, bytes]) -> str:
    """A card with what was learned where no name was earned, or beside names whose law differs in form; a curve is
    drawn (``shapes["closure"]``).
    """
    c = d.closure
    if c is None:
        return ""
    corrects = d.verdict == "explained"
    is_law = any(m.law == FREE for m in d.mechanisms)
    place = escape(c.place.removeprefix("learned_").replace("_", " "))
    form = next((f for f in _FORMS if c.place.endswith(f)), "sum of terms" if c.curve is None else "smooth curve")
    why = (
        f"The mechanism named follows no law of the catalogue; this {form} is its law."
        if is_law
        else f"The mechanisms named explain nearly all of the misfit; this {form} corrects the form of their laws."
        if corrects
        else f"No mechanism of the catalogue is named for it, but this {form} does better than none."
    )
    why += _FORMS[form][0] if form in _FORMS else ""
    head = "The law" if is_law else "Correction" if corrects else "Learned, not named"
    error = "; ± is one standard error" * ("±" in c.expression)
    drawn, other = "", " or ".join(c.equivalents)
    if c.curve is not None:
        shapes["closure"] = plot.png(curve(c.curve))
        near = f" The dashed line is the expression, with {percent(c.curve.share)} of its variation." * bool(
            c.curve.expression
        )
        what = _FORMS[form][1] if form in _FORMS else "The curve s that was learned"
        drawn = page.figure(shapes["closure"], f"{what}, with its 95 % band.{near}")
    return "\n".join(
        (
            '<div class="card">',
            f"<header><h3>{head}: {place}</h3>"
            f'<span class="soft small">removes {percent(max(c.held_out_gain, 0.0))} of the held-out misfit · fall of '
            f"the BIC {number(c.delta_bic, 3)}</span></header>",
            page.text(
                f"{why} It was fitted through the simulation and judged on what was held out{error}. "
                "It holds in the range of these recordings only."
            ),
            f'<div class="equation">{escape(c.expression)}</div>',
            drawn,
            page.text(f"These recordings cannot tell it from {other}.") if other else "",
            "</div>",
        )
    )


def curve(c: Drawn) -> Figure:
    """A learned curve with its 95 % band over its variable, and the expression that comes close to it."""
    out = new_figure(6.2, 2.7)
    axis = out.subplots()
    axis.fill_between(c.at, c.value - 1.96 * c.std, c.value + 1.96 * c.std, color=EXTENDED, alpha=0.22, lw=0)
    axis.plot(c.at, c.value, color=EXTENDED, lw=1.6, label="learned")
    if c.expression:
        axis.plot(c.at, c.near, color=TEXT, lw=1.1, ls="--", label=f"s ≈ {c.expression}")
    axis.axhline(0, color=FAINT, lw=0.8)
    axis.set_xlabel(f"{_UNITS[c.variable][0]} ({c.at_unit})")
    axis.set_ylabel(f"{c.product} ({c.unit})" if c.variable == "frequency" else f"s in {c.product} ({c.unit})")
    axis.legend(frameon=False, fontsize=8)
    style(axis)
    out.tight_layout()
    return out
