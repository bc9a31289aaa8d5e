"""References of thesis 4.4.3 for a loop, and minimum jerk; the shapes are those of `scpjax.recordings.excitation`.

Every signal holds both ends: 60 s every 0.02 s are 3001 samples. The amplitude (25 degrees), 0.05 Hz for sine and
square, 0.02 Hz for the sawtooth and a value every 20 s for multilevel, stair and triangle are printed. The text leaves
open, and here is chosen:

- sine, square: 60 s, starting at 0 and high, as the figures with disturbances go on for 60 s.
- sawtooth: rises from -amplitude to +amplitude; its 120 s are not printed.
- stair: from -amplitude to +amplitude in five rises, 120 s. The number of rises is not printed; five fit the table.
- triangle: "triangle-shaped" is read as the "stair (triangle shaped)" of section 4.3.1 and Figure 4.5 (c): the same
  levels up and down again, 220 s. Nothing is left to choose then. `ramps` is a triangle of straight lines.
- multilevel: seven levels, 140 s. The text prints none. They follow from the voltages of this simulation, which the
  author published as tables for his microcontroller (github.com/GabrielSilva96/Dissertation-s-codes, AAA_ANG_TRACK):
  438 pairs, 0.32 s apart. Under those before the end of every 20 s the plant (4.4) would rest within 0.6 degrees of
  the levels here, which are the nearest multiples of five. Table 4.16 had no part in it.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any, Literal, get_args

import numpy as np

from scpjax.control.errors import ControlError
from scpjax.errors import ScpjaxError
from scpjax.recordings import excitation
from scpjax.recordings.excitation import Signal

Name = Literal[
    "sine", "square", "triangle", "sawtooth", "stair", "multilevel", "ramps", "sweep", "step_difference", "minimum_jerk"
]
NAMES: tuple[str, ...] = get_args(Name)
_USUAL = {  # frequency [Hz], duration [s]
    "sine": (0.05, 60.0),
    "square": (0.05, 60.0),
    "triangle": (0.05, 220.0),
    "sawtooth": (0.02, 120.0),
    "stair": (0.05, 120.0),
    "multilevel": (0.05, 140.0),
    "ramps": (0.01, 100.0),
    "sweep": (0.5, 60.0),
    "step_difference": (0.025, 60.0),
    "minimum_jerk": (0.05, 60.0),
}


@dataclass(frozen=True, kw_only=True)
class Reference:
    """A named reference: ``amplitude`` [rad], ``frequency`` [Hz], ``duration`` and ``dt`` [s].

    Frequency and duration are as told above where they are None. For ``stair``, ``triangle``, ``multilevel``
    and ``minimum_jerk`` a level lasts ``1 / frequency``; a ``sweep`` runs from 0 up to the frequency; a
    ``step_difference`` goes up at 0 and down after half a period. With a ``seed`` the levels of ``multilevel`` are
    drawn, of 11 even ones; without they are the thesis's, again and again.
    """

    amplitude: float = math.radians(25.0)
    frequency: float | None = None
    duration: float | None = None
    dt: float = 0.02
    seed: int | None = None

    def make(self, name: str) -> Signal:
        """Time [s] and reference [rad]. **Raises** `ControlError` for an unknown name or impossible numbers."""
        if name not in NAMES:
            raise ControlError(f"no reference {name!r}", mend=f"use one of {', '.join(NAMES)}, or a CSV file")
        usual = _USUAL[name]
        frequency = usual[0] if self.frequency is None else self.frequency
        duration = usual[1] if self.duration is None else self.duration
        for word, value in (("amplitude", self.amplitude), ("frequency", frequency), ("duration", duration)):
            if not (math.isfinite(value) and value > 0):
                raise ControlError(f"{word} {value:g}", mend=f"the {word} must be above 0")
        if not (math.isfinite(self.dt) and 0 < self.dt < duration):
            raise ControlError(f"a sample every {self.dt:g} s for {duration:g} s", mend="take a dt below the duration")
        try:
            return self._make(name, frequency, duration)
        except ScpjaxError as error:
            raise ControlError(error.problem, where=name, mend=error.mend) from error

    def _make(self, name: str, frequency: float, duration: float) -> Signal:
        a, dt = self.amplitude, self.dt
        grid: dict[str, Any] = {"duration_s": duration + dt, "period_s": dt}
        hold = 1 / frequency
        if name == "sine":
            return excitation.sine(**grid, amplitude=a, frequency_hz=frequency)
        if name == "square":
            return excitation.square(**grid, low=-a, high=a, frequency_hz=frequency)
        if name == "ramps":
            return excitation.triangle(**grid, low=-a, high=a, frequency_hz=frequency)
        if name == "sawtooth":
            return excitation.sawtooth(**grid, low=-a, high=a, frequency_hz=frequency)
        if name == "multilevel" and self.seed is not None:
            return excitation.multilevel_random(**grid, low=-a, high=a, hold_s=hold, seed=self.seed, levels=11)
        if name == "sweep":
            return excitation.chirp(**grid, amplitude=a, start_hz=0.0, stop_hz=frequency)
        if name == "step_difference":
            return excitation.step_difference(**grid, amplitude=a, up_s=0.0, down_s=hold / 2)
        time = dt * np.arange(math.ceil((duration + dt) / dt - 1e-6))
        levels = _LEVELS.get(name)
        if levels is not None:
            index = np.minimum((time / hold + 1e-9).astype(int), math.ceil(duration / hold - 1e-6) - 1)
            return time, a * np.asarray(levels)[index % len(levels)]
        return time, minimum_jerk(time, amplitude=a, hold=hold)


_UP = (-1.0, -0.6, -0.2, 0.2, 0.6, 1.0)
_LEVELS = {  # shares of the amplitude
    "stair": _UP,
    "triangle": _UP + _UP[-2:0:-1],
    "multilevel": (0.6, -0.4, -1.0, 0.2, 1.0, 0.4, -0.6),
}


def minimum_jerk(time: np.ndarray, *, amplitude: float, hold: float) -> np.ndarray:
    """From 0 to ``amplitude``, to ``-amplitude`` and back to and fro, each way in ``hold`` [s] with least jerk: (n,).

    ``x(s) = 10 s^3 - 15 s^4 + 6 s^5`` over each way (Flash, Hogan, J. Neurosci. 5 (1985) 1688, equation (3)).
    """
    leg = (time / hold + 1e-9).astype(int)
    s = np.clip(time / hold - leg, 0.0, 1.0)
    share = s**3 * (10 - 15 * s + 6 * s**2)
    ends = amplitude * np.where(np.arange(leg[-1] + 2) % 2 == 1, 1.0, -1.0)
    ends[0] = 0.0
    return ends[leg] + (ends[leg + 1] - ends[leg]) * share


def sections(name: str, *, frequency: float | None = None) -> float:
    """Length [s] of the stretches that are compared with each other: half a period, or one level."""
    f = _USUAL[name][0] if frequency is None else frequency
    return 1 / f if name in (*_LEVELS, "sawtooth", "minimum_jerk") else 0.5 / f
