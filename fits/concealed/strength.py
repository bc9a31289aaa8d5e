"""How strong an effect is: misfit of the best base model over the noise, by a quick fit of its own.

The base model is linear, so its response to V^2 is a filter that is exact for a drive held between samples; its gains
and the zeros of its sensors are found by linear least squares for every trial of the other three numbers
(variable projection: Golub, Pereyra 1973).
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
from scipy.optimize import least_squares
from scipy.signal import lfilter

from fits.concealed.plants import Plant
from fits.concealed.recorder import Column

Simulated = tuple[np.ndarray, np.ndarray]  # volts (n, sides), readings (n, columns)


def filter_of(matrix: np.ndarray, into: np.ndarray, out: np.ndarray, period: float) -> tuple[np.ndarray, np.ndarray]:
    """(numerator, denominator) in 1/z of out x, x' = matrix x + into u, from rest, u held between samples."""
    size = len(matrix)
    block = np.zeros((size + 1, size + 1))
    block[:size, :size], block[:size, size] = matrix, into
    step = _exponential(block * period)
    a, z = step[:size, :size], step[:size, size]
    poles = np.poly(a)
    markov = [0.0]
    for _ in range(size):
        markov.append(float(out @ z))
        z = a @ z
    return np.convolve(poles, markov)[: size + 1], poles


def _exponential(matrix: np.ndarray) -> np.ndarray:
    """exp of a small matrix: Taylor's series of a 2^n-th of it, squared n times."""
    halvings = max(0, int(np.ceil(np.log2(max(float(np.abs(matrix).sum(axis=1).max()), 1e-300)))) + 2)
    small = matrix / 2**halvings
    total = term = np.eye(len(matrix))
    for i in range(1, 14):
        term = term @ small / i
        total = total + term
    for _ in range(halvings):
        total = total @ total
    return total


@dataclass(frozen=True)
class BaseFit:
    """Best base model: misfit in units of the noise by column (noise included), and its three numbers."""

    misfit: dict[str, float]
    rates: np.ndarray  # 1/settling, k/m, beta/m

    @property
    def worst(self) -> float:
        """Misfit of the worst column."""
        return max(self.misfit.values())


def base_fit(plant: Plant, columns: Sequence[Column], files: Sequence[Simulated], period: float) -> BaseFit:
    """Fit the base model to readings without noise; every column counts by its noise."""
    start = np.log([1 / plant.settling, *_mechanical(plant)])
    shown = [j for j, c in enumerate(columns) if c.name]
    wanted = {j: np.concatenate([r[:, j] for _, r in files]) * columns[j].scale / columns[j].noise for j in shown}

    def residual(logs: np.ndarray) -> np.ndarray:
        return np.concatenate(list(_left(plant, np.exp(logs), files, wanted, period).values()))

    free = 3 if plant.moves else 1
    found = least_squares(
        lambda p: residual(np.concatenate([p, start[free:]])),
        start[:free],
        bounds=(start[:free] - 4.0, start[:free] + 4.0),
        max_nfev=60,
        xtol=1e-7,
        ftol=1e-9,
    )
    rates = np.exp(np.concatenate([found.x, start[free:]]))
    left = _left(plant, rates, files, wanted, period)
    return BaseFit({columns[j].name: float(np.sqrt(1 + np.mean(left[j] ** 2))) for j in shown}, rates)


def _mechanical(plant: Plant) -> tuple[float, float]:
    if plant.kind == "joint":
        moving = 2 * plant.mass + 0.5 * plant.pulley_mass
        return 2 * plant.stiffness / moving, 2 * plant.damping / moving
    return plant.stiffness / plant.mass, plant.damping / plant.mass


def _left(
    plant: Plant, rates: np.ndarray, files: Sequence[Simulated], wanted: dict[int, np.ndarray], period: float
) -> dict[int, np.ndarray]:
    """What the best gain and zero leave of each column, in units of the noise."""
    cooling, elastic, viscous = rates
    third = np.array([[-cooling, 0, 0], [0, 0, 1], [1, -elastic, -viscous]])
    first = third[:1, :1]
    sides = plant.sides
    heating = filter_of(first, np.ones(1), np.ones(1), period)
    warm = [np.concatenate([lfilter(*heating, v[:, i] ** 2) for v, _ in files]) for i in range(sides)]
    out = {}
    gains = [j for j in wanted if j < sides]
    if gains:  # one gain for both sides, a zero for each
        both = np.concatenate([warm[j] for j in gains])
        zeros = np.kron(np.eye(len(gains)), np.ones((len(warm[0]), 1)))
        left = _project(np.column_stack([both, zeros]), np.concatenate([wanted[j] for j in gains]))
        out |= dict(zip(gains, np.split(left, len(gains)), strict=True))
    if plant.moves:
        moving = filter_of(third, np.array([1.0, 0, 0]), np.array([0, 1.0, 0]), period)
        drives = [v[:, 0] ** 2 - (v[:, 1] ** 2 if sides == 2 else 0.0) for v, _ in files]
        moved = np.concatenate([lfilter(*moving, u) for u in drives]) * elastic
        out[sides] = _project(np.column_stack([moved, np.ones(len(moved))]), wanted[sides])
    return out


def _project(matrix: np.ndarray, wanted: np.ndarray) -> np.ndarray:
    return wanted - matrix @ np.linalg.lstsq(matrix, wanted, rcond=None)[0]


_TRIALS = 7


def calibrate(misfit: Callable[[float], float], wanted: float, guess: float, most: float) -> tuple[float, float]:
    """(strength, misfit) at which the misfit is near ``wanted``; at ``most`` where it is not reached.

    The part of the misfit that is not noise is about proportional to a power of the strength. An infinite misfit (there
    was no simulating it) is as far as the strength may go.
    """
    aim = np.sqrt(wanted**2 - 1)
    tried: list[tuple[float, float]] = []
    strength = guess
    for _ in range(_TRIALS):
        found = misfit(strength)
        if not np.isfinite(found):
            strength = np.sqrt(strength * tried[-1][0]) if tried else strength / 4
            continue
        tried.append((strength, found))
        reached = [float(np.sqrt(max(m**2 - 1, 1e-6))) for _, m in tried]
        if abs(reached[-1] / aim - 1) < 0.12 or (strength >= most and reached[-1] < aim):
            break
        power = 1.0
        if len(tried) > 1 and tried[-1][0] != tried[-2][0]:
            power = np.log(reached[-1] / reached[-2]) / np.log(tried[-1][0] / tried[-2][0])
            power = float(np.clip(power, 0.4, 3.0))
        strength = float(np.clip(strength * (aim / reached[-1]) ** (1 / power), strength / 8, strength * 8))
        strength = min(strength, most)
    if not tried:
        raise ValueError(f"no misfit at any strength from {guess:g} down to {strength:g}")
    best = min(tried, key=lambda t: abs(np.log(np.sqrt(max(t[1] ** 2 - 1, 1e-6)) / aim)))
    return float(f"{best[0]:.4g}"), best[1]
