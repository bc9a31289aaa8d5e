"""Two cascaded tanks: pump to lower level, from a base that is no actuator. Run ``python -m fits.tanks.run``.

The base and what it may leave out are those of ``examples/two_tanks.py``. Only est.csv is diagnosed; val.csv is
predicted from its drive and its first sample.
"""

from __future__ import annotations

import argparse
import time
from pathlib import Path

import numpy as np

from fits.common import Panel, Row, compare, main, names
from scpjax.diagnose.diagnose import diagnose
from scpjax.fit.metrics import rmse
from scpjax.fit.predict import first_state
from scpjax.physics.model import Model
from scpjax.recordings import Recording, read_recording
from scpjax.simulate.simulate import simulate
from scpjax.simulate.trial import use_base

BASE = Path(__file__).resolve().parents[2] / "examples" / "two_tanks.py"
EDGES = {"upper": "upper_overflow.edge", "lower": "lower_overflow.edge"}


def overflows(model: Model, recording: Recording) -> dict[str, list[tuple[float, float]]]:
    """When each tank overflows [s], by the model's edges; nothing for a tank whose overflow was not named."""
    states = np.asarray(simulate(model, recording, initial=first_state(model, recording, {})).states)
    out = {}
    for i, tank in enumerate(("upper", "lower")):
        if EDGES[tank] not in model.structure.index:
            continue
        full = states[:, i] > float(model.value(EDGES[tank]))
        ends = np.flatnonzero(np.diff(np.concatenate([[0], full.astype(int), [0]])))
        last = recording.n - 1
        out[tank] = [
            (float(recording.time[a]), float(recording.time[min(b, last)]))
            for a, b in zip(ends[::2], ends[1::2], strict=True)
        ]
    return out


def work(folder: Path, given: argparse.Namespace) -> tuple[list[Row], list[Panel]]:
    """Diagnose est, predict val; say where the water runs over."""
    began = time.monotonic()
    found = diagnose([read_recording(folder / "est.csv")], model=use_base(BASE).name)
    print(f"{found.verdict}: {found.says}")
    for m in found.mechanisms:
        print(f"{m.name}: " + ", ".join(f"{k} = {e.value:.3g} ± {e.std:.2g} {e.unit}" for k, e in m.parameters.items()))
    rows, panels = [], []
    for name in ("est", "val"):
        recording = read_recording(folder / f"{name}.csv")
        measured, base, extended, column = compare(found, recording)
        errors = (rmse(base, measured), rmse(extended, measured))
        note = "; ".join(
            f"the {tank} tank overflows {', '.join(f'{a:.0f} to {b:.0f} s' for a, b in spells) or 'never'}"
            for tank, spells in overflows(found.model, recording).items()
        )
        test = "est, fitted" if name == "est" else name
        rows.append(Row("tanks", test, "RMSE, V", *errors, names(found), time.monotonic() - began, note))
        panels.append(Panel(f"tanks, {name}", recording.time, measured, base, extended, y_label=column))
    return rows, panels


if __name__ == "__main__":
    main("tanks", "Diagnose est.csv from a base of two linear tanks and predict val.csv.", work)
