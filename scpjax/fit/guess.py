"""Values of the base parameters read off the recordings: where a fit starts."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from scipy.signal import lfilter

from scpjax.errors import FitError, ScpjaxError
from scpjax.fit.data import columns
from scpjax.fit.start import Linear, best_linear, thermal_mass_from_energy
from scpjax.physics.structure import Structure
from scpjax.recordings.condition import resample
from scpjax.recordings.recording import Recording, place
from scpjax.simulate.drive import drive_values, recorded_effort


@dataclass(frozen=True)
class Scales:
    """What is small and large in these recordings; SI."""

    response: float  # s, the time constant that governs the outputs
    duration: float  # s
    temperature: float  # K, greatest excess (of the model's start)
    displacement: float  # m, greatest travel
    drive: float = 1.0  # V (or A), greatest drive: root of the greatest effort


@dataclass(frozen=True)
class Guess:
    values: dict[str, float]
    score: float


def _uniform(r: Recording, structure: Structure, ambient: float) -> tuple[float, np.ndarray, dict[int, np.ndarray]]:
    """(period, effort (n, sides), outputs by index) on a uniform grid of at most a few thousand samples."""
    even = r if r.is_uniform else resample(r)
    n, period = even.n, even.period
    step = max(n // 6000, 1)
    e = np.asarray(recorded_effort(structure, even, ambient=ambient))
    outputs = {j: even.output(stem) for j, stem in columns(structure, even)}
    if step == 1 or not structure.thermal:  # a mechanical signal would alias
        keep = min(n, 12000)
        return period, e[:keep], {j: y[:keep] for j, y in outputs.items()}
    m = n // step * step
    fold = lambda x: x[:m].reshape(m // step, step, *x.shape[1:]).mean(axis=1)  # noqa: E731
    return period * step, fold(e), {j: fold(y) for j, y in outputs.items()}


def guess_base(
    recordings: Sequence[Recording], s: Structure, ambient: Sequence[float], known: Mapping[str, float]
) -> tuple[list[Guess], Scales]:
    """Base parameter values from the data, several where the data leave a choice; best first.

    The heat balance is read off the recording driven most, for longest, of those with a thermometer, the force balance
    off that of those with a displacement.
    """
    if s.system:
        return _system_guess(recordings, s, ambient)
    last = len(s.outputs) - 1
    thermal: dict[str, float] = {}
    gain = known.get("joule_heating.gain", 1.0)
    every, heated = 1.0, np.zeros(1)
    if s.thermal:
        warmed = _driven_most(recordings, s, range(last) if s.mechanical else range(last + 1))
        every, both, outputs = _uniform(recordings[warmed], s, ambient[warmed])
        at = int(np.argmax(np.ptp(both, axis=0)))
        heated = both[:, at]
        where = place(recordings[warmed].metadata)
        thermal = _thermal_guess(every, heated, outputs.get(at), gain, ambient[warmed], known, where)
    moved = _driven_most(recordings, s, [last] if s.mechanical else range(last + 1))
    r = recordings[moved]
    period, e, outputs = _uniform(r, s, ambient[moved])
    side = int(np.argmax(np.ptp(e, axis=0)))
    guesses, response, peak = _mechanical_guess(
        s, period, e, outputs, thermal, gain, known, side, held=r.hold == "zero_order"
    )
    if s.thermal:
        decay = thermal.get("newton_cooling.conductance", 1.0) / thermal.get("newton_cooling.thermal_mass", 1.0)
        response = 1 / decay if thermal else response
        v = guesses[0].values
        peak = _first_order(gain * heated / v["newton_cooling.thermal_mass"], response, every).max()
    travel = 1.0
    if s.mechanical and last in outputs:
        x = outputs[last] * (s.pulley_radius or 1.0)
        travel = float(np.max(np.abs(x - np.median(x[: max(len(x) // 200, 1)])))) or 1.0
    drive = float(np.sqrt(max(np.max(np.abs(e)), np.max(np.abs(heated))))) or 1.0
    scales = Scales(response, max(q.duration for q in recordings), float(max(peak, 1e-9)), travel, drive)
    return guesses, scales


def _driven_most(recordings: Sequence[Recording], s: Structure, outputs: Iterable[int]) -> int:
    """Which recording was driven most, for longest, of those with one of some outputs, or of all where none has."""
    having = [i for i, r in enumerate(recordings) if any(j in {*outputs} for j, _ in columns(s, r))]
    driven = [np.ptp(np.asarray(drive_values(s, r)), axis=0).sum() * r.duration for r in recordings]
    return max(having or range(len(recordings)), key=lambda i: driven[i])


def _system_guess(
    recordings: Sequence[Recording], s: Structure, ambient: Sequence[float]
) -> tuple[list[Guess], Scales]:
    """Starts that the user's base gives, and how quickly its outputs follow the drive."""
    assert s.system is not None
    guesses = [Guess(values, 0.0) for values in s.system.beginnings()]
    longest = max(recordings, key=lambda r: r.duration)
    period, e, outputs = _uniform(longest, s, ambient[0])
    times = []
    for y in outputs.values():
        first = best_linear(e[:, 0], y, period, 1, held=longest.hold == "zero_order")
        times += [1.0 / float(m.a[0]) for m in first[:1] if m.a[0] > 0]
    travel = max(float(np.ptp(y)) for y in outputs.values()) or 1.0
    response = min(times, default=longest.duration / 20)
    response = float(np.clip(response, 2 * period, longest.duration))
    drive = float(np.sqrt(np.max(np.abs(e)))) or 1.0
    return guesses, Scales(response, max(r.duration for r in recordings), 1.0, travel, drive)


def _thermal_guess(
    period: float,
    e: np.ndarray,
    temperature: np.ndarray | None,
    gain: float,
    ambient: float,
    known: Mapping[str, float],
    where: str,
) -> dict[str, float]:
    """Conductance and thermal mass from a thermometer, if there is one."""
    if temperature is None:
        return {}
    excess = temperature - ambient
    values: dict[str, float] = {}
    found = best_linear(e, temperature, period, 1)
    try:
        lam, mass = thermal_mass_from_energy(gain * e, excess, period)
    except ScpjaxError:
        lam = mass = float("nan")
    if found and found[0].b0 > 0 and (not np.isfinite(lam) or found[0].nrmse > 20):
        mass_iv = gain / found[0].b0
        lam_iv = found[0].a[0] * mass_iv
        if not np.isfinite(lam) or not 0.5 < mass / mass_iv < 2:
            lam, mass = lam_iv, mass_iv
    if not (np.isfinite(lam) and lam > 0 and mass > 0):
        raise FitError(
            "the temperature does not follow the drive",
            where=where,
            mend="check that drive and temperature columns are the right ones and that the drive changes",
        )
    values["newton_cooling.conductance"], values["newton_cooling.thermal_mass"] = lam, mass
    return {k: known.get(k, v) for k, v in values.items()}


def _mechanical_guess(
    s: Structure,
    period: float,
    e: np.ndarray,
    outputs: Mapping[int, np.ndarray],
    thermal: dict[str, float],
    gain: float,
    known: Mapping[str, float],
    side: int,
    *,
    held: bool,
) -> tuple[list[Guess], float, float]:
    """Guesses for the force balance (with the energy balance where no thermometer told it)."""
    last = len(s.outputs) - 1
    typical = {slot.key: slot.parameter.typical for slot in s.slots if slot.parameter.null is None} | dict(known)
    if not s.mechanical or last not in outputs:
        return [Guess(typical | thermal, 0.0)], 1.0, 1.0
    sign = 1.0 if side == 0 else -1.0
    x = outputs[last] * (s.pulley_radius or 1.0) * sign
    sides = len(s.sides)
    mass = typical["inertia.mass"] * sides + 0.5 * s.pulley_mass
    guesses: list[Guess] = []
    if not s.thermal:  # driven directly: a second-order system
        if "inertia.mass" not in known:
            mass = 1.0 if s.drive == "gain" else mass
        for m in best_linear(e[:, 0], x, period, 2, held=held)[:2]:
            guesses += _second_order(typical | {"inertia.mass": mass}, m, mass)
        if not guesses or max(g.score for g in guesses) < 50.0:  # no resonance seen: follow the drive, stiffly or less
            slope = float(np.polyfit(e[:, 0], x, 1)[0])
            for omega in (0.3 / period, 0.03 / period):
                guesses.append(_quasi_static(typical | {"inertia.mass": mass}, slope, omega, mass, 1))
        return (
            guesses,
            1.0 / np.sqrt(guesses[0].values["elastic_spring.stiffness"] / mass),
            float(np.max(np.abs(e))),
        )
    drive = e[:, 0] - e[:, 1] if sides == 2 else e[:, 0]
    drive = drive * sign if sides == 2 else drive
    if not thermal:
        first = best_linear(drive, x, period, 1, held=held)
        decay = float(first[0].a[0]) if first and first[0].a[0] > 0 else 1.0 / (len(x) * period / 10)
        mass_th = known.get("newton_cooling.thermal_mass", typical["newton_cooling.thermal_mass"])
        thermal = {"newton_cooling.thermal_mass": mass_th, "newton_cooling.conductance": decay * mass_th}
    response = thermal["newton_cooling.thermal_mass"] / thermal["newton_cooling.conductance"]
    warm = _first_order(gain * drive / thermal["newton_cooling.thermal_mass"], response, period)
    basis = np.column_stack([warm, np.ones_like(warm), np.exp(-np.arange(len(x)) * period / response)])
    slope = float(np.linalg.lstsq(basis, x, rcond=None)[0][0])
    start = typical | thermal
    found = [m for m in best_linear(warm, x, period, 2, held=False)[:1] if m.nrmse > 0]
    for omega in (float(np.sqrt(typical["elastic_spring.stiffness"] * sides / mass)),):
        guesses.append(_quasi_static(start, slope, omega, mass, sides))
    for m in found:
        omega = float(np.sqrt(abs(m.a[1])))
        if 1.0 < omega < 0.7 * np.pi / period:
            guesses += [_quasi_static(start, slope, omega, mass, sides, float(abs(m.a[0])) / (2 * omega))]
    return guesses, response, float(np.max(warm))


def _second_order(start: dict[str, float], m: Linear, mass: float) -> list[Guess]:
    damping, stiffness = m.a
    if damping <= 0 or stiffness <= 0:
        return []
    v = {
        "inertia.mass": mass,
        "elastic_spring.stiffness": float(stiffness) * mass,
        "viscous_damping.damping": float(damping) * mass,
        "thermal_actuation.coefficient": m.b0 * mass,
    }
    return [Guess(start | v, m.nrmse)]


def _quasi_static(
    start: dict[str, float], slope: float, omega: float, mass: float, sides: int, ratio: float = 0.7
) -> Guess:
    """Displacement that follows the temperature by ``slope`` [m/K], with a resonance at ``omega`` [rad/s]."""
    stiffness = omega**2 * mass / sides
    v = {
        "elastic_spring.stiffness": stiffness,
        "viscous_damping.damping": 2 * ratio * omega * mass / sides,
        "thermal_actuation.coefficient": slope * stiffness * sides,
    }
    return Guess(start | v, 0.0)


def _first_order(u: np.ndarray, tau: float, period: float) -> np.ndarray:
    """Response of tau y' + y = tau u from rest, held input."""
    decay = np.exp(-period / tau)
    return np.asarray(lfilter([0.0, tau * (1 - decay)], [1.0, -decay], u))
