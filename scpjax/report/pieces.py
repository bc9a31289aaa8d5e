"""What the pages of a diagnosis, a fit and a fleet share, and how files are written."""

from __future__ import annotations

import json
import math
import shlex
from collections.abc import Mapping, Sequence
from html import escape
from pathlib import Path
from typing import Any

import numpy as np

import scpjax
from scpjax.fit.ambient import rooms
from scpjax.fit.data import sigma_by_output
from scpjax.fit.result import Estimate, Trace
from scpjax.physics.catalogue import catalogue
from scpjax.physics.structure import Structure
from scpjax.recordings.files import write_text
from scpjax.recordings.recording import Recording
from scpjax.report import page, plot
from scpjax.report.numbers import column, estimate, interval, number, unit

_SHOWN = 4  # recordings whose overlay is in the page; all are in figures/


def model_extra(recordings: Sequence[Recording], noise: Mapping[str, float], structure: Structure) -> dict[str, Any]:
    """What is kept beside a model fitted on these recordings, so that it can be used on others; where none of them told
    how warm its room was, what was taken for that.
    """
    if not recordings:
        return {}
    first = recordings[0]
    extra: dict[str, Any] = {
        "drive": [c.column for c in first.input_channels],
        "response": list(dict.fromkeys(c.column for r in recordings for c in r.output_channels)),
        "hold": first.hold,
        "recordings": [r.metadata.path or r.metadata.name for r in recordings],
        "noise": dict(noise),
    }
    taken = rooms(recordings, structure, sigma_by_output(structure, noise).get(0, 0.0))
    if taken:
        extra["rooms_K"] = taken
    if first.metadata.supply_V is not None:
        extra["supply_V"] = first.metadata.supply_V
    return extra


def command_line(words: Sequence[str]) -> str:
    """The words of a call as a line for a shell."""
    parts = [shlex.quote(w) for w in ("scpjax", *words)]
    if len(" ".join(parts)) < 90:
        return " ".join(parts)
    lines = [" ".join(parts[:2])]
    for part in parts[2:]:
        joins = lines[-1].lstrip().startswith("--") and not part.startswith("--") and " " not in lines[-1].strip()
        lines = [*lines[:-1], f"{lines[-1]} {part}"] if joins else [*lines, f"  {part}"]
    return " \\\n".join(lines)


def heading(kind: str, badge: str, colour: str, says: str, files: str) -> str:
    where = f"<span>{escape(files)}</span>" if files else ""
    return (
        f'<div class="kicker"><span>{kind}</span><span class="badge {colour}">{escape(badge)}</span>'
        f"{where}</div>"
        f"<h1>{escape(says)}</h1>"
    )


def fact(name: str, before: float | None, after: float, what: str, noise: float | None = None) -> tuple[str, str, str]:
    """An error of a column for ``page.facts``: (words, before, after)."""
    words, u = column(name)
    beside = f" (noise {number(noise, 2)} {u})" if noise else ""
    old = "" if before is None else number(before, 3)
    return f"{words}, {what}{beside}", old, f"{number(after, 3)} {u}".strip()


def overlays(traces: Sequence[Trace], noise: Mapping[str, float], labels: tuple[str, str]) -> dict[str, bytes]:
    """Overlay figures by file stem, in the order of the recordings."""
    out: dict[str, bytes] = {}
    for name in dict.fromkeys(t.recording for t in traces):
        mine = [t for t in traces if t.recording == name]
        stem = "".join(c if c.isalnum() or c in "-_" else "_" for c in name) or "recording"
        while f"overlay_{stem}" in out:
            stem += "_"
        out[f"overlay_{stem}"] = plot.png(plot.overlay(mine, noise=noise, labels=labels))
    return out


def overlay_figures(files: Mapping[str, bytes], traces: Sequence[Trace], both: bool) -> str:
    names = list(dict.fromkeys(t.recording for t in traces))
    parts = []
    for name, image in list(zip(names, files.values(), strict=True))[:_SHOWN]:
        models = "base (orange) and extended model (blue)" if both else "model (blue)"
        parts.append(
            page.figure(
                image,
                f"{name}: measured (grey) against the {models}; residuals with ± 2 noise, and the drive.",
            )
        )
    if len(names) > _SHOWN:
        parts.append(page.text(f"All {len(names)} recordings are in the folder figures.", "small soft"))
    return "\n".join(parts)


def row(key: str, e: Estimate) -> tuple[str, str, str, str, str]:
    words = e.description or key.replace("_", " ").replace(".", ": ")
    words = words[:1].upper() + words[1:]
    side = f" ({key.split('@')[1]})" if "@" in key else ""
    return (
        words + side,
        e.symbol,
        estimate(e.value, e.std, e.low, e.high, e.at_limit),
        interval(e.low, e.high, e.at_limit),
        unit(e.unit),
    )


def parameters_table(parameters: Mapping[str, Estimate]) -> str:
    rows = [(*row(k, e), k) for k, e in parameters.items()]
    return page.table(("Parameter", "", "Estimate", "95 % interval", "Unit", "Name"), rows, (2,), tight=(3, 4))


def notes_of_all(notes: Mapping[str, Sequence[str]]) -> list[str]:
    """Notes of many actuators, by name: each sentence once, with those that it is of where these are not all."""
    by_note: dict[str, list[str]] = {}
    for name, said in notes.items():
        for note in dict.fromkeys(said):
            by_note.setdefault(note, []).append(name)
    return [n if len(who) == len(notes) > 1 else f"{', '.join(who)}: {n}" for n, who in by_note.items()]


def reproduce(command: str, settings: Mapping[str, Any], seconds: float, recordings: Sequence[Recording]) -> str:
    files = [r.metadata.path or r.metadata.name for r in recordings]
    line = page.text("Run again with:") + f"<pre>{escape(command)}</pre>" if command else ""
    rows = [("scpjax", scpjax.__version__), ("Time taken", f"{number(seconds, 2)} s")]
    rows += [("Files", ", ".join(files))] if files else []
    rows += [
        (k.replace("_", " ").capitalize(), _plain(v)) for k, v in settings.items() if k != "files" and v is not None
    ]
    return page.section("How to make this again", line, page.table((), rows, tight=(0,)))


def title(name: str) -> str:
    return catalogue()[name].title if name in catalogue() else name


def sentence(words: str) -> str:
    first = words.split(" ", 1)[0]
    name = "." in first or "_" in first  # of a parameter: as it is written elsewhere
    return (words if name else words[:1].upper() + words[1:]) + ("" if words.endswith(".") else ".")


def file_names(recordings: Sequence[Recording]) -> str:
    return ", ".join(r.metadata.name or "recording" for r in recordings)


def write_json(path: Path, content: Mapping[str, Any]) -> None:
    write_text(path, json.dumps(_clean(content), indent=1, ensure_ascii=False, allow_nan=False) + "\n")


def write_figures(out: Path, shapes: Mapping[str, bytes]) -> None:
    (out / "figures").mkdir(parents=True, exist_ok=True)
    for name, image in shapes.items():
        (out / "figures" / f"{name}.png").write_bytes(image)


def write_page(out: Path, title: str, body: Sequence[str]) -> Path:
    write_text(out / "report.html", page.page(title, body))
    return out / "report.html"


def _plain(value: Any) -> str:
    if isinstance(value, Mapping):
        return ", ".join(f"{k.replace('_', ' ')} {_plain(v)}" for k, v in value.items())
    return f"{value:g}" if isinstance(value, float) else str(value)


def _clean(value: Any) -> Any:
    """Plain JSON values; what is not finite becomes null."""
    if isinstance(value, Mapping):
        return {str(k): _clean(v) for k, v in value.items()}
    if isinstance(value, list | tuple):
        return [_clean(v) for v in value]
    if isinstance(value, np.ndarray):
        return _clean(value.tolist())
    if isinstance(value, np.generic):
        return _clean(value.item())
    return None if isinstance(value, float) and not math.isfinite(value) else value
