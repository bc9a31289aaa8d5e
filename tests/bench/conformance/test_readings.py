"""Sensors on every board: resistance, thermistor, echo, encoder."""

import itertools

import numpy as np
import pytest
from boards import Talk, of

from scpjax.bench import messages as m
from scpjax.bench.errors import BenchError
from scpjax.bench.messages import Calibration
from scpjax.bench.play import follow
from scpjax.bench.rig import Rig
from scpjax.bench.sessions import calibrate, rest
from scpjax.bench.wiring import Position, Wiring
from scpjax.bench.world import Muscle, Noise, Still
from scpjax.control.pid import thesis_pair
from scpjax.control.plant import Difference
from scpjax.physics.known import known_model


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
        rig.wait(0.3)
        world.echo_s = lambda: 0.0
        follow(rig, thesis_pair().agonist, np.full(200, 0.1), every=4, on=on)
    assert device.duty() == (0.0, 0.0)


def test_the_zero_of_an_encoder_lies_between_counts_of_either_sign(board):
    """The board adds up 16 bits without a sign: -1 is 65535 there."""
    wiring = Wiring(position=Position(source="encoder", per_count=2e-5, zero=0.0))
    world = Muscle(Difference(known_model("plant"), radius=None), wiring, noise=Noise(volts=0.0))
    turns = itertools.cycle((0, -1))
    world.encoder = lambda: next(turns)
    with Rig(board(world), wiring) as rig:
        found = calibrate(rig, pulse=0.0, resistance=False)
    assert found.wiring.position.zero == pytest.approx(-0.5, abs=0.02)
    with Rig(board(world), wiring) as rig:
        assert rest(rig, most=60.0) < 30.0
