"""What ``scpjax rig ...`` takes. The work is in `scpjax.cli.rig`, imported when it is asked for."""

from __future__ import annotations

import argparse
from collections.abc import Callable
from typing import Any

Command = Callable[..., argparse.ArgumentParser]


def add_rig(places: Any, command: Command) -> None:
    """Add ``rig`` and its own commands to the subparsers ``places``."""
    parser = places.add_parser(
        "rig",
        help="drive and record a real or simulated bench",
        description="Drive and record a real bench (an Arduino with rig/firmware) or a simulated one (--port sim). "
        "Each command has its own --help and most write to --out.",
        allow_abbrev=False,
    )
    mine = parser.add_subparsers(title="commands", metavar="COMMAND", required=True, dest="rig_command")
    _record(mine, command)
    _play(mine, command)
    _loop(mine, command)
    _calibrate(mine, command)
    _characterise(mine, command)
    _validate(mine, command)


def _bench(parser: argparse.ArgumentParser) -> None:
    group = parser.add_argument_group("bench")
    group.add_argument("--port", metavar="PORT", help="serial port, or sim (default: the only board there is)")
    group.add_argument("--bench", metavar="FILE", help="bench.toml, as calibrate writes it: what is connected")
    group.add_argument("--max-temperature", metavar="DEGC", type=float, help="tighten the board's cut-out for this run")
    group.add_argument("--live", action="store_true", help="a live plot in the browser (default: headless)")
    sim = parser.add_argument_group("simulated bench (--port sim)")
    sim.add_argument("--sim", metavar="M", help="muscle (the default), thesis, plant, aaa or a model.json")
    sim.add_argument(
        "--conceal",
        metavar="NAME[:KEY=X,...]",
        action="append",
        default=[],
        help="a mechanism in the simulated muscle, such as creep:compliance=0.3 (may be repeated)",
    )
    sim.add_argument(
        "--actuators",
        type=int,
        choices=(1, 2),
        help="2: a joint (default: as the bench, the file played or the model; else 1, for loop 2)",
    )
    sim.add_argument("--noise", metavar="MV", type=float, default=2.0, help="of every reading (default: %(default)s)")
    sim.add_argument("--seed", metavar="N", type=int, default=0, help="of noise and random signals")
    sim.add_argument("--real-time", action="store_true", help="as slow as the real thing")


def _excitation(parser: argparse.ArgumentParser) -> None:
    parser.add_argument("--max-volts", metavar="V", type=float, help="greatest drive, root mean square (default: 3)")
    parser.add_argument("--duration", metavar="S", type=float, help="of each recording (default: 120)")
    parser.add_argument("--period", metavar="S", type=float, default=0.1, help="between samples (default: %(default)s)")


def _record(places: Any, command: Command) -> None:
    parser = command(
        places,
        "record",
        ("rig", "run_record"),
        "record while the board plays an excitation",
        "Writes NAME.csv and NAME.toml, every byte received to NAME.raw, remarks (type a line and press return; not on "
        "Windows) to NAME.markers.csv and what the line lost to NAME.quality.json.",
    )
    parser.add_argument(
        "--excite",
        metavar="NAME",
        default="rest",
        help="step, step_difference, stair, multilevel, prbs, triangle or rest (the default)",
    )
    _excitation(parser)
    parser.add_argument("--min-volts", metavar="V", type=float, default=0.0, help="least drive (default: 0)")
    parser.add_argument(
        "--hold", metavar="S", type=float, help="of a level of multilevel and prbs (default: a tenth of the duration)"
    )
    parser.add_argument(
        "--legacy",
        choices=("temperature", "distance"),
        help="read the tab-separated lines of the thesis's own sketches, whose value is this (no quality.json)",
    )
    parser.add_argument("--out", metavar="FILE", required=True, help="CSV to write")
    _bench(parser)


def _play(places: Any, command: Command) -> None:
    parser = command(
        places,
        "play",
        ("rig", "run_play"),
        "record while the board plays a file: a voltage profile, or next_experiment.csv",
        "Volts are root mean square values: heat goes with their square.",
    )
    parser.add_argument("file", metavar="FILE", help="CSV with time_s and voltage_V (or both voltages of a joint)")
    parser.add_argument("--out", metavar="FILE", required=True, help="CSV to write")
    _bench(parser)


def _reference(parser: argparse.ArgumentParser) -> None:
    parser.add_argument("--amplitude", metavar="DEG", type=float, help="of the reference (default: 25)")
    parser.add_argument("--frequency", metavar="HZ", type=float, help="as of scpjax loop")
    parser.add_argument("--dt", metavar="S", type=float, help="sampling period, whole 5 ms (default: 0.02)")
    parser.add_argument("--on", choices=("board", "host"), default="board", help="where the PID runs (%(default)s)")


def _loop(places: Any, command: Command) -> None:
    parser = command(
        places,
        "loop",
        ("rig", "run_loop"),
        "close the loop on the bench",
        "Writes time_s, reference_deg, angle_deg and the voltages, and says how well it follows; every sample goes to "
        "NAME_samples.csv, with NAME_samples.raw and so on, as it comes.",
    )
    parser.add_argument("--gains", metavar="G", default="thesis", help="thesis (Table 3.7) or a gains.toml")
    parser.add_argument("--reference", metavar="R", default="sine", help="as of scpjax loop (default: %(default)s)")
    _reference(parser)
    parser.add_argument("--duration", metavar="S", type=float, help="as of scpjax loop")
    parser.add_argument("--out", metavar="FILE", required=True, help="CSV to write")
    _bench(parser)


def _calibrate(places: Any, command: Command) -> None:
    parser = command(
        places,
        "calibrate",
        ("rig", "run_calibrate"),
        "measure zero, ambient, wire resistance and dead time, and write bench.toml",
        "At rest and cold. For the dead time the drive is on for 2 s.",
    )
    parser.add_argument("--pulse", metavar="V", type=float, default=1.5, help="0: no drive at all (%(default)s)")
    parser.add_argument("--out", metavar="FILE", required=True, help="bench.toml to write")
    _bench(parser)


def _characterise(places: Any, command: Command) -> None:
    parser = command(
        places,
        "characterise",
        ("rig", "run_characterise"),
        "record steps, stairs and levels, and fit a model to them",
        "Thesis 4.1 to 4.3: under one weight, or a series that you hang one after another when it asks (a simulated "
        "bench hangs them itself). Writes recordings/*.csv, model.json, fit.json, figures and report.html; of a series "
        "also the stiffness, weights/*.csv, weights.csv, weights.json, and bench.toml as it is at the end.",
    )
    parser.add_argument("--levels", metavar="V,V", default="2,3", help="of the steps (default: %(default)s)")
    parser.add_argument("--mass", metavar="KG", type=float, help="that hangs on the actuator, known")
    parser.add_argument("--weights", metavar="KG,KG", help="to be hung one after another; the last one stays")
    parser.add_argument("--duration", metavar="S", type=float, default=60.0, help="of a step (default: %(default)s)")
    parser.add_argument("--period", metavar="S", type=float, default=0.1, help="between samples (default: %(default)s)")
    parser.add_argument("--out", metavar="DIR", required=True, help="folder to write")
    _bench(parser)


def _validate(places: Any, command: Command) -> None:
    parser = command(
        places,
        "validate",
        ("rig", "run_validate"),
        "predicted against measured, open loop and closed loop; where they part, why",
        "Where they part, what was recorded is diagnosed at once. With --until-explained the experiments that tell the "
        "hypotheses apart are played, each if you say yes.",
    )
    parser.add_argument("--model", metavar="FILE", required=True, help="model.json of a fit or a diagnosis")
    parser.add_argument("--gains", metavar="FILE", help="thesis or a gains.toml: the closed loop as well")
    parser.add_argument("--reference", metavar="R", default="sine", help="of the closed loop (default: %(default)s)")
    _reference(parser)
    _excitation(parser)
    parser.add_argument(
        "--with",
        dest="others",
        metavar="FILE",
        nargs="+",
        default=[],
        help="recordings of this actuator for the diagnosis, beside those made now",
    )
    parser.add_argument(
        "--until-explained",
        metavar="N",
        type=int,
        default=0,
        help="play up to N experiments of the diagnosis's own choice, until one hypothesis is left",
    )
    parser.add_argument("--yes", action="store_true", help="do not ask before each experiment of --until-explained")
    parser.add_argument("--out", metavar="DIR", required=True, help="folder to write")
    _bench(parser)
