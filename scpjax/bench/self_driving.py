"""A bench that asks its own questions: record, diagnose, choose an experiment, play it, until one answer is left."""

from __future__ import annotations

import dataclasses
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from scpjax.bench.errors import BoardFault
from scpjax.bench.rig import Rig
from scpjax.bench.sessions import Excite, record_profile, rest
from scpjax.bench.wiring import Wiring
from scpjax.diagnose.diagnose import DiagnoseOptions, diagnose
from scpjax.diagnose.profiles import Limits
from scpjax.diagnose.proposal import NextExperiment
from scpjax.diagnose.result import Diagnosis
from scpjax.errors import FitError
from scpjax.recordings.files import read_recording
from scpjax.recordings.recording import Recording
from scpjax.report.report import write_diagnosis

Tell = Callable[[str, float], None]
_SPARE_K = 5.0  # that a hypothesis stays below the board's own cut-out


@dataclass(frozen=True, kw_only=True)
class SelfDriving:
    """``most`` experiments of its own choice, each within the limits: ``high`` [V], ``hottest`` [K] of any heated part,
    ``duration`` and ``period`` [s]."""

    most: int = 3
    high: float = 3.7
    hottest: float = 383.15
    duration: float = 120.0
    period: float = 0.1

    def limits(self) -> Limits:
        """As the design of an experiment takes them."""
        return Limits(lowest=0.0, highest=self.high, hottest=self.hottest, duration=self.duration, period=self.period)


@dataclass(frozen=True)
class Driven:
    """``diagnoses`` after each round; ``played`` experiments of its own choice; ``why`` it stopped, in words."""

    diagnoses: tuple[Diagnosis, ...]
    recordings: tuple[Recording, ...]
    played: int
    why: str

    @property
    def last(self) -> Diagnosis:
        return self.diagnoses[-1]

    @property
    def names(self) -> tuple[str, ...]:
        """Mechanisms named at the end."""
        return tuple(m.name for m in self.last.mechanisms)


def until_explained(
    rig: Rig,
    folder: Path,
    options: SelfDriving,
    *,
    recordings: Sequence[Recording] = (),
    model: str | None = None,
    agree: Callable[[NextExperiment], bool] | None = None,
    tell: Tell | None = None,
    command: str = "",
) -> Driven:
    """Diagnose what was recorded and play the experiment that best separates what is left close, again and again.

    Begins with a multilevel signal where there are no recordings yet. Stops when one hypothesis is left, when no
    experiment within the limits tells the rest apart, after ``most`` experiments, or when ``agree`` says no to one.
    Everything is in the folder: ``N_*.csv``, and the last diagnosis with its report.

    **Raises** as `Rig` and `diagnose` do; an experiment that the board cut off is used as far as it came.
    """
    tell = tell or (lambda text, fraction: None)
    folder.mkdir(parents=True, exist_ok=True)
    have = list(recordings)
    if not have:
        tell("first recording", 0.0)
        excite = Excite(duration=options.duration, period=options.period, high=_within(rig.wiring, options))
        time, volts = excite.make("multilevel", rig.wiring.sides)
        have.append(_recorded(rig, folder / "0_multilevel.csv", time, volts, "multilevel"))
    found: list[Diagnosis] = []
    played = 0
    while True:
        share = played / (options.most + 1)
        tell(f"diagnosing {len(have)} recordings", share)
        d = _diagnosed(have, model, options)
        found.append(d)
        write_diagnosis(d, folder, recordings=have, command=command)
        e = d.next_experiment
        if e is None:
            return Driven(tuple(found), tuple(have), played, _settled(d))
        if played == options.most:
            why = f"{played} experiments were played; {' and '.join(e.separates[:2])} are still close"
            return Driven(tuple(found), tuple(have), played, why)
        if agree is not None and not agree(e):
            return Driven(tuple(found), tuple(have), played, "the next experiment was declined")
        played += 1
        tell(f"experiment {played}: {' or '.join(e.separates[:2])}", share)
        file = folder / f"{played}_{'_or_'.join(n.split()[0] for n in e.separates[:2])}.csv"
        have.append(_recorded(rig, file, e.time, e.drive, e.says))


def _settled(d: Diagnosis) -> str:
    if d.verdict == "adequate":
        return "the model is adequate: nothing is missing at this noise"
    names = " + ".join(m.name for m in d.mechanisms)
    if d.verdict == "explained":
        return f"one hypothesis is left: {names}"
    return f"no experiment within the limits separates what is left ({names or 'nothing named'})"


def _within(wiring: Wiring, options: SelfDriving) -> float:
    return min(options.high, wiring.supply_V)


def _recorded(rig: Rig, path: Path, time: np.ndarray, volts: np.ndarray, title: str) -> Recording:
    rest(rig)
    try:
        return record_profile(rig, path, time, volts, title=title[:200])
    except BoardFault:
        rest(rig)
        rig.clear_fault()
        return read_recording(path)


def _diagnosed(recordings: Sequence[Recording], model: str | None, options: SelfDriving) -> Diagnosis:
    """With the next experiment; where the limits leave none, without."""
    try:
        return diagnose(recordings, model=model, options=DiagnoseOptions(next=options.limits()))
    except FitError as error:
        d = diagnose(recordings, model=model)
        return dataclasses.replace(d, notes=(*d.notes, f"No next experiment: {error}"))


def hottest_of(rig: Rig) -> float:
    """Temperature [K] that experiments on this board should stay below: its cut-out, less 5 K."""
    return rig.get("max_temperature") + 273.15 - _SPARE_K
