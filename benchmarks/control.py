"""Closed loops beside plain C, gradients beside simulations, tuning beside differential evolution, robust tuning.

python benchmarks/control.py                # all
python benchmarks/control.py --only speed gradient tune robust
"""

from __future__ import annotations

import argparse
import ctypes
import subprocess
import tempfile
import time
from collections.abc import Callable, Sequence
from pathlib import Path

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from scipy.optimize import differential_evolution

from scpjax.control.batch import batched
from scpjax.control.fleet import spread_plants
from scpjax.control.loop import Loop, run
from scpjax.control.objective import Objective
from scpjax.control.pid import DEGREE, PID, Pair, thesis_pair
from scpjax.control.plant import Difference
from scpjax.control.problem import BOUNDS, Problem
from scpjax.control.reference import Reference
from scpjax.control.tune import TuneOptions, tune, value_at, values_and_gradients, values_at
from scpjax.physics.known import known_model
from scpjax.simulate.exponential import phi_functions

FREE = ("Kp", "Ki", "Kd", "N")
DT, RADIUS, SUPPLY = 0.02, 0.015, 3.7


def thesis_loop() -> Loop:
    """Plant (4.4) twice over a pulley of 15 mm, gains of Table 3.7."""
    plant = known_model("thesis")
    return Loop(Difference(plant, plant, radius=RADIUS), thesis_pair())


def least(call: Callable[[], object], repeats: int) -> float:
    """Least time [s] of some calls, after one that is not counted."""
    call()
    times = []
    for _ in range(repeats):
        began = time.perf_counter()
        call()
        times.append(time.perf_counter() - began)
    return min(times)


def c_library() -> Callable[..., None]:
    """The C loop, compiled here with gcc -O3 -march=native."""
    out = Path(tempfile.mkdtemp()) / "loops.so"
    source = Path(__file__).with_name("control.c")
    flags = ["-O3", "-march=native", "-shared", "-fPIC", "-pthread"]
    subprocess.run(["gcc", *flags, str(source), "-o", str(out), "-lm"], check=True)
    return ctypes.CDLL(str(out)).loops


def plain_c(gains: np.ndarray, reference: np.ndarray, threads: int) -> Callable[[], np.ndarray]:
    """A call that gives the RMSE [rad] of every loop."""
    loops, model = c_library(), known_model("thesis")
    a, b = model.linearise()
    p0, p1, *_ = (np.asarray(p) for p in phi_functions(a * DT))
    push = (p1 * DT @ np.asarray(b))[:, 0]
    chosen = [p0[0, 0], p0[1, 0], p0[1, 1], p0[1, 2], p0[2, 0], p0[2, 1], p0[2, 2], *push, 1 / RADIUS, SUPPLY**2, DT]
    given = [np.ascontiguousarray(x, np.float64) for x in (gains, chosen, reference)]
    rmse = np.zeros(len(gains))
    pointers = [x.ctypes.data_as(ctypes.POINTER(ctypes.c_double)) for x in (*given, rmse)]

    def call() -> np.ndarray:
        loops(*pointers, *(ctypes.c_long(v) for v in (len(gains), len(reference), threads)))
        return rmse

    call.keep = given  # type: ignore[attr-defined]
    return call


def speed(count: int, steps: int, threads: int, repeats: int) -> None:
    """Loops with gains of their own, beside C."""
    rng = np.random.default_rng(0)
    gains = np.array([0.5, 0.12, 0.47, 5.84]) * np.exp(0.5 * rng.standard_normal((count, 4)))
    gains[:, :3] /= DEGREE
    reference = np.radians(25) * np.sin(2 * np.pi * 0.05 * DT * np.arange(steps))
    plant = thesis_loop().plant

    def rmse(g: jax.Array) -> jax.Array:
        response = run(Loop(plant, Pair(PID(g[0], g[1], g[2], g[3]))), reference, dt=DT)
        return jnp.sqrt(jnp.mean(response.error**2))

    c = plain_c(gains, reference, threads)
    ours = batched(rmse, threads=threads)
    off = np.max(np.abs(np.asarray(ours(gains)) / c() - 1))
    theirs, mine = least(c, repeats), least(lambda: ours(gains), repeats)
    again = least(c, repeats)
    theirs = min(theirs, again)
    rate = count * steps / 1e6
    print(f"\n{count} loops of {steps} steps with two plants each, {threads} threads, double precision")
    print(f"  {'plain C, gcc -O3 -march=native':40}{theirs:8.3f} s {rate / theirs:8.0f} million steps/s")
    print(f"  {'scpjax':40}{mine:8.3f} s {rate / mine:8.0f} million steps/s   {theirs / mine:.2f} of C's rate")
    print(f"  greatest relative difference of an RMSE: {off:.1e}")


def gradient(starts: int, repeats: int) -> None:
    """One value-and-gradient of the tuning objective over many starts, in simulations."""
    problem = Problem(thesis_loop(), Reference(dt=DT).make("sine")[1][:3000])
    rng = np.random.default_rng(0)
    at = jnp.asarray(np.log([0.5, 0.12, 0.47, 5.84]) + 0.5 * rng.standard_normal((starts, 4)))
    value = eqx.filter_jit(lambda p, x: jax.vmap(lambda y: value_at(p, FREE, y))(x))
    both = eqx.filter_jit(lambda p, x: values_and_gradients(p, FREE, x))
    back = eqx.filter_jit(lambda p, x: jax.vmap(jax.value_and_grad(lambda y: value_at(p, FREE, y)))(x))
    repeats = 5 * repeats  # short calls: a quiet moment for each
    one = least(lambda: jax.block_until_ready(value(problem, at)), repeats)
    print(f"\nvalue and gradient in 4 gains over {starts} starts, 3000 steps")
    print(f"  {'simulation':40}{1e3 * one:8.2f} ms")
    for name, call in (("forward, tangents abreast", both), ("reverse", back)):
        taken = least(lambda call=call: jax.block_until_ready(call(problem, at)), repeats)
        print(f"  {name:40}{1e3 * taken:8.2f} ms {taken / one:8.2f} simulations")


def tuning(seeds: int, evaluations: int) -> None:
    """scpjax's tuner and scipy's differential evolution on four references of Table 4.16."""
    print(
        f"\ntuned one reference at a time; RMSE in degrees (differential evolution: {evaluations} loops, {seeds} seeds)"
    )
    print(f"  {'':10}{'Table 3.7':>10}{'scpjax':>9}{'loops':>7}{'s':>6}   other seeds{'':14}   differential evolution")
    bounds = [tuple(np.log(BOUNDS[name])) for name in FREE]
    for name in ("sine", "square", "triangle", "sawtooth"):
        problem = Problem(thesis_loop(), Reference(dt=DT).make(name)[1])
        found = [tune(problem, TuneOptions(seed=seed)) for seed in range(max(seeds, 1))]
        began = time.perf_counter()
        tune(problem)
        seconds = time.perf_counter() - began
        peer = [_evolve(problem, bounds, evaluations, seed) for seed in range(seeds)]
        degrees = lambda v: " ".join(f"{np.degrees(x):7.4f}" for x in v)  # noqa: E731
        ours, values = found[0].value, [f.value for f in found[1:]]
        print(
            f"  {name:10}{np.degrees(found[0].before):10.4f}{np.degrees(ours):9.4f}{found[0].loops:7d}{seconds:6.1f}   "
            f"{degrees(values):25}   {degrees(peer)}   ours / theirs: {ours / peer[0]:.4f} (seed 0), "
            f"{ours / np.median(peer):.4f} (median), {ours / min(peer):.4f} (best)"
        )


def _evolve(problem: Problem, bounds: Sequence[tuple[float, float]], evaluations: int, seed: int) -> float:
    def worth(x: np.ndarray) -> np.ndarray:
        return np.asarray(values_at(problem, FREE, jnp.asarray(x.T)))

    generations = evaluations // (15 * len(bounds)) - 1
    return differential_evolution(
        worth, bounds, popsize=15, maxiter=generations, tol=0, atol=0, polish=False, seed=seed, vectorized=True,
        updating="deferred",
    ).fun  # fmt: skip


def robust(count: int) -> None:
    """Gains tuned on the nominal plant and on many, tried on many others."""
    loop = thesis_loop()
    here, there = (spread_plants(loop.plant, 0.2, count, seed=seed) for seed in (0, 1))
    values = eqx.filter_jit(lambda p, c: p.values(c, p.responses(c)))
    print(f"\nrobust tuning (CVaR) over {count} plants with 20 % spread; RMSE in degrees on {count} others")
    for degrees in (10.0, 25.0):
        reference = Reference(amplitude=np.radians(degrees), dt=DT).make("square")[1]
        nominal = tune(Problem(loop, reference))
        many = tune(Problem(loop, reference, plants=here, objective=Objective(over="cvar")))
        test = Problem(loop, reference, plants=there)
        tails = []
        for name, tuned in (("Table 3.7", loop.controller), ("nominal", nominal.controller), ("CVaR", many.controller)):
            rmse = np.degrees(np.asarray(values(test, tuned)))
            tails.append(np.percentile(rmse, 95))
            print(
                f"  square {degrees:2.0f} deg {name:12} median {np.median(rmse):6.2f}  95th percentile {tails[-1]:6.2f}"
            )
        below = 100 * (1 - tails[2] / tails[1])
        print(f"  95th percentile {below:.1f} % below that of the nominal gains ({many.seconds:.0f} s)")


def main(argv: Sequence[str] | None = None) -> None:
    """Command line."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--only", nargs="+", choices=("speed", "gradient", "tune", "robust"), help="default: all")
    parser.add_argument("--loops", type=int, default=10_000, help="beside C (default: %(default)s)")
    parser.add_argument("--steps", type=int, default=3000, help="of each (default: %(default)s)")
    parser.add_argument("--threads", type=int, default=2, help="of both (default: %(default)s)")
    parser.add_argument("--seeds", type=int, default=4, help="of the tuner and of its peer (default: %(default)s)")
    parser.add_argument("--repeats", type=int, default=10, help="calls timed (default: %(default)s)")
    given = parser.parse_args(argv)
    jax.config.update("jax_enable_x64", True)
    chosen = given.only or ("speed", "gradient", "tune", "robust")
    print(f"jax {jax.__version__} on {jax.devices()[0].device_kind}; least of {given.repeats} calls")
    if "speed" in chosen:
        speed(given.loops, given.steps, given.threads, given.repeats)
    if "gradient" in chosen:
        gradient(64, given.repeats)
    if "tune" in chosen:
        tuning(given.seeds, 12_000)
    if "robust" in chosen:
        robust(256)


if __name__ == "__main__":
    main()
