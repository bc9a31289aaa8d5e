"""The pages of a fit and of a fleet, and their numbers as JSON and CSV."""

from __future__ import annotations

import csv
import io
import math
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np

import scpjax
from scpjax.diagnose.fleet import TABLE
from scpjax.fit.fleet import Fleet
from scpjax.fit.result import Estimate, Fit
from scpjax.physics.storage import save_model
from scpjax.recordings.files import write_text
from scpjax.recordings.recording import Recording
from scpjax.report import bars, page, plot
from scpjax.report.numbers import column, number, unit
from scpjax.report.pieces import (
    fact,
    file_names,
    heading,
    model_extra,
    notes_of_all,
    overlay_figures,
    overlays,
    parameters_table,
    reproduce,
    sentence,
    write_figures,
    write_json,
    write_page,
)


def write_fit(
    fit: Fit, out_dir: str | Path, *, recordings: Sequence[Recording] = (), command: str = "", before: str = ""
) -> Path:
    """Write fit.json, model.json, figures/*.png and report.html; the path of the report.

    ``before`` is a section (`scpjax.report.page.section`) that stands before the parameters.
    """
    out = Path(out_dir)
    write_json(out / "fit.json", {"schema": "scpjax.fit/1", "version": scpjax.__version__, **fit_json(fit)})
    save_model(fit.model, out / "model.json", extra=model_extra(recordings, fit.noise, fit.model.structure))
    files = overlays(fit.traces, fit.noise, ("fit", "fit"))
    write_figures(out, files)
    s = fit.model.structure
    verdict = "converged" if fit.converged else "not converged"
    level = max((fit.scores[c]["rmse"] / fit.noise[c] for c in fit.scores if fit.noise.get(c)), default=math.nan)
    said = f"The {s.name} model leaves a misfit of {number(level, 2)} times the noise."
    if math.isfinite(level) and level < 1.15:
        said = f"The {s.name} model fits these recordings down to their noise."
    body = [
        heading("Fit", verdict, "explained" if fit.converged else "unexplained", said, file_names(recordings)),
        page.facts([fact(c, None, v["rmse"], "error", fit.noise.get(c)) for c, v in fit.scores.items()]),
        before,
        page.section("Parameters", parameters_table(fit.parameters), _held(fit)),
        page.section(
            "What these recordings leave open",
            page.bullets([sentence(s) for s in dict.fromkeys(fit.not_identifiable)]),
        ),
        page.section(
            "Fit and recordings",
            _fit_scores(fit.scores, fit.noise),
            overlay_figures(files, fit.traces, False),
        ),
        page.section("Notes", page.bullets(fit.notes)),
        reproduce(command, {}, fit.seconds, recordings),
    ]
    return write_page(out, f"scpjax fit: {s.name}", body)


def fit_json(fit: Fit) -> dict[str, Any]:
    """A fit as plain values."""
    return {
        "model": fit.model.structure.name,
        "converged": fit.converged,
        "rank": fit.rank,
        "free_parameters": fit.n_free,
        "parameters": {k: e.to_dict() for k, e in fit.parameters.items()},
        "known": {k: float(fit.model.value(k)) for k in fit.known},
        "scores": fit.scores,
        "noise": fit.noise,
        "not_identifiable": list(fit.not_identifiable),
        "notes": list(fit.notes),
        "seconds": fit.seconds,
    }


def _held(fit: Fit) -> str:
    if not fit.known:
        return ""
    units = {s.key: fit.model.structure.unit_of(s.parameter) for s in fit.model.structure.slots}
    shown = ", ".join(f"{k} = {number(float(fit.model.value(k)), 4)} {unit(units[k])}".strip() for k in fit.known)
    return page.text(f"Held as known: {shown}.", "small soft")


def _fit_scores(scores: Mapping[str, Mapping[str, float]], noise: Mapping[str, float]) -> str:
    rows = []
    for name, s in scores.items():
        words, u = column(name)
        rows.append(
            (
                words,
                u,
                number(noise.get(name, math.nan), 2),
                number(s["rmse"]),
                number(s.get("mae", math.nan)),
                f"{number(s['nrmse'])} %",
            )
        )
    return page.table(("Column", "Unit", "Noise", "RMSE", "MAE", "NRMSE"), rows, (2, 3, 4, 5))


def write_fleet(fleet: Fleet, out_dir: str | Path, *, command: str = "") -> Path:
    """Write fleet.csv (a row per actuator), fleet.json, figures/spread.png and report.html; its path."""
    out = Path(out_dir)
    good = {n: f for n, f in zip(fleet.names, fleet.fits, strict=True) if isinstance(f, Fit)}
    failed = {n: f for n, f in zip(fleet.names, fleet.fits, strict=True) if isinstance(f, str)}
    every = {
        n: fit_json(f) if isinstance(f, Fit) else {"failure": f} for n, f in zip(fleet.names, fleet.fits, strict=True)
    }
    write_json(
        out / "fleet.json",
        {
            "schema": "scpjax.fleet/1",
            "version": scpjax.__version__,
            "seconds": fleet.seconds,
            "actuators": every,
        },
    )
    write_text(out / TABLE, _fleet_csv(fleet))
    keys = list(dict.fromkeys(k for f in good.values() for k in f.parameters))
    values = {k: [f.parameters.get(k) for f in good.values()] for k in keys}
    shapes = {"spread": plot.png(bars.spread(values, list(good)))} if keys else {}
    write_figures(out, shapes)
    said = f"{len(good)} of {len(fleet.fits)} actuators were fitted in {number(fleet.seconds, 2)} s."
    kind = "explained" if not failed else "unexplained"
    body = [
        heading("Fleet", f"{len(good)} fitted" + (f", {len(failed)} not" if failed else ""), kind, said, ""),
        page.section(
            "How the actuators differ",
            _fleet_table(values),
            page.figure(
                shapes["spread"],
                "Each actuator's value with its 95 % interval; the dashed line is the median.",
            )
            if shapes
            else "",
        ),
        page.section("How well each is fitted", _fleet_scores(good)),
        page.section("Not fitted", page.bullets([f"{n}: {why}" for n, why in failed.items()])),
        page.section("Notes", page.bullets(notes_of_all({n: f.notes for n, f in good.items()}))),
        reproduce(command, {}, fleet.seconds, ()),
    ]
    return write_page(out, "scpjax fleet", body)


def _fleet_table(values: Mapping[str, Sequence[Estimate | None]]) -> str:
    rows = []
    for key, estimates in values.items():
        v = np.array([e.value for e in estimates if e is not None])
        first = next(e for e in estimates if e is not None)
        middle, quartiles = float(np.median(v)), np.quantile(v, [0.25, 0.75])
        shown = [number(float(x)) for x in (middle, v.min(), v.max(), np.ptp(quartiles))]
        rows.append((key, first.symbol, unit(first.unit), *shown))
    head = ("Parameter", "", "Unit", "Median", "Least", "Greatest", "Interquartile range")
    return page.table(head, rows, (3, 4, 5, 6))


def _fleet_scores(good: Mapping[str, Fit]) -> str:
    names = list(dict.fromkeys(c for f in good.values() for c in f.scores))
    rows = [
        (
            n,
            *(number(f.scores[c]["nrmse"]) if c in f.scores else "–" for c in names),
            "yes" if f.converged else "no",
            "; ".join(dict.fromkeys(f.not_identifiable)) or "–",
        )
        for n, f in good.items()
    ]
    return page.table(
        ("Actuator", *(f"{column(c)[0]} (NRMSE, %)" for c in names), "Converged", "Left open"),
        rows,
        tuple(range(1, len(names) + 1)),
    )


def _fleet_csv(fleet: Fleet) -> str:
    good = [f for f in fleet.fits if isinstance(f, Fit)]
    keys = list(dict.fromkeys(k for f in good for k in f.parameters))
    names = list(dict.fromkeys(c for f in good for c in f.scores))
    text = io.StringIO()
    writer = csv.writer(text, lineterminator="\n")
    writer.writerow(
        ["actuator", "status"]
        + [part for k in keys for part in (k, f"{k}_std")]
        + [f"{score}_{c}" for c in names for score in ("rmse", "nrmse")]
        + ["message"]
    )
    for name, f in zip(fleet.names, fleet.fits, strict=True):
        if isinstance(f, str):
            writer.writerow([name, "failed", *[""] * (2 * len(keys) + 2 * len(names)), f])
            continue
        found = [f.parameters.get(k) for k in keys]
        row: list[object] = [name, "ok" if f.converged else "not converged"]
        row += [part for e in found for part in ((repr(e.value), repr(e.std)) if e else ("", ""))]
        row += [repr(f.scores[c][s]) if c in f.scores else "" for c in names for s in ("rmse", "nrmse")]
        writer.writerow([*row, "; ".join(f.not_identifiable)])
    return text.getvalue()
