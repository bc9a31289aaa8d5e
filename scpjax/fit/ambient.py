"""How warm were the surroundings, where a recording does not say?"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from scipy.stats import chi2

from scpjax.physics.structure import Structure
from scpjax.recordings.plausible import doubts_of_ambient
from scpjax.recordings.recording import Recording

_FALLBACK = 293.15  # K
_RESTING, _DRIVEN = 5, 9  # first readings used: of an actuator at rest, of one that is driven from the start
_ALIKE = 0.999  # share of chance differences that pass for none


def ambients(recordings: Sequence[Recording], s: Structure, sigma: float) -> tuple[list[float], tuple[str, ...]]:
    """(ambient of each recording [K], notes): as told, else where its thermometer began, else 293.15 K.

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
    doubted = tuple(d for i, (value, _) in begun.items() for d in doubts_of_ambient(names[i], value))
    return [_FALLBACK if value is None else value for value in known], doubted + tuple(notes)


def told_ambient(r: Recording, s: Structure) -> float | None:
    """Ambient [K] that a recording tells, or of a temperature that drives, from where it counts; None where neither."""
    thermometer = s.thermal and any(c.stem.startswith("temperature") for c in r.output_channels)
    if r.metadata.ambient_K is not None or thermometer or s.drive != "temperature":
        return r.metadata.ambient_K
    return float(r.inputs[0, 0])


def _beginning(r: Recording, s: Structure, sigma: float) -> tuple[float, float] | None:
    """(temperature [K] when the recording began, its standard deviation); None without a thermometer.

    An actuator that is driven from the start has warmed by the next readings: a parabola leads back.
    """
    stem = next((c.stem for c in r.output_channels if c.stem.startswith("temperature")), None)
    if not s.thermal or stem is None:
        return None
    seen = np.flatnonzero(r.weight(stem) > 0)
    resting = not np.any(r.inputs[:_RESTING])
    at = seen[: _RESTING if resting else _DRIVEN]
    values = r.output(stem)[at]
    if resting or len(at) < 4:
        return float(np.median(values)), 1.25 * sigma / np.sqrt(len(at))
    later = (r.time[at] - r.time[0]) / (r.time[at[-1]] - r.time[0])
    design = np.stack([np.ones_like(later), later, later**2], axis=1)
    inverse = np.linalg.pinv(design)
    return float(inverse[0] @ values), sigma * float(np.linalg.norm(inverse[0]))


def _common(begun: Sequence[tuple[float, float]]) -> float | None:
    """Their mean, if they differ by no more than noise."""
    if not begun:
        return None
    values, std = (np.array(x) for x in zip(*begun, strict=True))
    mean = float(np.average(values, weights=std**-2.0))
    return mean if np.sum(((values - mean) / std) ** 2) <= chi2.ppf(_ALIKE, max(len(values) - 1, 1)) else None
