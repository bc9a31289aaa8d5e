"""Arduino heater board: heater to temperature. Run ``python -m fits.tclab.run``."""

from __future__ import annotations

import argparse
from pathlib import Path

from fits.common import Panel, Row, compare, main, names, train
from scpjax.fit.metrics import rmse
from scpjax.recordings import read_recording


def work(folder: Path, given: argparse.Namespace) -> tuple[list[Row], list[Panel]]:
    """Diagnose step_train, predict step_test."""
    found, _ = train([folder / "step_train.csv"])
    test = read_recording(folder / "step_test.csv")
    measured, base, extended, column = compare(found, test)
    errors = (rmse(base, measured), rmse(extended, measured))
    row = Row("tclab", "step_test", "RMSE, degC", *errors, names(found), found.seconds)
    return [row], [Panel("TCLab, step_test", test.time, measured, base, extended, y_label=column)]


if __name__ == "__main__":
    main("tclab", "Diagnose TCLab's training steps and predict its test steps.", work)
