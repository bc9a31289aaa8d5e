"""What the fits share: where the recordings lie, a row of figures, and a picture."""

from __future__ import annotations

import argparse
import os
import sys
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import NoReturn

import numpy as np

from fits.commit import commit
from scpjax.cli.commands import MINUTES
from scpjax.cli.program import start
from scpjax.diagnose.diagnose import DiagnoseOptions, diagnose
from scpjax.diagnose.result import Diagnosis
from scpjax.errors import ScpjaxError
from scpjax.fit.predict import predict
from scpjax.physics.model import Model
from scpjax.recordings import Recording, read_recording

AS_THE_COMMAND = DiagnoseOptions(patience=60 * MINUTES)
"""No longer than ``scpjax diagnose`` takes, unless told otherwise."""

_HEADER = ("fit", "test", "measure", "base", "extended", "named", "seconds")


@dataclass(frozen=True)
class Row:
    """One line of the table: how well the base and the extended model predict a test."""

    fit: str
    test: str
    measure: str
    base: float
    extended: float
    named: str
    seconds: float
    note: str = ""  # what else is to be told of this test

    def text(self) -> str:
        """As a line of a Markdown table."""
        cells = (self.fit, self.test, self.measure, f"{self.base:.4g}", f"{self.extended:.4g}", self.named)
        return f"| {' | '.join(cells)} | {self.seconds:.0f} |"


@dataclass(frozen=True)
class Panel:
    """One picture against ``x`` (n,): what was measured and what two models say; a line at ``start``."""

    title: str
    x: np.ndarray
    measured: np.ndarray
    base: np.ndarray
    extended: np.ndarray
    x_label: str = "time, s"
    y_label: str = ""
    start: float | None = None


Work = Callable[[Path, argparse.Namespace], tuple[list[Row], list[Panel]]]


def main(name: str, about: str, work: Work, argv: Sequence[str] | None = None) -> None:
    """A fit as a program: finds the data, does the work, prints the table and draws the figure."""
    parser = argparse.ArgumentParser(prog=f"python -m fits.{name}.run", description=about)
    parser.add_argument(
        "--data",
        metavar="DIR",
        type=Path,
        default=os.environ.get("SCPJAX_DATA"),
        help=f"folder that holds {name}/ (default: the environment's SCPJAX_DATA)",
    )
    parser.add_argument(
        "--out",
        metavar="DIR",
        type=Path,
        default=Path("out") / name,
        help="folder for the figure (default: %(default)s)",
    )
    parser.add_argument("--page", metavar="FILE", type=Path, help="keep the table there, as fits/real.md")
    given = parser.parse_args(argv)
    folder = find(given.data, name)
    start()
    try:
        rows, panels = work(folder, given)
    except ScpjaxError as error:
        _stop(str(error))
    lines = [f"| {' | '.join(_HEADER)} |", f"|{'---|' * len(_HEADER)}", *(row.text() for row in rows)]
    lines += [f"\n{row.test}: {row.note}" for row in rows if row.note]
    print("\n".join(lines))
    if given.page is not None:
        keep(given.page, name, lines)
    print(f"figure: {draw(panels, given.out / f'{name}.png')}", file=sys.stderr)


def keep(page: Path, name: str, lines: Sequence[str]) -> None:
    """Put a fit's table into its section of a page of all fits, with the commit; other sections stay as they are."""
    head, *sections = (page.read_text(encoding="utf-8") if page.exists() else _PAGE).split("\n## ")
    by_name = {section.split("\n", 1)[0]: section.rstrip() for section in sections}
    by_name[name] = "\n".join(
        [name, "", f"`python -m fits.{name}.run --page {page}` on commit {commit()}:", "", *lines]
    )
    text = "\n\n## ".join([head.rstrip(), *(by_name[n] for n in sorted(by_name))])
    page.write_text(text + "\n", encoding="utf-8")


_PAGE = """# Real recordings: what was named, and how unseen ones are predicted

Each table is written by the command above it. `base` and `extended` are errors (or NRMSE, of which 100 % is perfect) on
recordings, or parts of them, that took no part in fitting; a test that did is called fitted. Of the tanks `val` was
scored between choices of structure (`tanks/README.md`).
"""


def _stop(message: str) -> NoReturn:
    print(message, file=sys.stderr)
    raise SystemExit(2)


def find(data: Path | str | None, name: str) -> Path:
    """The folder of a fit's recordings; ends the program with a line on what to set where it is not there."""
    if data is None:
        _stop(f"no data: set SCPJAX_DATA, or give --data, to the folder that holds {name}/ (see fits/README.md)")
    folder = Path(data) / name
    if not folder.is_dir():
        _stop(f"{folder}: no such folder; SCPJAX_DATA or --data names the folder that holds {name}/")
    return folder


def train(files: Sequence[Path]) -> tuple[Diagnosis, list[Recording]]:
    """Diagnosis of recordings."""
    recordings = [read_recording(f) for f in files]
    return diagnose(recordings, options=AS_THE_COMMAND), recordings


def compare(found: Diagnosis, test: Recording) -> tuple[np.ndarray, np.ndarray, np.ndarray, str]:
    """(measured, base, extended (n,), column) of a test's only column, in the file's unit."""
    channel = test.output_channels[0]
    measured = np.asarray(channel.unit.from_si(test.output(channel.stem)))
    return measured, said(found.base_model, test, found), said(found.model, test, found), channel.column


def said(model: Model, test: Recording, found: Diagnosis) -> np.ndarray:
    """What a model says of a test's only column (n,), in the file's unit."""
    column = test.output_channels[0].column
    return predict(model, test, noise=found.base.noise, response_columns=(column,))[1][column]


def names(found: Diagnosis) -> str:
    """Mechanisms named, each with its law, and the verdict."""
    named = " + ".join(f"{m.name} ({m.law})" if m.law else m.name for m in found.mechanisms)
    return f"{named}: {found.verdict}" if named else found.verdict


def draw(panels: Sequence[Panel], path: Path) -> Path:
    """Measured against predicted, one panel above the other."""
    import matplotlib

    matplotlib.use("Agg")
    from matplotlib import pyplot as plt

    figure, axes = plt.subplots(len(panels), 1, figsize=(7, 2.4 * len(panels)), squeeze=False, layout="constrained")
    for axis, panel in zip(axes[:, 0], panels, strict=True):
        axis.plot(panel.x, panel.measured, color="0.6", lw=2, label="measured")
        axis.plot(panel.x, panel.base, color="tab:blue", lw=0.9, label="base")
        axis.plot(panel.x, panel.extended, color="tab:red", lw=0.9, label="extended")
        if panel.start is not None:
            axis.axvline(panel.start, color="0.3", ls=":", lw=1)
        axis.set(title=panel.title, xlabel=panel.x_label, ylabel=panel.y_label)
    axes[0, 0].legend(frameon=False, ncols=3)
    path.parent.mkdir(parents=True, exist_ok=True)
    figure.savefig(path, dpi=130)
    plt.close(figure)
    return path
