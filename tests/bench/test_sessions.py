"""What is done on a bench, end to end: the files, the laws of the sensors, loops against pure simulation."""

import json
import os
import threading
import urllib.request
from dataclasses import replace

import boards
import jax
import numpy as np
import pytest

from scpjax.bench import legacy
from scpjax.bench.cable import Cable
from scpjax.bench.device import EmulatedDevice, PortDevice
from scpjax.bench.errors import BenchError
from scpjax.bench.live import Live
from scpjax.bench.messages import Resistance, Sample
from scpjax.bench.parameters import BoardConfig
from scpjax.bench.play import Profile, follow, play, profile, set_gains
from scpjax.bench.quality import Quality
from scpjax.bench.rig import Rig, RigOptions
from scpjax.bench.sessions import EXCITATIONS, Excite, calibrate, record_profile, rest
from scpjax.bench.simulated import muscle, simulated, with_concealed
from scpjax.bench.validate import open_loop
from scpjax.bench.wiring import Position, Sensing, Thermistors, Wiring, load_wiring, save_wiring
from scpjax.bench.world import Muscle, Noise, Still
from scpjax.control.loop import Loop, run
from scpjax.control.pid import PID, thesis_pair
from scpjax.control.reference import Reference
from scpjax.recordings.files import read_recording
from scpjax.simulate.simulate import simulate

QUIET = Noise(volts=0.0)


def emulated(made, **options):
    return EmulatedDevice(made.world, config=made.config, **options)


# -- sensors ---------------------------------------------------------------------------------------------------------


def test_thermistor_law_is_that_of_a_table():
    # 100 kohm, B 3950: resistances worked out by hand with the B equation
    law = Thermistors(fixed_ohm=10e3)
    for celsius, ohms in ((25.0, 100e3), (50.0, 35_896.0), (100.0, 6_972.0)):
        counts = 4096 * 10e3 / (10e3 + ohms) - 2.0
        assert float(law.temperature(counts)) - 273.15 == pytest.approx(celsius, abs=0.05)
        assert float(law.volts(celsius + 273.15)) == pytest.approx(5 * 10e3 / (10e3 + ohms), rel=2e-3)
    assert np.isnan(law.temperature(0))
    assert np.isnan(law.temperature(4092))


def test_resistance_law_is_ohms():
    assert Sensing().resistance(4096 * 3.0 / 5.0 - 2) == pytest.approx(3.0 / 20 / 0.125)
    reading = Resistance(1, 0, 0, round(4096 * 3.0 / 5.0))
    assert Wiring().resistance(reading) == pytest.approx(1.2, abs=2e-3)


def test_voltage_of_a_duty_heats_as_the_duty():
    w = Wiring()
    pwm = np.arange(256)
    np.testing.assert_allclose(w.voltage(pwm) ** 2, pwm / 255 * 3.7**2)
    np.testing.assert_array_equal(w.pwm(w.voltage(pwm)), pwm)


@pytest.mark.parametrize("sides", [1, 2])
def test_bench_file_is_read_back(tmp_path, sides):
    wiring = Wiring(
        sides=sides,
        ambient_K=295.5,
        position=Position(source="echo", per_count=-8.5e-5, zero=1234.5),
        thermistors=Thermistors(fitted=False),
        known=(("resistance_ohm", 1.2),),
    )
    assert load_wiring(save_wiring(wiring, tmp_path / "bench.toml")) == wiring


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("supply = 3.7", "did you mean supply_V"),
        ("sides = 3", "sides is 1, or 2"),
        ("supply_V = -1", "above 0"),
        ("[position]\nsource = 'sonar'", "no position sensor 'sonar'"),
        ("[position]\nper_cuont = 1", "did you mean per_count"),
        ("[position]\nper_count = 0", "does not change"),
        ("position = 3", "is no section"),
        ("supply_V = ", "is not TOML"),
        ("supply_V = 'x'", "no finite number"),
    ],
)
def test_a_bad_bench_file_is_refused_in_one_line(tmp_path, text, words):
    path = tmp_path / "bench.toml"
    path.write_text(text)
    with pytest.raises(BenchError, match=words) as error:
        load_wiring(path)
    assert str(path) in str(error.value)
    assert "\n" not in str(error.value)


# -- recordings ------------------------------------------------------------------------------------------------------


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


# -- loops -----------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("on", ["board", "host"])
def test_tracking_is_that_of_pure_simulation_within_5_percent(board, on):
    """The 0.05 Hz, 25 degree sine on the joint of the thesis's fitted plant (4.4), with noise and converters."""
    made = simulated("thesis", sides=2)
    device = board(made.world, config=replace(made.config, max_temperature_C=150.0))
    _, reference = Reference().make("sine")
    pair = thesis_pair()
    with Rig(device, made.wiring, options=RigOptions(keep=1 << 16)) as rig:
        found = follow(rig, pair, reference, every=4, on=on)
    assert len(found.time) >= len(reference) - 1
    said = jax.jit(lambda loop, r: run(loop, r, dt=0.02))(Loop(made.plant, pair), reference)
    pure = float(np.sqrt(np.mean(np.asarray(said.error) ** 2)))
    print(f"{on}: {np.degrees(found.rmse):.4f} deg, pure simulation {np.degrees(pure):.4f} deg")
    assert found.rmse == pytest.approx(pure, rel=0.05)


@pytest.mark.parametrize(
    ("controller", "words"),
    [
        (thesis_pair(form="tustin"), "does not do this form"),
        (thesis_pair(anti_windup="none"), "does not do this form"),
        (thesis_pair(derivative_weight=0.0), "does not do this form"),
        (PID.per_degree(0.5), "not the agonist's opposite"),
    ],
)
def test_controllers_that_the_firmware_has_not_are_refused(controller, words):
    with Rig(EmulatedDevice(), Wiring(sides=2)) as rig, pytest.raises(BenchError, match=words):
        set_gains(rig, controller)


# -- simulated benches -----------------------------------------------------------------------------------------------


def test_a_concealed_mechanism_is_in_the_muscle():
    model = with_concealed(muscle(), ["creep:compliance=0.4,time_constant=7", "two_node_thermal"])
    assert float(model.value("creep.compliance")) == pytest.approx(0.4)
    assert float(model.value("two_node_thermal.time_constant")) == pytest.approx(0.05 * 1.1 / 0.14, rel=1e-5)


@pytest.mark.parametrize(
    ("words", "said"),
    [("crep", "creep"), ("creep:tau=1", "no 'tau'"), ("creep:compliance=x", "'x' is no number"), ("inertia", "every")],
)
def test_bad_names_to_conceal(words, said):
    with pytest.raises(BenchError, match=said):
        with_concealed(muscle(), [words])


def test_a_model_that_is_right_agrees_and_one_that_is_wrong_parts(tmp_path):
    for concealed, parts in (((), False), (("creep:compliance=0.3,time_constant=8",), True)):
        made = simulated("muscle", concealed=concealed)
        with Rig(emulated(made), made.wiring, options=RigOptions(every=20)) as rig:
            time, volts = Excite(duration=40.0).make("multilevel")
            recording = record_profile(rig, tmp_path / f"{len(concealed)}.csv", time, volts)
        found = {c.column: c for c in open_loop(muscle(), recording)}
        assert found["displacement_mm"].parts == parts
        assert not found["temperature_degC"].parts


def test_the_board_guards_a_muscle_hotter_than_it_was_built_for():
    """A muscle that cools a third worse than the board believes: the thermistor is what saves it."""
    made = simulated("muscle")
    hot = muscle().replace({"newton_cooling.conductance": 0.095})
    world = Muscle(replace_plant(made, hot), made.wiring, seed=1)
    device = EmulatedDevice(world, config=made.config)
    with pytest.raises(BenchError, match="thermistor read the temperature limit"), Rig(device, made.wiring) as rig:
        rig.set_voltage(3.7)
        rig.wait(120.0)
    assert world.hottest - 273.15 <= made.config.max_temperature_C


def replace_plant(made, model):
    from scpjax.control.plant import Difference

    return Difference(model, radius=None)


# -- the thesis's lines, the page ------------------------------------------------------------------------------------


def thesis_lines(n=60):
    rows = [f"{55 * i}\t{120 if i > 5 else 0}\t{40.0 + (0.02 * max(0, i - 5)):.2f}\r\n" for i in range(n)]
    rows[20] = f"{55 * 20}\t120\t52.10\r\n"
    return "".join(rows)


def test_the_thesis_lines_become_a_recording():
    text = "13\t7\n" + thesis_lines() + "garbage\n\t\t\n55\t999\t1\n"
    found = legacy.recording(text.encode().split(b"\n"), value="distance")
    assert found.n == 60
    assert found.output("displacement")[-1] == pytest.approx(0.2 * 54 * 1e-3, rel=1e-6)
    assert found.weight("displacement")[20] == 0
    assert np.sum(found.weight("displacement") == 0) == 1
    nearer = legacy.recording(text.encode().split(b"\n"), value="distance", nearer=True)
    assert nearer.output("displacement")[-1] < 0


def test_a_real_jump_is_believed_after_three_readings():
    rows = [f"{50 * i}\t0\t{40.0 if i < 10 else 45.0}".encode() for i in range(20)]
    assert legacy.recording(rows, value="distance").output("displacement")[-1] == pytest.approx(0.05)


@pytest.mark.skipif(not hasattr(os, "openpty"), reason="skipped: no pseudo-terminals here")
def test_the_thesis_lines_end_on_silence():
    master, slave = os.openpty()
    device = PortDevice(os.ttyname(slave), baud=legacy.BAUD)
    device.open()
    writer = threading.Thread(target=os.write, args=(master, thesis_lines().encode()))
    writer.start()
    rows = list(legacy.lines(device, silence=0.4, most=20.0))
    writer.join()
    device.close()
    os.close(slave)
    os.close(master)
    assert len(legacy.parse(rows)) >= 59


def test_the_live_page_serves_what_comes():
    made = simulated("muscle")
    names = ("time_s", *made.wiring.drives, *made.wiring.responses)
    with Live(names) as live, Rig(emulated(made), made.wiring) as rig:
        rig.listener = lambda time, sample: live.add(time, rig.wiring.row(sample))
        rig.set_voltage(2.0)
        rig.wait(1.0)
        page = urllib.request.urlopen(live.url, timeout=5).read()
        data = json.loads(urllib.request.urlopen(f"{live.url}data?since=0", timeout=5).read())
        later = json.loads(urllib.request.urlopen(f"{live.url}data?since={data['next']}", timeout=5).read())
    assert b"canvas" in page
    assert data["names"] == list(names)
    assert len(data["rows"]) == data["next"] > 15
    assert len(data["rows"][-1]) == len(names)
    assert later["rows"] == []
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
