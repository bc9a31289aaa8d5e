"""What each command takes. The work is in the modules named by ``run``, imported when it is asked for."""

from __future__ import annotations

import argparse
import importlib
from collections.abc import Callable
from typing import Any

from scpjax.cli import rig_commands as rig

MODELS = ("te", "tm", "plant", "aaa")
MINUTES = 10.0  # for which other names are sought where none has reached the noise, unless told otherwise


def add_commands(places: Any) -> None:
    """Add every command to the subparsers ``places``."""
    _simulate(places)
    _fit(places)
    _diagnose(places)
    _predict(places)
    _fleet(places)
    _loop(places)
    _tune(places)
    rig.add_rig(places, command)
    _demo(places)


def _later(module: str, function: str) -> Callable[[argparse.Namespace], None]:
    def run(arguments: argparse.Namespace) -> None:
        getattr(importlib.import_module(f"scpjax.cli.{module}"), function)(arguments)

    return run


def command(places: Any, name: str, run: tuple[str, str], summary: str, more: str = "") -> argparse.ArgumentParser:
    """A command with what all of them have; ``run``: module of `scpjax.cli` and function."""
    parser = places.add_parser(
        name,
        help=summary,
        description=f"{summary[0].upper()}{summary[1:]}. {more}".strip(),
        allow_abbrev=False,
    )
    parser.set_defaults(run=_later(*run), parser=parser)
    shown = parser.add_mutually_exclusive_group()
    shown.add_argument("--quiet", action="store_true", help="print nothing but errors")
    shown.add_argument("--progress", action="store_true", help="show progress even when not in a terminal")
    return parser


def _roles(parser: argparse.ArgumentParser) -> None:
    parser.add_argument("--drive", metavar="COL", help="column that drives (default: [roles], else by its name)")
    parser.add_argument("--response", metavar="COL", help="columns that respond, comma separated")


def _model(parser: argparse.ArgumentParser, own: bool = False) -> None:
    which = parser.add_mutually_exclusive_group()
    which.add_argument("--model", choices=MODELS, help="default: as the files say, or by their columns")
    if own:
        words = "a base model of your own, no heated actuator: with what it may leave out beside it"
        which.add_argument("--base", metavar="FILE.py", help=words)


def _simulate(places: Any) -> None:
    parser = command(
        places,
        "simulate",
        ("simulate", "run_simulate"),
        "simulate a model over the drive of a file",
        "From rest at ambient. Writes time_s, the drive and what the model says, and a .toml beside it.",
    )
    parser.add_argument(
        "--model",
        metavar="M",
        required=True,
        help="a model.json, or te, tm, plant, aaa (actuator 2 of Table 4.14) or thesis (the plant (4.4))",
    )
    parser.add_argument("--input", metavar="FILE", required=True, help="CSV with time_s and the drive columns")
    parser.add_argument("--out", metavar="FILE", required=True, help="CSV to write")
    parser.add_argument("--drive", metavar="COL", help="column that drives")


def _fit(places: Any) -> None:
    parser = command(
        places,
        "fit",
        ("study", "run_fit"),
        "estimate the parameters of a model from recordings of one actuator",
        "Writes model.json, fit.json, figures and report.html.",
    )
    parser.add_argument("files", metavar="FILE", nargs="+", help="recordings (CSV) of one actuator")
    parser.add_argument("--out", metavar="DIR", required=True, help="folder to write")
    _model(parser, own=True)
    parser.add_argument(
        "--fixed",
        metavar="KEY=VALUE",
        action="append",
        default=[],
        help="hold a parameter, SI: elastic_spring.stiffness=100 or resistance_ohm=1.07 (may be repeated)",
    )
    parser.add_argument("--robust", action="store_true", help="do not let outliers pull the fit")
    _roles(parser)


def _diagnose(places: Any) -> None:
    parser = command(
        places,
        "diagnose",
        ("study", "run_diagnose"),
        "find which physics the model leaves out, from recordings of one actuator",
        "Writes diagnosis.json, model.json, figures and report.html.",
    )
    parser.add_argument("files", metavar="FILE", nargs="*", help="recordings (CSV) of one actuator")
    parser.add_argument("--out", metavar="DIR", required=True, help="folder to write")
    _model(parser, own=True)
    parser.add_argument(
        "--then",
        metavar="FILE",
        nargs="+",
        default=[],
        help="recordings made since; without other files those of the diagnosis in DIR are taken along",
    )
    _mechanism(parser)
    _roles(parser)
    _patience(parser)
    _next(parser)


def _patience(parser: argparse.ArgumentParser, of: str = "") -> None:
    parser.add_argument(
        "--minutes",
        metavar="M",
        type=_minutes,
        help=f"after which no other names are sought{of} where none has reached the noise, a second one apart "
        f"(default: {MINUTES:g}); half as long after it, and a minute at least, nothing is begun that the answer can "
        "do without; an experiment (--next) comes on top",
    )


def _minutes(word: str) -> float:
    try:
        minutes = float(word)
    except ValueError:
        minutes = 0.0
    if not minutes > 0:
        raise argparse.ArgumentTypeError(f"{word!r} is no positive number of minutes (inf: however long)")
    return minutes


def _mechanism(parser: argparse.ArgumentParser) -> None:
    parser.add_argument(
        "--mechanism",
        metavar="FILE.py",
        action="append",
        default=[],
        help="a mechanism of your own to try beside the catalogue's (may be repeated)",
    )


def _next(parser: argparse.ArgumentParser) -> None:
    group = parser.add_argument_group("next experiment")
    group.add_argument(
        "--next",
        action="store_true",
        help="design the drive that best separates hypotheses left close: next_experiment.csv; any limit asks for it "
        "too, and one not given is as recorded",
    )
    group.add_argument("--max-volts", metavar="V", type=float, help="greatest drive of a voltage column")
    group.add_argument("--min-volts", metavar="V", type=float, help="least drive of a voltage column")
    group.add_argument("--max-drive", metavar="X", type=float, help="greatest drive, in the unit of its column")
    group.add_argument("--min-drive", metavar="X", type=float, help="least drive, in the unit of its column")
    group.add_argument(
        "--max-temperature",
        metavar="DEGC",
        type=float,
        help="that any heated part, or a temperature that drives, may reach",
    )
    group.add_argument("--duration", metavar="S", type=float, help="of the experiment")
    group.add_argument("--period", metavar="S", type=float, help="between its samples")
    group.add_argument("--slew", metavar="X", type=float, help="greatest change of the drive in a second")


def _predict(places: Any) -> None:
    parser = command(
        places,
        "predict",
        ("simulate", "run_predict"),
        "predict the outputs of a fitted or diagnosed model over the drive of a file",
        "Only the drive is used; of the outputs only the first sample, where the file has it, as the start.",
    )
    parser.add_argument("model", metavar="DIR/model.json", help="as fit and diagnose write it")
    parser.add_argument("file", metavar="FILE", help="CSV with time_s and the drive columns")
    parser.add_argument("--out", metavar="FILE", required=True, help="CSV to write")
    parser.add_argument("--drive", metavar="COL", help="column that drives (default: as in the fit)")


def _fleet(places: Any) -> None:
    parser = command(
        places,
        "fleet",
        ("fleet", "run_fleet"),
        "fit many actuators at once and compare them, or diagnose each",
        "Each subfolder with CSV files, and each CSV file beside them, is an actuator. Writes fleet.csv, "
        "fleet.json, figures and report.html.",
    )
    parser.add_argument("where", metavar="DIR_OR_GLOB", help="folder of actuators, or a quoted pattern")
    parser.add_argument("--out", metavar="DIR", required=True, help="folder to write")
    parser.add_argument(
        "--diagnose",
        action="store_true",
        help="diagnose each actuator in turn, into a folder of its own below actuators/, and say which effects are in "
        "which; a call that was stopped goes on where it was",
    )
    _patience(parser, " of an actuator under --diagnose")
    _model(parser, own=True)
    _mechanism(parser)
    _roles(parser)


_USUAL = "default: as scpjax/control/reference.py has it, for those of thesis 4.4.3 as printed there"


def _closed_loop(parser: argparse.ArgumentParser) -> None:
    parser.add_argument(
        "--plant", metavar="P", required=True, help="thesis (the plant (4.4)), plant, aaa, or a model.json of a fit"
    )
    parser.add_argument(
        "--reference",
        metavar="R",
        required=True,
        help="sine, square, triangle, sawtooth, stair, multilevel, ramps, sweep, step_difference, minimum_jerk, or a "
        "CSV file with time_s,reference_deg",
    )
    parser.add_argument("--amplitude", metavar="DEG", type=float, help="of the reference (default: 25)")
    parser.add_argument("--frequency", metavar="HZ", type=float, help=f"of the reference ({_USUAL})")
    parser.add_argument("--duration", metavar="S", type=float, help=f"of the reference ({_USUAL})")
    parser.add_argument("--dt", metavar="S", type=float, help="sampling period (default: 0.02, or that of the file)")
    parser.add_argument("--radius", metavar="M", type=float, help="of the pulley (default: 0.015)")


_SEED = "draw the levels of the multilevel reference (default: those of the thesis)"


def _loop(places: Any) -> None:
    parser = command(
        places,
        "loop",
        ("loop", "run_loop"),
        "close the loop: a PID for each muscle, a plant, a reference",
        "Writes time_s, reference_deg, angle_deg and both voltages, and says how well it follows and whether it is "
        "stable.",
    )
    parser.add_argument(
        "--gains", metavar="G", default="thesis", help="thesis (Table 3.7, the default) or a gains.toml with Kp Ki Kd N"
    )
    _closed_loop(parser)
    parser.add_argument("--seed", metavar="N", type=int, help=_SEED)
    parser.add_argument("--out", metavar="FILE", required=True, help="CSV to write")


def _tune(places: Any) -> None:
    parser = command(
        places,
        "tune",
        ("tune", "run_tune"),
        "tune the gains of a loop for a reference, by differentiating through it",
        "Never worse than the gains it starts from. Writes gains.toml, loop.csv, figures and report.html.",
    )
    parser.add_argument("--gains", metavar="G", default="thesis", help="where to start: thesis, or a gains.toml")
    _closed_loop(parser)
    parser.add_argument(
        "--spread", metavar="SHARE", type=float, help="tune for many plants whose parameters differ by this share"
    )
    parser.add_argument("--plants", metavar="N", type=int, default=64, help="how many, with --spread (%(default)s)")
    parser.add_argument(
        "--effort", metavar="DEG", type=float, default=0.0, help="weight of 1 V² of mean effort, in degrees"
    )
    parser.add_argument("--hottest", metavar="DEGC", type=float, help="keep the temperature below this")
    parser.add_argument(
        "--sensitivity", metavar="MS", type=float, help="keep the sensitivity peak below this, such as 2"
    )
    parser.add_argument("--seed", metavar="N", type=int, help=f"{_SEED}; and of the plants under --spread")
    parser.add_argument("--out", metavar="DIR", required=True, help="folder to write")


def _demo(places: Any) -> None:
    parser = command(
        places,
        "demo",
        ("demo", "run_demo"),
        "diagnose the recordings that come with the package",
        "Also asks what Table 4.4 of the thesis (steady displacements of nine actuators) can tell.",
    )
    parser.add_argument("--out", metavar="DIR", default="scpjax-demo", help="folder to write (default: %(default)s)")
