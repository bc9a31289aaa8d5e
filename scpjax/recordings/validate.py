"""What the arrays of a recording must satisfy."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from scpjax.errors import RecordingError

MIN_SAMPLES = 8
_UNIFORM = 1e-3  # of a period: what rounding in a CSV does to a clock that is uniform


def uniform(time: np.ndarray) -> bool:
    """Whether ``time`` (n,) lies on an even grid but for rounding."""
    step = (time[-1] - time[0]) / (time.size - 1)
    return bool(np.max(np.abs(time - time[0] - step * np.arange(time.size))) <= _UNIFORM * step)


def check_stems(stems: Sequence[str], where: str) -> None:
    """Each quantity once."""
    twice = sorted({stem for stem in stems if stems.count(stem) > 1})
    if twice:
        raise RecordingError(
            f"'{twice[0]}' is there twice",
            where=where,
            mend="keep one column for each quantity, or choose roles",
        )


def check_shapes(
    time: np.ndarray,
    inputs: np.ndarray,
    outputs: np.ndarray,
    weights: np.ndarray,
    channels: tuple[int, int],
    where: str,
    *,
    require_outputs: bool = True,
) -> None:
    """``time`` (n,), ``inputs`` (n, u), ``outputs`` and ``weights`` (n, y), with ``channels`` = (u, y)
    above 0; y may be 0 where outputs are not required.
    """
    u, y = channels
    if not u or (require_outputs and not y):
        kind = "outputs" if u else "inputs"
        raise RecordingError(f"no {kind}", where=where, mend="give at least one input and one output")
    n = time.shape[0] if time.ndim == 1 else -1
    if n < 0 or (inputs.shape, outputs.shape, weights.shape) != ((n, u), (n, y), (n, y)):
        raise RecordingError(
            f"shapes do not agree: time {time.shape}, inputs {inputs.shape}, outputs {outputs.shape}, "
            f"weights {weights.shape}",
            where=where,
            mend="time is (n,), inputs (n, channels), outputs and weights (n, channels)",
        )
    if n < MIN_SAMPLES:
        raise RecordingError(f"only {n} samples", where=where, mend=f"record at least {MIN_SAMPLES}")


def check_values(
    time: np.ndarray,
    inputs: np.ndarray,
    outputs: np.ndarray,
    weights: np.ndarray,
    columns: Sequence[str],
    where: str,
) -> None:
    """Time finite and growing, inputs finite, outputs finite or NaN, weights finite and not negative."""
    if not np.all(np.isfinite(time)):
        i = int(np.argmin(np.isfinite(time)))
        raise RecordingError("time is not a number", where=f"{where}: sample {i}", mend="remove or repair it")
    if np.any(np.diff(time) <= 0):
        i = int(np.argmax(np.diff(time) <= 0)) + 1
        raise RecordingError(
            f"time does not grow: {time[i]:.9g} s after {time[i - 1]:.9g} s",
            where=f"{where}: sample {i}",
            mend="sort the rows by time and remove repeated ones",
        )
    bad = ~np.isfinite(inputs)
    if bad.any():
        i, j = (int(k) for k in np.argwhere(bad)[0])
        raise RecordingError(
            "an input is missing or not finite",
            where=f"{where}: sample {i}, column {columns[j]}",
            mend="fill it in or cut the recording there",
        )
    if np.isinf(outputs).any() or not np.isfinite(weights).all() or (weights < 0).any():
        raise RecordingError(
            "an output is infinite, or a weight negative or not finite",
            where=where,
            mend="leave missing outputs empty (NaN); weights are 0 or more",
        )


def fill(time: np.ndarray, values: np.ndarray, weights: np.ndarray) -> np.ndarray:
    """``values`` (n, y) with NaN replaced by linear interpolation between seen samples; 0 without any."""
    filled = values.copy()
    for i in range(values.shape[1]):
        missing = np.isnan(values[:, i])
        if missing.any():
            seen = (weights[:, i] > 0) & ~missing
            filled[missing, i] = np.interp(time[missing], time[seen], values[seen, i]) if seen.any() else 0.0
    return filled
