"""What is recorded on a bench: excitations, profiles, remarks, calibration."""

import json
import os
import threading
from dataclasses import replace

import boards
import numpy as np
import pytest

from scpjax.bench.cable import Cable
from scpjax.bench.device import EmulatedDevice, PortDevice
from scpjax.bench.errors import BenchError
from scpjax.bench.messages import Sample
from scpjax.bench.parameters import BoardConfig
from scpjax.bench.play import Profile, play, profile
from scpjax.bench.quality import Quality
from scpjax.bench.rig import Rig, RigOptions
from scpjax.bench.sessions import EXCITATIONS, Excite, calibrate, record_profile, rest
from scpjax.bench.simulated import muscle, simulated
from scpjax.bench.world import Noise, Still
from scpjax.recordings.files import read_recording
from scpjax.simulate.simulate import simulate

QUIET = Noise(volts=0.0)


def emulated(made, **options):
    return EmulatedDevice(made.world, config=made.config, **options)


@pytest.mark.parametrize("name", EXCITATIONS)
def test_excitations_stay_within_their_ends(name):
    time, volts = Excite(duration=30.0, high=2.5, low=0.5, seed=3).make(name, 2)
    assert time[1] == 0.1
    assert volts.shape == (len(time), 2)
    assert volts.min() >= 0
    assert volts.max() <= 2.5
    assert np.all(volts[:20] == 0)


def test_what_is_recorded_is_what_the_model_says(board, tmp_path):
    made = simulated("muscle", noise=QUIET)
    device = board(made.world, config=made.config)
    excite = Excite(duration=40.0, high=3.0, hold=8.0)
    with Rig(device, made.wiring, options=RigOptions(every=20)) as rig:
        time, volts = excite.make("multilevel")
        recording = record_profile(rig, tmp_path / "a.csv", time, volts, title="levels")
    assert recording.metadata.title == "levels"
    assert dict(recording.metadata.known) == dict(made.wiring.known)
    assert recording.metadata.ambient_K == pytest.approx(295.15)
    assert recording.hold == "zero_order"
    given = recording.input("voltage")[: len(volts)]
    np.testing.assert_allclose(given, volts[:, 0], atol=0.13)  # one count of the PWM is 0.23 V at the bottom
    said = np.asarray(simulate(muscle(), recording).outputs)
    moved = recording.output("displacement")
    assert np.ptp(moved) > 2e-3
    np.testing.assert_allclose(recording.output("temperature"), said[:, 0], atol=0.9)  # one step of 10 bits when cold
    np.testing.assert_allclose(moved, said[:, 1], atol=1.5 * 15e-3 * np.deg2rad(270) / 1024)
    quality = json.loads((tmp_path / "a.quality.json").read_text())
    assert quality["lost"] == quality["damaged"] == 0
    assert (tmp_path / "a.raw").read_bytes().count(b"$D") >= recording.n


def test_markers_come_from_any_thread(tmp_path):
    with Rig(EmulatedDevice(), options=RigOptions(every=1)) as rig:
        rig.record(tmp_path / "a.csv")
        rig.wait(1.0)
        thread = threading.Thread(target=rig.mark, args=('weight "on", 80 g',))
        thread.start()
        thread.join()
        rig.wait(0.5)
        rig.mark("off")
    rows = (tmp_path / "a.markers.csv").read_text().splitlines()
    assert rows[0] == "time_s,marker"
    assert rows[1].endswith('"weight ""on"", 80 g"')
    assert float(rows[1].split(",")[0]) == pytest.approx(1.0, abs=0.02)
    assert float(rows[2].split(",")[0]) == pytest.approx(1.5, abs=0.02)


def test_who_reads_late_loses_nothing_of_the_recording(tmp_path):
    with Rig(EmulatedDevice(), options=RigOptions(every=1, keep=16)) as rig:
        rig.record(tmp_path / "a.csv")
        rig.wait(2.0)
        assert len(rig.unread()) == 16
        assert rig.quality.unread > 350
    assert read_recording(tmp_path / "a.csv").n > 390


def test_a_joint_has_the_columns_of_a_joint(tmp_path):
    made = simulated("aaa")
    with Rig(emulated(made), made.wiring) as rig:
        time, volts = Excite(duration=5.0, lead=1.0).make("step", 2)
        recording = record_profile(rig, tmp_path / "a.csv", time, volts)
    assert [c.column for c in recording.input_channels] == ["voltage_agonist_V", "voltage_antagonist_V"]
    assert [c.stem for c in recording.output_channels] == ["temperature_agonist", "temperature_antagonist", "angle"]
    assert recording.metadata.model == "aaa"
    assert recording.metadata.pulley_radius_m == 0.015


@pytest.mark.parametrize(
    ("time", "volts", "words"),
    [
        ([0, 1, 2], [0, 9, 0], "9 V with a supply of 3.7 V"),
        ([0, 1, 2], [0, -1, 0], "stay within 0"),
        ([0, 2, 1], [0, 1, 0], "do not grow"),
        ([0, 1], [[0, 1], [1, 0]], "2 drives for a bench with 1"),
        (np.arange(70_000) * 0.02, np.zeros(70_000), "more than the board can count"),
    ],
)
def test_profiles_that_the_bench_cannot_play(time, volts, words):
    with Rig(EmulatedDevice()) as rig, pytest.raises(BenchError, match=words):
        profile(rig, np.asarray(time, float), np.asarray(volts, float))


def test_uneven_times_are_put_on_a_grid():
    with Rig(EmulatedDevice()) as rig:
        found = profile(rig, np.array([0.0, 0.13, 1.0, 1.5]), np.array([0.0, 3.7, 0.0, 3.7])[:, None])
    assert found.ticks == 4
    on = np.flatnonzero(found.counts[:, 0] == 255) * 0.02
    assert on[0] == pytest.approx(0.14, abs=0.011)
    assert np.all((found.counts[:, 0] == 0) | (found.counts[:, 0] == 255))


def test_a_table_whose_end_is_lost_on_the_line_ends():
    class Deaf(EmulatedDevice):
        def _tick(self):
            return b"".join(line for line in super()._tick().splitlines(keepends=True) if not line.startswith(b"$E"))

    with Rig(Deaf()) as rig:
        began = rig.device.now()
        play(rig, Profile(np.full((100, 1), 50), 4))
        assert 2.4 < rig.device.now() - began < 3.5
        assert rig.events == []


def test_rest_waits_until_nothing_changes():
    made = simulated("muscle")
    with Rig(emulated(made), made.wiring, options=RigOptions(every=20)) as rig:
        rig.set_voltage(3.0)
        rig.wait(10.0)
        hot = float(made.world.temperature[0])
        took = rest(rig)
    assert hot > 330
    assert 20 < took < 120
    assert float(made.world.temperature[0]) - 295.15 < 2.5


def test_calibration_finds_what_is_there(board):
    made = simulated("muscle", noise=Noise(volts=2e-3))
    wrong = replace(made.wiring, position=replace(made.wiring.position, zero=0.0), ambient_K=None, known=())
    with Rig(board(made.world, config=made.config), wrong) as rig:
        found = calibrate(rig)
    assert found.wiring.position.zero == pytest.approx(made.wiring.position.zero, abs=3.0)
    assert found.wiring.ambient_K == pytest.approx(295.15, abs=0.3)
    assert dict(found.wiring.known)["resistance_ohm"] == pytest.approx(1.07, abs=0.01)
    assert any("ms from command to pins" in s for s in found.says)


def test_calibration_without_sensors_says_so():
    with Rig(EmulatedDevice(Still((0, 0, 2.5, 0, 0, 0)))) as rig:
        found = calibrate(rig, pulse=0.0)
    assert not found.wiring.thermistors.fitted
    assert not found.wiring.sensing.fitted
    assert "known" not in found.wiring.known

    assert all(not t.name.startswith("scpjax") for t in threading.enumerate())


def test_drift_and_jitter_are_those_put_in():
    rng = np.random.default_rng(0)
    quality = Quality()
    true_jitter = 40e-6
    for k in range(4000):
        stamp = round(5000 * k + rng.normal(0, 1e6 * true_jitter / np.sqrt(2)))
        sample = Sample(k & 0xFFFF, stamp, (0, 0), 0, 0, 0, (0, 0), 0, 0)
        assert quality.number(sample.sequence)
        quality.time_of(sample, 0.005 * k * (1 - 100e-6) + 3e-3 * rng.random(), 0.005)
    assert quality.drift_ppm == pytest.approx(100, abs=15)
    assert quality.stamp_jitter_s == pytest.approx(true_jitter, rel=0.1)
    assert quality.arrival_jitter_s == pytest.approx(3e-3 / np.sqrt(12), rel=0.1)


@pytest.mark.skipif(not hasattr(os, "openpty"), reason="skipped: no pseudo-terminals here")
def test_the_rig_works_over_a_port(tmp_path):
    made = simulated("muscle")
    cable = Cable(boards.make("emulator", made.world, config=BoardConfig()))
    with Rig(PortDevice(cable.port), made.wiring) as rig:
        time, volts = Excite(duration=2.0, lead=0.5).make("step")
        recording = record_profile(rig, tmp_path / "a.csv", time, volts)
    cable.pull()
    assert recording.n > 30
    assert recording.is_uniform
