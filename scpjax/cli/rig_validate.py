"""``scpjax rig validate``: predicted against measured, and where they part the diagnosis, and the next experiment."""

from __future__ import annotations

import math
import sys
from argparse import Namespace
from pathlib import Path

from scpjax.bench.errors import BenchError
from scpjax.bench.play import follow
from scpjax.bench.self_driving import SelfDriving, hottest_of, until_explained
from scpjax.bench.sessions import Excite, record_profile, rest
from scpjax.bench.validate import Compared, closed_loop, open_loop, tracking, write_page
from scpjax.cli.inputs import read_files
from scpjax.cli.loop import named_plant
from scpjax.cli.program import Progress, check_folder, progress, say, start
from scpjax.cli.rig import controller_of, loop_columns, recorded, reference_of
from scpjax.cli.rig_bench import Bench, bench, ticks_of, watcher
from scpjax.cli.simulate import csv_text
from scpjax.cli.then import say_next
from scpjax.diagnose.proposal import NextExperiment
from scpjax.physics.storage import load_model
from scpjax.recordings.files import write_text
from scpjax.recordings.recording import Recording
from scpjax.report.numbers import number
from scpjax.report.pieces import write_json
from scpjax.report.report import command_line


def validate(arguments: Namespace) -> None:
    """Open loop, closed loop where there are gains, and the diagnosis where they part."""
    out = check_folder(arguments.out)
    start()
    path = Path(arguments.model)
    model, extra = load_model(path / "model.json" if (path / "model.json").is_file() else path)
    others = read_files(arguments.others, drive=None, response=None)
    if arguments.until_explained < 0:
        raise BenchError(f"is {arguments.until_explained}", where="--until-explained", mend="give 0 or more")
    sections: dict[str, list[Compared]] = {}
    with bench(arguments, period=arguments.period, sides=len(model.structure.sides)) as b, progress(arguments) as show:
        recording = _open_loop(arguments, b, out, show)
        sections["open loop"] = open_loop(model, recording, extra)
        if arguments.gains:
            sections["closed loop"] = [_closed_loop(arguments, b, out, show)]
        _say(arguments, out, sections)
        parts = any(c.parts for found in sections.values() for c in found)
        if parts or arguments.until_explained:
            _why(arguments, b, out, [*others, recording], show)


def _volts(arguments: Namespace, b: Bench) -> float:
    return min(3.0 if arguments.max_volts is None else arguments.max_volts, b.rig.wiring.supply_V)


def _open_loop(arguments: Namespace, b: Bench, out: Path, show: Progress | None) -> Recording:
    duration = 120.0 if arguments.duration is None else arguments.duration
    excite = Excite(duration=duration, period=arguments.period, high=_volts(arguments, b), seed=arguments.seed + 1)
    rest(b.rig)
    time, volts = excite.make("multilevel", b.rig.wiring.sides)
    watch = watcher(b.rig, show, "open loop", float(time[-1]))
    return record_profile(b.rig, out / "open_loop.csv", time, volts, title="validation, open loop", watch=watch)


def _closed_loop(arguments: Namespace, b: Bench, out: Path, show: Progress | None) -> Compared:
    duration, arguments.duration = arguments.duration, None  # that of the open loop is not the reference's
    time, reference = reference_of(arguments)
    arguments.duration = duration
    controller = controller_of(arguments.gains, b)
    radius = None if b.rig.wiring.sides == 2 and _is_joint(arguments) else b.rig.wiring.pulley_radius_m
    plant = named_plant(arguments.model, radius)
    if plant.sides != b.rig.wiring.sides:
        from scpjax.control.plant import Difference

        assert isinstance(plant, Difference)
        plant = Difference(plant.agonist, radius=radius)
    rest(b.rig)
    watch = watcher(b.rig, show, "closed loop", float(time[-1]))
    every = ticks_of(float(time[1] - time[0]), "--dt")
    with recorded(b, out / "closed_loop.csv"):
        found = follow(b.rig, controller, reference, every=every, on=arguments.on, watch=watch)
    write_text(out / "closed_loop.csv", csv_text(loop_columns(found)))
    measured, simulated = (math.degrees(x) for x in tracking(plant, controller, found))
    say(arguments, f"closed loop: tracking RMSE {number(measured)} deg, in pure simulation {number(simulated)} deg")
    return closed_loop(plant, controller, found)


def _is_joint(arguments: Namespace) -> bool:
    path = Path(arguments.model)
    return len(load_model(path / "model.json" if path.is_dir() else path)[0].structure.sides) == 2


def _say(arguments: Namespace, out: Path, sections: dict[str, list[Compared]]) -> None:
    says = [f"{name}: {c.says}" for name, found in sections.items() for c in found]
    for words in says:
        say(arguments, words)
    write_json(out / "validation.json", {k: {c.column: c.to_json() for c in v} for k, v in sections.items()})
    write_page(out, "scpjax validation", sections, says)
    say(arguments, f"report: {out / 'report.html'}")


def _why(arguments: Namespace, b: Bench, out: Path, recordings: list[Recording], show: Progress | None) -> None:
    options = SelfDriving(
        most=arguments.until_explained,
        high=_volts(arguments, b),
        hottest=hottest_of(b.rig),
        duration=120.0 if arguments.duration is None else arguments.duration,
        period=arguments.period,
    )

    def agree(e: NextExperiment) -> bool:
        say(arguments, f"next experiment: {e.says}")
        if arguments.yes:
            return True
        if not sys.stdin.isatty():
            say(arguments, "  not played: nobody to ask (--yes plays it)")
            return False
        return input("play it? [y/N] ").strip().lower() in ("y", "yes")

    driven = until_explained(
        b.rig,
        out / "diagnosis",
        options,
        recordings=recordings,
        agree=agree,
        tell=show,
        command=command_line(arguments.line),
    )
    say(arguments, f"diagnosis: {driven.last.says}")
    say(arguments, f"  {driven.played} experiments of its own choice; {driven.why}")
    if driven.played == 0 and arguments.until_explained == 0:
        say_next(arguments, driven.last, asked=True)
    say(arguments, f"report: {out / 'diagnosis' / 'report.html'}")
