"""(c) Tables 4.9, 4.11 and 4.12: what does the joint's model (3.11) leave out?

C is not fitted to the joint: it is what makes the same actuator alone move as it does. How far that is the thesis says
twice, and the two do not agree: 11.8 to 13.3 mm in 5 s (Tables 4.5, 4.8), 11.4 mm for long (Table 4.4). And the order
of Table 4.9's drives is known from a sketch of the author's only. `Supposed` is which of these is taken.

The mass on the springs rings a hundred times faster than the coil heats, so the joint stands where the forces balance:

    x = ((C (T1 - T2) e^(-w W) - 2 f) / K)+,   f = F0 + mu W,   K = k1 + k2 + kp + kl W,   angle = x / r

W is the weight on both sides. The temperatures are those of (3.3) under the drives of `fits.thesis_control.joint`, with
a second lag, a dead time or a slower heat balance where one is tried; a reversal turns the joint by twice the friction
less. All sets of up to four effects are fitted to the 33 angles; each parameter has a null value at which it vanishes.
"""

from __future__ import annotations

import itertools
import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from scipy.optimize import least_squares

from fits.thesis_control.joint import GRAVITY, RADIUS, turned
from scpjax.recordings.thesis import (
    TABLE_4_4,
    TABLE_4_5,
    TABLE_4_8,
    TABLE_4_9,
    TABLE_4_11,
    TABLE_4_12,
    TABLE_4_14,
    JointTrial,
)

ACTUATOR = next(row for row in TABLE_4_14 if row.code == "1")  # like 16 and 17
TRIALS: tuple[tuple[str, JointTrial], ...] = tuple(
    (name, trial) for name, table in (("4.9", TABLE_4_9), ("4.11", TABLE_4_11), ("4.12", TABLE_4_12)) for trial in table
)
MEASURED = np.degrees([t.angle_rad for _, t in TRIALS])
GROUPS = np.array([f"{name}, {1e3 * t.agonist_mass_kg:.1f} g" for name, t in TRIALS])
TABLES = np.array([name for name, _ in TRIALS])
WEIGHT = GRAVITY * np.array([t.agonist_mass_kg + t.antagonist_mass_kg for _, t in TRIALS])
EFFECTS: dict[str, tuple[str, str, float]] = {
    "C": ("C free", "times Table 4.14", 6.0),
    "kp": ("a stiffness beside the springs", "N/m", 150.0),
    "kl": ("a stiffness that grows with the load", "N/m per N", 100.0),
    "w": ("a pull that weakens with the load", "1/N", 0.2),
    "mu": ("friction in proportion to the load", "1", 0.05),
    "F0": ("friction, or slack, whatever the load", "N", 0.05),
    "lag": ("a second lag", "s", 1.5),
    "delay": ("a dead time", "s", 1.5),
    "slow": ("a slower heat balance", "times C_th/λ more", 0.5),
}
"""Effects that may be added: words, unit of their parameter, where its search starts."""


@dataclass(frozen=True)
class Supposed:
    """What the tables leave open. ``steady``: the actuator alone moves for long as far as Table 4.4 says, not in 5 s as
    far as Table 4.5 says; ``from_rest``: Table 4.9's angles are turns from rest, not the third turn of the sketch."""

    steady: bool = False
    from_rest: bool = False


SUPPOSED = Supposed()


VOLTS = 3.26


def _constants() -> tuple[float, float, float, float]:
    """(k [N/m], C [N/K], thermal time constant [s], temperature excess at 3.26 V for long [K]) of Table 4.14."""
    a = ACTUATOR
    values = (a.stiffness_N_per_m, a.force_N_per_K, a.conductance_W_per_K)
    k, c, lam = (float(v) for v in values if v is not None)
    return k, c, a.heat_capacity_J_per_K / lam, VOLTS**2 / (a.resistance_ohm * lam)


STIFFNESS, FORCE, TAU, HOT = _constants()


def single(
    lag: float = 0.0, delay: float = 0.0, slow: float = 0.0, supposed: Supposed = SUPPOSED
) -> tuple[float, float]:
    """(C in units of Table 4.14's, its standard error) with which actuator 16 alone moves as in Table 4.5 in the 5 s of
    Table 4.8, or for long as in Table 4.4 (one reading: no error); what is late in the joint is late in the coil, too.
    """
    if supposed.steady:
        row = next(row for row in TABLE_4_4 if row.code == 16)
        at = int(np.argmin(np.abs(np.array(row.voltage_V) - VOLTS)))
        return row.displacement_m[at] * STIFFNESS / (FORCE * HOT), math.nan
    seconds = next(row.duration_s for row in TABLE_4_8 if row.code == "16")
    moved = np.array(next(row.displacement_m for row in TABLE_4_5 if row.code == 16))
    factor = moved * STIFFNESS / (FORCE * HOT * heating(seconds, lag, delay, slow))
    return float(factor.mean()), float(factor.std(ddof=1) / math.sqrt(len(factor)))


def heating(t: np.ndarray | float, lag: float = 0.0, delay: float = 0.0, slow: float = 0.0) -> np.ndarray | float:
    """Share of the final temperature ``t`` [s] after the drive went on: (3.3), and another lag behind it."""
    late, tau = np.maximum(np.asarray(t, float) - delay, 0.0), TAU * (1 + slow)
    if lag < 1e-9:
        return 1 - np.exp(-late / tau)
    second = lag if abs(lag / tau - 1) > 1e-6 else tau * (1 + 1e-6)
    return 1 - (tau * np.exp(-late / tau) - second * np.exp(-late / second)) / (tau - second)


def _difference(from_rest: bool, on: float, late: tuple[float, float, float]) -> float:
    """Greatest change of (T1 - T2) over the long-term temperature within the drive whose turn is measured."""

    def pulse(t: np.ndarray, start: float) -> np.ndarray:
        return heating(t - start, *late) * (t > start) - heating(t - start - on, *late) * (t > start + on)

    if from_rest:
        return float(heating(on, *late))
    t = np.linspace(2 * on, 3 * on, 200)
    course = pulse(t, 0.0) + pulse(t, 2 * on) - pulse(t, on)
    return float(course.max() - course.min()) if late[0] or late[1] else float(course[-1] - course[0])


def said(p: Mapping[str, float], use: np.ndarray | None = None, supposed: Supposed = SUPPOSED) -> np.ndarray:
    """Angles [deg] of the trials (those of the mask ``use``) under parameters; what is not there is at its null."""
    which = np.flatnonzero(np.ones(len(TRIALS), bool) if use is None else use)
    late = (p.get("lag", 0.0), p.get("delay", 0.0), p.get("slow", 0.0))
    factor = p["C"] if "C" in p else single(*late, supposed)[0]
    swings: dict[tuple[bool, float], float] = {}
    out = []
    for i in which:
        name, trial = TRIALS[i]
        other = trial.antagonist_stiffness_N_per_m or STIFFNESS
        turn = (name != "4.9" or supposed.from_rest, trial.on_s)
        if turn not in swings:
            swings[turn] = _difference(*turn, late)
        pull = factor * FORCE * HOT * swings[turn] * math.exp(-p.get("w", 0.0) * WEIGHT[i])
        rubbed = 2 * (p.get("F0", 0.0) + p.get("mu", 0.0) * WEIGHT[i])
        stiffness = STIFFNESS + other + p.get("kp", 0.0) + p.get("kl", 0.0) * WEIGHT[i]
        out.append(max(pull - rubbed, 0.0) / stiffness / RADIUS)
    return np.degrees(out)


@dataclass(frozen=True)
class Account:
    """Effects fitted to the angles: parameters with standard errors, and errors in degrees."""

    effects: tuple[str, ...]
    values: dict[str, float]
    std: dict[str, float]
    rmse: float
    bic: float
    left_out: float = math.nan  # RMS error of load pairs left out of the fit
    tables: Mapping[str, float] | None = None  # of whole tables left out

    @property
    def name(self) -> str:
        """The effects in words."""
        return " + ".join(EFFECTS[e][0] for e in self.effects) or "nothing: C of the actuator alone"


def fit(effects: Sequence[str], use: np.ndarray | None = None, supposed: Supposed = SUPPOSED) -> Account:
    """Least squares in the angle, each effect from two starts."""
    use = np.ones(len(TRIALS), bool) if use is None else use
    size, n = np.array([EFFECTS[e][2] for e in effects]), int(use.sum())

    def miss(x: np.ndarray) -> np.ndarray:
        return said(dict(zip(effects, x * size, strict=True)), use, supposed) - MEASURED[use]

    if not effects:
        left = miss(np.zeros(0))
        return Account((), {}, {}, float(np.sqrt(np.mean(left**2))), float(n * np.log(np.mean(left**2)) + np.log(n)))
    found = min(
        (least_squares(miss, np.full(len(size), s), bounds=(0.0, np.inf), diff_step=1e-4) for s in (1.0, 0.3)),
        key=lambda f: f.cost,
    )
    rss, k = 2 * found.cost, len(effects)
    variance = np.maximum(np.diag(np.linalg.pinv(found.jac.T @ found.jac)), 0.0)
    spread = np.sqrt(variance * rss / max(n - k, 1)) * size
    values, std = (dict(zip(effects, map(float, v), strict=True)) for v in (found.x * size, spread))
    bic = n * np.log(rss / n) + (k + 1) * np.log(n)
    return Account(tuple(effects), values, std, float(np.sqrt(rss / n)), float(bic))


def judged(account: Account, supposed: Supposed = SUPPOSED) -> Account:
    """The same with its errors on load pairs, and on whole tables, left out of the fit."""

    def left(labels: np.ndarray) -> dict[str, np.ndarray]:
        out = {}
        for label in dict.fromkeys(labels):
            gone = labels == label
            found = fit(account.effects, ~gone, supposed).values
            out[str(label)] = said(found, gone, supposed) - MEASURED[gone]
        return out

    rms = lambda e: float(np.sqrt(np.mean(e**2)))  # noqa: E731
    tables = {name: rms(e) for name, e in left(TABLES).items()}
    pairs = rms(np.concatenate(list(left(GROUPS).values())))
    return Account(account.effects, account.values, account.std, account.rmse, account.bic, pairs, tables)


def compare(
    most: int = 4, supposed: Supposed = SUPPOSED, use: np.ndarray | None = None, effects: Sequence[str] = tuple(EFFECTS)
) -> list[Account]:
    """All sets of up to ``most`` effects, fitted to the trials of the mask ``use``, best BIC first."""
    sets = [s for n in range(most + 1) for s in itertools.combinations(effects, n)]
    return sorted((fit(s, use, supposed) for s in sets), key=lambda a: a.bic)


def closed_form_error(factor: float = 7.0, ratio: float = 0.07) -> float:
    """Greatest difference [deg] between `said` and the library's simulation of (3.11) with friction on Table 4.9.

    `fits.thesis_control.joint` simulates the joint with its mass, its damping and dry friction.
    """
    use = TABLES == "4.9"
    simulated = np.degrees(turned(list(TABLE_4_9), factor, ratio))
    return float(np.max(np.abs(said({"C": factor, "mu": ratio}, use) - simulated)))


def cooling_time(smallest: float, delay: float = 0.0) -> tuple[float, float, float]:
    """Time constant [s], its standard error and the RMS error [s] by the times back to the start of Tables 4.11, 4.12.

    The joint is back when the eye sees no more than ``smallest`` [deg] of its angle, TAU ln(angle / smallest) after it
    begins to cool, which is ``delay`` [s] after the drive went off. The thesis does not say what the eye sees.
    """
    back = np.array([t.return_s for _, t in TRIALS if t.return_s is not None]) - delay
    angle = np.degrees([t.angle_rad for _, t in TRIALS if t.return_s is not None])
    decades = np.log(angle / smallest)
    tau = float(decades @ back / (decades @ decades))
    left = back - tau * decades
    error = float(np.sqrt(left @ left / (len(back) - 1) / (decades @ decades)))
    return tau, error, float(np.sqrt(np.mean(left**2)))
