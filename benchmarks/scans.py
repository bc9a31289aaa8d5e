"""What the command line's option for scans over small arrays is worth: the same program with it and without.

``python benchmarks/scans.py`` begins a process with the option and one without, in turn and several times, since XLA
reads it only once. Each computes on the example that ships with scpjax: the least of the turns is shown,
with the option first.
"""

from __future__ import annotations

import json
import os
import subprocess
import sys
import time
from collections.abc import Callable
from functools import partial
from importlib import resources

import numpy as np

from scpjax.cli.program import LOOPS

MECHANISMS, TURNS, REPEATS = ("hysteresis", "creep", "two_node_thermal"), 3, 10


def measure() -> dict[str, list[float]]:
    """By mechanism: seconds for a Jacobian with its compiling, for one without, and for sixteen simulations abreast."""
    import jax

    jax.config.update("jax_enable_x64", True)
    from scpjax.diagnose.hypothesis import grown, trial_at
    from scpjax.fit.setup import prepare
    from scpjax.fit.solve import evaluate, residuals_at, stack
    from scpjax.physics.catalogue import mechanism
    from scpjax.recordings import read_recording

    with resources.as_file(resources.files("scpjax") / "examples" / "demo") as folder:
        setup = prepare([read_recording(f) for f in sorted(folder.glob("*.csv"))])
    out = {}
    for name in MECHANISMS:
        problem = grown(setup, mechanism(name))
        laws = np.zeros(len(problem.structure.mechanisms))
        start = np.asarray(problem.starts[0])
        trials = stack([trial_at(problem, start, laws)])
        jacobian = partial(evaluate, trials, setup.data, problem.space)
        simulations = partial(residuals_at, start[None], laws[None], setup.data, problem.space)
        out[name] = [_seconds(jacobian), _quickest(jacobian), _quickest(simulations)]
    return out


def _seconds(function: Callable[[], object]) -> float:
    began = time.perf_counter()
    function()
    return time.perf_counter() - began


def _quickest(function: Callable[[], object]) -> float:
    function()
    return min(_seconds(function) for _ in range(REPEATS))


def elsewhere(flags: str) -> dict[str, list[float]]:
    """What a process of its own measures, with these ``XLA_FLAGS``."""
    told = {k: v for k, v in os.environ.items() if k not in ("XLA_FLAGS", "JAX_COMPILATION_CACHE_DIR")}
    command = [sys.executable, __file__, "--measure"]
    return json.loads(subprocess.run(command, env=told | {"XLA_FLAGS": flags}, check=True, capture_output=True).stdout)


def main() -> None:
    turns = [(elsewhere(LOOPS), elsewhere("")) for _ in range(TURNS)]
    print(("{:20}" + "{:>26}" * 3).format("seconds (ratio)", "Jacobian, first", "Jacobian", "16 simulations"))
    for name in MECHANISMS:
        ours, plain = (np.min([t[i][name] for t in turns], axis=0) for i in (0, 1))
        shown = [f"{a:.3f} / {b:.3f} ({a / b:.2f})" for a, b in zip(ours, plain, strict=True)]
        print(("{:20}" + "{:>26}" * 3).format(name, *shown))


if __name__ == "__main__":
    if "--measure" in sys.argv:
        print(json.dumps(measure()))
    else:
        main()
