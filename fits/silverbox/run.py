"""Silverbox, a Duffing-like circuit: volts to volts. Run ``python -m fits.silverbox.run``."""

from __future__ import annotations

import argparse
from pathlib import Path

from fits.common import Panel, Row, compare, main, names, train
from scpjax.fit.metrics import rmse
from scpjax.recordings import read_recording


def work(folder: Path, given: argparse.Namespace) -> tuple[list[Row], list[Panel]]:
    """Diagnose multisine_train, predict multisine_test and arrow_test."""
    found, _ = train([folder / "multisine_train.csv"])
    rows, panels = [], []
    for name in ("multisine_test", "arrow_test"):
        test = read_recording(folder / f"{name}.csv")
        measured, base, extended, _ = compare(found, test)
        errors = [1e3 * rmse(model, measured) for model in (base, extended)]
        rows.append(Row("silverbox", name, "RMS, mV", errors[0], errors[1], names(found), found.seconds))
        wrong = [1e3 * (model - measured) for model in (base, extended)]
        panels.append(Panel(f"{name}: signal and errors", test.time, 1e3 * measured, wrong[0], wrong[1], y_label="mV"))
    return rows, panels


if __name__ == "__main__":
    main("silverbox", "Diagnose Silverbox's multisines, predict its test multisine and its arrow.", work)
