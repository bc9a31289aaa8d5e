"""Frames, answers, stream and parameters: what every board does, the Python one and the compiled firmware alike."""

import numpy as np
import pytest
from boards import Talk, of

from scpjax.bench import messages as m
from scpjax.bench.errors import BenchError
from scpjax.bench.frames import command
from scpjax.bench.messages import Banner, Calibration, Reply, Resistance, Sample
from scpjax.bench.parameters import NAMES, BoardConfig, from_bits
from scpjax.bench.rig import Rig


def test_banner_says_version_pins_and_limits(board):
    device = board(config=BoardConfig(max_temperature_C=95.0, max_energy_J=321.0))
    talk = Talk(device)
    talk.send("?")
    (banner,) = of(Banner, talk.wait(0.1))
    assert (banner.name, banner.protocol, banner.version, banner.tick_hz) == ("scpjax-rig", 1, "1.0.1", 200)
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
