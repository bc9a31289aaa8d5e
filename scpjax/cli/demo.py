"""``scpjax demo``: recordings and a table that come with the package, diagnosed."""

from __future__ import annotations

from argparse import Namespace
from importlib import resources
from pathlib import Path

from scpjax.cli.inputs import read_files
from scpjax.cli.program import check_folder, say, start
from scpjax.cli.study import diagnose_into
from scpjax.errors import ScpjaxError


class DemoError(ScpjaxError):
    """The package lacks what the demo shows."""


def run_demo(arguments: Namespace) -> None:
    """Diagnose the packaged recordings, then Table 4.4 of the thesis."""
    out = check_folder(arguments.out)
    with resources.as_file(resources.files("scpjax") / "examples" / "demo") as folder:
        files = demo_files(folder)
        recordings = read_files(files, drive=None, response=None)
        say(arguments, f"Recordings of one actuator: {', '.join(Path(f).stem for f in files)}\n")
        start()
        diagnose_into(arguments, recordings, out, model=None)
    say(arguments, "\n" + "-" * 72)
    say_table(arguments)


def demo_files(folder: Path) -> list[str]:
    """The packaged recordings."""
    files = sorted(str(p) for p in folder.glob("*.csv")) if folder.is_dir() else []
    if not files:
        raise DemoError("the packaged recordings are missing", where=str(folder), mend="install scpjax again")
    return files


def say_table(arguments: Namespace) -> None:
    """What Table 4.4 says: laws ranked, and the conclusion in words."""
    from scpjax.diagnose.table import diagnose_steady, resistance_times_conductance
    from scpjax.recordings.thesis import table_4_4_recordings

    table = table_4_4_recordings()
    found = diagnose_steady(table, r_lambda=resistance_times_conductance())
    say(arguments, f"Table 4.4 of the thesis: {found.n} steady displacements of {len(table)} actuators\n")
    say(arguments, f"  {'law':42}{'':37}{'rms':>6}{'left out':>10}{'ΔBIC':>8}")
    for s in found.scores:
        errors = f"{1e3 * s.rmse_m:6.2f}{1e3 * s.cv_rmse_m:10.2f}{s.bic - found.scores[0].bic:8.0f}"
        say(arguments, f"  {s.law.title:42}{s.law.equation:37}{errors}")
    say(arguments, "  rms in mm of the fit, and at voltages left out of it; ΔBIC above 10 is decisive\n")
    for sentence in found.says:
        say(arguments, sentence)
