"""``scpjax fleet``: many actuators, fitted at once, or each diagnosed in turn."""

from __future__ import annotations

import dataclasses
import glob
import hashlib
import json
from argparse import Namespace
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import scpjax
from scpjax.cli.inputs import read_files
from scpjax.cli.program import Progress, check_folder, progress, say, staged, start
from scpjax.cli.study import patience_of, say_doubts
from scpjax.cli.then import Read
from scpjax.diagnose.fleet import TABLE
from scpjax.diagnose.proposal import CSV_NAME
from scpjax.errors import FitError, RecordingError, ScpjaxError
from scpjax.recordings.recording import Recording

EACH = "actuators"
"""Folder below the output with a folder for every actuator diagnosed."""
_WRITTEN = {CSV_NAME, TABLE}  # by scpjax: no recordings, though they may lie beside some


@dataclasses.dataclass(frozen=True)
class _Job:
    """What is asked for, and of whom: files by actuator, what was read of them, and why some could not be."""

    arguments: Namespace
    out: Path
    actuators: dict[str, list[str]]
    read: dict[str, list[Recording]]
    failed: dict[str, str]
    model: str | None


def run_fleet(arguments: Namespace) -> None:
    """Fit, or diagnose, every actuator of a folder; one that cannot be read or fitted does not stop the others."""
    out = check_folder(arguments.out)
    if arguments.mechanism and not arguments.diagnose:
        arguments.parser.error("--mechanism is tried in a diagnosis: add --diagnose")
    if arguments.minutes and not arguments.diagnose:
        arguments.parser.error("--minutes is of a diagnosis: add --diagnose")
    actuators = find_actuators(arguments.where, out)
    if empty := empty_folders(arguments.where, out):
        say(arguments, f"no recordings (*.csv) in {', '.join(empty)}: not among the actuators")
    read: dict[str, list[Recording]] = {}
    failed: dict[str, str] = {}
    first: ScpjaxError | None = None
    for name, files in actuators.items():
        try:
            read[name] = read_files(files, drive=arguments.drive, response=arguments.response, model=arguments.model)
        except ScpjaxError as error:
            failed[name], first = str(error), first or error
    if not read:
        assert first is not None
        raise first
    start()
    job = _Job(arguments, out, actuators, read, failed, _model(arguments))
    if arguments.diagnose:
        _diagnose_all(job)
    else:
        _fit_all(job)


def _model(arguments: Namespace) -> str | None:
    """The model asked for; the user's files are in the catalogue from now on."""
    from scpjax.simulate.trial import use, use_base

    model = arguments.model if arguments.base is None else use_base(arguments.base).name
    for file in arguments.mechanism:
        use(file)
    return model


def _fit_all(job: _Job) -> None:
    from scpjax.fit.fleet import fit_fleet
    from scpjax.report.report import command_line, write_fleet

    with progress(job.arguments) as show:
        fleet = fit_fleet(list(job.read.values()), names=list(job.read), model=job.model, progress=show)
        by_name = dict(zip(fleet.names, fleet.fits, strict=True)) | job.failed
        fleet = dataclasses.replace(fleet, names=tuple(job.actuators), fits=tuple(by_name[n] for n in job.actuators))
        if all(isinstance(f, str) for f in fleet.fits):
            raise _none(job.actuators, str(fleet.fits[0]))
        with staged(job.out) as folder:
            write_fleet(fleet, folder, command=command_line(job.arguments.line))
    failures = {n: f for n, f in zip(fleet.names, fleet.fits, strict=True) if isinstance(f, str)}
    for f in fleet.fits:
        say_doubts(job.arguments, () if isinstance(f, str) else f.notes)
    say(job.arguments, f"{len(job.actuators) - len(failures)} of {len(job.actuators)} actuators fitted")
    _say_end(job, failures)


def _none(actuators: dict[str, list[str]], why: str) -> FitError:
    return FitError(f"none of {len(actuators)} actuators could be fitted; the first: {why}")


def _say_end(job: _Job, failures: dict[str, str]) -> None:
    for name, why in failures.items():
        say(job.arguments, f"  {name}: {why}")
    say(job.arguments, f"table: {job.out / TABLE}\nreport: {job.out / 'report.html'}")


def _diagnose_all(job: _Job) -> None:
    """Each actuator into a folder of its own, where those that lie there already are left alone; then a page of all,
    with what they share.
    """
    from scpjax.diagnose.fleet import Member, outliers, spreads, summary
    from scpjax.diagnose.shared import sharing
    from scpjax.report.fleet import write_fleet_diagnosis
    from scpjax.report.report import command_line

    members: dict[str, Member] = {}
    failed, kept = dict(job.failed), 0
    with progress(job.arguments) as show:
        for i, (name, recordings) in enumerate(job.read.items()):
            mark = fingerprint(job.actuators[name], job.arguments)
            content = finished(_place(job, name), mark)
            kept += content is not None
            try:
                if content is None:
                    content = _diagnose_one(job, name, recordings, mark, _told(show, name, i, len(job.read)))
                members[name] = Member(name, content)
            except ScpjaxError as error:
                failed[name] = str(error)
            except KeyboardInterrupt as stop:
                done = f"{len(members)} of {len(job.read)} actuators are in {job.out / EACH}"
                raise KeyboardInterrupt(f"{done}; the same call goes on from there") from stop
        every = [members.get(name) or Member(name, None, failed[name]) for name in job.actuators]
        if not members:
            raise _none(job.actuators, every[0].failure)
        found = spreads(every)
        odd = outliers(every, found)
        try:
            shared = sharing(every, job.read, (lambda text: show(text, 0.99)) if show else lambda text: None)
        except KeyboardInterrupt as stop:
            done = f"all {len(members)} actuators that could be diagnosed are in {job.out / EACH}"
            raise KeyboardInterrupt(f"{done}; the same call goes on from there") from stop
        with staged(job.out) as folder:
            write_fleet_diagnosis(every, found, odd, folder, shared=shared, command=command_line(job.arguments.line))
    if kept:
        say(job.arguments, f"{kept} actuators had been diagnosed before and were not diagnosed again")
    for member in members.values():
        say_doubts(job.arguments, member.content["notes"] if member.content else ())
    for sentence in (*summary(every, found), *(e.says for e in shared.effects)):
        say(job.arguments, sentence)
    for o in odd:
        say(job.arguments, f"  {o.name}: {o.says}")
    _say_end(job, failed)


def _told(show: Progress | None, name: str, i: int, n: int) -> Progress | None:
    """Progress of the ``i``-th actuator of ``n`` as that of all."""
    return (lambda text, fraction: show(f"{name}: {text}", (i + fraction) / n)) if show else None


def _place(job: _Job, name: str) -> Path:
    return job.out / EACH / folder_name(name, job.actuators)


def _diagnose_one(
    job: _Job, name: str, recordings: Sequence[Recording], mark: str, show: Progress | None
) -> dict[str, Any]:
    """Diagnose an actuator into its folder; the diagnosis as JSON."""
    from scpjax.diagnose.diagnose import DiagnoseOptions, diagnose
    from scpjax.report.diagnosis import drop_old_proposal
    from scpjax.report.report import command_line, write_diagnosis

    told, place = job.arguments, _place(job, name)
    read = Read(job.actuators[name], told.drive, told.response, told.model, told.mechanism, told.base)
    options = DiagnoseOptions(patience=patience_of(told))
    found = diagnose(recordings, model=job.model, options=options, progress=show)
    found = dataclasses.replace(found, settings={**found.settings, "read": read.to_json(), "fingerprint": mark})
    with staged(place) as folder:
        write_diagnosis(found, folder, recordings=recordings, command=command_line(told.line))
        drop_old_proposal(found, place)
    return json.loads((place / "diagnosis.json").read_text(encoding="utf-8"))


def fingerprint(files: Sequence[str], arguments: Namespace) -> str:
    """What a diagnosis depends on, as one number: the files and those beside them, how they are read, the version."""
    digest = hashlib.sha256(scpjax.__version__.encode())
    told = (arguments.model, arguments.drive, arguments.response, patience_of(arguments))
    digest.update(json.dumps(told).encode())
    own = [f for f in (arguments.base, *arguments.mechanism) if f]
    for file in (*files, *own):
        for path in (Path(file), Path(file).with_suffix(".toml")):
            if path.is_file():
                digest.update(path.name.encode() + b"\0" + path.read_bytes())
    return digest.hexdigest()


def finished(folder: Path, mark: str) -> dict[str, Any] | None:
    """The diagnosis in a folder if it is whole and of these very files; else None."""
    try:
        content = json.loads((folder / "diagnosis.json").read_text(encoding="utf-8"))
        return content if content["settings"]["fingerprint"] == mark and (folder / "report.html").is_file() else None
    except (OSError, ValueError, KeyError, TypeError):
        return None


def folder_name(name: str, actuators: dict[str, list[str]]) -> str:
    """A name as that of a folder, its own among all."""
    plain = lambda n: "".join(c if c.isalnum() or c in "-_." else "_" for c in n).strip(".") or "actuator"  # noqa: E731
    before = [plain(n) for n in list(actuators)[: list(actuators).index(name)]]
    same = before.count(plain(name))
    return plain(name) + "_" * same


def find_actuators(where: str, out: Path) -> dict[str, list[str]]:
    """Files of every actuator by name: subfolders with CSV files, and CSV files that lie side by side."""
    matches = _matches(where)
    found = _by_name({path: names for path, names in _files(matches, out).items() if names})
    if not found:
        if not matches and not Path(where).exists():
            raise RecordingError("no such folder, and no file matches", where=where, mend="check the name")
        raise RecordingError(
            "no CSV files and no subfolders with CSV files", where=where, mend="name a folder of recordings"
        )
    return found


def empty_folders(where: str, out: Path) -> list[str]:
    """Folders among what is named in which there is no recording, but for those that scpjax writes itself."""
    own = {(out / name).resolve() for name in (EACH, "figures")}
    return [
        str(path) for path, names in _files(_matches(where), out).items() if not names and path.resolve() not in own
    ]


def _matches(where: str) -> list[Path]:
    path = Path(where)
    if path.is_dir():
        return [p for p in sorted(path.iterdir()) if not p.name.startswith(".")]
    return [Path(p) for p in sorted(glob.glob(where, recursive=True))]


def _files(matches: Sequence[Path], out: Path) -> dict[Path, list[str]]:
    """Recordings by folder, maybe none, and each that lies beside these by itself."""
    files: dict[Path, list[str]] = {}
    for match in matches:
        if match.is_dir() and match.resolve() != out.resolve():
            files[match] = sorted(str(p) for p in match.glob("*") if _is_recording(p))
        elif _is_recording(match):
            files[match] = [str(match)]
    return files


def _is_recording(path: Path) -> bool:
    """A CSV file that is none of ours; loggers shout their names, and a name with a dot is a system's own."""
    name = path.name.lower()
    return name.endswith(".csv") and not name.startswith(".") and name not in _WRITTEN and path.is_file()


def _by_name(files: Mapping[Path, list[str]]) -> dict[str, list[str]]:
    """Files by the name of their folder, or their own: with the folders before it that tell it from others', if any."""
    parts = {path: (*path.parent.parts, path.stem if path.is_file() else path.name) for path in files}

    def name(path: Path) -> str:
        mine = parts[path]
        alone = (k for k in range(1, len(mine) + 1) if sum(p[-k:] == mine[-k:] for p in parts.values()) == 1)
        k = next(alone, None)  # None of a file beside a folder of the same name
        return path.as_posix() if k is None else Path(*mine[-k:]).as_posix()

    return {name(path): names for path, names in files.items()}
