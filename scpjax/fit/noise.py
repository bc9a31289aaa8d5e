"""How noisy are the columns of a recording?"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from scpjax.fit.data import columns
from scpjax.physics.structure import Structure
from scpjax.recordings.condition import estimate_noise
from scpjax.recordings.recording import Recording


def noise_of(recordings: Sequence[Recording], structure: Structure) -> np.ndarray:
    """Noise standard deviation of every output of the model, SI; the smaller of two estimates, pooled.

    Third differences suit slow signals; for fast ones the quietest high band of the spectrum is nearer the truth.
    """
    squares: list[list[float]] = [[] for _ in structure.outputs]
    for r in recordings:
        for j, stem in columns(structure, r):
            seen = np.flatnonzero(r.weight(stem) > 0)
            inner = slice(seen[0], seen[-1] + 1) if seen.size else slice(None)
            squares[j].append(noise_floor(r.output(stem)[inner], r.weight(stem)[inner], uniform=r.is_uniform) ** 2)
    sigma = np.array([np.sqrt(np.mean(s)) if s else 1.0 for s in squares])
    return np.where(sigma > 0, sigma, 1e-9)


def noise_floor(signal: np.ndarray, weights: np.ndarray | None = None, *, uniform: bool = True) -> float:
    """Standard deviation of white noise on a signal (n,): least of third differences and the top of the spectrum."""
    third = estimate_noise(signal, weights)
    n = len(signal)
    if not uniform or n < 512 or (weights is not None and np.any(weights == 0)):
        return third
    window = np.hanning(n)
    ramp = np.linspace(signal[: n // 50].mean(), signal[-n // 50 :].mean(), n)
    power = np.abs(np.fft.rfft((signal - ramp) * window)) ** 2 / np.sum(window**2)
    top = power[int(0.85 * len(power)) : -1]
    spectral = float(np.sqrt(np.median(top) / np.log(2.0)))  # |noise|^2 is exponential: median = mean ln 2
    return min(third, spectral) if spectral > 0 else third
