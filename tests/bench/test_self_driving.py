"""The bench that asks its own questions: what it plays, when it stops, and what it never does."""

from dataclasses import dataclass, field

import boards
import numpy as np
import pytest

from scpjax.bench import self_driving as room
from scpjax.bench.device import EmulatedDevice
from scpjax.bench.rig import Rig, RigOptions
from scpjax.bench.self_driving import SelfDriving, hottest_of, until_explained
from scpjax.bench.sessions import Excite, record_profile
from scpjax.bench.simulated import simulated
from scpjax.bench.world import Noise
from scpjax.recordings.files import read_recording


@dataclass
class Experiment:
    """A proposal as the design makes it, as far as it is played."""

    volts: float = 2.0
    separates: tuple[str, ...] = ("creep", "hysteresis (play)")
    says: str = "separates creep from hysteresis"

    @property
    def time(self):
        return 0.1 * np.arange(100)

    @property
    def drive(self):
        return np.full((100, 1), self.volts)


@dataclass
class Answer:
    """A diagnosis as far as it is looked at."""

    next_experiment: Experiment | None
    verdict: str = "explained"
    mechanisms: tuple = ()
    notes: tuple = ()
    seen: list = field(default_factory=list)


def bench(monkeypatch, answers):
    """A rig on a muscle, with these answers in the place of diagnoses."""
    asked = []

    def diagnosed(recordings, model, options):
        asked.append([r.metadata.name for r in recordings])
        return answers[len(asked) - 1]

    monkeypatch.setattr(room, "_diagnosed", diagnosed)
    monkeypatch.setattr(room, "write_diagnosis", lambda *a, **k: None)
    made = simulated("muscle")
    return made, EmulatedDevice(made.world, config=made.config), asked


def test_it_plays_until_one_hypothesis_is_left(monkeypatch, tmp_path):
    made, device, asked = bench(monkeypatch, [Answer(Experiment()), Answer(Experiment()), Answer(None)])
    with Rig(device, made.wiring, options=RigOptions(every=20)) as rig:
        driven = until_explained(rig, tmp_path, SelfDriving(duration=10.0))
    assert driven.played == 2
    assert "one hypothesis is left" in driven.why
    assert asked[-1] == ["0_multilevel", "1_creep_or_hysteresis", "2_creep_or_hysteresis"]
    played = read_recording(tmp_path / "2_creep_or_hysteresis.csv")
    assert np.median(played.input("voltage")) == pytest.approx(2.0, abs=0.02)
    first = played.output("temperature")[0]
    assert first == pytest.approx(295.15, abs=2.5)  # it rested before


def test_it_stops_after_as_many_as_were_allowed(monkeypatch, tmp_path):
    made, device, asked = bench(monkeypatch, [Answer(Experiment())] * 9)
    with Rig(device, made.wiring, options=RigOptions(every=20)) as rig:
        driven = until_explained(rig, tmp_path, SelfDriving(most=2, duration=10.0))
    assert (driven.played, len(asked)) == (2, 3)
    assert "still close" in driven.why


def test_it_plays_nothing_that_was_declined(monkeypatch, tmp_path):
    made, device, _ = bench(monkeypatch, [Answer(Experiment())])
    with Rig(device, made.wiring, options=RigOptions(every=20)) as rig:
        driven = until_explained(rig, tmp_path, SelfDriving(duration=10.0), agree=lambda e: False)
    assert driven.played == 0
    assert "declined" in driven.why
    assert len(list(tmp_path.glob("*.csv"))) == 1


def test_an_experiment_that_the_board_cuts_off_is_used_as_far_as_it_came(monkeypatch, tmp_path):
    made, device, _ = bench(monkeypatch, [Answer(Experiment(volts=3.7)), Answer(None)])
    with Rig(device, made.wiring, options=RigOptions(every=20)) as rig:
        time, volts = Excite(duration=5.0, high=1.0).make("step")
        first = record_profile(rig, tmp_path / "0.csv", time, volts)
        rig.set("max_temperature", 60.0)
        driven = until_explained(rig, tmp_path, SelfDriving(duration=10.0), recordings=[first])
        assert hottest_of(rig) == pytest.approx(273.15 + 55.0)
    assert driven.played == 1
    cut = driven.recordings[-1]
    assert 2.0 < cut.duration < 8.0
    assert made.world.hottest - 273.15 < 60.0


@pytest.mark.skipif(not boards.FULL_SIZE, reason="skipped: minutes long (SCPJAX_BENCH=1)")
def test_creep_is_found_and_the_limit_kept(tmp_path):
    made = simulated("muscle", concealed=["creep:compliance=0.3,time_constant=9"], noise=Noise(volts=3e-3))
    with Rig(EmulatedDevice(made.world, config=made.config), made.wiring, options=RigOptions(every=20)) as rig:
        driven = until_explained(rig, tmp_path, SelfDriving(high=3.5, hottest=hottest_of(rig), duration=90.0))
    assert driven.names == ("creep",)
    assert driven.played <= 3
    assert made.world.hottest - 273.15 <= made.config.max_temperature_C
    assert (tmp_path / "report.html").is_file()
