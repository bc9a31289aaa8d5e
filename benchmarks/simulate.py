"""Simulation and fleet fitting beside scipy, time and accuracy: ``python benchmarks/simulate.py``.

Every peer gets what suits it: ``lsim`` the squared volts under a zero-order hold; ``solve_ivp`` one call per
level, so that it need not find the jumps, and a right-hand side in plain floats; ``least_squares`` a residual
that is exact and vectorised, logarithmic parameters and the same start as scpjax. Compilation is timed apart.
"""

from __future__ import annotations

import argparse
import os
import time
from collections.abc import Callable, Sequence
from itertools import pairwise

os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")  # on 3 x 3 matrices more threads only slow scipy down

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from scipy.integrate import solve_ivp
from scipy.linalg import expm
from scipy.optimize import least_squares
from scipy.signal import lfilter, lsim, ss2tf

from scpjax.fit.fit import FitOptions
from scpjax.fit.fleet import fit_fleet
from scpjax.fit.setup import prepare
from scpjax.physics.catalogue import mechanism
from scpjax.physics.model import Model
from scpjax.physics.presets import plant
from scpjax.recordings import Metadata, Recording
from scpjax.recordings.excitation import multilevel_random
from scpjax.simulate.simulate import Exponential, simulate

PERIOD, HOLD, AMBIENT = 0.1, 5.0, 293.15
VALUES = {
    "resistance": 1.2,
    "conductance": 0.14,
    "thermal_mass": 1.1,
    "coefficient": 0.024,
    "stiffness": 180.0,
    "damping": 8.0,
    "mass": 0.25,
}
LOSS = {"nonlinear_heat_loss.strength": 0.5, "nonlinear_heat_loss.exponent": 0.5}
CREEP = {"creep.compliance": 0.35, "creep.time_constant": 15.0}
NOISE = np.array([0.15, 5e-5])  # K, m
FREE = ("conductance", "thermal_mass", "coefficient", "stiffness", "damping")


def clock(work: Callable[[], object], repeats: int) -> tuple[float, float]:
    """(seconds of the first call, least seconds of the next ``repeats``)."""
    taken = []
    for _ in range(repeats + 1):
        began = time.perf_counter()
        jax.block_until_ready(work())
        taken.append(time.perf_counter() - began)
    return taken[0], min(taken[1:])


def drive(duration: float, seed: int) -> tuple[np.ndarray, np.ndarray]:
    """Stamps and volts."""
    return multilevel_random(duration_s=duration, period_s=PERIOD, low=0.0, high=3.7, hold_s=HOLD, seed=seed)


def recording(t: np.ndarray, volts: np.ndarray, outputs: np.ndarray | None = None, name: str = "") -> Recording:
    """Volts with outputs (n, 2) [K, m] where there are any."""
    seen = np.zeros((len(t), 2)) if outputs is None else outputs
    known = (("resistance_ohm", VALUES["resistance"]), ("moving_mass_kg", VALUES["mass"]))
    return Recording.from_arrays(
        t,
        {"voltage_V": volts},
        {"temperature_K": seen[:, 0], "displacement_m": seen[:, 1]},
        metadata=Metadata(name=name, known=known, ambient_K=AMBIENT),
    )


def matrices(v: dict[str, float]) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """(A, B, C) of the plant in excess temperature, displacement and velocity, driven by squared volts."""
    a = np.array(
        [
            [-v["conductance"] / v["thermal_mass"], 0, 0],
            [0, 0, 1],
            [v["coefficient"] / v["mass"], -v["stiffness"] / v["mass"], -v["damping"] / v["mass"]],
        ]
    )
    return a, np.array([[1 / v["resistance"] / v["thermal_mass"]], [0], [0]]), np.eye(3)[:2]


def extended_rates(_: float, z: Sequence[float], u: float) -> list[float]:
    """The plant with growing heat loss and creep: T, x, v and the slow displacement."""
    v, (warm, x, speed, slow) = VALUES, z
    growth = 1 + LOSS["nonlinear_heat_loss.strength"] * (abs(warm) / 50.0) ** LOSS["nonlinear_heat_loss.exponent"]
    return [
        (u / v["resistance"] - v["conductance"] * growth * warm) / v["thermal_mass"],
        speed,
        (v["coefficient"] * warm - v["stiffness"] * (x - slow) - v["damping"] * speed) / v["mass"],
        (CREEP["creep.compliance"] * (x - slow) - slow) / CREEP["creep.time_constant"],
    ]


def by_level(
    rates: Callable, n: int, t: np.ndarray, volts: np.ndarray, *, method: str, rtol: float, atol: float
) -> np.ndarray:
    """``solve_ivp`` from level to level: temperature and displacement (n, 2)."""
    edges = [0, *(np.flatnonzero(np.diff(volts)) + 1), len(t) - 1]
    z, out = np.zeros(n), []
    for a, b in pairwise(edges):
        u = float(volts[a]) ** 2
        got = solve_ivp(rates, (t[a], t[b]), z, method=method, t_eval=t[a : b + 1], args=(u,), rtol=rtol, atol=atol)
        z = got.y[:, -1]
        out.append(got.y[:2, : b - a].T)
    return np.concatenate([*out, z[None, :2]])


def line(name: str, seconds: float, ours: float, error: np.ndarray, first: float | None = None) -> None:
    """Time, its ratio to ours, and the greatest error of each output."""
    note = "" if first is None else f"   first call {first:.1f} s"
    print(f"  {name:44}{1e3 * seconds:10.3f} ms {seconds / ours:9.2f}x   {error[0]:8.1e} K {error[1]:8.1e} m{note}")


def linear(duration: float, batch: int, repeats: int) -> None:
    """The plant: exact for both sides."""
    t, volts = drive(duration, 1)
    a, b, c = matrices(VALUES)
    truth = by_level(lambda _, z, u: a @ z + b[:, 0] * u, 3, t, volts, method="DOP853", rtol=1e-12, atol=1e-14)
    model, rec, rest = plant(ambient=AMBIENT, **VALUES), recording(t, volts), np.array([AMBIENT, 0.0])
    one = eqx.filter_jit(lambda m: simulate(m, rec).outputs)
    many = eqx.filter_jit(jax.vmap(lambda k: simulate(model.replace({"elastic_spring.stiffness": k}), rec).outputs))
    stiffness = jnp.full(batch, VALUES["stiffness"])
    wrong = lambda y: np.abs(np.asarray(y) - truth).max(axis=0)  # noqa: E731
    first, ours = clock(lambda: one(model), repeats)
    print(f"\nplant, {len(t)} samples, one call (a ratio above 1: slower than scpjax's exact simulator)")
    line("scpjax Exact", ours, ours, wrong(one(model) - rest), first)
    first, each = clock(lambda: many(stiffness), max(repeats // 4, 2))
    line(f"scpjax Exact, {batch} abreast, each", each / batch, ours, wrong(many(stiffness)[0] - rest), first)
    _, peer = clock(lambda: lsim((a, b, c, np.zeros((2, 1))), volts**2, t, interp=False), repeats)
    line(
        "scipy.signal.lsim, zero-order hold",
        peer,
        ours,
        wrong(lsim((a, b, c, np.zeros((2, 1))), volts**2, t, interp=False)[1]),
    )
    _, peer = clock(lambda: filtered(VALUES, volts), repeats)
    line("scipy.signal.lfilter, zero-order hold", peer, ours, wrong(filtered(VALUES, volts)))
    rows: list[list[float]] = a.tolist()
    gain = float(b[0, 0])

    def rates(_: float, z: Sequence[float], u: float) -> list[float]:
        return [rows[0][0] * z[0] + gain * u, z[2], rows[2][0] * z[0] + rows[2][1] * z[1] + rows[2][2] * z[2]]

    peers(rates, 3, t, volts, ours, wrong)


def extended(duration: float, batch: int, repeats: int) -> None:
    """The plant with two left-out mechanisms: fixed exponential steps against adaptive ones."""
    t, volts = drive(duration, 2)
    truth = by_level(extended_rates, 4, t, volts, method="DOP853", rtol=1e-12, atol=1e-14)
    base = plant(ambient=AMBIENT, **VALUES)
    structure = base.structure.with_mechanisms(mechanism("nonlinear_heat_loss"), mechanism("creep"))
    model = Model(structure, ambient=AMBIENT).replace(base.values() | LOSS | CREEP)
    rec, rest = recording(t, volts), np.array([AMBIENT, 0.0])
    wrong = lambda y: np.abs(np.asarray(y) - truth).max(axis=0)  # noqa: E731
    print(f"\nplant + nonlinear_heat_loss + creep, {len(t)} samples (ratios to the first line)")
    ours = 0.0
    for order in (2, 4):
        method = Exponential(order=order)
        one = eqx.filter_jit(lambda m, method=method: simulate(m, rec, method=method).outputs)
        first, taken = clock(lambda one=one: one(model), repeats)
        ours = ours or taken
        line(f"scpjax Exponential, order {order}", taken, ours, wrong(one(model) - rest), first)
    second = Exponential(order=2)
    many = eqx.filter_jit(
        jax.vmap(lambda k: simulate(model.replace({"elastic_spring.stiffness": k}), rec, method=second).outputs)
    )
    stiffness = jnp.full(batch, VALUES["stiffness"])
    first, each = clock(lambda: many(stiffness), max(repeats // 4, 2))
    line(
        f"scpjax Exponential, order 2, {batch} abreast, each",
        each / batch,
        ours,
        wrong(many(stiffness)[0] - rest),
        first,
    )
    peers(extended_rates, 4, t, volts, ours, wrong)


def peers(rates: Callable, n: int, t: np.ndarray, volts: np.ndarray, ours: float, wrong: Callable) -> None:
    """Adaptive integrators, loose and tight."""
    for method in ("RK45", "LSODA"):
        for rtol in (1e-4, 1e-8):
            call = lambda m=method, r=rtol: by_level(rates, n, t, volts, method=m, rtol=r, atol=1e-4 * r)  # noqa: E731
            _, taken = clock(call, 2)
            line(f"scipy solve_ivp {method}, rtol {rtol:g}, per level", taken, ours, wrong(call()))


def held(a: np.ndarray, b: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Zero-order hold discretisation: the exponential of [[A, B], [0, 0]]."""
    n = len(a)
    whole = expm(np.block([[a, b], [np.zeros((1, n + 1))]]) * PERIOD)
    return whole[:n, :n], whole[:n, n:]


def filtered(v: dict[str, float], volts: np.ndarray, warm: float = 0.0) -> np.ndarray:
    """The plant by two recursive filters, exact for a zero-order hold, from ``warm`` [K]: (n, 2)."""
    a, b, c = matrices(v)
    ad, bd = held(a, b)
    cd, dd = c, np.zeros((2, 1))
    numerator, denominator = ss2tf(ad, bd, cd, dd)
    out = np.stack([lfilter(top, denominator, volts**2) for top in numerator], axis=-1)
    if warm:
        z = np.array([warm, v["coefficient"] / v["stiffness"] * warm, 0.0])
        push = np.zeros(len(volts))
        push[0] = 1.0
        shifted = ss2tf(ad, (ad @ z)[:, None], cd, (cd @ z)[:, None])[0]
        out = out + np.stack([lfilter(top, denominator, push) for top in shifted], axis=-1)
    return out


def fleet(size: int, duration: float) -> None:
    """Actuators fitted abreast against one after the other."""
    rng = np.random.default_rng(3)
    actuators, truths = [], []
    for i in range(size):
        v = VALUES | {k: VALUES[k] * float(np.exp(rng.normal(0, 0.2))) for k in FREE}
        t, volts = drive(duration, 100 + i)
        outputs = filtered(v, volts) + NOISE * rng.standard_normal((len(t), 2)) + np.array([AMBIENT, 0.0])
        actuators.append([recording(t, volts, outputs, f"actuator {i}")])
        truths.append([v[k] for k in FREE])
    began = time.perf_counter()
    fit_fleet(actuators, model="plant", options=FitOptions(drop_outliers=False))
    first = time.perf_counter() - began
    began = time.perf_counter()
    found = fit_fleet(actuators, model="plant", options=FitOptions(drop_outliers=False))
    ours = (time.perf_counter() - began) / size
    setups = [prepare(rs, model="plant") for rs in actuators]
    index = setups[0].structure.index
    keys = [next(k for k in index if k.endswith(f".{p}")) for p in FREE]
    places = [index[k] for k in keys]
    began = time.perf_counter()
    theirs = [one_by_one(q.recordings[0], q.starts[0][places]) for q in setups]
    peer = (time.perf_counter() - began) / size
    table = found.table()
    print(
        f"\nfleet of {size} actuators, {len(actuators[0][0].time)} samples each, plant "
        "(a ratio above 1: slower than scpjax)"
    )
    print(f"  {'':44}{'each':>13} {'ratio':>10}   median relative error of {', '.join(FREE)}")
    for name, values, seconds in (
        ("scpjax fit_fleet, with error bars and rank", np.stack([table[k] for k in keys], axis=-1), ours),
        ("scipy least_squares, one after the other", np.array(theirs), peer),
    ):
        off = np.nanmedian(np.abs(values / np.array(truths) - 1), axis=0)
        print(f"  {name:44}{1e3 * seconds:10.1f} ms {seconds / ours:9.2f}x   " + "  ".join(f"{e:.1e}" for e in off))
    print(
        f"  scpjax's first call, with compilation: {first:.1f} s in all; "
        "finding starts is in its time, scipy was given them"
    )


def one_by_one(rec: Recording, start: np.ndarray) -> np.ndarray:
    """What a scipy user would write: five logarithms, both sensors' offsets, the initial temperature."""
    volts = rec.inputs[:, 0]

    def residual(x: np.ndarray) -> np.ndarray:
        v = VALUES | dict(zip(FREE, np.exp(x[:5]), strict=True))
        said = filtered(v, volts, warm=float(x[7])) + np.array([AMBIENT + x[5], 1e-3 * x[6]])
        return ((said - rec.outputs) / NOISE).ravel()

    x0 = np.concatenate([np.log(start), np.zeros(3)])
    return np.exp(least_squares(residual, x0, method="lm", x_scale="jac").x[:5])


def main(argv: Sequence[str] | None = None) -> None:
    """Command line."""
    parser = argparse.ArgumentParser(description="Simulation and fleet fitting beside scipy: time and accuracy.")
    parser.add_argument("--duration", type=float, default=150.0, help="s of each recording (default: %(default)s)")
    parser.add_argument("--batch", type=int, default=64, help="models simulated abreast (default: %(default)s)")
    parser.add_argument("--fleet", type=int, default=32, help="actuators in the fleet (default: %(default)s)")
    parser.add_argument("--repeats", type=int, default=20, help="calls timed (default: %(default)s)")
    given = parser.parse_args(argv)
    jax.config.update("jax_enable_x64", True)
    print(f"jax {jax.__version__} on {jax.devices()[0].device_kind}, double precision; least of {given.repeats} calls")
    linear(given.duration, given.batch, given.repeats)
    extended(given.duration, given.batch, given.repeats)
    fleet(given.fleet, given.duration)


if __name__ == "__main__":
    main()
