"""How good the stream was: frames lost, damaged or out of order, the board's clock against ours, jitter."""

from __future__ import annotations

import math
from dataclasses import dataclass, field
from typing import Any

from scpjax.bench.messages import Sample

_WRAP = 1 << 32
_JUMP_S = 0.5


@dataclass
class Clock:
    """The board's microseconds as seconds that go on: over the wrap after 71 minutes, and over jumps, which it counts.

    A stamp has jumped when it goes back, or on by more than the frames since the last account for and half a second.
    """

    jumps: int = 0
    _last: int | None = None
    _us: int = 0

    def restart(self, gap_s: float) -> None:
        """The next stamp is of another beginning, ``gap_s`` after the last."""
        self._last = None
        self._us += round(1e6 * gap_s)

    def seconds(self, stamp: int, frames: int, period_s: float) -> float:
        """Time of a stamp that came ``frames`` after the last, at ``period_s`` for each at the most."""
        if self._last is not None:
            passed = (stamp - self._last) % _WRAP
            if passed == 0 or passed > 1e6 * (frames * period_s + _JUMP_S):
                self.jumps += 1
                passed = round(1e6 * period_s)
            self._us += passed
        self._last = stamp
        return 1e-6 * self._us


@dataclass
class _Moments:
    """Count, mean and variance of a stream of numbers (Welford), and the largest."""

    n: int = 0
    mean: float = 0.0
    m2: float = 0.0
    most: float = 0.0

    def add(self, x: float) -> None:
        self.n += 1
        off = x - self.mean
        self.mean += off / self.n
        self.m2 += off * (x - self.mean)
        self.most = max(self.most, abs(x))

    @property
    def std(self) -> float:
        return math.sqrt(self.m2 / self.n) if self.n else 0.0


@dataclass
class Quality:
    """Counts over a stream.

    - ``frames`` good ones, ``samples`` among them; ``lost`` by gaps of the sequence numbers, ``damaged`` by CRC or
      grammar, ``stale`` those whose number was not after the last.
    - ``drift_ppm``: rate of the board's clock against ours, by least squares over the arrivals.
    - ``stamp_jitter_s``: standard deviation of the time between samples on the board; ``arrival_jitter_s`` that of the
      arrivals about the straight line.
    """

    frames: int = 0
    samples: int = 0
    lost: int = 0
    damaged: int = 0
    stray: int = 0
    stale: int = 0
    unread: int = 0
    clock: Clock = field(default_factory=Clock)
    _sequence: int | None = None
    _step: _Moments = field(default_factory=_Moments)
    _time: float | None = None
    _fit: list[float] = field(default_factory=lambda: [0.0] * 5)  # n, mean t, mean a, S_tt, S_ta
    _late: _Moments = field(default_factory=_Moments)
    _frames_since: int = 0

    def number(self, sequence: int) -> bool:
        """Take a frame's sequence number; False where it is old and the frame is to be dropped."""
        if self._sequence is not None:
            ahead = (sequence - self._sequence) & 0xFFFF
            if ahead == 0 or ahead >= 0x8000:
                self.stale += 1
                return False
            self.lost += ahead - 1
            self._frames_since += ahead
        self._sequence = sequence
        self.frames += 1
        return True

    def restart(self, gap_s: float = 0.0) -> None:
        """Numbers and clock of the board begin anew, ``gap_s`` after the last sample."""
        self._sequence = None
        self.clock.restart(gap_s)
        self._time = None

    def time_of(self, sample: Sample, arrival: float, period_s: float) -> float:
        """Seconds of a sample on the board's clock, from the first on."""
        t = self.clock.seconds(sample.stamp, max(self._frames_since, 1), period_s)
        if self._time is not None and self._frames_since == 1:
            self._step.add(t - self._time - period_s)
        self._frames_since = 0
        self._time = t
        self.samples += 1
        self._line(t, arrival)
        return t

    def _line(self, t: float, a: float) -> None:
        f = self._fit
        f[0] += 1
        dt, da = t - f[1], a - f[2]
        f[1] += dt / f[0]
        f[2] += da / f[0]
        f[3] += dt * (t - f[1])
        f[4] += dt * (a - f[2])
        if f[0] > 20 and f[3] > 0:
            self._late.add(a - f[2] - f[4] / f[3] * (t - f[1]))

    @property
    def drift_ppm(self) -> float:
        """Parts per million by which the board's clock is fast."""
        s_tt, s_ta = self._fit[3], self._fit[4]
        return 1e6 * (s_tt / s_ta - 1) if s_ta > 0 else math.nan

    @property
    def stamp_jitter_s(self) -> float:
        return self._step.std

    @property
    def arrival_jitter_s(self) -> float:
        return self._late.std

    def to_json(self) -> dict[str, Any]:
        """Plain values."""
        return {
            "frames": self.frames,
            "samples": self.samples,
            "lost": self.lost,
            "damaged": self.damaged,
            "stray_bytes": self.stray,
            "stale": self.stale,
            "unread": self.unread,
            "clock_jumps": self.clock.jumps,
            "drift_ppm": None if math.isnan(self.drift_ppm) else round(self.drift_ppm, 1),
            "stamp_jitter_us": round(1e6 * self.stamp_jitter_s, 1),
            "stamp_jitter_most_us": round(1e6 * self._step.most, 1),
            "arrival_jitter_ms": round(1e3 * self.arrival_jitter_s, 3),
            "arrival_jitter_most_ms": round(1e3 * self._late.most, 3),
        }
