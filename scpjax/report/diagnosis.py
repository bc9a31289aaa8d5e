"""The page of a diagnosis, and its numbers as JSON."""

from __future__ import annotations

import math
import re
from collections.abc import Mapping, Sequence
from html import escape
from pathlib import Path

from scpjax.diagnose.proposal import CSV_NAME
from scpjax.diagnose.result import Diagnosis, Named, Scores
from scpjax.physics.catalogue import catalogue
from scpjax.physics.storage import save_model
from scpjax.recordings.files import write_text
from scpjax.recordings.recording import Recording
from scpjax.report import bars, experiment, missing, page, plot
from scpjax.report.numbers import column, number, percent
from scpjax.report.pieces import (
    fact,
    heading,
    model_extra,
    overlay_figures,
    overlays,
    parameters_table,
    reproduce,
    row,
    sentence,
    title,
    write_figures,
    write_json,
    write_page,
)

_PLACES = {
    "drive": "the drive: between the recorded input and the wire",
    "thermoelectric": "the heat balance: what power comes in, what is stored and what is lost",
    "thermomechanical": "the force balance: what pulls, what resists, what gives way",
    "balance": "the balances of the base model",
    "sensor": "the sensor: between the actuator and the number that was recorded",
}


def write_diagnosis(
    diagnosis: Diagnosis, out_dir: str | Path, *, recordings: Sequence[Recording] = (), command: str = ""
) -> Path:
    """Write diagnosis.json, model.json, figures/*.png, report.html, and missing.csv where something is missing; the
    path of the report.

    ``command`` is the line that can be run to make them again.
    """
    d, out = diagnosis, Path(out_dir)
    write_json(out / "diagnosis.json", d.to_json())
    save_model(d.model, out / "model.json", extra=model_extra(recordings, d.base.noise, d.model.structure))
    base_label, after_label = _labels(d)
    files = overlays(d.traces, d.base.noise, (base_label, after_label))
    names = list(dict.fromkeys(t.recording for t in d.traces))
    ends = {t.recording: (float(t.time[0]), float(t.time[-1])) for t in d.traces}
    shapes = {**files}
    if d.location.windows or d.location.regimes or d.location.depends_on:
        shapes["misfit"] = plot.png(bars.misfit(d.location, names, ends))
    first = sorted((r for r in d.ranking if r.round == 1), key=lambda r: -r.delta_bic)[:16]
    if first:
        titles = {k: m.title for k, m in catalogue().items()}
        shapes["ranking"] = plot.png(bars.ranking(first, [m.name for m in d.mechanisms], titles))
    lacking = missing.section(d, shapes)
    learned = missing.learned(d, shapes)
    proposed = experiment.drawn(d.next_experiment)
    if d.next_experiment is not None and proposed is not None:
        shapes[_PROPOSED] = proposed
        write_text(out / CSV_NAME, d.next_experiment.csv())
    drop_old_proposal(d, out)
    missing.write_table(d, out)
    for name in {*_SOMETIMES} - {*shapes}:  # of an earlier diagnosis
        (out / "figures" / f"{name}.png").unlink(missing_ok=True)
    write_figures(out, shapes)
    cards = [_mechanism(m, d.only_by_form(m)) for m in d.mechanisms]
    body = [
        _diagnosis_head(d),
        _where(d, shapes),
        lacking,
        page.section("What was left out", *cards, _nothing_named(d), learned),
        page.section(
            "Before and after",
            _scores_table(d),
            overlay_figures(files, d.traces, _is_extended(d)),
        ),
        page.section(
            "What was tried",
            page.text(
                "Each mechanism was added to the base model and fitted. Evidence counts only where it also "
                "predicts the held-out stretches better. Probabilities here are of that evidence alone; that of a "
                "name above also counts how often such names were wrong where the truth was known."
            ),
            page.figure(shapes["ranking"], _RANKING_CAPTION) if "ranking" in shapes else "",
            _rounds(d),
        ),
        page.section("What these recordings cannot tell apart", *_cannot_tell(d)),
        experiment.section(d.next_experiment, proposed),
        page.section("Parameters of the extended model", parameters_table(d.base_parameters)),
        page.section("Notes", page.bullets(d.notes)),
        reproduce(command, d.settings, d.seconds, recordings),
    ]
    return write_page(out, f"scpjax diagnosis: {d.verdict}", body)


def drop_old_proposal(d: Diagnosis, out: Path) -> None:
    """Remove what an earlier diagnosis proposed into this folder, where this one proposes nothing: it would be played
    for nothing. A file of that name with more columns than the drive is a recording, and stays.
    """
    if d.next_experiment is not None:
        return
    (out / "figures" / f"{_PROPOSED}.png").unlink(missing_ok=True)
    path = out / CSV_NAME
    if path.is_file() and d.traces:
        with path.open("rb") as file:
            head = file.readline().strip()
        if head == ",".join(("time_s", *d.traces[0].drive_columns)).encode():
            path.unlink()


_PROPOSED = "next_experiment"  # name of its figure
_SOMETIMES = ("misfit", "ranking", "missing", "closure")  # names of figures that not every diagnosis has
_RANKING_CAPTION = (
    "First round: fall of the Bayesian information criterion (above 10 is very strong; logarithmic beyond "
    "10) and the part of the held-out misfit that each mechanism removes. In blue what was named."
)


def _is_extended(d: Diagnosis) -> bool:
    """Whether there is more in the model that is told than in the base model: what is named, or only learned."""
    return bool(d.mechanisms) or d.closure is not None


def _diagnosis_head(d: Diagnosis) -> str:
    items = []
    for name, before in d.base.held_out.items():
        after = d.extended.held_out.get(name, before)
        noise = d.base.noise.get(name)
        old = before["rmse"] if _is_extended(d) else None
        items.append(fact(name, old, after["rmse"], "held-out error", noise))
    files = ", ".join(dict.fromkeys(t.recording for t in d.traces))
    return heading("Diagnosis", d.verdict, d.verdict, d.says, files) + page.facts(items)


def _where(d: Diagnosis, shapes: Mapping[str, bytes]) -> str:
    """Where base model and recordings part."""
    where, words = d.location, column(d.location.column)[0].lower()
    if d.verdict == "adequate":
        lead = f"No stretch stands out; the residuals, largest in the {words}, are those of noise."
    else:
        places = dict.fromkeys((where.subsystem, *(m.subsystem for m in d.mechanisms)))
        lead = f"In {'; and in '.join(_PLACES.get(p, p) for p in places)}. It shows most in the {words}"
        lead += f", while {_regime(where.regimes)}." if where.regimes else "."
    strongest = [v for v, s in where.depends_on if s >= 0.15][:2]
    more = ""
    if strongest and d.verdict != "adequate":
        names = " and the ".join(v.replace("_", " ") for v in strongest)
        more = f"The residual goes with the {names}."
    if where.period_s:
        more = f"It swings with a period of {where.period_s:.3g} s, whatever the drive does. {more}"
    if where.period_m:
        more = f"It repeats with every {1e3 * where.period_m:.3g} mm of displacement. {more}"
    picture = ""
    if "misfit" in shapes:
        caption = "Misfit of the base model beyond the noise: when, in which regime, and what it follows."
        picture = page.figure(shapes["misfit"], caption)
    return page.section("Where", page.text(f"{lead} {more}".strip()), picture)


def _regime(regimes: Mapping[str, float]) -> str:
    name = max(regimes, key=lambda k: regimes[k])
    words = {
        "heating": "it heats up",
        "cooling": "it cools down",
        "rest": "it rests",
        "steady": "it is held steady",
        "reversal": "the motion reverses",
    }
    return f"{words.get(name, name)} ({percent(regimes[name])} of the misfit)"


def _of_form(m: Named, by_form: Sequence[str]) -> str:
    """Why some equivalents of the only name are that, though they look unlikely among what was tried."""
    if not by_form:
        return ""
    law, it, leaves = ("its law", "it", "it leaves") if len(by_form) == 1 else ("their laws", "them", "they leave")
    *others, last = (_quoted(title(e)) for e in by_form)
    whose = f"{', '.join(others)} and {last}" if others else last
    return (
        f" By {law} as the catalogue has {it}, {whose} would be far less likely; but {leaves} so little more of the "
        f"misfit than {_quoted(m.title)} that a law of a slightly different form may leave no more."
    )


def _quoted(said: str) -> str:
    return f'"{said[0].lower()}{said[1:]}"'


def _mechanism(m: Named, by_form: Sequence[str]) -> str:
    law = f" ({m.law.replace('_', ' ')})" if m.law else ""
    rows = [row(k, e) for k, e in m.parameters.items()]
    others = ""
    if m.equivalents:
        titles = ", ".join(title(e) for e in m.equivalents)
        others = page.text(f"These recordings do not tell it from: {titles}.{_of_form(m, by_form)}", "small")
    if m.as_well:
        begin = "Nor from" if m.equivalents else "These recordings do not tell it from"
        others += page.text(
            f"{begin} a term outside the catalogue: {' or '.join(m.as_well)}, with s a smooth curve.", "small"
        )
    return "\n".join(
        part
        for part in (
            '<div class="card">',
            f'<header><h3>{escape(m.title + law)}</h3><span class="soft small">probability '
            f"{percent(m.probability)} · <code>{escape(m.name)}</code></span></header>",
            page.text(f"{m.says} {m.differs}".rstrip()),
            page.table(("Parameter", "", "Estimate", "95 % interval", "Unit"), rows, (2,), tight=(3, 4)),
            _equation(m),
            page.text(m.stated, "small") if m.stated else "",
            others,
            page.text(f"Source: {m.source}", "soft small") if m.source else "",
            "</div>",
        )
        if part
    )


def _equation(m: Named) -> str:
    """The equation of a mechanism, a line for every law, that of the law which was found in bold."""
    if not m.equation:
        return ""
    lines = []
    for clause in re.split(r";\s+(?=laws? )|;\s{2,}", m.equation):
        found = m.law and clause.startswith((f"law {m.law}:", f"law {m.law},"))
        lines.append(f"<strong>{escape(clause)}</strong>" if found else escape(clause))
    return f'<div class="equation">{"<br>".join(lines)}</div>'


def _nothing_named(d: Diagnosis) -> str:
    if d.mechanisms:
        return ""
    if d.verdict == "adequate":
        return page.text("Nothing, at this noise: no mechanism of the catalogue earned its parameters.")
    return page.text("No mechanism of the catalogue explains it; none was given a name it has not earned.")


def _scores_table(d: Diagnosis) -> str:
    head = (
        "Column",
        "Unit",
        "Noise",
        "Base, fitted",
        "Base, held out",
        "Extended, fitted",
        "Extended, held out",
        "Fit",
    )
    rows = []
    for name, held in d.base.held_out.items():
        words, u = column(name)
        after = d.extended.held_out.get(name, {})
        rows.append(
            (
                words,
                u,
                number(d.base.noise.get(name, math.nan), 2),
                *(number(_rmse(s, name, held_out), 3) for s in (d.base, d.extended) for held_out in (False, True)),
                f"{number(held.get('nrmse', math.nan))} → {number(after.get('nrmse', math.nan))} %",
            )
        )
    what = page.text(
        f"Root mean square errors of the base model ({d.base.model}) and the extended one "
        f"({d.extended.model}), on what was fitted and on what was held out. Fit (held out): 100 % is "
        "perfect, 0 % no better than the mean.",
        "small soft",
    )
    return page.table(head, rows, (2, 3, 4, 5, 6, 7)) + what


def _rmse(s: Scores, name: str, held_out: bool) -> float:
    return (s.held_out if held_out else s.train).get(name, {}).get("rmse", math.nan)


def _rounds(d: Diagnosis) -> str:
    """The first few of each round, with their probabilities."""
    rows = []
    for round_ in sorted({r.round for r in d.ranking}):
        best = sorted((r for r in d.ranking if r.round == round_), key=lambda r: -r.delta_bic)[:5]
        rows += [
            (
                str(round_),
                title(r.name),
                number(r.delta_bic),
                percent(max(r.held_out_gain, 0.0)),
                percent(r.probability),
            )
            for r in best
        ]
    head = (
        "Round",
        "Added to what was named before",
        "Fall of the BIC",
        "Held-out misfit removed",
        "Probability",
    )
    return page.table(head, rows, (2, 3, 4))


def _cannot_tell(d: Diagnosis) -> list[str]:
    alike = [(m, (*(title(e) for e in m.equivalents), *m.as_well)) for m in d.mechanisms]
    apart = any(others for _, others in alike) and d.next_experiment is None
    parts = [
        page.bullets(
            [f"{m.title}, or {', or '.join(others)}. {_shown_by(m)}".rstrip() for m, others in alike if others]
        ),
        page.text(_TELL_APART) if apart else "",
        page.bullets([sentence(s) for s in dict.fromkeys(d.not_identifiable)]),
    ]
    if not any(parts):
        parts = [page.text("Nothing: every parameter is determined, and no other mechanism does as well.")]
    return parts


_TELL_APART = (
    "The same command with --next designs the experiment that tells them apart, within the limits of the rig "
    "(--max-volts, --duration and others), and writes the drive to play."
)


def _shown_by(m: Named) -> str:
    """In what a mechanism and those that stand beside it show, so far as the catalogue tells."""
    known = catalogue()
    said = [(known[n].title, known[n].excited_by) for n in (m.name, *m.equivalents) if n in known]
    return " ".join(f"What shows that {_quoted(t)}: {by}." for t, by in said if by)


def _labels(d: Diagnosis) -> tuple[str, str]:
    return "base model", "extended model" if _is_extended(d) else "model"
