"""A process that diagnoses one case after another and keeps what it has compiled.

Reads one JSON line per job: {"do": "library" | "command" | "narx" | "pysindy", "given": [...], "kept": [...],
"out": FOLDER, "noise": {column: std}} (the last for the baselines); answers with one line that begins with ``ANSWER``.
Truth files are not among what it is given.
"""

from __future__ import annotations

import contextlib
import json
import sys
import time
import traceback
from pathlib import Path
from typing import Any, TextIO

ANSWER = "@answer "
Errors = dict[str, dict[str, float]]


def diagnose_by_library(job: dict[str, Any]) -> dict[str, Any]:
    """``diagnose`` on the given files, ``predict`` on the kept ones with the extended and with the base model."""
    from scpjax.cli.commands import MINUTES
    from scpjax.diagnose.diagnose import DiagnoseOptions, diagnose
    from scpjax.recordings.files import read_recording

    options = DiagnoseOptions(patience=60.0 * MINUTES)  # as on the command line
    began = time.monotonic()
    found = diagnose([read_recording(f) for f in job["given"]], options=options)
    seconds = time.monotonic() - began
    kept: Errors = {}
    base: Errors = {}
    for file in job["kept"]:
        recording = read_recording(file)
        for errors, model in ((kept, found.model), (base, found.base_model)):
            errors[Path(file).stem] = _errors(model, recording, dict(found.base.noise))
    return {"diagnosis": found.to_json(), "kept": kept, "kept_base": base, "seconds": seconds}


def _errors(model: Any, recording: Any, noise: dict[str, float]) -> dict[str, float]:
    from scpjax.fit.metrics import rmse
    from scpjax.fit.predict import predict

    _, said = predict(model, recording, noise=noise)
    return {
        c.column: float(rmse(said[c.column], c.unit.from_si(recording.output(c.stem))))
        for c in recording.output_channels
    }


def diagnose_by_command(job: dict[str, Any]) -> dict[str, Any]:
    """The same by ``scpjax diagnose`` and ``scpjax predict``, as a user would; the base model is not predicted with."""
    import numpy as np

    from scpjax.cli import main

    out = Path(job["out"])
    began = time.monotonic()
    if main(["diagnose", *job["given"], "--out", str(out), "--quiet"]):
        raise RuntimeError("scpjax diagnose ended with an error")
    seconds = time.monotonic() - began
    kept: Errors = {}
    for file in job["kept"]:
        said = out / f"{Path(file).stem}.csv"
        if main(["predict", str(out / "model.json"), file, "--out", str(said), "--quiet"]):
            raise RuntimeError("scpjax predict ended with an error")
        measured, predicted = (np.genfromtxt(f, delimiter=",", names=True) for f in (file, said))
        kept[Path(file).stem] = {
            c: float(np.sqrt(np.mean((measured[c] - predicted[c]) ** 2)))
            for c in measured.dtype.names or ()
            if c in (predicted.dtype.names or ()) and c != "time_s" and not c.startswith("voltage")
        }
    found = json.loads((out / "diagnosis.json").read_text(encoding="utf-8"))
    return {"diagnosis": found, "kept": kept, "kept_base": {}, "seconds": seconds}


def learn_baseline(job: dict[str, Any]) -> dict[str, Any]:
    """A baseline on the same files."""
    import numpy as np

    from fits.concealed.baselines import narx, sindy
    from fits.concealed.baselines.series import read_series

    names = read_series(job["given"][0]).names
    noise = np.array([job["noise"][n] for n in names])
    judge = sindy.judge if job["do"] == "pysindy" else narx.judge
    return dict(judge(job["given"], job["kept"], noise).plain())


WAYS = {
    "library": diagnose_by_library,
    "command": diagnose_by_command,
    "narx": learn_baseline,
    "pysindy": learn_baseline,
}


def answer(job: dict[str, Any]) -> dict[str, Any]:
    """Do one job; an exception is an answer too."""
    try:
        return WAYS[job["do"]](job)
    except Exception as error:
        traceback.print_exc(file=sys.stderr)
        return {"error": f"{type(error).__name__}: {error}"[:500]}


def serve(lines: TextIO, out: TextIO) -> None:
    """Answer every line until there are no more."""
    from scpjax.cli.program import start

    start()
    for line in lines:
        with contextlib.redirect_stdout(sys.stderr):
            found = answer(json.loads(line))
        print(ANSWER + json.dumps(found), file=out, flush=True)


if __name__ == "__main__":
    serve(sys.stdin, sys.stdout)
