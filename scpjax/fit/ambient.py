"""How warm were the surroundings, where a recording does not say?"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from scipy.special import chdtri

from scpjax.physics.structure import Structure
from scpjax.recordings.plausible import doubts_of_ambient
from scpjax.recordings.recording import Recording

_FALLBACK = 293.15  # K
_RESTING, _DRIVEN = 5, 9  # first readings used: of an actuator at rest, of one that is driven from the start
_WILD = 8.0  # standard deviations that a first reading is off what the next ones lead back to
_JUMP = 3.0  # ratio to the steps between the next ones, from which it is no quick warming
_TOO_LATE = 10.0  # standard deviations of a reading, which leading back may cost
_ALIKE = 0.999  # share of chance differences that pass for none


def ambients(recordings: Sequence[Recording], s: Structure, sigma: float) -> tuple[list[float], tuple[str, ...]]:
    """(ambient of each recording [K], notes): as told, else where its thermometer began, else 293.15 K, or the mean of
    the others' where it has a thermometer that begins too late.

    ``sigma`` [K] is the thermometer's noise. Beginnings that differ by no more than noise are taken for one.
    """
    known = [told_ambient(r, s) for r in recordings]
    begun = {i: b for i, r in enumerate(recordings) if known[i] is None and (b := _beginning(r, s, sigma)) is not None}
    together = _common(list(begun.values()))
    notes, names = [], [r.metadata.name or f"recording {i}" for i, r in enumerate(recordings)]
    for i, (value, _) in begun.items():
        taken = value if together is None else together
        known[i] = taken
        where = "the first readings" if together is None or len(begun) == 1 else "the first readings of all recordings"
        notes.append(f"{names[i]}: ambient not given; taken from {where}, {taken - 273.15:.2f} degC")
    late = [i for i, r in enumerate(recordings) if known[i] is None and _thermometer(r, s) is not None]
    there = [value for value in known if value is not None] or [_FALLBACK]
    for i in late:
        known[i] = taken = float(np.mean(there))
        why = "ambient not given, and its thermometer begins too late to tell"
        notes.append(f"{names[i]}: {why}; taken to be {taken - 273.15:.2f} degC")
    doubted = tuple(d for i, (value, _) in begun.items() for d in doubts_of_ambient(names[i], value))
    return [_FALLBACK if value is None else value for value in known], doubted + tuple(notes)


def rooms(recordings: Sequence[Recording], s: Structure, sigma: float) -> list[float]:
    """Ambient [K] of each recording that was taken from its thermometer, or from a temperature that drives, and may be
    a room's; none where any recording tells its own.
    """
    if s.system or any(r.metadata.ambient_K is not None for r in recordings):
        return []
    taken = zip(recordings, ambients(recordings, s, sigma)[0], strict=True)
    return [k for r, k in taken if not s.thermal or (_thermometer(r, s) and not doubts_of_ambient("", k))]


def told_ambient(r: Recording, s: Structure) -> float | None:
    """Ambient [K] that a recording tells, or of a temperature that drives, from where it counts; None where neither."""
    thermometer = s.thermal and any(c.stem.startswith("temperature") for c in r.output_channels)
    if r.metadata.ambient_K is not None or thermometer or s.drive != "temperature":
        return r.metadata.ambient_K
    return float(r.inputs[0, 0])


def _beginning(r: Recording, s: Structure, sigma: float) -> tuple[float, float] | None:
    """(temperature [K] when the recording began, its standard deviation); None without a thermometer.

    An actuator that is driven from the start has warmed by the next readings: a parabola leads back, without a first
    reading that the others speak against. None also where they begin too late to be led back.
    """
    stem = _thermometer(r, s)
    seen = np.flatnonzero(r.weight(stem) > 0) if stem else np.zeros(0, int)
    if not stem or not seen.size:
        return None
    first = seen[:_RESTING]
    resting = not np.any(r.inputs[: first[-1] + 1])
    at = first if resting else seen[:_DRIVEN]
    values = r.output(stem)[at]
    if resting or len(at) < 4:
        return float(np.median(values)), 1.25 * sigma / np.sqrt(len(at))
    later = r.time[at] - r.time[0]
    if len(at) > 4:
        value, std = _led_back(later[1:], values[1:], sigma, to=float(later[0]))
        jumps = np.abs(np.diff(values))
        if abs(values[0] - value) > _WILD * np.hypot(std, sigma) and jumps[0] > _JUMP * np.max(jumps[1:]):
            later, values = later[1:], values[1:]
    value, std = _led_back(later, values, sigma)
    return (value, std) if std < _TOO_LATE * sigma else None


def _thermometer(r: Recording, s: Structure) -> str | None:
    """Stem of the first thermometer that shows how warm an actuator is."""
    return next((c.stem for c in r.output_channels if s.thermal and c.stem.startswith("temperature")), None)


def _led_back(time: np.ndarray, values: np.ndarray, sigma: float, to: float = 0.0) -> tuple[float, float]:
    """(value, standard deviation) at a time of a parabola through readings."""
    design = np.stack([np.ones_like(time), time - to, (time - to) ** 2], axis=1)
    inverse = np.linalg.pinv(design / (scale := np.max(np.abs(design), axis=0))) / scale[:, None]
    return float(inverse[0] @ values), sigma * float(np.linalg.norm(inverse[0]))


def _common(begun: Sequence[tuple[float, float]]) -> float | None:
    """Their mean, if they differ by no more than noise."""
    if not begun:
        return None
    values, std = (np.array(x) for x in zip(*begun, strict=True))
    mean = float(np.average(values, weights=std**-2.0))
    return mean if np.sum(((values - mean) / std) ** 2) <= chdtri(max(len(values) - 1, 1), 1.0 - _ALIKE) else None
