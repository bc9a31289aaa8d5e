"""What `scpjax.compiled` saves: compiling and running a least-squares fit with and without it, in one run.

``python benchmarks/compile.py`` prints seconds of both and their ratios.
"""

from __future__ import annotations

import time

import equinox as eqx
import jax
import numpy as np

from scpjax.compiled import forget, quick_options
from scpjax.diagnose.hypothesis import grown, trial_at
from scpjax.fit import solve as room
from scpjax.fit.setup import prepare
from scpjax.physics.catalogue import mechanism
from scpjax.physics.presets import plant
from scpjax.recordings import Metadata, Recording
from scpjax.recordings.excitation import multilevel_random
from scpjax.simulate.simulate import simulate

STEPS, REPEATS = 20, 5
MECHANISMS = ("creep", "two_node_thermal", "nonlinear_stiffness")


def recording() -> Recording:
    """A plant's, 300 s at 10 Hz."""
    time_s, volts = multilevel_random(duration_s=300, period_s=0.1, low=0, high=4, hold_s=8, seed=1)
    meta = Metadata(name="made", known=(("resistance_ohm", 1.2), ("moving_mass_kg", 0.25)), model="plant")
    driven = Recording.from_arrays(time_s, {"voltage_V": volts}, {}, metadata=meta, require_outputs=False)
    model = plant(
        resistance=1.2, conductance=0.14, thermal_mass=1.1, coefficient=0.024, stiffness=180.0, damping=8.0, mass=0.25
    )
    out = np.asarray(simulate(model, driven).outputs)
    noise = np.random.default_rng(0).standard_normal(out.shape)
    outputs = {
        "temperature_degC": out[:, 0] - 273.15 + 0.3 * noise[:, 0],
        "displacement_mm": 1e3 * out[:, 1] + 0.05 * noise[:, 1],
    }
    return Recording.from_arrays(time_s, {"voltage_V": volts}, outputs, metadata=meta)


def timed(options: dict, name: str) -> tuple[float, float]:
    """(compiling, running) [s] of `STEPS` steps of a fit of a model with one left-out mechanism."""
    setup = grown(prepare([recording()]), mechanism(name))
    trial = trial_at(setup, np.asarray(setup.starts[0]), np.zeros(len(setup.structure.mechanisms)))
    forget()
    program = eqx.filter_jit(room.solve_one, **({"compiler_options": options} if options else {}))
    began = time.perf_counter()
    compiled = program.lower(trial, setup.data, setup.space, max_steps=STEPS).compile()
    built = time.perf_counter() - began
    took = []
    for _ in range(REPEATS):
        began = time.perf_counter()
        jax.block_until_ready(compiled(trial, setup.data, setup.space, max_steps=STEPS))
        took.append(time.perf_counter() - began)
    return built, min(took)


def main() -> None:
    jax.config.update("jax_enable_x64", True)
    print(f"{'mechanism':24}{'compile':>10}{'quick':>10}{'ratio':>8}{'run':>10}{'quick':>10}{'ratio':>8}")
    for name in MECHANISMS:
        (c0, r0), (c1, r1) = timed({}, name), timed(quick_options("cpu"), name)
        print(f"{name:24}{c0:10.2f}{c1:10.2f}{c1 / c0:8.2f}{r0:10.3f}{r1:10.3f}{r1 / r0:8.2f}", flush=True)


if __name__ == "__main__":
    main()
