"""A cable that is pulled and put back: the board ends the drive, what came is on disk."""

import random
import threading

import boards
import numpy as np
import pytest
from ports import FAST, Kept, off_after, pty

from scpjax.bench.cable import Cable
from scpjax.bench.device import EmulatedDevice, PortDevice
from scpjax.bench.errors import PortLost
from scpjax.bench.parameters import TICK_S
from scpjax.bench.rig import Rig
from scpjax.recordings.files import read_recording

pytestmark = pytest.mark.usefixtures("nothing_is_left")


PULLS = 100 if boards.FULL_SIZE else 3


@pty
@pytest.mark.parametrize("seed", range(PULLS))
def test_the_cable_is_pulled(board, tmp_path, seed):
    device = board()
    cable = Cable(device)
    port = Kept(cable.port)
    timer = threading.Timer(0.15 + 0.5 * random.Random(seed).random(), cable.pull)
    timer.name = "scpjax-hand"
    before = []
    with pytest.raises(PortLost, match="plug the board in"), Rig(port, options=FAST) as rig:
        rig.record(tmp_path / "a.csv")
        rig.set_voltage(3.0)
        before.append(len(port.given))
        timer.start()
        rig.wait(5.0)
    timer.join()
    assert off_after(device) <= 1.1
    raw = (tmp_path / "a.raw").read_bytes()
    assert len(raw) > 500
    assert port.given.endswith(raw)
    assert len(port.given) - len(raw) <= before[0]  # what came before the recording began
    recording = read_recording(tmp_path / "a.csv")
    assert recording.n > 20
    assert np.max(np.diff(recording.time)) < 2.5 * TICK_S


@pty
def test_a_port_that_comes_back_is_used_again(tmp_path):
    device = EmulatedDevice()
    cable = Cable(device)
    link = tmp_path / "port"
    link.symlink_to(cable.port)
    with Rig(PortDevice(str(link)), options=FAST) as rig:
        rig.record(tmp_path / "a.csv")
        rig.set_voltage(2.0)
        rig.wait(0.3)
        cable.pull()
        with pytest.raises(PortLost):
            rig.wait(2.0)
        cable = Cable(device)
        link.unlink()
        link.symlink_to(cable.port)
        rig.reconnect(5.0)
        assert device.duty() == (0.0, 0.0)  # the drive stays off until it is asked for again
        rig.set_voltage(1.0)
        rig.wait(0.3)
    cable.pull()
    assert read_recording(tmp_path / "a.csv").n > 80
