"""``scpjax fit`` and ``scpjax diagnose``."""

from __future__ import annotations

import dataclasses
import math
from argparse import Namespace
from collections.abc import Sequence
from pathlib import Path

from scpjax.cli.commands import MINUTES
from scpjax.cli.inputs import fixed_values, read_files, with_known
from scpjax.cli.program import check_folder, progress, say, staged, start
from scpjax.cli.then import Earlier, Read, earlier, limits_of, probability_changes, say_next, with_earlier
from scpjax.diagnose.profiles import Limits
from scpjax.diagnose.result import Diagnosis
from scpjax.fit.result import Estimate
from scpjax.recordings.plausible import LOOK
from scpjax.recordings.recording import Recording
from scpjax.report.numbers import column, estimate, interval, number, percent, unit


def run_fit(arguments: Namespace) -> None:
    """Fit one actuator."""
    out = check_folder(arguments.out)
    keys, known = fixed_values(arguments.fixed)
    recordings = read_files(arguments.files, drive=arguments.drive, response=arguments.response, model=arguments.model)
    recordings = [with_known(r, known) for r in recordings]
    start()
    model = arguments.model if arguments.base is None else base_name(arguments.base)
    from scpjax.fit.fit import FitOptions, fit
    from scpjax.report.report import command_line, write_fit

    with progress(arguments) as show:
        if show:
            show("fitting", 0.1)
        options = FitOptions(robust=3.0 if arguments.robust else 0.0)
        found = fit(recordings, model=model, fixed=keys, options=options)
        if show:
            show("writing the report", 0.9)
        with staged(out) as folder:
            write_fit(found, folder, recordings=recordings, command=command_line(arguments.line))
    state = "converged" if found.converged else "NOT CONVERGED"
    say_doubts(arguments, found.notes)
    say(arguments, f"{found.model.structure.name} model, {state}, {number(found.seconds, 2)} s")
    say_parameters(arguments, found.parameters)
    for name, score in found.scores.items():
        words, u = column(name)
        text = f"RMSE {number(score['rmse'])} {u} (noise {number(found.noise.get(name, math.nan), 2)} {u})"
        say(arguments, f"  {words}: {text}, NRMSE {number(score['nrmse'])} %")
    for sentence in found.not_identifiable:
        say(arguments, f"  {sentence}")
    say(arguments, f"report: {out / 'report.html'}")


def base_name(file: str) -> str:
    """The base model of a user's file, by name; it and the mechanisms beside it are in the catalogue from now on."""
    from scpjax.simulate.trial import use_base

    return use_base(file).name


def run_diagnose(arguments: Namespace) -> None:
    """Diagnose one actuator."""
    out = check_folder(arguments.out)
    before = earlier(out) if arguments.then else None
    read = with_earlier(arguments, before, out)
    if before is not None and before.read.files != read.files[: -len(arguments.then)]:
        before = None  # the diagnosis there is of other files
    recordings = read_files(read.files, drive=read.drive, response=read.response, model=read.model)
    limits = limits_of(arguments, recordings)
    start()
    model = read.model if read.base is None else base_name(read.base)
    if read.mechanisms:
        from scpjax.simulate.trial import use

        for file in read.mechanisms:
            use(file)
    patience = patience_of(arguments)
    diagnose_into(arguments, recordings, out, model=model, limits=limits, before=before, read=read, patience=patience)


def patience_of(arguments: Namespace) -> float:
    """Seconds for which other explanations are sought (`scpjax.diagnose.diagnose.DiagnoseOptions`)."""
    return 60.0 * (MINUTES if arguments.minutes is None else arguments.minutes)


def diagnose_into(
    arguments: Namespace,
    recordings: Sequence[Recording],
    out: Path,
    *,
    model: str | None,
    limits: Limits | None = None,
    before: Earlier | None = None,
    read: Read | None = None,
    patience: float = math.inf,
) -> None:
    """Diagnose, write the folder and say what was found; ``before`` is the diagnosis that this one adds to."""
    from scpjax.diagnose.diagnose import DiagnoseOptions, diagnose
    from scpjax.report.diagnosis import drop_old_proposal
    from scpjax.report.report import command_line, write_diagnosis

    with progress(arguments) as show:
        found = diagnose(
            recordings, model=model, options=DiagnoseOptions(next=limits, patience=patience), progress=show
        )
        changes = [] if before is None else probability_changes(before, found)
        settings = {**found.settings, **({} if read is None else {"read": read.to_json()})}
        found = dataclasses.replace(found, notes=found.notes + tuple(changes), settings=settings)
        if show:
            show("writing the report", 0.95)
        with staged(out) as folder:
            write_diagnosis(found, folder, recordings=recordings, command=command_line(arguments.line))
            drop_old_proposal(found, out)
    say_diagnosis(arguments, found)
    for change in changes:
        say(arguments, change)
    say_next(arguments, found, asked=limits is not None)
    say(arguments, f"report: {out / 'report.html'}")


def say_diagnosis(arguments: Namespace, d: Diagnosis) -> None:
    """Verdict, mechanisms, and errors on held-out data before and after."""
    say_doubts(arguments, d.notes)
    say(arguments, f"{d.verdict.upper()}: {d.says}")
    for m in d.mechanisms:
        law = f" ({m.law})" if m.law else ""
        say(arguments, f"\n{m.name}{law}: {m.title}, {m.subsystem}, probability {percent(m.probability)}")
        say(arguments, f"  {m.says} {m.differs}".rstrip())
        say_parameters(arguments, m.parameters)
        if m.stated:
            say(arguments, f"  {m.stated}")
        if m.equivalents:
            by_form = d.only_by_form(m)
            whose = "" if by_form == m.equivalents else f"{' and '.join(by_form)} "
            form = f" ({whose}only if its law has a slightly different form)" if by_form else ""
            say(arguments, f"  not told apart from: {', '.join(m.equivalents)}{form}")
        if m.as_well:
            say(arguments, f"  outside the catalogue would do as well: {' or '.join(m.as_well)} (s: a smooth curve)")
    say(arguments, "\nheld-out error (RMSE)")
    for name, before in d.base.held_out.items():
        words, u = column(name)
        after = d.extended.held_out.get(name, before)
        noise = number(d.base.noise.get(name, math.nan), 2)
        change = f"{number(before['rmse'])} → {number(after['rmse'])} {u}"
        say(arguments, f"  {words}: {change} (noise {noise} {u})")


def say_doubts(arguments: Namespace, notes: Sequence[str]) -> None:
    """Which columns to look at again before anything is believed."""
    for note in notes:
        if note.startswith(LOOK):
            say(arguments, note)


def say_parameters(arguments: Namespace, parameters: dict[str, Estimate]) -> None:
    """A line for each: value ± standard error and the 95 % interval."""
    for key, e in parameters.items():
        value = f"{estimate(e.value, e.std, e.low, e.high, e.at_limit)} {unit(e.unit)}".strip()
        sure = "" if e.at_limit else f"   (95 %: {interval(e.low, e.high)})"
        say(arguments, f"  {key} = {value}{sure}")
