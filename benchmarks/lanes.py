"""What it is worth that sensitivities are simulated by as many as a processor takes at once, and of each recording only
those it depends on: the same Jacobian with one more, and with all of them for every recording.

``python benchmarks/lanes.py`` computes on the example that ships with scpjax, with the options of the command line.
"""

from __future__ import annotations

import os
import time
from collections.abc import Callable
from functools import partial
from importlib import resources

import equinox as eqx
import numpy as np

from scpjax.cli.program import LOOPS

HYPOTHESES = ("creep", "hysteresis", "two_node_thermal")
REPEATS = 20


def main() -> None:
    os.environ["XLA_FLAGS"] = f"{os.environ.get('XLA_FLAGS', '')} {LOOPS}".strip()
    import jax

    jax.config.update("jax_enable_x64", True)
    from scpjax.diagnose.hypothesis import grown, trial_at
    from scpjax.fit.setup import prepare
    from scpjax.fit.solve import evaluate, stack
    from scpjax.physics.catalogue import mechanism
    from scpjax.recordings import read_recording

    with resources.as_file(resources.files("scpjax") / "examples" / "demo") as folder:
        setup = prepare([read_recording(f) for f in sorted(folder.glob("*.csv"))])
    print("milliseconds for a Jacobian, by lanes (of the recording that depends on most: as many as move)")
    for name in HYPOTHESES:
        problem = grown(setup, mechanism(name))
        trial = trial_at(problem, np.asarray(problem.starts[0]), np.zeros(len(problem.structure.mechanisms)))
        every, mine = len(trial.index), np.asarray(trial.lanes)
        asked = {}
        for width in sorted({mine.shape[1], mine.shape[1] + 1, every, 4 * -(-every // 4)}):
            lanes = np.full((len(mine), width), every)
            filled = mine if width < every else np.tile(np.arange(every), (len(mine), 1))
            lanes[:, : filled.shape[1]] = filled
            trials = stack([eqx.tree_at(lambda t: t.lanes, trial, lanes)])
            asked[width] = partial(evaluate, trials, setup.data, problem.space)
        shown = "   ".join(f"{width}: {1e3 * seconds:.2f}" for width, seconds in _quickest(asked).items())
        print(f"{name:20} {shown}   ({every} move, {len(mine)} recordings)")


def _quickest(asked: dict[int, Callable[[], object]]) -> dict[int, float]:
    """The least of several turns: a machine that does other things besides slows all down alike."""
    best = dict.fromkeys(asked, np.inf)
    for _ in range(REPEATS):
        for width, function in asked.items():
            began = time.perf_counter()
            function()
            best[width] = min(best[width], time.perf_counter() - began)
    return best


if __name__ == "__main__":
    main()
