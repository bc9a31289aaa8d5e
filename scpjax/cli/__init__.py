"""The command line. Nothing heavy is imported before a command runs, so ``scpjax --help`` answers at once."""

from __future__ import annotations

import argparse
import difflib
import io
import re
import sys
from collections.abc import Sequence
from typing import NoReturn

import scpjax
from scpjax.cli import commands
from scpjax.cli.program import one_thread_for_blas
from scpjax.errors import ScpjaxError

_HELP = """\
examples
  scpjax demo                                        a diagnosis of recordings that come with the package
  scpjax diagnose step.csv random.csv --out found    what is the model missing?  found/report.html says
  scpjax predict found/model.json other.csv --out predicted.csv

A recording is a CSV file with the columns time_s, a drive (voltage_V, pwm, power_W, current_A) and what it
moved or heated (displacement_mm, temperature_degC, angle_deg). NAME.toml beside NAME.csv may say what is
known.
"""


class UsageError(ScpjaxError):
    """The command line itself does not make sense."""


class Parser(argparse.ArgumentParser):
    """Says what is wrong with a call in one line, with the nearest right word."""

    def error(self, message: str) -> NoReturn:
        words = [option for action in self._actions for option in action.option_strings]
        choices = [str(c) for action in self._actions for c in (action.choices or ())]
        wrong = re.search(r"invalid choice: '([^']*)'", message)
        stray = re.search(r"unrecognized arguments: (.*)", message)
        close: list[str] = []
        if wrong:
            close = difflib.get_close_matches(wrong[1], choices, n=1)
            message = f"{message.split('(choose')[0].strip()} (choose from {', '.join(choices)})"
        elif stray:
            close = difflib.get_close_matches(stray[1].split("=")[0].split()[0], words, n=1)
        nearest = f"did you mean {close[0]}? " if close else ""
        where = self.prog.removeprefix("scpjax").strip()
        raise UsageError(message, where=where, mend=f"{nearest}see {self.prog} --help")


def build_parser() -> Parser:
    """The parser of all commands."""
    parser = Parser(
        prog="scpjax",
        description="Simulate, fit and diagnose small heated or sprung actuators from recordings.",
        epilog=_HELP,
        formatter_class=argparse.RawDescriptionHelpFormatter,
        allow_abbrev=False,
    )
    parser.add_argument("--version", action="version", version=f"scpjax {scpjax.__version__}")
    places = parser.add_subparsers(title="commands", metavar="COMMAND", required=True, dest="command")
    commands.add_commands(places)
    return parser


def main(argv: Sequence[str] | None = None) -> int:
    """Run one command: 0 when done, 2 and one line on stderr when the call or a file is wrong."""
    one_thread_for_blas()
    for stream in (sys.stdout, sys.stderr):  # a redirected output of Windows knows no arrows: not the end of a run
        if isinstance(stream, io.TextIOWrapper):
            stream.reconfigure(errors="replace")
    given = list(sys.argv[1:] if argv is None else argv)
    try:
        parser = build_parser()
        arguments, rest = parser.parse_known_args(given)
        if rest:
            arguments.parser.error(f"unrecognized arguments: {' '.join(rest)}")
        arguments.line = given
        arguments.run(arguments)
    except ScpjaxError as error:
        print(f"scpjax: {error}", file=sys.stderr)
        return 2
    except KeyboardInterrupt as stop:
        print(f"scpjax: stopped; {str(stop) or 'nothing was written'}", file=sys.stderr)
        return 130
    return 0
