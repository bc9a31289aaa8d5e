"""Excitations: what to drive an actuator with. Every function gives ``time`` (n,) s and ``value`` (n,).

Samples lie at ``0, period_s, 2 period_s, ...`` below ``duration_s``; a value holds until the next sample.
Levels are in volts unless you mean otherwise. The step difference, stair and multilevel random signals are
those with which the thesis identified and validated its models (section 3.3.3, Table 4.13).
"""

from __future__ import annotations

import math
from typing import Literal

import numpy as np

from scpjax.errors import RecordingError

Signal = tuple[np.ndarray, np.ndarray]


def step(*, duration_s: float, period_s: float, amplitude: float, start_s: float = 0.0, offset: float = 0.0) -> Signal:
    """``offset`` until ``start_s``, then ``offset + amplitude``."""
    time = _time(duration_s, period_s)
    return time, offset + amplitude * _from(time, start_s, period_s)


def step_difference(
    *,
    duration_s: float,
    period_s: float,
    amplitude: float,
    up_s: float,
    down_s: float,
    offset: float = 0.0,
) -> Signal:
    """``offset``, then ``offset + amplitude`` from ``up_s`` to ``down_s``, then ``offset`` again."""
    if not 0.0 <= up_s < down_s:
        raise RecordingError(f"up at {up_s:g} s, down at {down_s:g} s", mend="go up before going down")
    time = _time(duration_s, period_s)
    return time, offset + amplitude * (_from(time, up_s, period_s) - _from(time, down_s, period_s))


def stair(*, duration_s: float, period_s: float, low: float, high: float, steps: int = 5, down: bool = True) -> Signal:
    """Even stairs from ``low`` to ``high`` in ``steps`` rises, and with ``down`` back again, in equal
    times.
    """
    _ordered(low, high)
    if steps < 1:
        raise RecordingError(f"{steps} steps", mend="use at least 1")
    levels = np.linspace(low, high, steps + 1)
    levels = np.concatenate([levels, levels[-2::-1]]) if down else levels
    time = _time(duration_s, period_s)
    index = np.minimum((time / duration_s * levels.size + 1e-9).astype(int), levels.size - 1)
    return time, levels[index]


def triangle(*, duration_s: float, period_s: float, low: float, high: float, frequency_hz: float) -> Signal:
    """Triangles that start at ``low``."""
    time, phase = _phase(duration_s, period_s, frequency_hz)
    _ordered(low, high)
    return time, low + (high - low) * (1.0 - np.abs(2.0 * phase - 1.0))


def square(
    *, duration_s: float, period_s: float, low: float, high: float, frequency_hz: float, duty: float = 0.5
) -> Signal:
    """``high`` for the share ``duty`` of each cycle, then ``low``."""
    time, phase = _phase(duration_s, period_s, frequency_hz)
    _ordered(low, high)
    if not 0.0 < duty < 1.0:
        raise RecordingError(f"duty {duty:g}", mend="use a share between 0 and 1")
    return time, np.where(phase < duty, high, low)


def sawtooth(*, duration_s: float, period_s: float, low: float, high: float, frequency_hz: float) -> Signal:
    """Rises from ``low`` to ``high`` and falls at once."""
    time, phase = _phase(duration_s, period_s, frequency_hz)
    _ordered(low, high)
    return time, low + (high - low) * phase


def sine(
    *,
    duration_s: float,
    period_s: float,
    amplitude: float,
    frequency_hz: float,
    offset: float = 0.0,
    phase_rad: float = 0.0,
) -> Signal:
    """``offset + amplitude sin(2 pi f t + phase)``."""
    time, _ = _phase(duration_s, period_s, frequency_hz)
    return time, offset + amplitude * np.sin(2.0 * np.pi * frequency_hz * time + phase_rad)


def multilevel_random(
    *,
    duration_s: float,
    period_s: float,
    low: float,
    high: float,
    hold_s: float,
    seed: int = 0,
    levels: int | None = None,
) -> Signal:
    """A random level for every ``hold_s``: uniform in ``low..high``, or one of ``levels`` even ones."""
    _ordered(low, high)
    time = _time(duration_s, period_s)
    _hold(hold_s, period_s)
    rng = np.random.default_rng(seed)
    index = (time / hold_s + 1e-9).astype(int)
    if levels is None:
        return time, rng.uniform(low, high, index[-1] + 1)[index]
    if levels < 2:
        raise RecordingError(f"{levels} levels", mend="use at least 2")
    return time, np.linspace(low, high, levels)[rng.integers(0, levels, index[-1] + 1)][index]


_TAPS = {3: 2, 4: 3, 5: 3, 6: 5, 7: 6, 9: 5, 10: 7, 11: 9, 15: 14, 17: 14, 18: 11, 20: 17}


def prbs(
    *,
    duration_s: float,
    period_s: float,
    low: float,
    high: float,
    hold_s: float,
    order: int = 9,
    seed: int = 0,
) -> Signal:
    """Pseudo-random binary sequence of length ``2^order - 1``, each bit held ``hold_s``, repeated as needed.

    A shift register with a primitive trinomial (orders 3-7, 9-11, 15, 17, 18, 20); ``seed`` chooses its
    start.
    """
    _ordered(low, high)
    _hold(hold_s, period_s)
    if order not in _TAPS:
        raise RecordingError(f"order {order}", mend=f"use one of {', '.join(map(str, _TAPS))}")
    time = _time(duration_s, period_s)
    index = (time / hold_s + 1e-9).astype(int)
    register = [bool(b) for b in np.random.default_rng(seed).integers(0, 2, order)]
    register[0] = register[0] or not any(register)
    bits = np.empty(min(index[-1] + 1, 2**order - 1), dtype=bool)
    for k in range(bits.size):
        bits[k] = register[-1]
        register = [register[order - 1] ^ register[_TAPS[order] - 1], *register[:-1]]
    return time, np.where(bits[index % bits.size], high, low)


def chirp(
    *,
    duration_s: float,
    period_s: float,
    amplitude: float,
    start_hz: float,
    stop_hz: float,
    offset: float = 0.0,
    sweep: Literal["linear", "logarithmic"] = "linear",
) -> Signal:
    """A sine whose frequency runs from ``start_hz`` to ``stop_hz`` over the duration."""
    _band(start_hz, stop_hz, period_s)
    time = _time(duration_s, period_s)
    if sweep == "linear":
        cycles = start_hz * time + 0.5 * (stop_hz - start_hz) * time**2 / duration_s
    elif sweep == "logarithmic":
        if start_hz <= 0:
            raise RecordingError("a logarithmic sweep cannot start at 0 Hz", mend="start above 0")
        ratio = math.log(stop_hz / start_hz)
        cycles = start_hz * duration_s / ratio * np.expm1(ratio * time / duration_s)
    else:
        raise RecordingError(f"unknown sweep '{sweep}'", mend="use 'linear' or 'logarithmic'")
    return time, offset + amplitude * np.sin(2.0 * np.pi * cycles)


def multisine(
    *,
    duration_s: float,
    period_s: float,
    rms: float,
    low_hz: float,
    high_hz: float,
    offset: float = 0.0,
    phases: Literal["schroeder", "random"] = "schroeder",
    seed: int = 0,
) -> Signal:
    """Every multiple of ``1 / duration`` from ``low_hz`` to ``high_hz`` with equal amplitude, ``rms`` in all.

    Periodic in the duration (of whole samples). Schroeder phases ``-pi k (k - 1) / N`` keep the crest low;
    random ones make many realisations of one spectrum.
    """
    _band(low_hz, high_hz, period_s)
    time = _time(duration_s, period_s)
    n = time.size
    base = 1.0 / (n * period_s)
    lines = np.arange(max(1, math.ceil(low_hz / base - 1e-9)), math.floor(high_hz / base + 1e-9) + 1)
    lines = lines[lines < n / 2]
    if lines.size == 0:
        raise RecordingError("no line lies in the band", mend="take a wider band or a longer duration")
    k = np.arange(1, lines.size + 1)
    if phases == "schroeder":
        angles = -np.pi * k * (k - 1) / lines.size
    elif phases == "random":
        angles = np.random.default_rng(seed).uniform(0.0, 2.0 * np.pi, lines.size)
    else:
        raise RecordingError(f"unknown phases '{phases}'", mend="use 'schroeder' or 'random'")
    spectrum = np.zeros(n // 2 + 1, dtype=complex)
    spectrum[lines] = 0.5 * n * rms * math.sqrt(2.0 / lines.size) * np.exp(1j * angles)
    return time, offset + np.fft.irfft(spectrum, n)


def _time(duration_s: float, period_s: float) -> np.ndarray:
    if not (0.0 < period_s < float("inf") and 0.0 < duration_s < float("inf")):
        raise RecordingError(f"duration {duration_s:g} s, period {period_s:g} s", mend="both must be positive")
    count = math.ceil(duration_s / period_s - 1e-6)
    if count < 2:
        raise RecordingError(f"{count} sample in {duration_s:g} s", mend="take a shorter period")
    return period_s * np.arange(count)


def _from(time: np.ndarray, start_s: float, period_s: float) -> np.ndarray:
    return (time >= start_s - 1e-6 * period_s).astype(float)


def _phase(duration_s: float, period_s: float, frequency_hz: float) -> Signal:
    time = _time(duration_s, period_s)
    _band(frequency_hz, frequency_hz, period_s)
    return time, np.mod(time * frequency_hz + 1e-9, 1.0)


def _band(low_hz: float, high_hz: float, period_s: float) -> None:
    nyquist = 0.5 / period_s if period_s > 0 else 0.0
    for frequency in (low_hz, high_hz):
        if not 0.0 <= frequency <= nyquist or high_hz == 0.0:
            raise RecordingError(
                f"frequency {frequency:g} Hz with a sample period of {period_s:g} s",
                mend=f"stay above 0 and at most {nyquist:g} Hz (Nyquist), or sample faster",
            )


def _hold(hold_s: float, period_s: float) -> None:
    if hold_s < period_s * (1 - 1e-9):
        raise RecordingError(f"hold {hold_s:g} s is shorter than a sample", mend="hold at least one period")


def _ordered(low: float, high: float) -> None:
    if not low < high:
        raise RecordingError(f"low {low:g} is not below high {high:g}", mend="swap them")
