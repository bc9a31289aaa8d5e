"""(a) The identified plant (4.4) against the parameters of Table 4.14: which states has the third-order fit found?

Arithmetic first: what each coefficient of (4.4) makes of k, beta and C by (3.15), and what that would mean on the
bench. Then what could stand behind a heat balance of one pole in place of the complex pair: each is fitted to what
(4.4) does without noise. Then the library: recordings simulated by (4.4), with the noise that the thesis's NRMSE of
90 % leaves, are diagnosed with mass, stiffness, damping, resistance and thermal mass held at Table 4.14.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import cast

import numpy as np
import scipy.signal
from scipy.optimize import least_squares

from scpjax.diagnose.diagnose import diagnose
from scpjax.diagnose.result import Diagnosis
from scpjax.physics.known import known_model
from scpjax.recordings.excitation import multilevel_random, step_difference
from scpjax.recordings.recording import Metadata, Recording
from scpjax.recordings.thesis import TABLE_3_5, TABLE_4_5, TABLE_4_14
from scpjax.simulate.simulate import simulate

GRAVITY = 9.81
PERIOD = 0.0611  # s, of the recording that (4.4) was identified from (Figure 3.10)
NOISE = 0.10  # of the spread: what an NRMSE of 90 % leaves
ACTUATOR = next(row for row in TABLE_4_14 if row.code == "2")
COEFFICIENTS = TABLE_3_5.rows[0]


@dataclass(frozen=True)
class Implied:
    """What (4.4) says of the mechanics by (3.15), SI, beside what was measured."""

    poles: tuple[complex, ...]  # 1/s
    thermal_pole: float  # 1/s, the real one
    thermal_measured: float  # lambda / C_th
    k_from_a1: float
    k_from_a0: float
    k_from_pair: float  # m times the square of the complex pair's modulus
    k_measured: float
    damping: float
    damping_measured: float
    ratio_measured: float  # damping ratio of weight and coil
    coefficient: float  # C from b0, in N/K, with the displacement in metres
    coefficient_printed: float
    coefficient_at_k: float  # C with which the measured k has the gain of (4.4)
    frequency: float  # rad/s, sqrt(k/m) as measured
    pair_frequency: float
    pair_ratio: float  # damping ratio of the pair
    pair_delay: float  # s, mean delay of the pair
    nyquist: float  # rad/s
    sag: float  # m, that the load would stretch a spring of k_from_pair
    sag_measured: float
    a1_by_thousandth: tuple[float, float]  # k/(1000 m) + lambda beta / (C_th m), k taken for N/mm, and a1
    stroke: tuple[float, float, float]  # m at 3.41 V: by (4.4), by Table 4.14, and measured (Table 4.5, 82.7 g)


def implied() -> Implied:
    """Every number from the tables."""
    a, c = ACTUATOR, COEFFICIENTS
    m, c_th = a.mass_kg, a.heat_capacity_J_per_K
    given = (a.stiffness_N_per_m, a.damping_Ns_per_m, a.conductance_W_per_K, a.force_N_per_K, a.load_mass_kg)
    k, beta, lam, force, load = (float(v) for v in given if v is not None)
    decay = lam / c_th
    poles = np.roots([1.0, c.a2, c.a1, c.a0])
    pair = poles[np.argmax(poles.imag)]
    thermal = float(-poles[np.argmin(np.abs(poles.imag))].real)
    k_pair = m * abs(pair) ** 2
    volts = 3.41
    gain = c.b0 / c.a0  # m/V^2 at rest
    table = next(r for r in TABLE_4_5 if r.code == 2)
    return Implied(
        poles=tuple(complex(p) for p in poles),
        thermal_pole=thermal,
        thermal_measured=decay,
        k_from_a1=m * (c.a1 - decay * beta / m),
        k_from_a0=m * c.a0 / decay,
        k_from_pair=k_pair,
        k_measured=k,
        damping=m * (c.a2 - decay),
        damping_measured=beta,
        ratio_measured=beta / (2 * np.sqrt(k * m)),
        coefficient=c.b0 * c_th * m * a.resistance_ohm,
        coefficient_printed=force,
        coefficient_at_k=gain * k * lam * a.resistance_ohm,
        frequency=float(np.sqrt(k / m)),
        pair_frequency=float(abs(pair)),
        pair_ratio=float(-pair.real / abs(pair)),
        pair_delay=float(-2 * pair.real / abs(pair) ** 2),
        nyquist=np.pi / PERIOD,
        sag=GRAVITY * load / k_pair,
        sag_measured=GRAVITY * load / k,
        a1_by_thousandth=(k / (1e3 * m) + decay * beta / m, c.a1),
        stroke=(
            gain * volts**2,
            force / (lam * a.resistance_ohm * k) * volts**2,
            table.displacement_m[int(np.argmin(np.abs(np.array(table.mass_kg) - load)))],
        ),
    )


@dataclass(frozen=True)
class StandIn:
    """What may stand behind the heat in place of the pair: its numbers, and how far it is from (4.4).

    ``pole``: of the heat [1/s]; ``held``: whether that is the measured one; ``rmse``: [mm], without noise; ``bic``:
    less the best one's, of recordings with the noise of `NOISE`, as expected.
    """

    name: str
    held: bool
    pole: float
    values: dict[str, float]
    rmse: float
    bic: float


_FINER = 10  # parts of a period, between which what is late by a part of one is read
Rational = tuple[list[float], list[float]]
BEHIND: dict[str, tuple[dict[str, float], Callable[..., Rational]]] = {
    "nothing": ({}, lambda: ([1.0], [1.0])),
    "a dead time": ({"delay (s)": 1.3}, lambda delay: ([1.0], [1.0])),
    "a lag, or a second node that warms the coil": ({"time constant (s)": 1.5}, lambda tau: ([1.0], [tau, 1.0])),
    "a second node beside the measured one": (
        {"lag (s)": 0.5, "lead (s)": 0.3},
        lambda lag, lead: ([lead, 1.0], [lag, 1.0]),
    ),
    "a low-pass filter of second order (Butterworth)": (
        {"cutoff (rad/s)": 1.5},
        lambda w: ([1.0], [1 / w**2, np.sqrt(2.0) / w, 1.0]),
    ),
}
"""What may stand behind the heat: where its numbers begin, and its transfer function but for a dead time."""


def stand_ins() -> list[StandIn]:
    """Every one of `BEHIND` after a pole of heat, free and as measured, fitted to what (4.4) does; the best first."""
    drives = np.concatenate([volts**2 for _, volts in _drives()])  # one after the other
    fine = np.repeat(drives, _FINER)
    made = _response(([COEFFICIENTS.b0], [1.0, COEFFICIENTS.a2, COEFFICIENTS.a1, COEFFICIENTS.a0]), fine)
    found = [_stand_in(name, held, fine, made) for name in BEHIND for held in (False, True)]
    best = min(s.bic for s in found)
    return sorted((replace(s, bic=s.bic - best) for s in found), key=lambda s: s.bic)


def _stand_in(name: str, held: bool, fine: np.ndarray, made: np.ndarray) -> StandIn:
    """One of them, fitted to what was ``made`` of a drive, both on the finer grid."""
    starts, behind = BEHIND[name]
    time = PERIOD / _FINER * np.arange(len(fine))

    def off(logs: np.ndarray) -> np.ndarray:
        pole, *own = np.exp(np.append(np.log(implied().thermal_measured), logs) if held else logs)
        top, bottom = behind(*own)
        y = _response((top, list(np.polymul([1 / pole, 1.0], bottom))), fine)
        y = np.interp(time - own[0], time, y, left=0.0) if name == "a dead time" else y
        return float(y @ made / (y @ y)) * y - made

    logs = np.log([*([] if held else [0.19]), *starts.values()])
    if len(logs):
        logs = least_squares(lambda x: off(x)[::_FINER], logs, diff_step=1e-4).x
    rms, n = float(np.sqrt(np.mean(off(logs) ** 2))), len(fine) // _FINER
    values = dict(zip(starts, map(float, np.exp(logs[len(logs) - len(starts) :])), strict=True))
    pole = implied().thermal_measured if held else float(np.exp(logs[0]))
    bic = n * (rms / (NOISE * float(np.std(made)))) ** 2 + (len(logs) + 1) * np.log(n)
    return StandIn(name, held, pole, values, 1e3 * rms, float(bic))


def _response(system: Rational, drive: np.ndarray) -> np.ndarray:
    """What a transfer function makes of a drive that is held between the stamps of the finer grid, from rest."""
    made = scipy.signal.cont2discrete(system, PERIOD / _FINER)
    top, bottom, _ = cast(tuple[np.ndarray, np.ndarray, float], made)
    return np.asarray(scipy.signal.lfilter(np.ravel(top), bottom, drive))


def _drives() -> list[tuple[str, np.ndarray]]:
    """Names and volts of a step difference and of a multilevel random drive."""
    _, up = step_difference(duration_s=200.0, period_s=PERIOD, amplitude=3.41, up_s=20.0, down_s=110.0)
    _, levels = multilevel_random(duration_s=200.0, period_s=PERIOD, low=0.0, high=3.41, hold_s=20.0, seed=3)
    return [("step difference", up), ("multilevel", levels)]


def recordings(noise: float = NOISE) -> list[Recording]:
    """A step difference and a multilevel random drive on (4.4), white noise ``noise`` times the spread added."""
    model = known_model("thesis", ambient=295.15)
    out = []
    for seed, (name, volts) in enumerate(_drives()):
        time = PERIOD * np.arange(len(volts))
        meta = Metadata(name=name, ambient_K=295.15, model="plant")
        drive = Recording.from_arrays(time, {"voltage_V": volts}, {}, require_outputs=False, metadata=meta)
        x = 1e3 * np.asarray(simulate(model, drive).outputs[:, 1])
        x = x + noise * np.std(x) * np.random.default_rng(seed).standard_normal(len(x))
        out.append(Recording.from_arrays(time, {"voltage_V": volts}, {"displacement_mm": x}, metadata=meta))
    return out


def held() -> dict[str, float]:
    """What Table 4.14 measured, by parameter key."""
    a = ACTUATOR
    assert a.stiffness_N_per_m is not None
    assert a.damping_Ns_per_m is not None
    return {
        "joule_heating.gain": 1 / a.resistance_ohm,
        "newton_cooling.thermal_mass": a.heat_capacity_J_per_K,
        "elastic_spring.stiffness": a.stiffness_N_per_m,
        "viscous_damping.damping": a.damping_Ns_per_m,
        "inertia.mass": a.mass_kg,
    }


def missing(given: list[Recording] | None = None) -> Diagnosis:
    """What the plant with the measured mechanics lacks to do what (4.4) does."""
    return diagnose(given or recordings(), fixed=held())
