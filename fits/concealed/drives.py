"""Voltage profiles of five families. Levels are held; every edge lies on the grid of samples."""

from __future__ import annotations

from typing import Literal

import numpy as np

from fits.concealed.plants import FULL_DRIVE

Family = Literal["step", "multilevel", "pulses", "sweep", "triangle"]
FAMILIES: tuple[Family, ...] = ("step", "multilevel", "pulses", "sweep", "triangle")
SECONDS: dict[Family, float] = {"step": 110, "multilevel": 150, "pulses": 120, "sweep": 120, "triangle": 130}
Levels = list[tuple[float, float]]  # (volts, seconds) one after another


def draw_drive(family: Family, sides: int, period: float, rng: np.random.Generator) -> np.ndarray:
    """Volts (n, sides) at every sample, held until the next. ``period``: s between samples."""
    levels = _LEVELS[family](rng)
    n = round(SECONDS[family] / period)
    volts = _hold(levels, n, period)[:, None]
    return volts if sides == 1 else _shared_out(volts[:, 0], family, rng)


def _hold(levels: Levels, n: int, period: float) -> np.ndarray:
    out = np.zeros(n)
    at = 0
    for volts, seconds in levels:
        until = min(n, at + max(1, round(seconds / period)))
        out[at:until] = round(volts, 4)
        at = until
    return out


def _shared_out(volts: np.ndarray, family: Family, rng: np.random.Generator) -> np.ndarray:
    """To each side its stretches: which one pulls changes where the drive comes through zero, or at a jump."""
    out = np.zeros((len(volts), 2))
    if family == "step":
        out[:, 0] = volts
        return out
    low = volts < 0.05 * FULL_DRIVE
    starts = np.flatnonzero(np.diff(volts, prepend=volts[0] - 1.0))
    side = 0
    for a, b in zip(starts, [*starts[1:], len(volts)], strict=True):
        jump = a > 0 and abs(volts[a] - volts[a - 1]) > 0.25 * FULL_DRIVE
        if (a > 0 and low[a]) or (jump and family == "multilevel" and rng.random() < 0.5):
            side = 1 - side
        out[a:b, side] = volts[a:b]
        if family == "multilevel" and rng.random() < 0.3:  # both at once, now and then
            out[a:b, 1 - side] = round(float(rng.uniform(0.2, 0.7)) * FULL_DRIVE, 4)
    return out


def _step(rng: np.random.Generator) -> Levels:
    top = FULL_DRIVE * float(rng.choice([1.0, 1.0, 0.9]))
    return [(0.0, 5.0), (top, float(rng.uniform(45, 58))), (0.0, 200.0)]


def _multilevel(rng: np.random.Generator) -> Levels:
    levels: Levels = [(0.0, 2.0)]
    while sum(s for _, s in levels) < SECONDS["multilevel"]:
        off = rng.random() < 0.2
        levels.append((0.0 if off else FULL_DRIVE * float(rng.uniform(0.25, 1.0)), float(rng.uniform(5, 20))))
    return levels


def _pulses(rng: np.random.Generator) -> Levels:
    levels: Levels = []
    while sum(s for _, s in levels) < SECONDS["pulses"]:
        levels.append((FULL_DRIVE * float(rng.uniform(0.6, 1.0)), float(rng.uniform(3, 12))))
        levels.append((0.0, float(rng.uniform(4, 16))))
    return levels


def _sweep(rng: np.random.Generator) -> Levels:
    """A chirp from 0.012 to about 0.1 Hz, in steps of half a second."""
    hold, top = 0.5, FULL_DRIVE * float(rng.uniform(0.85, 1.0))
    t = np.arange(0.0, SECONDS["sweep"], hold)
    first, last = 0.012, float(rng.uniform(0.07, 0.12))
    phase = 2 * np.pi * (first * t + 0.5 * (last - first) * t**2 / SECONDS["sweep"])
    return [(float(v), hold) for v in 0.5 * top * (1 - np.cos(phase))]


def _triangle(rng: np.random.Generator) -> Levels:
    """Up and down in small steps, to a lower peak every time: nested loops."""
    hold, levels = 1.0, [(0.0, 1.0)]
    for peak, half in zip((1.0, 0.75, 0.5, 0.9), (20, 16, 12, 14), strict=True):
        down_to = 0.0 if peak > 0.6 else 0.2
        up = np.linspace(0.0, peak, half) * FULL_DRIVE
        down = np.linspace(peak, down_to, half) * FULL_DRIVE
        levels += [(float(v), hold * float(rng.uniform(0.9, 1.1))) for v in (*up, *down)]
    return levels


_LEVELS = {"step": _step, "multilevel": _multilevel, "pulses": _pulses, "sweep": _sweep, "triangle": _triangle}
