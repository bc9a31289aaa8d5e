"""How noisy are the columns of a recording?"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from scpjax.errors import RecordingError
from scpjax.fit.data import columns
from scpjax.physics.structure import Structure
from scpjax.recordings.condition import estimate_noise
from scpjax.recordings.recording import Recording, place

_TOP = 0.85  # of the spectrum, above which a signal has least of itself
_SAMPLES = 512  # from which there is enough of it
_SPREAD = 0.9  # relative standard deviation of its estimate, times the root of the number of lines
_NOT_WILD = (0.01, 0.99)  # quantiles between which readings are not wild ones
_FINEST = 1e-5  # of its range, that any reading is off by
_CLEARLY = 3.0  # of its standard deviations, that it has to be below the other to be believed instead


@dataclass(frozen=True)
class _Seen:
    """Two estimates of a noise variance: from third differences, and from ``lines`` of the top of the spectrum (0
    where it can not be had)."""

    third: float
    top: float = 0.0
    lines: int = 0


def noise_of(recordings: Sequence[Recording], structure: Structure) -> np.ndarray:
    """Noise standard deviation of every output of the model, SI, over all recordings together.

    From third differences, which suit slow signals and are the surer; where that is clearly below, from the top of the
    spectrum, which has less of a fast signal. Simulated readings may have none: at least 1e-5 of the output's range.
    """
    seen: list[list[_Seen]] = [[] for _ in structure.outputs]
    ranges = np.zeros(len(structure.outputs))
    for r in recordings:
        for j, stem in columns(structure, r):
            there = np.flatnonzero(r.weight(stem) > 0)
            inner = slice(there[0], there[-1] + 1) if there.size else slice(None)
            if there.size:
                ranges[j] = max(ranges[j], float(np.ptp(np.quantile(r.output(stem)[there], _NOT_WILD))))
            try:
                seen[j].append(_look(r.output(stem)[inner], r.weight(stem)[inner], uniform=r.is_uniform))
            except RecordingError as error:
                column = next(c.column for c in r.output_channels if c.stem == stem)
                where = f"{place(r.metadata)}: column {column}"
                raise RecordingError(error.problem, where=where, mend=error.mend) from error
    sigma = np.array([_pooled(s) if s else 1.0 for s in seen])
    return np.maximum(np.where(sigma > 0, sigma, 1e-9), _FINEST * ranges)


def noise_floor(signal: np.ndarray, weights: np.ndarray | None = None, *, uniform: bool = True) -> float:
    """Standard deviation of white noise on a signal (n,), as `noise_of` has it."""
    return _pooled([_look(signal, weights, uniform=uniform)])


def _look(signal: np.ndarray, weights: np.ndarray | None, *, uniform: bool) -> _Seen:
    third = estimate_noise(signal, weights) ** 2
    n = len(signal)
    if not uniform or n < _SAMPLES or (weights is not None and np.any(weights == 0)):
        return _Seen(third)
    window = np.hanning(n)
    ramp = np.linspace(signal[: n // 50].mean(), signal[-n // 50 :].mean(), n)
    power = np.abs(np.fft.rfft((signal - ramp) * window)) ** 2 / np.sum(window**2)
    top = power[int(_TOP * len(power)) : -1]
    return _Seen(third, float(np.median(top) / np.log(2.0)), len(top))  # |noise|^2 is exponential: median = mean ln 2


def _pooled(seen: Sequence[_Seen]) -> float:
    """Standard deviation from the estimates of several recordings of one sensor."""
    both = [s for s in seen if s.top > 0]
    third = np.array([s.third for s in seen])
    if both:
        doubt = _SPREAD / np.sqrt(sum(s.lines for s in both))
        tops, thirds = (np.sqrt(np.mean(x)) for x in ([s.top for s in both], [s.third for s in both]))
        if tops < (1.0 - _CLEARLY * doubt) * thirds:
            third = np.array([s.top or s.third for s in seen])
    return float(np.sqrt(np.mean(third)))
