"""``scpjax rig``: record, play, loop, calibrate, characterise, validate."""

from __future__ import annotations

import contextlib
import math
import sys
import threading
from argparse import Namespace
from collections.abc import Iterator
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from scpjax.bench import legacy
from scpjax.bench.device import PortDevice, find_port
from scpjax.bench.errors import BenchError
from scpjax.bench.play import Followed, follow, within_supply
from scpjax.bench.sessions import (
    Characterise,
    Characterised,
    Excite,
    calibrate,
    characterise,
    record_profile,
    rest,
    with_known,
)
from scpjax.bench.weights import check_weights
from scpjax.bench.wiring import Wiring, load_wiring, save_wiring
from scpjax.cli.program import check_file, check_folder, progress, say, start
from scpjax.cli.rig_bench import Bench, bench, ticks_of, watcher
from scpjax.cli.simulate import csv_text
from scpjax.recordings.files import read_recording, write_recording, write_text
from scpjax.recordings.recording import Recording
from scpjax.report.numbers import column, number

if TYPE_CHECKING:
    from scpjax.control.controller import Controller

_VOLTS = 3.0


def run_record(arguments: Namespace) -> None:
    """Record an excitation."""
    out = check_file(arguments.out, bench=arguments.bench)
    if arguments.legacy:
        _record_legacy(arguments, out)
        return
    start()
    excite = Excite(
        duration=120.0 if arguments.duration is None else arguments.duration,
        period=arguments.period,
        low=arguments.min_volts,
        high=_VOLTS if arguments.max_volts is None else arguments.max_volts,
        hold=arguments.hold,
        seed=arguments.seed,
    )
    with bench(arguments, period=arguments.period) as b, progress(arguments) as show:
        time, volts = excite.make(arguments.excite, b.rig.wiring.sides)
        watch = watcher(b.rig, show, arguments.excite, float(time[-1]))
        recording = record_profile(b.rig, out, time, volts, title=f"{arguments.excite} on the bench", watch=watch)
    say_recording(arguments, out, recording)


def run_play(arguments: Namespace) -> None:
    """Record a profile of a file."""
    out = check_file(arguments.out, arguments.file, bench=arguments.bench)
    start()
    given = read_recording(arguments.file, response=[], require_outputs=False)
    if any(c.unit.quantity != "voltage" for c in given.input_channels):
        columns = ", ".join(c.column for c in given.input_channels)
        mend = "give voltage_V, or voltage_agonist_V and voltage_antagonist_V"
        raise BenchError(f"the drive {columns} is not in volts", where=arguments.file, mend=mend)
    period = min(given.period, 0.1)
    ticks = max(1, min(255, round(period / 0.005)))
    with bench(arguments, period=0.005 * ticks, sides=len(given.input_channels)) as b, progress(arguments) as show:
        watch = watcher(b.rig, show, "playing", given.duration)
        title = f"{Path(arguments.file).name} on the bench"
        recording = record_profile(b.rig, out, given.time - given.time[0], given.inputs, title=title, watch=watch)
    say_recording(arguments, out, recording)


def say_recording(arguments: Namespace, out: Path, recording: Recording) -> None:
    """What was recorded, in words."""
    for i, channel in enumerate((*recording.input_channels, *recording.output_channels)):
        values = recording.inputs if i < len(recording.input_channels) else recording.outputs
        column = values[:, i if i < len(recording.input_channels) else i - len(recording.input_channels)]
        low, high = channel.unit.from_si(float(column.min())), channel.unit.from_si(float(column.max()))
        say(arguments, f"  {channel.column}: {number(low)} to {number(high)}")
    say(arguments, f"{out}: {recording.n} samples, {recording.duration:.1f} s")


def _record_legacy(arguments: Namespace, out: Path) -> None:
    supply = (load_wiring(arguments.bench) if arguments.bench else Wiring()).supply_V
    device = PortDevice(arguments.port or find_port(), baud=legacy.BAUD)
    device.open()
    most = 3600.0 if arguments.duration is None else arguments.duration
    rows: list[bytes] = []

    def written() -> Path:
        return write_recording(legacy.recording(rows, value=arguments.legacy, supply_V=supply), out)

    try:
        out.parent.mkdir(parents=True, exist_ok=True)
        with open(out.with_suffix(".raw"), "wb", buffering=0) as raw:
            for row in legacy.lines(device, most=most, keep=raw.write):
                rows.append(row)
    except BaseException as error:
        with contextlib.suppress(BenchError):  # too few lines for a recording: they are in NAME.raw
            written()
        if isinstance(error, OSError):
            problem = f"cannot be written ({error.strerror})"
            raise BenchError(problem, where=str(out.with_suffix(".raw")), mend="check the disk") from error
        if isinstance(error, KeyboardInterrupt):
            raise KeyboardInterrupt(f"what had come is in {out.with_suffix('.raw')}") from error
        raise
    finally:
        device.close()
    say_recording(arguments, out, read_recording(written()))


def run_loop(arguments: Namespace) -> None:
    """Close the loop on the bench."""
    out = check_file(arguments.out, arguments.gains, arguments.reference)
    start()
    time, reference = reference_of(arguments)
    every = ticks_of(float(time[1] - time[0]), "--dt")
    with bench(arguments, sides=2) as b, progress(arguments) as show:
        controller = controller_of(arguments.gains, b)
        rest(b.rig, most=60.0)
        watch = watcher(b.rig, show, "closing the loop", float(time[-1]))
        with recorded(b, out):
            found = follow(b.rig, controller, reference, every=every, on=arguments.on, watch=watch)
    write_text(out, csv_text(loop_columns(found)))
    say(arguments, f"  RMSE: {number(math.degrees(found.rmse), 4)} deg, PID on the {arguments.on}")
    say(arguments, f"{out}: {len(found.time)} samples")


@contextlib.contextmanager
def recorded(b: Bench, out: Path) -> Iterator[None]:
    """Every sample on disk as it comes, whatever ends the loop: NAME_samples.csv and what belongs to it beside NAME."""
    b.rig.record(out.with_name(f"{out.stem}_samples.csv"), title="a closed loop")
    try:
        yield
    finally:
        b.rig.end_recording()


def loop_columns(found: Followed) -> dict[str, np.ndarray]:
    """A loop as file columns, those of ``scpjax loop``."""
    sides = ("voltage_agonist_V", "voltage_antagonist_V")
    angles = {"reference_deg": np.degrees(found.reference), "angle_deg": np.degrees(found.angle)}
    return {"time_s": found.time, **angles, **dict(zip(sides, found.voltage.T, strict=False))}


def reference_of(arguments: Namespace) -> tuple[np.ndarray, np.ndarray]:
    """Time [s] and reference [rad]."""
    from scpjax.cli.loop import named_reference

    return named_reference(arguments)


def controller_of(gains: str, b: Bench) -> Controller:
    """A controller for as many sides as the bench has."""
    from scpjax.control.gains import load_gains
    from scpjax.control.pid import Pair, thesis_pair

    pair = within_supply(thesis_pair() if gains == "thesis" else Pair(load_gains(gains)), b.rig.wiring.supply_V)
    return pair if b.rig.wiring.sides == 2 else pair.agonist


def run_calibrate(arguments: Namespace) -> None:
    """Calibrate and write bench.toml."""
    out = Path(arguments.out)
    if out.suffix != ".toml":
        raise BenchError("is no TOML file name", where=f"--out {out}", mend="end it in .toml")
    start()
    with bench(arguments) as b:
        found = calibrate(b.rig, pulse=arguments.pulse)
    save_wiring(found.wiring, out)
    for words in found.says:
        say(arguments, f"  {words}")
    say(arguments, f"bench: {out}")


def run_characterise(arguments: Namespace) -> None:
    """Record the experiments that lead to a model, and fit it."""
    out = check_folder(arguments.out)
    levels = _numbers(arguments.levels, "--levels", "no volts", "write 2,3")
    weights = _numbers(arguments.weights or "", "--weights", "no kilograms", "write 0.05,0.1,0.15")
    if weights and arguments.mass is not None:
        raise BenchError("two words on what hangs there", where="--mass", mend="the last of --weights is the mass")
    if weights:
        check_weights(weights)
    start()
    options = Characterise(
        duration=arguments.duration, levels=levels, period=arguments.period, seed=arguments.seed, weights=weights
    )
    with bench(arguments, period=arguments.period) as b, progress(arguments) as show:
        if arguments.mass is not None:
            b.rig.wiring = _with_mass(b.rig.wiring, arguments.mass)
        tell = (lambda text, share: show(text, 0.7 * share)) if show else None
        put_on = partial(hang, b)
        found = characterise(b.rig, out / "recordings", options, hang=put_on, tell=tell)
        wiring = b.rig.wiring
    _fit_into(arguments, found, wiring, out)


def _numbers(text: str, where: str, problem: str, mend: str) -> tuple[float, ...]:
    try:
        return tuple(float(v) for v in text.split(",")) if text else ()
    except ValueError as error:
        raise BenchError(f"{text!r} are {problem}", where=where, mend=mend) from error


def _with_mass(wiring: Wiring, mass: float) -> Wiring:
    if not (math.isfinite(mass) and mass > 0):
        raise BenchError(f"is {mass:g} kg", where="--mass", mend="give kilograms, above 0")
    return with_known(wiring, moving_mass_kg=mass)


def hang(b: Bench, mass: float) -> None:
    """Have a weight hung: a simulated bench does it itself, elsewhere somebody does, and says so with the Enter key."""
    b.rig.stop()
    if b.behind is not None:
        b.behind.world.hang(mass)
        return
    said = list[str]()
    reader = threading.Thread(target=lambda: said.append(sys.stdin.readline()), daemon=True)
    print(f"hang {mass:g} kg on it and press Enter", flush=True)
    reader.start()
    while reader.is_alive():
        b.rig.wait(0.5, lambda: not reader.is_alive())
    if not said or not said[0]:
        raise BenchError("nobody to hang the weights", where="--weights", mend="run it in a terminal")


def _fit_into(arguments: Namespace, found: Characterised, wiring: Wiring, out: Path) -> None:
    """Fit what was recorded and write the folder."""
    from scpjax.bench import weights
    from scpjax.bench.validate import open_loop
    from scpjax.cli.program import staged
    from scpjax.cli.study import say_parameters
    from scpjax.fit.fit import fit
    from scpjax.report import plot
    from scpjax.report.pieces import write_figures, write_json
    from scpjax.report.report import command_line, write_fit

    says, before = list[str](), ""
    with progress(arguments) as show:
        if show:
            show("fitting", 0.8)
        fitted = fit(found.recordings)
        with staged(out) as folder:
            if found.stiffness is not None:
                for h, recording in zip(found.series, found.steps, strict=False):
                    model = fitted.model.replace({"inertia.mass": h.mass})
                    says += [f"under {h.mass:g} kg, {c.says}" for c in open_loop(model, recording)]
                image = plot.png(weights.figure(found.series, found.stiffness))
                before = weights.section(found.series, found.stiffness, image, says)
                write_figures(folder, {"weights": image})
                write_text(folder / "weights.csv", weights.table(found.series))
                write_json(folder / "weights.json", weights.to_json(found.series, found.stiffness))
                save_wiring(wiring, folder / "bench.toml")
            line = command_line(arguments.line)
            write_fit(fitted, folder, recordings=found.recordings, command=line, before=before)
    if found.stiffness is not None:
        say(arguments, found.stiffness.says)
        for words in says:
            say(arguments, f"  {words}")
        say(arguments, f"bench: {out / 'bench.toml'} (zero, weight and stiffness as they are now)")
    say_parameters(arguments, fitted.parameters)
    for name, score in fitted.scores.items():
        words, unit = column(name)
        noise = number(fitted.noise.get(name, math.nan), 2)
        say(arguments, f"  {words}: RMSE {number(score['rmse'])} {unit} (noise {noise} {unit})")
    for sentence in fitted.not_identifiable:
        say(arguments, f"  {sentence}")
    say(arguments, f"model: {out / 'model.json'}\nreport: {out / 'report.html'}")


def run_validate(arguments: Namespace) -> None:
    """Predicted against measured."""
    from scpjax.cli.rig_validate import validate

    validate(arguments)
