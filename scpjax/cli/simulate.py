"""``scpjax simulate`` and ``scpjax predict``."""

from __future__ import annotations

import dataclasses
from argparse import Namespace
from collections.abc import Mapping
from pathlib import Path

import numpy as np

from scpjax.cli.inputs import fit_drive, named_model, output_columns, read_input
from scpjax.cli.program import check_file, progress, say, start
from scpjax.errors import ModelError
from scpjax.physics.storage import load_model
from scpjax.recordings.files import write_recording, write_text
from scpjax.recordings.recording import Recording


def run_simulate(arguments: Namespace) -> None:
    """Simulate a model from rest over the drive of a file."""
    out = check_file(arguments.out, arguments.input, arguments.model)
    start()
    model, recording, extra = named_model(arguments.model, arguments.input, arguments.drive)
    from scpjax.simulate.simulate import simulate

    with progress(arguments) as show:
        if show:
            show("simulating", 0.1)
        values = np.asarray(simulate(model, recording).outputs)
    wanted = output_columns(model, recording, extra)
    columns = {name: unit.from_si(values[:, i]) for name, (i, unit) in wanted.items()}
    _check_finite(columns, arguments.model)
    inputs = {c.column: c.unit.from_si(recording.inputs[:, i]) for i, c in enumerate(recording.input_channels)}
    s = model.structure
    meta = dataclasses.replace(
        recording.metadata,
        title=f"Simulation of {arguments.model} over {Path(arguments.input).name}",
        model=s.name,
        ambient_K=float(model.ambient) if s.thermal else recording.metadata.ambient_K,
        pulley_radius_m=s.pulley_radius,
        pulley_mass_kg=s.pulley_mass or None,
        known=(),
    )
    made = Recording.from_arrays(recording.time, inputs, columns, hold=recording.hold, metadata=meta)
    write_recording(made, out)
    say(arguments, f"{out}: {recording.n} samples of {', '.join(columns)}")


def run_predict(arguments: Namespace) -> None:
    """Predict the outputs of a model in a file over the drive of another."""
    out = check_file(arguments.out, arguments.file, arguments.model)
    start()
    path = Path(arguments.model)
    model, extra = load_model(path / "model.json" if (path / "model.json").is_file() else path)
    recording = read_input(arguments.file, structure=model.structure, told=arguments.drive, extra=extra)
    model = fit_drive(model, recording)
    from scpjax.fit.predict import predict

    with progress(arguments) as show:
        if show:
            show("predicting", 0.1)
        time, predicted = predict(
            model,
            recording,
            noise=extra.get("noise"),
            response_columns=tuple(extra.get("response", ())),
            rooms=tuple(extra.get("rooms_K", ())),
        )
    columns = {"time_s": np.asarray(time)} | {k: np.asarray(v) for k, v in predicted.items()}
    _check_finite(columns, arguments.model)
    write_text(out, csv_text(columns))
    say(arguments, f"{out}: {len(columns['time_s'])} samples of {', '.join(list(columns)[1:])}")


def csv_text(columns: Mapping[str, np.ndarray]) -> str:
    """Columns (n,) as the text of a CSV file; a NaN is an empty cell."""
    cells = [["" if np.isnan(v) else f"{v:.12g}" for v in values] for values in columns.values()]
    rows = "\n".join(",".join(row) for row in zip(*cells, strict=True))
    return f"{','.join(columns)}\n{rows}\n"


def _check_finite(columns: Mapping[str, np.ndarray], model: str) -> None:
    for name, values in columns.items():
        if not np.all(np.isfinite(values)):
            raise ModelError(
                f"the simulation of {name} does not stay finite",
                where=model,
                mend="check the parameters: masses, damping and stiffness positive?",
            )
