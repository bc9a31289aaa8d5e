"""What is done on a bench: rest, record an excitation, calibrate, characterise (thesis 4.1-4.3)."""

from __future__ import annotations

import math
import os
from collections import deque
from collections.abc import Callable
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

from scpjax.bench.errors import BenchError
from scpjax.bench.messages import Calibration, Sample
from scpjax.bench.play import Watch, play, profile
from scpjax.bench.rig import Rig
from scpjax.bench.weights import Hung, Stiffness, check_weights, stand, stiffness
from scpjax.bench.wiring import Wiring
from scpjax.recordings import excitation
from scpjax.recordings.excitation import Signal
from scpjax.recordings.files import read_recording
from scpjax.recordings.recording import Recording

EXCITATIONS = ("step", "step_difference", "stair", "multilevel", "prbs", "triangle", "rest")
_STILL_COUNTS = 2.0  # of a sum of four conversions, from one half of that time to the other
_STILL_S = 10.0


@dataclass(frozen=True, kw_only=True)
class Excite:
    """An excitation: volts (root mean square) from ``low`` to ``high``, a value each ``period`` [s], levels that hold
    ``hold`` [s] (a tenth of the duration when None) and begin after ``lead`` [s] of rest."""

    duration: float = 120.0
    period: float = 0.1
    low: float = 0.0
    high: float = 3.0
    hold: float | None = None
    lead: float = 2.0
    seed: int = 0

    def make(self, name: str, sides: int = 1) -> tuple[np.ndarray, np.ndarray]:
        """Times [s] (n,) and volts (n, sides); of two sides the second is driven opposite to the first.

        **Raises** `BenchError` for an unknown name, and as `scpjax.recordings.excitation` does.
        """
        if name not in EXCITATIONS:
            raise BenchError(f"no excitation {name!r}", mend=f"use one of {', '.join(EXCITATIONS)}, or play a CSV file")
        if not (math.isfinite(self.duration) and self.duration > self.lead >= 0):
            raise BenchError(f"{self.duration:g} s is no duration", mend="give seconds, more than the rest before it")
        time, volts = self._signal(name)
        n = round(self.lead / self.period)
        volts = np.concatenate([np.zeros(n), volts])
        time = self.period * np.arange(len(volts))
        if sides == 1:
            return time, volts[:, None]
        other = np.where(np.arange(len(volts)) < n, 0.0, self.high + self.low - volts)
        return time, np.stack([volts, other if name != "rest" else volts], axis=1)

    def _signal(self, name: str) -> Signal:
        at: dict[str, Any] = {"duration_s": self.duration - self.lead, "period_s": self.period}
        whole = self.duration - self.lead
        ends: dict[str, Any] = {"low": self.low, "high": self.high}
        hold = whole / 10 if self.hold is None else self.hold
        if name == "step":
            return excitation.step(**at, amplitude=self.high - self.low, offset=self.low)
        if name == "step_difference":
            return excitation.step_difference(
                **at, amplitude=self.high - self.low, offset=self.low, up_s=0.0, down_s=0.5 * whole
            )
        if name == "stair":
            return excitation.stair(**at, **ends)
        if name == "multilevel":
            return excitation.multilevel_random(**at, **ends, hold_s=hold, seed=self.seed)
        if name == "prbs":
            return excitation.prbs(**at, **ends, hold_s=hold, seed=self.seed)
        if name == "triangle":
            return excitation.triangle(**at, **ends, frequency_hz=1 / whole)
        time = self.period * np.arange(max(2, round(whole / self.period)))
        return time, np.zeros(len(time))


def rest(rig: Rig, *, most: float = 600.0, watch: Watch | None = None) -> float:
    """Power off until nothing has changed for 10 s; the time it took [s], ``most`` at the most."""
    rig.stop()
    began, seen = rig.device.now(), deque[tuple[float, Sample]]()
    for time, sample in rig.samples(most):
        seen.append((time, sample))
        if watch is not None:
            watch(rig.device.now() - began)
        if time - seen[0][0] < _STILL_S:
            continue
        seen.popleft()
        items = list(seen)
        half = len(items) // 2
        if half and np.max(np.abs(_mean_of(rig, items[:half]) - _mean_of(rig, items[half:]))) < _STILL_COUNTS:
            break
    return rig.device.now() - began


def _mean_of(rig: Rig, items: list[tuple[float, Sample]]) -> np.ndarray:
    return np.mean([(*s.thermistors, rig.wiring.counted(s)) for _, s in items], axis=0)


def record_profile(
    rig: Rig,
    path: str | os.PathLike[str],
    time: np.ndarray,
    volts: np.ndarray,
    *,
    title: str = "",
    tail: float = 0.0,
    watch: Watch | None = None,
) -> Recording:
    """Record while the board plays volts (n, sides), and ``tail`` [s] after; the recording as it is read back.

    When a limit cuts the power what came until then stays on disk. **Raises** as `Rig` does.
    """
    wanted = profile(rig, np.asarray(time, float), volts)
    try:
        play(rig, wanted, watch=watch, begin=lambda: rig.record(path, title=title))
        if tail > 0:
            rig.wait(tail)
    finally:
        rig.end_recording()
    return read_recording(path)


# -- calibration -----------------------------------------------------------------------------------------------------


@dataclass(frozen=True)
class Calibrated:
    """A wiring with what was measured, and words on each."""

    wiring: Wiring
    says: tuple[str, ...]


def calibrate(rig: Rig, *, pulse: float = 1.5, resistance: bool = True) -> Calibrated:
    """Zero of the position, thermistors that are there, ambient, wire resistance, noise and dead time.

    With the power off; then, for the dead time, ``pulse`` volts for 2 s on each side (none where it is 0).
    """
    found: Calibration = rig.calibrate()
    rig.wait(0.5)
    assert rig.last is not None
    w, says, n = rig.wiring, [], found.TICKS
    fitted = rig.last.fitted
    there = all(fitted >> i & 1 for i in range(w.sides))
    w = replace(w, thermistors=replace(w.thermistors, fitted=there))
    says.append("thermistors: fitted" if there else "thermistors: none that reads; the board relies on its model")
    if there:
        ambient = float(np.mean([w.thermistors.temperature(t / n) for t in found.totals[: w.sides]]))
        w = replace(w, ambient_K=round(ambient, 3))
        says.append(f"ambient: {ambient - 273.15:.2f} degC")
    if w.position.source != "none":
        zero = found.totals[2] / n
        if w.position.source == "encoder":  # the board adds up counts without their sign
            near = w.counted(rig.last)
            zero = near + ((found.totals[2] - n * near + 0x8000) % 0x10000 - 0x8000) / n
        w = replace(w, position=replace(w.position, zero=round(zero, 3)))
        says.append(f"position: zero at {zero:.1f} counts")
    if resistance and w.sensing.fitted:
        ohms = [float(np.median([rig.resistance(i) for _ in range(9)])) for i in range(w.sides)]
        if all(0.05 < r < 0.98 * w.sensing.resistance(4092) for r in ohms):
            w = with_known(w, resistance_ohm=round(float(np.mean(ohms)), 4))
            says.append(f"wire resistance: {', '.join(f'{r:.3f}' for r in ohms)} ohm")
        else:
            w = replace(w, sensing=replace(w.sensing, fitted=False))
            says.append("wire resistance: no sensing circuit answers")
    rig.wiring = w
    if pulse > 0:
        says.append(_dead_time(rig, pulse))
    return Calibrated(w, tuple(says))


def _dead_time(rig: Rig, volts: float) -> str:
    """Time from the command to the first sample that shows it at the pins, and to the first that shows it warm."""
    every = rig.options.every
    rig.stream(1)
    sent = rig.device.now()
    rig.set_voltage(*([volts] * rig.wiring.sides))
    pins: float | None = None
    warm: list[tuple[float, float]] = []
    for _, sample in rig.samples(2.0):
        now = rig.device.now() - sent
        if pins is None and sample.pwm[0] > 0:
            pins = now
        warm.append((now, float(sample.thermistors[0])))
    rig.stop()
    rig.stream(every)
    values = np.array([v for _, v in warm])
    quiet = values[: max(8, len(values) // 20)]
    up = np.flatnonzero(values > quiet.mean() + 6 * max(quiet.std(), 0.5))
    felt = f", felt by the thermistor after {1e3 * warm[int(up[0])][0]:.0f} ms" if up.size else ""
    return f"dead time: {1e3 * (pins or 0.0):.0f} ms from command to pins{felt}"


# -- characterisation ------------------------------------------------------------------------------------------------


@dataclass(frozen=True, kw_only=True)
class Characterise:
    """The experiments that lead to a model: steps to levels and a stair (thesis 4.1.2, 4.2.1), then a multilevel signal
    (3.3.3), each from rest; ``duration`` [s] of each, ``levels`` [V].

    With ``weights`` [kg] these hang one after another: under each it is read where the actuator stands, cold, and how
    far a step to the top level lifts it (Figure 4.8, Table 4.5); the other experiments are made under the last.
    """

    duration: float = 60.0
    levels: tuple[float, ...] = (2.0, 3.0)
    period: float = 0.1
    seed: int = 0
    weights: tuple[float, ...] = ()


@dataclass(frozen=True)
class Characterised:
    """``recordings`` to fit; of a series of weights also what it says, and ``steps`` under the weights before the last,
    which no fit has seen."""

    recordings: list[Recording]
    series: tuple[Hung, ...] = ()
    stiffness: Stiffness | None = None
    steps: tuple[Recording, ...] = ()


def characterise(
    rig: Rig,
    folder: Path,
    options: Characterise,
    *,
    hang: Callable[[float], None] | None = None,
    tell: Callable[[str, float], None] | None = None,
) -> Characterised:
    """Record steps, a stair and levels into a folder: under the weight that hangs there (`Wiring.known`), or under a
    series of weights, each of which ``hang`` puts on before it returns.

    Of a series the rig's wiring keeps the last weight, the stiffness and the zero there as its own.

    **Raises** `BenchError` for a series that gives no stiffness, and as `Rig` does.
    """
    base = Excite(duration=options.duration, period=options.period, seed=options.seed)
    top = max(options.levels)
    last = [(f"step_{v:g}V", "step_difference", replace(base, high=v)) for v in options.levels]
    twice = replace(base, high=top, duration=2 * options.duration)
    last += [("stair", "stair", twice), ("multilevel", "multilevel", twice)]
    runs = max(len(options.weights) - 1, 0) + len(last)

    def run(i: int, path: Path, kind: str, excite: Excite) -> Recording:
        if tell is not None:
            tell(path.stem, i / runs)
        time, volts = excite.make(kind, rig.wiring.sides)
        return record_profile(rig, path, time, volts, title=f"{kind} to {excite.high:g} V")

    series, steps, found = list[Hung](), list[Recording](), None
    if options.weights:
        check_weights(options.weights)
        if rig.wiring.sides != 1 or hang is None:
            raise BenchError("a series of weights hangs on one actuator", where="--weights", mend="use --actuators 1")
        law = rig.wiring.position
        for i, mass in enumerate(options.weights):
            hang(mass)
            if tell is not None:
                tell(f"{mass:g} kg: resting", i / runs)
            rest(rig)
            rig.wiring = with_known(replace(rig.wiring, position=law), moving_mass_kg=mass)
            path = folder.parent / "weights" / f"{i}_{mass:g}kg"
            seen = stand(rig, path.with_name(f"{path.name}_standing.csv"))
            series.append(Hung(mass, seen.m, seen.error))
            rig.wiring = replace(rig.wiring, position=replace(law, zero=round(seen.counts, 3)))
            if i < len(options.weights) - 1:
                path = path.with_name(f"{path.name}_step_{top:g}V.csv")
                steps.append(run(i, path, "step_difference", replace(base, high=top)))
                series[-1] = replace(series[-1], lift=_lift(steps[-1]), volts=top)
        found = stiffness(series)
        rig.wiring = with_known(rig.wiring, stiffness_N_per_m=float(f"{found.value:.5g}"))
    out = []
    for i, (name, kind, excite) in enumerate(last):
        if tell is not None:
            tell(f"{name}: resting", (len(steps) + i) / runs)
        rest(rig)
        out.append(run(len(steps) + i, folder / f"{i}_{name}.csv", kind, excite))
    if series:
        at = options.levels.index(top)
        series[-1] = replace(series[-1], lift=_lift(out[at]), volts=top)
    return Characterised(out, tuple(series), found, tuple(steps))


def with_known(wiring: Wiring, **values: float) -> Wiring:
    """The wiring with more that is known of the actuator."""
    return replace(wiring, known=tuple({**dict(wiring.known), **values}.items()))


def _lift(recording: Recording) -> float:
    """Highest displacement [m] above the start, over the noise: means of five samples."""
    moved = recording.output("displacement")
    smooth = np.convolve(moved, np.ones(5) / 5, mode="valid")
    return float(np.max(smooth) - np.mean(moved[:10]))
