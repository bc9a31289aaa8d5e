"""``scpjax diagnose --next`` and ``--then``: limits of the next experiment, and the diagnosis that comes after it."""

from __future__ import annotations

import json
from argparse import Namespace
from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

from scpjax.cli.program import OutputError, say
from scpjax.diagnose.profiles import Limits
from scpjax.diagnose.proposal import CSV_NAME, NO_EXPERIMENT
from scpjax.diagnose.result import Diagnosis
from scpjax.errors import RecordingError
from scpjax.recordings.recording import Recording, place
from scpjax.report.numbers import number, percent


@dataclass(frozen=True)
class Read:
    """What was read for a diagnosis, and how: enough to read it again."""

    files: list[str]
    drive: str | None
    response: str | None
    model: str | None
    mechanisms: list[str]  # files of the user's own
    base: str | None = None  # file of the user's own base model

    def to_json(self) -> dict[str, Any]:
        """Only what was told; the files stand beside it."""
        told = {"drive": self.drive, "response": self.response, "model": self.model, "mechanisms": self.mechanisms}
        told["base"] = self.base
        return {k: v for k, v in told.items() if v}


@dataclass(frozen=True)
class Earlier:
    """A diagnosis in a folder: what it read, and the probability of each mechanism."""

    read: Read
    probabilities: dict[str, float]


def earlier(out: Path) -> Earlier | None:
    """The diagnosis in a folder; None where there is none.

    **Raises** `RecordingError` for a diagnosis.json that cannot be read.
    """
    path = out / "diagnosis.json"
    if not path.is_file():
        return None
    try:
        content = json.loads(path.read_text(encoding="utf-8"))
        settings = content["settings"]
        told = settings.get("read", {})
        files = list(dict.fromkeys(settings["files"]))  # a long file was read in pieces
        own = (list(told.get("mechanisms", [])), told.get("base"))
        read = Read(files, told.get("drive"), told.get("response"), told.get("model"), *own)
        return Earlier(read, _probabilities(content["ranking"], content["mechanisms"]))
    except (OSError, ValueError, KeyError, TypeError, AttributeError) as error:
        raise RecordingError(
            "is not a diagnosis that can be added to", where=str(path), mend="diagnose all files together"
        ) from error


def with_earlier(arguments: Namespace, before: Earlier | None, out: Path) -> Read:
    """What to read for a call: its files, with ``--then`` after them; without files those of the earlier diagnosis.

    **Raises** `RecordingError` where there is nothing to read or earlier files are gone; `OutputError` where the
    call would write over one of its files.
    """
    files = list(arguments.files)
    own = (list(arguments.mechanism), arguments.base)
    read = Read(files, arguments.drive, arguments.response, arguments.model, *own)
    if arguments.then and not files:
        if before is None:
            raise RecordingError(
                "no earlier diagnosis there to add to",
                where=f"--out {out}",
                mend="name the earlier recordings too: scpjax diagnose OLD.csv --then NEW.csv --out DIR",
            )
        for file in before.read.files:
            if not Path(file).is_file():
                raise RecordingError(
                    "was read by the earlier diagnosis and is not found from here",
                    where=file,
                    mend="run this where that was run, or name the earlier files before --then",
                )
        old = before.read
        mechanisms = list(dict.fromkeys([*old.mechanisms, *read.mechanisms]))
        by = read if read.model or read.base else old  # a model told now takes the place of a base then, and vice versa
        told = (read.drive or old.drive, read.response or old.response, by.model)
        read = Read(old.files, *told, mechanisms, by.base)
    if not read.files:
        arguments.parser.error("the following arguments are required: FILE")
    read = replace(read, files=[*read.files, *arguments.then])
    for file in read.files:
        if Path(file).resolve() == (out / CSV_NAME).resolve():
            raise OutputError(
                "is where the next experiment is written", where=file, mend="copy what was recorded to another name"
            )
    return read


def limits_of(arguments: Namespace, recordings: Sequence[Recording]) -> Limits | None:
    """The limits of the next experiment in SI; None where none is asked for.

    **Raises** `RecordingError` for volts where the drive is none.
    """
    told = ("max_volts", "min_volts", "max_drive", "min_drive", "max_temperature", "duration", "period", "slew")
    if not (arguments.next or any(getattr(arguments, name) is not None for name in told)):
        return None
    channel = recordings[0].input_channels[0]
    volts = [name for name in ("max_volts", "min_volts") if getattr(arguments, name) is not None]
    if volts and channel.unit.quantity != "voltage":
        raise RecordingError(
            f"the drive {channel.column} is not in volts",
            where=place(recordings[0].metadata),
            mend=f"give --max-drive and --min-drive in {channel.unit.suffix}",
        )

    def end(which: str) -> float | None:
        value, in_volts = getattr(arguments, f"{which}_drive"), getattr(arguments, f"{which}_volts")
        if in_volts is not None:
            return in_volts
        return None if value is None else channel.unit.to_si(value)

    hottest = arguments.max_temperature
    return Limits(
        lowest=end("min"),
        highest=end("max"),
        hottest=None if hottest is None else hottest + 273.15,
        duration=arguments.duration,
        period=arguments.period,
        slew=None if arguments.slew is None else arguments.slew * channel.unit.scale,
    )


def _probabilities(ranking: Sequence[Any], mechanisms: Sequence[Any]) -> dict[str, float]:
    """Greatest probability that each mechanism was given in any round; of those named, their own."""
    out: dict[str, float] = {}
    for r in ranking:
        out[r["name"]] = max(out.get(r["name"], 0.0), float(r["probability"]))
    return out | {m["name"]: float(m["probability"]) for m in mechanisms}


def probability_changes(before: Earlier, found: Diagnosis) -> list[str]:
    """Sentences on how the probabilities of the mechanisms changed with the new recordings; likeliest first."""
    content = found.to_json()
    now = _probabilities(content["ranking"], content["mechanisms"])
    names = sorted({*now, *before.probabilities}, key=lambda n: -max(now.get(n, 0.0), before.probabilities.get(n, 0.0)))
    out = []
    for name in names:
        old, new = before.probabilities.get(name, 0.0), now.get(name, 0.0)
        if max(old, new) > 0.01:
            out.append(f"With the new recordings, probability of {name}: {percent(old)} → {percent(new)}.")
    return out


def say_next(arguments: Namespace, d: Diagnosis, *, asked: bool) -> None:
    """The next experiment in the terminal; a word on how to get one where mechanisms were not told apart."""
    e = d.next_experiment
    if e is not None:
        say(arguments, f"\nnext experiment: {e.says}")
        say(arguments, f"  {e.standard}, within the same limits, would bring {number(e.standard_bits, 3)} bits")
    elif failed := next((n for n in d.notes if n.startswith(NO_EXPERIMENT)), ""):
        say(arguments, f"\n{failed}")
    elif asked:
        say(arguments, "\nnext experiment: none; no two hypotheses are close, or none within these limits parts them")
    elif any(m.equivalents or m.as_well for m in d.mechanisms):
        say(arguments, "\n--next designs the experiment that tells them apart (limits: --max-volts, --duration, ...)")
