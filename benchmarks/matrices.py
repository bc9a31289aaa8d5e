"""What a loop over the columns of a step's matrices is worth, where several mechanisms are in a model: the same
Jacobian with the matrices gone through by columns and taken apart into scalars.

``python benchmarks/matrices.py`` begins a process for each, in turn, with the options of the command line. It computes
on the example that ships with scpjax: columns first.
"""

from __future__ import annotations

import json
import os
import subprocess
import sys
import time
from importlib import resources

import numpy as np

from scpjax.cli.program import LOOPS

HYPOTHESES = ("hysteresis", "hysteresis+creep", "hysteresis+creep+two_node_thermal")
REPEATS = 10


def measure(few: int) -> dict[str, tuple[float, float]]:
    """By hypothesis: seconds for a Jacobian with its compiling, and for one without."""
    import jax

    jax.config.update("jax_enable_x64", True)
    from scpjax.diagnose.hypothesis import grown, trial_at
    from scpjax.fit.setup import prepare
    from scpjax.fit.solve import evaluate, stack
    from scpjax.physics.catalogue import mechanism
    from scpjax.recordings import read_recording
    from scpjax.simulate import exponential

    exponential._FEW = few
    with resources.as_file(resources.files("scpjax") / "examples" / "demo") as folder:
        setup = prepare([read_recording(f) for f in sorted(folder.glob("*.csv"))])
    out = {}
    for names in HYPOTHESES:
        problem = grown(setup, *(mechanism(name) for name in names.split("+")))
        laws = np.zeros(len(problem.structure.mechanisms))
        trials = stack([trial_at(problem, np.asarray(problem.starts[0]), laws)])
        times = []
        for _ in range(REPEATS + 1):
            began = time.perf_counter()
            evaluate(trials, setup.data, problem.space)
            times.append(time.perf_counter() - began)
        out[names] = times[0], min(times[1:])
    return out


def elsewhere(few: int) -> dict[str, tuple[float, float]]:
    """What a process of its own measures, where matrices of so many entries are taken apart."""
    told = {k: v for k, v in os.environ.items() if k != "JAX_COMPILATION_CACHE_DIR"} | {"XLA_FLAGS": LOOPS}
    command = [sys.executable, __file__, "--measure", str(few)]
    return json.loads(subprocess.run(command, env=told, check=True, capture_output=True).stdout)


def main() -> None:
    columns, scalars = elsewhere(0), elsewhere(10_000)
    print(("{:36}" + "{:>26}" * 2).format("seconds (ratio)", "Jacobian, first", "Jacobian"))
    for names in HYPOTHESES:
        shown = [f"{a:.3f} / {b:.3f} ({a / b:.2f})" for a, b in zip(columns[names], scalars[names], strict=True)]
        print(("{:36}" + "{:>26}" * 2).format(names, *shown))


if __name__ == "__main__":
    if "--measure" in sys.argv:
        print(json.dumps(measure(int(sys.argv[-1]))))
    else:
        main()
