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
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from scipy.optimize import differential_evolution

from scpjax.control.batch import batched
from scpjax.control.controller import Controller
from scpjax.control.fleet import spread_plants
from scpjax.control.loop import Loop, run
from scpjax.control.objective import Objective
from scpjax.control.pid import DEGREE, PID, Pair, thesis_pair
from scpjax.control.plant import Difference, Plant
from scpjax.control.problem import BOUNDS, Problem, gains_of, with_gains
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
    calls = {"simulation": value, "forward, tangents abreast": both, "reverse": back}
    times: dict[str, list[float]] = {name: [] for name in calls}
    for _ in range(10 * repeats):  # short calls, in turn: a quiet moment for each
        for name, call in calls.items():
            began = time.perf_counter()
            jax.block_until_ready(call(problem, at))
            times[name].append(time.perf_counter() - began)
    one = min(times["simulation"])
    print(f"\nvalue and gradient in 4 gains over {starts} starts, 3000 steps; least of {10 * repeats} calls in turn")
    for name, taken in times.items():
        print(f"  {name:40}{1e3 * min(taken):8.2f} ms {min(taken) / one:8.2f} simulations")


def tuning(seeds: int, peers: int, evaluations: int, names: Sequence[str]) -> None:
    """scpjax's tuner and scipy's differential evolution, one reference at a time."""
    print(f"\ntuned one reference at a time; RMSE in degrees; differential evolution with {evaluations} loops each")
    print(f"  {'':11}{'Table 3.7':>9}  scpjax: median of {seeds} seeds (range)   loops   s   differential evolution")
    bounds = [tuple(np.log(BOUNDS[name])) for name in FREE]
    for name in names:
        problem = Problem(thesis_loop(), Reference(dt=DT).make(name)[1])
        found = [tune(problem, TuneOptions(seed=seed)) for seed in range(seeds)]
        ours = np.degrees([f.value for f in found])
        theirs = np.degrees([_evolve(problem, bounds, evaluations, seed) for seed in range(peers)])
        off = f"{np.mean(ours > 1.02 * np.median(theirs)):.0%}, {np.mean(ours > 1.02 * min(theirs)):.0%}"
        print(
            f"  {name:11}{np.degrees(found[0].before):9.4f}  {np.median(ours):.4f} ({min(ours):.4f} to {max(ours):.4f})"
            f"{max(f.loops for f in found):6d} {found[-1].seconds:5.1f}   {' '.join(f'{v:.4f}' for v in theirs)}"
            f"   our median over theirs {np.median(ours) / np.median(theirs):.4f}, over their best"
            f" {np.median(ours) / min(theirs):.4f}; seed 0 over seed 0 {ours[0] / theirs[0]:.4f};"
            f" ours beyond 1.02 of their median, their best: {off}",
            flush=True,
        )


def _evolve(problem: Problem, bounds: Sequence[tuple[float, float]], evaluations: int, seed: int) -> float:
    def worth(x: np.ndarray) -> np.ndarray:
        return np.asarray(values_at(problem, FREE, jnp.asarray(x.T)))

    generations = evaluations // (15 * len(bounds)) - 1
    seeded: dict[str, Any] = {"seed": seed}  # scipy calls it rng from 1.15 on, and knows both names
    return differential_evolution(
        worth, bounds, popsize=15, maxiter=generations, tol=0, atol=0, polish=False, vectorized=True,
        updating="deferred", **seeded,
    ).fun  # fmt: skip


def robust(count: int, amplitudes: Sequence[float]) -> None:
    """Gains tuned on the nominal plant and on many, tried on many others, beside gains of its own for every plant."""
    loop = thesis_loop()
    here, there = (spread_plants(loop.plant, 0.2, count, seed=seed) for seed in (0, 1))
    values = eqx.filter_jit(lambda p, c: p.values(c, p.responses(c)))
    print(f"\nrobust tuning (CVaR) over {count} plants with 20 % spread in all parameters of both sides")
    print(f"95th percentile of the RMSE in degrees on {count} others; in brackets the share below the nominal gains'")
    print(f"  {'':18}{'Table 3.7':>10}{'nominal':>9}{'CVaR':>9}{'':9}{'own gains for each':>20}{'s':>13}")
    for amplitude in amplitudes:
        for name in ("sine", "square", "multilevel", "sawtooth", "stair", "triangle"):
            reference = Reference(amplitude=np.radians(amplitude), dt=DT).make(name)[1]
            nominal = tune(Problem(loop, reference)).controller
            given = eqx.tree_at(lambda m: m.controller, loop, nominal)
            many = tune(
                Problem(given, reference, plants=here, objective=Objective(over="cvar")), TuneOptions(walk=None)
            )
            test = Problem(loop, reference, plants=there)
            kinds = (loop.controller, nominal, many.controller)
            found = [np.degrees(np.asarray(values(test, c))) for c in kinds]
            found.append(np.degrees(own_gains(test, kinds)))
            tails = [float(np.percentile(v, 95)) for v in found]
            below = [100 * (1 - t / tails[1]) for t in tails]
            print(
                f"  {name:11}{amplitude:3.0f} deg{tails[0]:10.2f}{tails[1]:9.2f}{tails[2]:9.2f} ({below[2]:4.1f} %)"
                f"{tails[3]:11.2f} ({below[3]:4.1f} %){many.seconds:13.0f}",
                flush=True,
            )


def own_gains(problem: Problem, starts: Sequence[Controller], *, rounds: int = 30, children: int = 6) -> np.ndarray:
    """RMSE [rad] of every plant with gains of its own, from the best of the starts on: common gains cannot beat it."""
    rng = np.random.default_rng(0)
    low, high = (np.log([BOUNDS[n][i] for n in FREE]) for i in (0, 1))
    at = np.log([[gains_of(c)[n] for n in FREE] for c in starts])
    reference, controller, plants = problem.references[0], problem.loop.controller, problem.plants
    assert plants is not None

    def one(plant: Plant, x: jax.Array) -> jax.Array:
        gains = with_gains(controller, dict(zip(FREE, jnp.exp(x), strict=True)))
        return jnp.sqrt(jnp.mean(run(Loop(plant, gains), reference, dt=DT).error ** 2))

    look = eqx.filter_jit(jax.vmap(jax.vmap(one, in_axes=(None, 0))))
    count = problem.loops
    points = np.repeat(at[None], count, axis=0)
    values = np.asarray(look(plants, jnp.asarray(points)))
    rows = np.arange(count)
    best, least = points[rows, values.argmin(axis=1)], values.min(axis=1)
    for size in 0.5 * 0.92 ** np.arange(rounds):
        tried = np.clip(best[:, None] + size * rng.standard_normal((count, children, len(FREE))), low, high)
        values = np.asarray(look(plants, jnp.asarray(tried)))
        k = values.argmin(axis=1)
        better = values[rows, k] < least
        best[better], least[better] = tried[rows, k][better], values[rows, k][better]
    return least


def main(argv: Sequence[str] | None = None) -> None:
    """Command line."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--only", nargs="+", choices=("speed", "gradient", "tune", "robust"), help="default: all")
    parser.add_argument("--loops", type=int, default=10_000, help="beside C (default: %(default)s)")
    parser.add_argument("--steps", type=int, default=3000, help="of each (default: %(default)s)")
    parser.add_argument("--threads", type=int, default=2, help="of both (default: %(default)s)")
    parser.add_argument(
        "--references", nargs="+", default=["sine", "square", "triangle", "sawtooth"], help="to tune for"
    )
    parser.add_argument("--amplitudes", nargs="+", type=float, default=[25.0, 10.0], help="of robust tuning, degrees")
    parser.add_argument("--seeds", type=int, default=10, help="of the tuner (default: %(default)s)")
    parser.add_argument("--peers", type=int, default=3, help="seeds of differential evolution (default: %(default)s)")
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
        tuning(given.seeds, given.peers, 12_000, given.references)
    if "robust" in chosen:
        robust(256, given.amplitudes)


if __name__ == "__main__":
    main()
