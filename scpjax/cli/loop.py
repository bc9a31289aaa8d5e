"""``scpjax loop``, and plants, gains and references as the command line names them."""

from __future__ import annotations

import math
from argparse import Namespace
from pathlib import Path

import jax
import numpy as np

from scpjax.cli.program import check_file, progress, say, start
from scpjax.cli.simulate import csv_text
from scpjax.control.controller import Controller
from scpjax.control.errors import ControlError
from scpjax.control.gains import load_gains
from scpjax.control.loop import Loop, Response, run
from scpjax.control.metrics import as_rows, measure
from scpjax.control.pid import Pair, check_sampling, thesis_pair
from scpjax.control.plant import Difference, Joint, Plant, check_dead_times
from scpjax.control.reference import NAMES, Reference, sections
from scpjax.control.verdict import check_finite, judge
from scpjax.physics.known import KNOWN_MODELS, known_model
from scpjax.physics.storage import load_model
from scpjax.recordings.files import write_text
from scpjax.recordings.table import read_columns, read_table
from scpjax.report.numbers import number

_RADIUS = 0.015  # m, thesis 3.4.1
_EVEN = 1e-3  # of a sampling period: what rounded time stamps may be off


def run_loop(arguments: Namespace) -> None:
    """Close the loop over a reference and write what it does."""
    out = check_file(arguments.out, arguments.plant, arguments.gains, arguments.reference)
    start()
    plant = named_plant(arguments.plant, arguments.radius)
    loop = Loop(plant, named_gains(arguments.gains, plant))
    time, reference = named_reference(arguments, seed=arguments.seed)
    dt = float(time[1] - time[0])
    check_sampling(loop.controller, dt)
    check_dead_times(plant, dt)
    with progress(arguments) as show:
        if show:
            show("closing the loop", 0.1)
        response = jax.jit(lambda m, r: run(m, r, dt=dt))(loop, reference)
        check_finite(response)
        if show:
            show("is it stable?", 0.5)
        verdict = judge(loop, reference, dt=dt)
    write_text(out, csv_text(columns(time, response)))
    say_figures(arguments, loop, response)
    low, high = (math.degrees(angle) for angle in verdict.reach)
    rests = f"the joint comes to rest between {low:.1f} and {high:.1f} deg at full drive"
    for words in verdict.says or (f"The loop is stable and the reference within reach: {rests}.",):
        say(arguments, words)
    say(arguments, f"{out}: {len(time)} samples")


def columns(time: np.ndarray, response: Response) -> dict[str, np.ndarray]:
    """A response as file columns; one voltage where there is one actuator."""
    volts = np.asarray(response.voltage)
    sides = ("voltage_agonist_V", "voltage_antagonist_V")
    named = dict(zip(sides, volts.T, strict=False))
    angles = {"reference_deg": np.degrees(response.reference), "angle_deg": np.degrees(response.angle)}
    return {"time_s": time, **angles, **named}


def say_figures(arguments: Namespace, loop: Loop, response: Response) -> None:
    """The figures of a response, a line for each."""
    name = arguments.reference
    section = sections(name, frequency=arguments.frequency) if name in NAMES else None
    for words, value, unit in as_rows(measure(response, loop=loop, section=section)):
        say(arguments, f"  {words}: {number(value, 4)} {unit}")


def named_plant(name: str, radius: float | None) -> Plant:
    """``thesis`` or another preset, or a model.json; two of an actuator, or a joint as it is.

    **Raises** `ControlError` for a model that does not move, and a radius that is not positive.
    """
    if radius is not None and not (math.isfinite(radius) and radius > 0):
        raise ControlError(f"a pulley radius of {radius:g} m", where="--radius", mend="give it in metres, above 0")
    if name in KNOWN_MODELS:
        if name in ("te", "tm"):
            raise ControlError(
                f"the preset {name} does not turn a joint", where="--plant", mend="use thesis, plant or aaa"
            )
        model = known_model(name, pulley_radius=radius)
    else:
        path = Path(name)
        if not (name.endswith(".json") or path.exists() or path.parent != Path(".")):
            mend = "use thesis, plant, aaa or a model.json that fit has written"
            raise ControlError(f"no plant named {name!r}", where="--plant", mend=mend)
        model, _ = load_model(path / "model.json" if (path / "model.json").is_file() else path)
    if not (model.structure.mechanical and model.structure.thermal):
        mend = "fit a plant: volts to displacement"
        raise ControlError("the model does not lead from a drive to a displacement", where=name, mend=mend)
    if model.structure.drive not in ("voltage", "pwm"):
        mend = "fit it to volts or pwm"
        raise ControlError(
            f"the model is driven by {model.structure.drive}, the controller gives volts", where=name, mend=mend
        )
    if len(model.structure.sides) == 2:
        if radius is not None and model.structure.pulley_radius != radius:
            mend = "leave --radius out"
            raise ControlError(
                f"the joint has its pulley radius, {model.structure.pulley_radius:g} m", where=name, mend=mend
            )
        return Joint(model)
    return Difference(model, model, radius=_RADIUS if radius is None else radius)


def named_gains(name: str, plant: Plant) -> Controller:
    """``thesis`` (Table 3.7) or a gains.toml, for each side of the plant."""
    pair = thesis_pair() if name == "thesis" else Pair(load_gains(name))
    return pair if plant.sides == 2 else pair.agonist


def named_reference(arguments: Namespace, *, seed: int | None = None) -> tuple[np.ndarray, np.ndarray]:
    """Time [s] and reference [rad] of a name or a CSV file ``time_s,reference_deg``; with a ``seed`` the levels of
    ``multilevel`` are drawn.

    **Raises** `ControlError` for an unknown name, stamps that are not even, or options that a file does not take.
    """
    name = arguments.reference
    if name in NAMES:
        amplitude = 25.0 if arguments.amplitude is None else arguments.amplitude
        if not (math.isfinite(amplitude) and amplitude > 0):
            raise ControlError(f"is {amplitude:g} degrees", where="--amplitude", mend="give degrees, above 0")
        return Reference(
            amplitude=math.radians(amplitude),
            frequency=arguments.frequency,
            duration=arguments.duration,
            dt=0.02 if arguments.dt is None else arguments.dt,
            seed=seed,
        ).make(name)
    if not (name.lower().endswith(".csv") or Path(name).exists() or "/" in name):
        raise ControlError(f"no reference {name!r}", where="--reference", mend=f"use {', '.join(NAMES)}, or a CSV file")
    for option in ("amplitude", "frequency", "duration"):
        if getattr(arguments, option) is not None:
            raise ControlError(f"--{option} has no meaning for a file", where=name, mend="leave it out")
    return _read_reference(name, arguments.dt)


def _read_reference(name: str, dt: float | None) -> tuple[np.ndarray, np.ndarray]:
    table = read_table(name)
    wanted = ("time_s", "reference_deg")
    for column in wanted:
        if column not in table.names:
            mend = f"the header must be {','.join(wanted)}"
            raise ControlError(f"no column {column}", where=name, mend=mend)
    found = read_columns(table, wanted, ())
    time, degrees = found["time_s"], found["reference_deg"]
    if time.size < 2 or np.any(np.diff(time) <= 0):
        raise ControlError("the time does not go on from row to row", where=name, mend="give 2 rows or more, in order")
    if dt is not None:
        if not (math.isfinite(dt) and 0 < dt < time[-1] - time[0]):
            raise ControlError(f"a sample every {dt:g} s", where="--dt", mend="give seconds, below the duration")
        fine = time[0] + dt * np.arange(int((time[-1] - time[0]) / dt + 1e-6) + 1)
        return fine - time[0], np.radians(np.interp(fine, time, degrees))
    period = (time[-1] - time[0]) / (time.size - 1)
    if np.max(np.abs(time - time[0] - period * np.arange(time.size))) > _EVEN * period + 1e-6:
        raise ControlError("the samples are not even in time", where=name, mend="give --dt, and they are interpolated")
    return period * np.arange(time.size), np.radians(degrees)


__all__ = ["columns", "named_gains", "named_plant", "named_reference", "run_loop", "say_figures"]
