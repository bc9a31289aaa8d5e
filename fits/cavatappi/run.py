"""Cavatappi, coiled tubes under pressure: pressure to displacement. Run ``python -m fits.cavatappi.run``."""

from __future__ import annotations

import argparse
from pathlib import Path

import numpy as np
from scipy.signal import find_peaks

from fits.common import AS_THE_COMMAND, Panel, Row, compare, main, names
from scpjax.diagnose.diagnose import diagnose
from scpjax.errors import RecordingError
from scpjax.fit.metrics import nrmse
from scpjax.recordings import Recording, read_recording

CYCLES = 2  # that the fit sees


def cycle_ends(recording: Recording) -> np.ndarray:
    """Times [s] of the pressure minima between cycles."""
    pressure = recording.inputs[:, 0]
    width = max(recording.n // 100, 3)
    smooth = np.convolve(np.pad(pressure, width, mode="edge"), np.ones(width) / width, mode="same")[width:-width]
    minima, _ = find_peaks(-smooth, prominence=0.3 * np.ptp(smooth))
    return recording.time[minima]


def work(folder: Path, given: argparse.Namespace) -> tuple[list[Row], list[Panel]]:
    """For each load: diagnose the first cycles, predict the whole, score the rest; the median of all."""
    rows, panels = [], []
    for path in sorted(folder.glob("sample1_*.csv")):
        whole = read_recording(path)
        ends = cycle_ends(whole)
        if len(ends) < CYCLES:
            raise RecordingError(f"{len(ends) + 1} pressure cycles", where=str(path), mend=f"{CYCLES + 1} are needed")
        stop = float(ends[CYCLES - 1])
        found = diagnose([whole.slice(None, stop)], options=AS_THE_COMMAND)
        measured, base, extended, column = compare(found, whole)
        rest = whole.time >= stop
        scores = [nrmse(model[rest], measured[rest]) for model in (base, extended)]
        rows.append(Row("cavatappi", path.stem, "NRMSE, %", scores[0], scores[1], names(found), found.seconds))
        panels.append(Panel(path.stem, whole.time, measured, base, extended, y_label=column, start=stop))
    if not rows:
        raise RecordingError("no sample1_*.csv", where=str(folder), mend="check SCPJAX_DATA")
    middle = [float(np.median([r.base for r in rows])), float(np.median([r.extended for r in rows]))]
    total = sum(r.seconds for r in rows)
    return [*rows, Row("cavatappi", "median", "NRMSE, %", middle[0], middle[1], "", total)], panels


if __name__ == "__main__":
    main("cavatappi", "Diagnose the first two cycles of each load and predict the rest.", work)
