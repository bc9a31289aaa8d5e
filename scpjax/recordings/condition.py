"""Conditioning of recordings: filter, remove offsets, resample, decimate, and set outliers aside.

These are the steps of section 3.3.3 and figure 3.10 of the thesis. Every function gives a new recording;
weights follow the samples, so that what was missing stays missing.
"""

from __future__ import annotations

import math
from typing import Any, Literal

import numpy as np

from scpjax.errors import RecordingError
from scpjax.recordings.recording import Recording, place

_GAP_PERIODS = 3.5
_THIRD = math.sqrt(20.0)  # third differences of white noise: 1 + 9 + 9 + 1 variances
_CLIP = 3.5
_CLIPPED_STD = math.sqrt(
    1.0 - 2.0 * _CLIP * math.exp(-0.5 * _CLIP**2) / math.sqrt(2.0 * math.pi) / math.erf(_CLIP / math.sqrt(2.0))
)


def lowpass(recording: Recording, cutoff_hz: float, *, order: int = 4) -> Recording:
    """Outputs through a Butterworth low pass run forwards and backwards: no phase lag, -6 dB at
    ``cutoff_hz``.

    Needs a uniform recording and ``0 < cutoff_hz < 1 / (2 period)``; ``RecordingError`` otherwise.
    """
    from scipy.signal import butter, sosfiltfilt

    _need_uniform(recording, "lowpass")
    nyquist = 0.5 / recording.period
    if not 0.0 < cutoff_hz < nyquist:
        raise RecordingError(
            f"cutoff {cutoff_hz:g} Hz is not between 0 and {nyquist:g} Hz",
            where=place(recording.metadata),
            mend="stay below half the sample rate",
        )
    sections = butter(order, cutoff_hz / nyquist, output="sos")
    padding = min(3 * (2 * order + 1), recording.n - 1)
    return recording.with_outputs(sosfiltfilt(sections, recording.outputs, axis=0, padlen=padding))


def remove_offset(
    recording: Recording,
    *,
    mode: Literal["mean", "initial"] = "mean",
    initial_s: float | None = None,
    inputs: bool = False,
) -> Recording:
    """Outputs less their weighted mean, or less that of the first ``initial_s`` (default: 2 % of the
    duration).

    With ``inputs`` the drives lose theirs too (for linear black-box identification; a squared voltage needs
    its zero). Weight-0 samples do not count.
    """
    if mode not in ("mean", "initial"):
        raise RecordingError(f"unknown mode '{mode}'", mend="use 'mean' or 'initial'")
    span = recording.duration if mode == "mean" else initial_s if initial_s else 0.02 * recording.duration
    first = recording.time - recording.time[0] <= span
    weights = recording.weights[first]
    total = weights.sum(axis=0)
    if (total == 0).any():
        raise RecordingError(
            "an output has no values there",
            where=place(recording.metadata),
            mend="take a longer initial_s, or select other outputs",
        )
    offset = (weights * recording.outputs[first]).sum(axis=0) / total
    moved = recording.with_outputs(recording.outputs - offset)
    return moved.with_inputs(recording.inputs - recording.inputs[first].mean(axis=0)) if inputs else moved


def resample(recording: Recording, period_s: float | None = None) -> Recording:
    """On an even grid of ``period_s`` (default: the median step), from the first time on.

    Zero-order inputs keep their last value, others run linearly; outputs run linearly between the values
    that are there, with weight 0 where those are more than 3.5 periods apart. To go to a longer period,
    ``decimate`` afterwards: this function does not average.
    """
    period = recording.period if period_s is None else float(period_s)
    if not 0.0 < period <= recording.duration:
        raise RecordingError(
            f"period {period:g} s is not between 0 and {recording.duration:g} s",
            where=place(recording.metadata),
            mend="give a sample period in seconds",
        )
    count = math.floor(recording.duration / period * (1.0 + 1e-9) + 1e-3) + 1
    grid = recording.time[0] + period * np.arange(count)
    inputs = _resample_inputs(recording, grid, period)
    outputs = np.zeros((count, recording.outputs.shape[1]))
    weights = np.zeros_like(outputs)
    longest = _GAP_PERIODS * max(period, recording.period)
    for i in range(outputs.shape[1]):
        seen = recording.weights[:, i] > 0
        if not seen.any():
            continue
        time, values = recording.time[seen], recording.outputs[seen, i]
        outputs[:, i] = np.interp(grid, time, values)
        after = np.clip(np.searchsorted(time, grid - 1e-3 * period), 0, time.size - 1)
        before = np.clip(np.searchsorted(time, grid + 1e-3 * period, side="right") - 1, 0, time.size - 1)
        inside = (grid >= time[0] - 1e-3 * period) & (grid <= time[-1] + 1e-3 * period)
        near = inside & (time[after] - time[before] <= longest)
        weights[:, i] = near * np.interp(grid, time, recording.weights[seen, i])
    return recording.with_samples(grid, inputs, outputs, weights)


def decimate(recording: Recording, factor: int) -> Recording:
    """Means over bins of ``factor`` samples; a last bin that is not full is left out.

    A bin's time is the mean of its times and an output its weighted mean there, so nothing moves in time. A
    zero-order input becomes the mean of what was held from that time to the next bin's; other inputs the
    mean of the bin. Missing samples do not count; a bin without any has weight 0, else the mean of its
    weights.
    """
    _need_uniform(recording, "decimate")
    if factor < 1 or factor != int(factor):
        raise RecordingError(f"factor {factor} is not a whole number above 0", mend="use 2, 3, 4, ...")
    bins = recording.n // factor
    cut = bins * factor

    def mean(values: np.ndarray) -> np.ndarray:
        return values[:cut].reshape(bins, factor, *values.shape[1:]).mean(axis=1)

    time, share = mean(recording.time), mean(recording.weights)
    outputs = mean(recording.weights * recording.outputs) / np.where(share > 0, share, 1.0)
    outputs = np.where(share > 0, outputs, mean(recording.outputs))
    inputs = mean(recording.inputs)
    if recording.hold == "zero_order":
        edges = 0.5 * (factor - 1) + factor * np.arange(bins + 1)
        area = np.concatenate([np.zeros((1, inputs.shape[1])), np.cumsum(recording.inputs, axis=0)])
        area = np.concatenate([area, area[-1] + factor * recording.inputs[-1:]])
        knots = np.append(np.arange(recording.n + 1), recording.n + factor)
        sums = [np.diff(np.interp(edges, knots, column)) for column in area.T]
        inputs = np.stack(sums, axis=1) / factor
    return recording.with_samples(time, inputs, outputs, share)


def hampel(recording: Recording, *, window: int = 11, n_sigmas: float = 5.0) -> Recording:
    """Weight 0 for outputs further than ``n_sigmas`` robust deviations from the median of ``window`` samples.

    The deviation is 1.4826 times the median distance from that median in the window, and at least the noise
    of the whole signal (``estimate_noise``). Values stay as they are: no data are invented.
    """
    if window < 3 or window % 2 == 0 or window > recording.n:
        raise RecordingError(f"window {window} is not odd, 3 or more", mend="use 5, 7, 11, ...")
    weights = recording.weights.copy()
    for i in range(weights.shape[1]):
        seen = np.flatnonzero(weights[:, i] > 0)
        if seen.size < window:
            continue
        values = recording.outputs[seen, i]
        away = np.abs(values - _running_median(values, window))
        spread = 1.4826 * _running_median(away, window)
        spread = np.maximum(spread, estimate_noise(values))
        weights[seen[away > n_sigmas * spread], i] = 0.0
    return recording.with_weights(weights)


def replace_jumps(recording: Recording, limit: float, *, output: str | None = None, run: int = 5) -> Recording:
    """Hold the last good value where the next lies further than ``limit`` (SI) from it, as for the thesis'
    sonar.

    The replaced samples get weight 0. ``output`` is the stem, needed where there are several. After ``run``
    readings in a row that were refused the new level is believed. ``RecordingError`` for a limit that is not
    positive.
    """
    if limit <= 0:
        raise RecordingError(f"limit {limit:g} is not positive", mend="give the largest step that can be real, in SI")
    if output is None and len(recording.output_channels) > 1:
        stems = ", ".join(c.stem for c in recording.output_channels)
        raise RecordingError("several outputs", where=place(recording.metadata), mend=f"name one of {stems}")
    stem = output or next(c.stem for c in recording.output_channels)
    values, weights = recording.output(stem).copy(), recording.weight(stem).copy()
    column = [stem in (c.stem, c.column) for c in recording.output_channels].index(True)
    good: float | None = None
    refused = 0
    for k in range(values.size):
        if weights[k] == 0:
            continue
        if good is not None and abs(values[k] - good) > limit and refused < run:
            values[k], weights[k] = good, 0.0
            refused += 1
        else:
            good, refused = float(values[k]), 0
    outputs, all_weights = recording.outputs.copy(), recording.weights.copy()
    outputs[:, column], all_weights[:, column] = values, weights
    return recording.with_samples(recording.time, recording.inputs, outputs, all_weights)


def estimate_noise(signal: Any, weights: Any = None) -> float:
    """Standard deviation of white noise on an evenly sampled ``signal`` (n,), from its third differences.

    A smooth signal leaves none of itself there; their standard deviation is sqrt(20) times the noise's.
    Values beyond 3.5 robust deviations (jumps of the signal) are left out and the truncation made good;
    windows across a missing sample (weight 0) are skipped, but where that leaves next to none (a sensor logged more
    rarely than the clock) those of the samples that are there are taken. Of a quantised signal the steps
    count as noise; what a signal has near half the sample rate counts too, so there this is an upper bound.
    """
    values = np.asarray(signal, dtype=np.float64)
    seen = np.isfinite(values) if weights is None else (np.asarray(weights) > 0) & np.isfinite(values)
    whole = seen[:-3] & seen[1:-2] & seen[2:-1] & seen[3:]
    third = np.diff(np.where(seen, values, 0.0), 3)[whole]
    if third.size < 4:
        third = np.diff(values[seen], 3)
    if third.size < 4:
        raise RecordingError("too few samples to see the noise", mend="give at least 7")
    steps = np.abs(np.diff(values[seen]))
    step = steps[steps > 1e-9 * np.max(np.abs(values[seen]), initial=0.0)].min(initial=np.inf)
    size = np.abs(third)
    spread = 1.4826 * float(np.median(size))
    for _ in range(4):
        coarse = np.isfinite(step) and _CLIP * spread < 8.0 * step  # 8: one step's largest third difference
        kept = size[size <= (8.0 * step * (1 + 1e-6) if coarse else _CLIP * spread)]
        if kept.size == 0:
            return 0.0
        spread = math.sqrt(float(np.mean(kept**2))) / (1.0 if coarse else _CLIPPED_STD)
        if coarse:
            break
    return spread / _THIRD


def estimate_noises(recording: Recording) -> np.ndarray:
    """``estimate_noise`` of each output (y,), SI; windows across gaps of the clock are skipped."""
    step = np.diff(recording.time)
    even = np.append(True, np.abs(step - recording.period) <= 0.05 * recording.period)
    values = []
    for i in range(recording.outputs.shape[1]):
        signal, seen = recording.outputs[:, i], recording.weights[:, i] > 0
        breaks = np.flatnonzero(~even)
        values.append(estimate_noise(np.insert(signal, breaks, np.nan), np.insert(seen, breaks, False)))
    return np.array(values)


def _resample_inputs(recording: Recording, grid: np.ndarray, period: float) -> np.ndarray:
    if recording.hold == "zero_order":
        last = np.searchsorted(recording.time, grid + 1e-3 * period, side="right") - 1
        return recording.inputs[np.clip(last, 0, recording.n - 1)]
    return np.stack([np.interp(grid, recording.time, column) for column in recording.inputs.T], axis=1)


def _running_median(values: np.ndarray, window: int) -> np.ndarray:
    padded = np.pad(values, window // 2, mode="reflect")
    return np.median(np.lib.stride_tricks.sliding_window_view(padded, window), axis=1)


def _need_uniform(recording: Recording, what: str) -> None:
    if not recording.is_uniform:
        raise RecordingError(
            f"{what} needs an even sample period",
            where=place(recording.metadata),
            mend=f"resample it first: resample(recording, {recording.period:.4g})",
        )
