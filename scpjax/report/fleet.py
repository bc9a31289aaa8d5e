"""The page of a fleet that was diagnosed: which effects in which, what spreads, what is not like the others."""

from __future__ import annotations

import csv
import io
import math
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.figure import Figure
from matplotlib.patches import Patch

import scpjax
from scpjax.diagnose.fleet import TABLE, Member, Outlier, Spread, effects, not_compared, summary
from scpjax.diagnose.shared_effect import Sharing
from scpjax.fit.result import Estimate
from scpjax.recordings.files import write_text
from scpjax.report import bars, page, plot
from scpjax.report.numbers import column, interval, number, percent, unit
from scpjax.report.pieces import (
    heading,
    notes_of_all,
    reproduce,
    sentence,
    title,
    write_figures,
    write_json,
    write_page,
)
from scpjax.report.plot import EXTENDED, FAINT, GRID, TEXT, new_figure
from scpjax.report.shared import plain, section, shared_values

_VERDICTS = {"adequate": "#00734f", "explained": EXTENDED, "unexplained": "#a63d00"}
_MANY = 60  # actuators, with more of which rows carry no names


def write_fleet_diagnosis(
    members: Sequence[Member],
    found: Sequence[Spread],
    odd: Sequence[Outlier],
    out_dir: str | Path,
    *,
    shared: Sharing | None = None,
    command: str = "",
) -> Path:
    """Write fleet.csv (a row per actuator), fleet.json, figures/*.png and report.html; the path of the report."""
    out = Path(out_dir)
    shared = shared or Sharing()
    write_json(out / "fleet.json", _json(members, found, odd, shared))
    write_text(out / TABLE, _csv(members))
    whole = [m for m in members if m.content is not None]
    unlike = page.bullets([f"{o.name}: {sentence(o.says)}" for o in odd])
    shapes = {"effects": plot.png(matrix(whole))}
    values = {s.key: [_estimate(s.estimates.get(m.name)) for m in whole] for s in found}
    if values:
        shapes["spread"] = plot.png(bars.spread(values, [m.name for m in whole], shared_values(found, shared)))
    write_figures(out, shapes)
    says = (*summary(members, found), *(e.says for e in shared.effects))
    left = sum(m.verdict == "unexplained" for m in whole)
    failed = [m for m in members if m.content is None]
    badge = f"{len(whole)} diagnosed" + (f", {len(failed)} not" if failed else "")
    seconds = sum(float((m.content or {}).get("seconds", 0.0)) for m in whole)
    body = [
        heading("Fleet", badge, "unexplained" if left or failed else "explained", says[0], ""),
        *(page.text(s) for s in says[1:]),
        page.section("Which effects are in which", page.figure(shapes["effects"], _EFFECTS), _effects_table(whole)),
        page.section("Not like the others", unlike or _none(whole)),
        page.section("Shared by the fleet", *section(shared)),
        page.section(
            "How the parameters spread",
            _spread_table(found),
            page.text(_SPREAD, "small soft") if found else "",
            page.text(_stated_for(found), "small soft"),
            page.figure(shapes["spread"], _VALUES) if values else "",
        ),
        page.section("Each actuator", _each(whole)),
        page.section("Not diagnosed", page.bullets([f"{m.name}: {m.failure}" for m in failed])),
        page.section("Notes", page.bullets(notes_of_all({m.name: m.notes for m in whole}))),
        reproduce(command, {}, seconds, ()),
    ]
    return write_page(out, "scpjax fleet: diagnosed", body)


_EFFECTS = (
    "Each row is an actuator, each column a mechanism named in at least one. Dark: named, with its probability; light: "
    "could stand in for one that was named."
)
_SPREAD = (
    "Scatter: what is left of the spread between actuators when the errors of the estimates are taken out, as a share "
    "of the median. Mean: of the fleet that these are a sample of, each weighed by its error and the scatter; where "
    "nothing scatters, what all share. p: of values this far apart or farther if all were the same (Cochran's Q)."
)
_BY_FORM = "* By its law as the catalogue has it far less likely; not told apart only if its law has a different form."
_VALUES = (
    "Each actuator's value with its 95 % interval; the dashed line is the median, a band what one set of values for "
    "all makes it, with its interval."
)


def matrix(members: Sequence[Member]) -> Figure:
    """Actuators by mechanisms: what was named in which, and the verdict at the right."""
    named = list(effects(members))
    rows, columns = len(members), len(named)
    few = rows <= _MANY
    tall = max(0.24 * rows, 0.6) if few else min(0.06 * rows + 2, 9.0)
    figure = new_figure(8.6, tall + 1.35)
    left, right = 0.2 if few else 0.07, 0.97
    axis = figure.add_axes((left, 0.12 / figure.get_figheight(), right - left, tall / figure.get_figheight()))
    for j, name in enumerate(named):
        for i, m in enumerate(members):
            chance = m.effects.get(name)
            if chance is not None:
                axis.add_patch(_cell(j, i, EXTENDED, 0.35 + 0.65 * min(max(chance, 0.0), 1.0)))
                if few:
                    words = percent(chance)
                    axis.text(j, i, words, ha="center", va="center", fontsize=7, color="white")
            elif name in m.equivalents:
                axis.add_patch(_cell(j, i, EXTENDED, 0.18))
    for i, m in enumerate(members):
        axis.add_patch(_cell(columns + 0.25, i, _VERDICTS.get(m.verdict, FAINT), 1.0))
        if few:
            axis.text(columns + 0.25, i, m.verdict, ha="center", va="center", fontsize=6.5, color="white")
    axis.set_xlim(-0.5, columns + 0.75)
    axis.set_ylim(rows - 0.5, -0.5)
    axis.set_xticks([*range(columns), columns + 0.25], [*(title(n) for n in named), "verdict"], rotation=30, ha="left")
    axis.xaxis.tick_top()
    axis.set_yticks(range(rows) if few else [], [m.name for m in members] if few else [])
    if not few:
        axis.set_ylabel(f"{rows} actuators", color=TEXT, fontsize=8.5)
        handles = [Patch(color=c, label=v) for v, c in _VERDICTS.items()]
        figure.legend(handles=handles, fontsize=7, loc="upper left", frameon=False, title="verdict", title_fontsize=7)
    axis.tick_params(length=0, labelsize=8, colors=TEXT)
    for side in axis.spines.values():
        side.set_color(GRID)
    return figure


def _cell(x: float, y: float, colour: str, strength: float) -> Any:
    from matplotlib.patches import Rectangle

    return Rectangle((x - 0.47, y - 0.42), 0.94, 0.84, facecolor=colour, alpha=strength, lw=0)


def _estimate(e: Mapping[str, Any] | None) -> Estimate | None:
    """An estimate out of a file, None where it has no value."""
    if e is None or e["value"] is None:
        return None
    std, low, high = (math.nan if e[k] is None else float(e[k]) for k in ("std", "low", "high"))
    return Estimate(float(e["value"]), std, str(e["unit"]), low, high, at_limit=bool(e.get("at_limit")))


def _none(whole: Sequence[Member]) -> str:
    few = len(whole) < 5
    return page.text("Too few actuators to tell." if few else "None: every actuator is like the others.")


def _effects_table(whole: Sequence[Member]) -> str:
    rows = []
    for name, having in effects(whole).items():
        stands = [m.name for m in whole if name in m.equivalents and name not in m.effects]
        chance = [m.effects[name] for m in whole if name in m.effects]
        rows.append(
            (title(name), name, f"{len(having)} of {len(whole)}", percent(min(chance)), ", ".join(stands) or "–")
        )
    head = ("Effect", "Name", "Named in", "Least probability", "Could stand in, too, in")
    return page.table(head, rows, (2, 3), tight=(1,))


def _spread_table(found: Sequence[Spread]) -> str:
    rows = []
    for s in found:
        error = s.std[np.isfinite(s.std)]
        typical = number(float(np.median(error)), 2) if error.size else "–"
        ends = interval(float(s.values.min()), float(s.values.max()))
        scatter = percent(s.relative) if s.relative < 1e3 else "–"
        shared = f"{number(s.mean[0])} ({interval(*s.mean[1:])})" if np.isfinite(s.mean[0]) else "–"
        rows.append((s.key, unit(s.unit), str(len(s.values)), number(s.median), ends, typical, shared, scatter, _p(s)))
    head = ("Parameter", "Unit", "In", "Median", "Range", "Typical error", "Mean (95 %)", "Scatter", "p")
    return page.table(head, rows, (2, 3, 7, 8))


def _stated_for(found: Sequence[Spread]) -> str:
    """For what values are stated that depend on that: their actuators' own values may be stated for others."""
    said = [f"{s.key} ({s.stated})" for s in found if s.stated]
    return f"Stated for the same in all: {', '.join(said)}." if said else ""


def _p(s: Spread) -> str:
    return "–" if np.isfinite(s.std).sum() < 2 else "< 0.001" if s.differs < 1e-3 else f"{s.differs:.3f}"


def _each(whole: Sequence[Member]) -> str:
    rows = []
    for m in whole:
        assert m.content is not None
        errors = []
        for name, before in m.content["base"]["held_out"].items():
            after = m.content["extended"]["held_out"].get(name, before)
            words, u = column(name)
            noise = m.content["base"]["noise"].get(name)
            beside = "" if noise is None else f", noise {number(noise, 2)}"
            errors.append(f"{words.lower()} {number(before['rmse'])} → {number(after['rmse'])}{beside} {u}".rstrip())
        named = [
            n + (f" ({x['law']})" if x["law"] else "") + "".join(f" or {e}{_by_form(x, e)}" for e in x["equivalents"])
            for n, x in _named(m).items()
        ]
        rows.append((m.name, m.verdict, ", ".join(named) or "–", "; ".join(errors)))
    table = page.table(("Actuator", "Verdict", "Left out", "Held-out error, base → extended"), rows, tight=(0, 1))
    by_form = any(x.get("equivalents_by_form") for m in whole for x in _named(m).values())
    return table + (page.text(_BY_FORM, "small soft") if by_form else "")


def _by_form(named: Mapping[str, Any], equivalent: str) -> str:
    """A mark at an equivalent whose law, as the catalogue has it, is clearly behind that of the name."""
    return " *" if equivalent in named.get("equivalents_by_form", ()) else ""


def _named(m: Member) -> dict[str, Mapping[str, Any]]:
    return {x["name"]: x for x in (m.content or {}).get("mechanisms", [])}


def _json(
    members: Sequence[Member], found: Sequence[Spread], odd: Sequence[Outlier], shared: Sharing
) -> dict[str, Any]:
    every = {
        m.name: {"failure": m.failure}
        if m.content is None
        else {k: m.content[k] for k in ("verdict", "says", "mechanisms", "parameters", "base", "extended", "seconds")}
        for m in members
    }
    return {
        "schema": "scpjax.fleet/1",
        "version": scpjax.__version__,
        "seconds": sum(float(v.get("seconds", 0.0)) for v in every.values()),
        "says": [*summary(members, found), *(e.says for e in shared.effects)],
        "actuators": every,
        "effects": {k: list(v) for k, v in effects(members).items()},
        "outliers": [vars(o) for o in odd],
        "spread": {
            s.key: {
                "unit": s.unit,
                "median": s.median,
                "mean": dict(zip(("value", "low", "high"), s.mean, strict=True)),
                "n": len(s.values),
                "scatter": s.relative,
                "p": s.differs,
                "law": s.law,
                "references": dict(s.references),
            }
            for s in found
        },
        "not_compared": list(not_compared(members)),
        "shared": [plain(e) for e in shared.effects],
        "shared_left_out": dict(shared.left_out),
    }


def _csv(members: Sequence[Member]) -> str:
    """As each diagnosis states them; for what, and under which law, in the columns after the message."""
    keys = list(dict.fromkeys(k for m in members for k in m.parameters))
    text = io.StringIO()
    writer = csv.writer(text, lineterminator="\n")
    cells = [part for k in keys for part in (k, f"{k}_std")]
    stated = list(dict.fromkeys(k for m in members for k in _stated(m)))
    writer.writerow(["actuator", "status", "verdict", "mechanisms", *cells, "message", *stated])
    for m in members:
        if m.content is None:
            writer.writerow([m.name, "failed", "", "", *[""] * len(cells), m.failure, *[""] * len(stated)])
            continue
        row: list[object] = [m.name, "ok", m.verdict, " ".join(m.effects)]
        for key in keys:
            e = m.parameters.get(key, {})
            row += ["" if e.get(part) is None else repr(float(e[part])) for part in ("value", "std")]
        writer.writerow([*row, m.content["says"], *(_stated(m).get(k, "") for k in stated)])
    return text.getvalue()


def _stated(m: Member) -> dict[str, str]:
    """Law of each mechanism named, and the references for which its parameters are stated, by column."""
    out = {}
    for name, (law, references) in m.stated.items():
        out[f"{name}.law"] = law
        out |= {f"{name}.{k}": repr(float(r["value"])) for k, r in references.items()}
    return out
