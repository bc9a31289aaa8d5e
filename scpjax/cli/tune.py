"""``scpjax tune``."""

from __future__ import annotations

import math
from argparse import Namespace

import jax

from scpjax.cli.loop import columns, named_gains, named_plant, named_reference
from scpjax.cli.program import check_folder, progress, say, staged, start
from scpjax.cli.simulate import csv_text
from scpjax.control.errors import ControlError
from scpjax.control.fleet import spread_plants
from scpjax.control.gains import save_gains
from scpjax.control.loop import Loop, run
from scpjax.control.objective import Effort, Objective, PeakTemperature, Robustness, Term, Tracking
from scpjax.control.plant import Plant
from scpjax.control.problem import Problem
from scpjax.control.tune import Tuned, TuneOptions, tune
from scpjax.control.verdict import judge
from scpjax.recordings.files import write_text
from scpjax.report.control import TuningReport, write_tuning
from scpjax.report.numbers import number
from scpjax.report.report import command_line

_SEED = 211  # of the plants under --spread


def run_tune(arguments: Namespace) -> None:
    """Tune gains for a reference; write gains.toml, figures and a page."""
    out = check_folder(arguments.out)
    start()
    plant = named_plant(arguments.plant, arguments.radius)
    loop = Loop(plant, named_gains(arguments.gains, plant))
    time, reference = named_reference(arguments, seed=arguments.seed)
    dt = float(time[1] - time[0])
    plants = None if arguments.spread is None else _fleet(arguments, plant)
    problem = Problem(loop, reference, dt=dt, objective=_objective(arguments), plants=plants)
    with progress(arguments) as show:
        if show:
            show("tuning", 0.05)
        tuned = tune(problem, TuneOptions())
        after = Loop(plant, tuned.controller)
        if show:
            show("is it stable?", 0.8)
        verdict = judge(after, reference, dt=dt)
        go = jax.jit(lambda m, r: run(m, r, dt=dt))
        report = TuningReport(
            tuned=tuned,
            loops=(loop, after),
            responses=(go(loop, reference), go(after, reference)),
            verdict=verdict,
            objective=problem.objective,
            command=command_line(arguments.line),
            spread=arguments.spread,
            title=f"{arguments.plant}, {arguments.reference}",
        )
        if show:
            show("writing the report", 0.9)
        with staged(out) as folder:
            title = f"Tuned for {arguments.reference} on {arguments.plant}"
            save_gains(tuned.controller, folder / "gains.toml", dt=dt, title=title)
            write_text(folder / "loop.csv", csv_text(columns(time, report.responses[1])))
            write_tuning(report, folder)
    _say(arguments, tuned, verdict.says, f"gains: {out / 'gains.toml'}\nreport: {out / 'report.html'}")


def _say(arguments: Namespace, tuned: Tuned, says: tuple[str, ...], files: str) -> None:
    plain = arguments.effort == 0 and arguments.hottest is None and arguments.sensitivity is None
    simple = plain and arguments.spread is None
    scale, unit = (180 / math.pi, " deg") if simple else (1.0, "")
    words = "RMSE" if simple else "objective"
    if tuned.improved:
        say(arguments, f"{words}: {number(scale * tuned.before, 4)} → {number(scale * tuned.value, 4)}{unit}")
    else:
        say(
            arguments,
            f"nothing better found; the gains given are kept, {words} {number(scale * tuned.before, 4)}{unit}",
        )
    for name in ("Kp", "Ki", "Kd", "N"):
        say(arguments, f"  {name} = {number(tuned.gains[name], 4)}   (was {number(tuned.given[name], 4)})")
    if tuned.at_bound:
        say(arguments, f"  at the end of what was searched: {', '.join(tuned.at_bound)}")
    say(arguments, f"  {tuned.loops} loops in {tuned.seconds:.1f} s")
    for line in says:
        say(arguments, line)
    say(arguments, files)


def _objective(arguments: Namespace) -> Objective:
    terms: list[Term] = [Tracking()]
    for option in ("effort", "hottest", "sensitivity"):
        value = getattr(arguments, option)
        if value is not None and not math.isfinite(value):
            raise ControlError(f"is {value:g}", where=f"--{option}", mend="give a finite number")
    if arguments.effort:
        terms.append(Effort(weight=arguments.effort * math.pi / 180))
    if arguments.hottest is not None:
        terms.append(PeakTemperature(limit=arguments.hottest + 273.15))
    if arguments.sensitivity is not None:
        terms.append(Robustness(limit=arguments.sensitivity))
    return Objective(*terms, over="mean" if arguments.spread is None else "cvar")


def _fleet(arguments: Namespace, plant: Plant) -> Plant:
    if not 0 < arguments.spread < 1:
        raise ControlError(f"a spread of {arguments.spread:g}", where="--spread", mend="give a share, such as 0.2")
    seed = _SEED if arguments.seed is None else arguments.seed
    return spread_plants(plant, arguments.spread, arguments.plants, seed=seed)
