"""What every board does, the Python one and the compiled firmware alike."""

import jax
import numpy as np
import pytest
from boards import Talk

from scpjax.bench import messages as m
from scpjax.bench.errors import BenchError, BoardFault, BoardReset
from scpjax.bench.frames import command
from scpjax.bench.messages import Banner, Calibration, Event, Reply, Resistance, Sample
from scpjax.bench.parameters import NAMES, BoardConfig, from_bits
from scpjax.bench.play import Profile, follow, loop_on_board, play
from scpjax.bench.rig import Rig
from scpjax.bench.wiring import Position, Wiring
from scpjax.bench.world import Muscle, Noise, Still
from scpjax.control.pid import thesis_pair
from scpjax.control.plant import Difference
from scpjax.control.reference import Reference
from scpjax.physics.known import known_model


def of(kind, messages):
    return [x for x in messages if isinstance(x, kind)]


# -- protocol --------------------------------------------------------------------------------------------------------


def test_banner_says_version_pins_and_limits(board):
    device = board(config=BoardConfig(max_temperature_C=95.0, max_energy_J=321.0))
    talk = Talk(device)
    talk.send("?")
    (banner,) = of(Banner, talk.wait(0.1))
    assert (banner.name, banner.protocol, banner.version, banner.tick_hz) == ("scpjax-rig", 1, "1.0.0", 200)
    assert banner.pins[:2] == ("3", "9")
    assert (banner.max_temperature_C, banner.max_energy_J) == (95, 321)
    assert (banner.sustained_power_W, banner.max_on_s, banner.max_current_A) == (6, 600, 9)
    assert device.duty() == (0.0, 0.0)


@pytest.mark.parametrize(
    ("kind", "fields", "status"),
    [
        ("H", (), m.OK),
        ("Q", (), m.UNKNOWN),
        ("W", (1,), m.BAD_ARGUMENTS),
        ("W", (1, 2, 3), m.BAD_ARGUMENTS),
        ("W", (256, 0), m.OUT_OF_RANGE),
        ("R", (256,), m.OUT_OF_RANGE),
        ("P", (1, 1), m.BAD_ARGUMENTS),
        ("T", (1, 0x8000), m.OUT_OF_RANGE),
        ("V", (99, 0), m.OUT_OF_RANGE),
        ("V", (0, 0x7FC00000), m.OUT_OF_RANGE),
        ("V", (0, 0x7F800000), m.OUT_OF_RANGE),
        ("Z", (2,), m.OUT_OF_RANGE),
        ("X", (1,), m.BAD_ARGUMENTS),
        ("S", (), m.OK),
    ],
)
def test_every_command_is_answered(talk, kind, fields, status):
    assert talk.ask(kind, *fields).status == status
    assert talk.device.duty() == (0.0, 0.0)


@pytest.mark.parametrize(
    "data",
    [
        b"",
        b"$*\n",
        b"$" + b"A" * 300 + b"\n",
        b"W,0001,FF,FF\n",
        command("W", 1, (255, 255)).replace(b"FF", b"FE", 1),
        command("W", 1, (255, 255))[:-2] + b"\n",
        command("W", 1, (255, 255)).replace(b"$", b""),
        command("W", 1, (255, 255)).lower(),
        b"$W,0001,FF,FF*00000000\n",
        bytes(range(256)) * 4,
    ],
)
def test_what_is_no_frame_is_not_obeyed(talk, data):
    for i in range(0, len(data), 64):
        talk.raw(data[i : i + 64])
        assert of(Reply, talk.wait(0.01)) == []
    assert talk.device.duty() == (0.0, 0.0)
    assert talk.ask("H").status == m.OK


@pytest.mark.parametrize(
    "body", ["W,0001,FF,", "W,0001,FF,XX", "W,0001,FF,1FFFFFFFF", "W", "W,", "W,0001 ,FF,FF", "W,1,ff,ff"]
)
def test_a_right_crc_does_not_save_a_wrong_body(talk, body):
    talk.body(body)
    assert of(Reply, talk.wait(0.05)) == []
    assert talk.ask("H").value >> 16 >= 1
    assert talk.device.duty() == (0.0, 0.0)


def test_noise_between_frames_does_no_harm(talk):
    talk.raw(b"\xff\x00garbage\n$$$W,00" + command("H", 77))
    (reply,) = of(Reply, talk.wait(0.05))
    assert (reply.to, reply.status) == (77, m.OK)


@pytest.mark.parametrize("every", [1, 4, 10, 200])
def test_the_stream_keeps_its_rate(talk, every):
    talk.ask("R", every)
    samples = of(Sample, talk.wait(2.0 + every * 0.005))
    gaps = np.diff([s.stamp for s in samples])
    assert len(samples) == pytest.approx(2.0 / (0.005 * every), abs=2)
    np.testing.assert_allclose(gaps, 5000 * every, atol=60)
    assert np.all(np.diff([s.sequence for s in samples]) == 1)
    talk.ask("R", 0)
    assert of(Sample, talk.wait(1.0)) == []


def test_pwm_is_what_was_asked_for(talk):
    for a, b in [(0, 0), (1, 254), (127, 128), (255, 1), (0, 255), (64, 0)]:
        talk.ask("W", a, b)
        talk.wait(0.02)
        assert talk.device.duty() == pytest.approx((a / 255, b / 255), abs=1 / 256)
        assert [d == 0.0 for d in talk.device.duty()] == [a == 0, b == 0]


def test_parameters_are_kept_in_single_precision(talk):
    assert talk.set("kp", 0.1).status == m.OK
    assert from_bits(talk.ask("U", NAMES.index("kp")).value) == np.float32(0.1)


# -- watchdogs and resets --------------------------------------------------------------------------------------------


def test_a_silent_host_loses_the_drive_within_1_1_s(talk):
    talk.ask("W", 255, 100)
    talk.wait(0.9)
    assert talk.device.duty()[0] == 1.0
    assert talk.until_off(1.0) < 0.2
    talk.ask("W", 10, 0)  # no lasting fault
    talk.wait(0.02)
    assert talk.device.duty()[0] > 0


def test_damaged_frames_are_no_sign_of_life(talk):
    talk.ask("W", 255, 0)
    for _ in range(11):
        talk.raw(command("H", 1)[:-3] + b"0\n")
        talk.wait(0.1)
    assert talk.device.duty() == (0.0, 0.0)


def test_a_hanging_board_is_reset_by_its_watchdog(talk):
    talk.ask("W", 255, 255)
    talk.wait(0.05)
    talk.send("X", 0xDEAD)
    talk.wait(0.02)
    assert talk.until_off(0.6) < 0.3
    (banner,) = of(Banner, talk.wait(0.3))
    assert banner.sequence == 1
    assert banner.reset_cause & 8
    assert talk.ask("H").value & 0xFF == m.IDLE


def test_a_reset_in_mid_stream_ends_the_drive_and_is_noticed(board, tmp_path):
    device = board()
    with pytest.raises(BoardReset, match="began anew"), Rig(device) as rig:
        rig.record(tmp_path / "a.csv")
        rig.set_voltage(3.0)
        rig.wait(0.5)
        assert device.duty()[0] > 0.5
        device.reset()
        assert device.duty() == (0.0, 0.0)
        rig.wait(0.5)
    assert device.duty() == (0.0, 0.0)
    time = np.loadtxt(tmp_path / "a.csv", delimiter=",", skiprows=1)[:, 0]
    assert 0.4 < time[-1] < 0.6


# -- the table -------------------------------------------------------------------------------------------------------


def test_a_table_is_played_entry_by_entry(board):
    counts = np.random.default_rng(0).integers(0, 256, (600, 2))
    device = board()
    with Rig(device) as rig:
        rig.stream(1)
        seen = []
        rig.quality.samples = 0
        play(rig, Profile(counts, 2), watch=lambda t: seen.append(t))
        played = [s.pwm for _, s in rig._samples if s.mode == m.PLAY]
    assert seen
    assert seen[-1] == pytest.approx(6.0, abs=0.1)
    first = played.index(tuple(counts[0]))
    np.testing.assert_array_equal(np.array(played[first:])[::2], counts)
    assert device.duty() == (0.0, 0.0)


def test_a_table_that_runs_dry_ends_the_drive(talk):
    talk.ask("T", 0, 0xFFFF, 0xFFFF, 0xFFFF)
    talk.ask("P", 10, 100)
    messages = talk.wait(0.3)
    assert [e.what for e in of(Event, messages)] == [m.UNDERRUN]
    assert talk.device.duty() == (0.0, 0.0)


def test_the_table_takes_entries_in_order_and_says_when_it_is_full(talk):
    for i in range(0, 252, 12):
        assert talk.ask("T", i, *range(12)).status == m.OK
    full = talk.ask("T", 252, *range(12))
    assert (full.status, full.value >> 16, full.value & 0xFFFF) == (m.FULL, 252, 3)
    again = talk.ask("T", 240, 1)
    assert (again.status, again.value >> 16) == (m.OUT_OF_RANGE, 252)
    assert talk.ask("S").status == m.OK
    assert talk.ask("T", 0, 1).status == m.OK


# -- the controller --------------------------------------------------------------------------------------------------


def joint() -> tuple[Difference, Wiring]:
    muscle = known_model("thesis")
    return Difference(muscle, muscle, radius=0.015), Wiring(sides=2)


@pytest.mark.parametrize("shape", ["sine", "square"])
def test_pid_on_the_board_is_that_of_the_host_within_a_count_over_60_s(board, shape):
    plant, wiring = joint()
    config = BoardConfig(max_temperature_C=200.0)
    device = board(Muscle(plant, wiring), config=config)
    pair = thesis_pair()
    _, reference = Reference().make(shape)
    with Rig(device, wiring) as rig:
        rig.stream(4)
        loop_on_board(rig, pair, reference, 4)
        samples = [s for _, s in rig._samples if s.mode == m.LOOP]
    assert len(samples) >= len(reference) - 1
    seen = np.array([wiring.angle(s) for s in samples[: len(reference)]])
    wanted = np.deg2rad(np.round(100 * np.rad2deg(reference)) / 100)[: len(seen)]

    def step(state, x):
        state, said = pair.step(state, x[0], x[1], 0.02)
        return state, said.effort

    efforts = np.stack(jax.lax.scan(step, pair.initial(), (seen, wanted))[1], axis=1)
    counts = np.floor(255 * efforts / 3.7**2 + 0.5)
    given = np.array([s.pwm for s in samples[: len(seen)]])
    assert np.ptp(given[:, 0]) > 150
    assert (np.max(given) == 255) == (shape == "square")  # the limit and the clamp are at work
    assert np.max(np.abs(counts - given)) <= 1
    assert np.mean(counts != given) < 0.02


def test_the_loop_needs_the_host_too(board):
    plant, wiring = joint()
    talk = Talk(board(Muscle(plant, wiring)))
    talk.ask("T", 0, *[2000] * 12)
    talk.ask("C", 200, 12)
    talk.wait(0.5)
    assert talk.device.duty()[0] > 0
    assert talk.until_off(1.0) < 0.7


# -- cut-outs --------------------------------------------------------------------------------------------------------

LASTING = [
    ("model_resistance", 0.2, m.HOT_BY_MODEL, {}),
    ("max_energy", 5.0, m.OVER_ENERGY, {}),
    ("max_on", 0.6, m.ON_TOO_LONG, {}),
    ("max_current", 1.0, m.OVER_CURRENT, {3: 0.8}),
    ("max_temperature", 50.0, m.HOT_BY_SENSOR, {0: 1.6}),
    ("max_temperature", 119.0, m.SENSOR_LOST, {1: 0.0}),
]


@pytest.mark.parametrize(
    ("name", "value", "fault", "inputs"), LASTING, ids=lambda x: str(x) if isinstance(x, str) else ""
)
def test_a_limit_met_cuts_the_power_and_lasts(board, name, value, fault, inputs):
    world = Still()
    talk = Talk(board(world, config=BoardConfig(model_thermal_mass_J_per_K=0.5)))
    assert talk.set(name, value).status == m.OK
    talk.ask("W", 255, 0)
    talk.wait(0.1)
    assert talk.device.duty()[0] > 0
    for i, volts in inputs.items():
        world.inputs[i] = volts
    events = []
    for _ in range(30):
        talk.send("H")
        events += of(Event, talk.wait(0.1))
    assert [e.what for e in events] == [fault]
    assert talk.device.duty() == (0.0, 0.0)
    assert talk.ask("W", 1, 0).status == m.FAULTY
    assert talk.ask("P", 1, 1).status == m.FAULTY
    if inputs:
        assert talk.ask("F").status == m.FAULTY
        world.inputs[:] = Still().inputs
        talk.wait(0.1)
        assert talk.ask("F").status == m.OK
        assert talk.ask("W", 1, 0).status == m.OK
    talk.wait(0.02)


def test_a_reset_does_not_forget_what_an_actuator_has_had(board):
    config = BoardConfig(max_energy_J=20.0, sustained_power_W=0.5, model_thermal_mass_J_per_K=5.0)
    device = board(config=config)
    talk = Talk(device)
    total = 0.0
    for _ in range(10):
        if talk.ask("W", 255, 0).status != m.OK:
            break
        for _ in range(4):
            talk.wait(0.1)
            total += 0.1 * device.duty()[0] * 3.7**2 / 1.07
        device.reset()
        talk.wait(0.1)
    assert total < 20.0 + 0.5 * 6
    talk.wait(0.1)
    assert device.duty() == (0.0, 0.0)


@pytest.mark.parametrize(
    ("name", "tighter", "looser"),
    [("max_temperature", 80.0, 81.0), ("max_energy", 10.0, 11.0), ("model_ambient", 30.0, 29.0), ("max_on", 5.0, 1e9)],
)
def test_limits_can_only_be_made_tighter(talk, name, tighter, looser):
    assert talk.set(name, tighter).status == m.OK
    assert talk.set(name, looser).status == m.OUT_OF_RANGE
    assert from_bits(talk.ask("U", NAMES.index(name)).value) == pytest.approx(tighter)


def test_the_rig_says_what_cut_the_power(board):
    with pytest.raises(BoardFault, match="energy"), Rig(board()) as rig:
        rig.set("max_energy", 3.0)
        rig.set_voltage(3.7)
        rig.wait(5.0)


# -- sensors ---------------------------------------------------------------------------------------------------------


def test_resistance_is_measured_with_the_drive_off(board):
    world = Still((0.5, 0.5, 2.5, 0.0, 3.0, 2.0))
    with Rig(board(world)) as rig:
        rig.set_voltage(2.0)
        assert rig.resistance(0) == pytest.approx(1.2, abs=0.004)
        assert rig.resistance(1) == pytest.approx(0.8, abs=0.004)


def test_calibration_averages_and_needs_the_power_off(board):
    talk = Talk(board(Still((0.5, 0.6, 2.5, 0.1, 0, 0))))
    talk.ask("W", 10, 0)
    assert talk.ask("K").status == m.BUSY
    talk.ask("S")
    talk.ask("K")
    (found,) = of(Calibration, talk.wait(0.5))
    np.testing.assert_allclose(np.array(found.totals) / 64, [408, 488, 2048, 80], atol=4)


def test_a_thermistor_plugged_in_later_is_found_by_calibration(board):
    world = Still((0.0, 0.0, 2.5, 0.0, 0, 0))
    with Rig(board(world)) as rig:
        rig.wait(0.2)
        assert rig.last is not None
        assert rig.last.fitted == 0
        world.inputs[0] = 0.5
        rig.calibrate()
        rig.wait(0.2)
        assert rig.last.fitted == 1


@pytest.mark.parametrize("source", ["echo", "encoder"])
def test_echo_and_encoder_follow(board, source):
    plant = Difference(known_model("plant"), radius=None)
    law = Position(
        source=source, per_count=-8.5e-5 if source == "echo" else 2e-5, zero=1500.0 if source == "echo" else 0
    )
    wiring = Wiring(position=law)
    world = Muscle(plant, wiring, noise=Noise(volts=0.0))
    with Rig(board(world), wiring) as rig:
        rig.set("position_source", 1.0 if source == "echo" else 2.0)
        rig.wait(0.3)
        rig.set_voltage(3.0)
        rig.wait(6.0)
        assert rig.last is not None
        assert world.position > 0.5e-3
        assert wiring.measured(rig.last) == pytest.approx(world.position, abs=1.2e-4)


def test_a_lost_echo_is_a_missing_sample(board):
    plant = Difference(known_model("plant"), radius=None)
    wiring = Wiring(position=Position(source="echo", per_count=-8.5e-5, zero=1500.0))
    world = Muscle(plant, wiring, noise=Noise(volts=0.0))
    with Rig(board(world), wiring) as rig:
        rig.set("position_source", 1.0)
        rig.wait(0.5)
        assert rig.last is not None
        assert wiring.measured(rig.last) == pytest.approx(0.0, abs=1e-4)
        world.echo_s = lambda: 0.0
        rig.wait(0.5)
        assert np.isnan(wiring.measured(rig.last))
        assert np.isnan(wiring.row(rig.last)[-1])


@pytest.mark.parametrize("on", ["board", "host"])
def test_a_loop_without_its_echo_is_ended(board, on):
    plant = Difference(known_model("plant"), radius=None)
    wiring = Wiring(position=Position(source="echo", per_count=-8.5e-5, zero=1500.0))
    world = Muscle(plant, wiring, noise=Noise(volts=0.0))
    device = board(world)
    with pytest.raises(BenchError, match=r"no echo|gives nothing"), Rig(device, wiring) as rig:
        rig.set("position_source", 1.0)
        rig.wait(0.3)
        world.echo_s = lambda: 0.0
        follow(rig, thesis_pair().agonist, np.full(200, 0.1), every=4, on=on)
    assert device.duty() == (0.0, 0.0)


def test_messages_are_those_of_the_protocol(talk):
    talk.ask("R", 1)
    talk.send("Z", 0)
    talk.send("K")
    kinds = {type(x) for x in talk.wait(0.5)}
    assert kinds == {Sample, Reply, Resistance, Calibration}


def test_bad_names_and_values_are_refused_here(board):
    with Rig(board()) as rig:
        with pytest.raises(BenchError, match="no parameter 'kpp'"):
            rig.get("kpp")
        with pytest.raises(BenchError, match="refused"):
            rig.set("max_temperature", 500.0)
