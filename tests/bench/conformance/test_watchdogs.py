"""What ends the drive on every board: silence of the host, a hanging program, a reset, limits."""

import numpy as np
import pytest
from boards import Talk, of

from scpjax.bench import messages as m
from scpjax.bench.errors import BoardFault, BoardReset
from scpjax.bench.frames import command
from scpjax.bench.messages import Banner, Event
from scpjax.bench.parameters import NAMES, BoardConfig, from_bits
from scpjax.bench.rig import Rig
from scpjax.bench.world import Still


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
