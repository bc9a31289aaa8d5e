"""A host that stalls, dies, whose clock jumps or disk is full; ports and firmware that are not as they should be."""

import os
import signal
import subprocess
import sys
import textwrap
import time
from pathlib import Path

import numpy as np
import pytest
from ports import FAST, pty

from scpjax.bench.cable import Cable
from scpjax.bench.device import EmulatedDevice, PortDevice, find_port
from scpjax.bench.emulator import Board
from scpjax.bench.errors import BenchError, BoardFault
from scpjax.bench.parameters import TICK_S
from scpjax.bench.rig import Rig
from scpjax.recordings.files import read_recording

pytestmark = pytest.mark.usefixtures("nothing_is_left")


def test_a_stalled_host_loses_the_drive_and_is_told(tmp_path):
    device = EmulatedDevice(real_time=True)
    with pytest.raises(BoardFault, match="nothing good came from the host"), Rig(device, options=FAST) as rig:
        rig.record(tmp_path / "a.csv")
        rig.set_voltage(3.0)
        rig.wait(0.1)
        time.sleep(1.4)  # our own thread stalls; the reader's goes on
        assert device.duty() == (0.0, 0.0)
        rig.wait(0.1)
    recording = read_recording(tmp_path / "a.csv")
    volts = recording.input("voltage")
    on = recording.time[volts > 1]
    assert 0.9 < on[-1] - on[0] < 1.3
    assert recording.duration > 1.4


HOST = """
import signal
import sys
signal.signal(signal.SIGINT, signal.default_int_handler)  # ignored in what a shell began in the background
from scpjax.bench.device import PortDevice
from scpjax.bench.rig import Rig, RigOptions
with Rig(PortDevice(sys.argv[1]), options=RigOptions(every=1)) as rig:
    rig.record(sys.argv[2])
    rig.set_voltage(3.0)
    print("on", flush=True)
    rig.wait(30)
"""


@pty
@pytest.mark.parametrize("number", [signal.SIGKILL, signal.SIGTERM, signal.SIGINT, signal.SIGHUP], ids=lambda s: s.name)
def test_a_host_that_is_killed(board, tmp_path, number):
    device = board()
    cable = Cable(device)
    script = tmp_path / "host.py"
    script.write_text(textwrap.dedent(HOST))
    call = [sys.executable, str(script), cable.port, str(tmp_path / "a.csv")]
    root = str(Path(__file__).resolve().parents[2])
    env = {**os.environ, "PYTHONPATH": os.pathsep.join([root, os.environ.get("PYTHONPATH", "")])}
    host = subprocess.Popen(call, stdout=subprocess.PIPE, stderr=subprocess.PIPE, env=env)
    assert host.stdout is not None
    assert host.stdout.readline() == b"on\n"
    csv = tmp_path / "a.csv"
    while csv.read_bytes().count(b"\n") < 80:
        time.sleep(0.01)
    assert device.duty()[0] > 0.5
    killed = device.ticks
    host.send_signal(number)
    while device.duty() != (0.0, 0.0):
        assert device.ticks - killed < 3 / TICK_S
        time.sleep(0.002)
    off = device.ticks
    host.communicate(timeout=30)
    cable.pull()
    assert (off - killed) * TICK_S <= 1.1
    recording = read_recording(csv)
    assert recording.n >= 79
    assert (tmp_path / "a.raw").read_bytes().count(b"$D") >= recording.n
    assert (tmp_path / "a.quality.json").exists() == (number != signal.SIGKILL)  # the others leave in good order
    if number != signal.SIGKILL:
        assert host.returncode in (128 + number, -number, 1)


def test_the_wall_clock_may_jump(monkeypatch, tmp_path):
    with Rig(EmulatedDevice(real_time=True), options=FAST) as rig:
        rig.record(tmp_path / "a.csv")
        rig.wait(0.2)
        now = time.time
        monkeypatch.setattr(time, "time", lambda: now() - 3600)
        rig.wait(0.2)
        monkeypatch.setattr(time, "time", lambda: now() + 86400)
        rig.wait(0.2)
    recording = read_recording(tmp_path / "a.csv")
    np.testing.assert_allclose(np.diff(recording.time), TICK_S, atol=1e-6)


@pytest.mark.parametrize("jump_us", [10_000_000, -50_000, 3_000_000_000])
def test_the_clock_of_the_board_may_jump(tmp_path, jump_us):
    device = EmulatedDevice()
    with Rig(device, options=FAST) as rig:
        rig.record(tmp_path / "a.csv")
        rig.wait(0.2)
        device.board.clock_us += jump_us
        rig.wait(0.2)
        assert rig.quality.clock.jumps == 1
    recording = read_recording(tmp_path / "a.csv")
    np.testing.assert_allclose(np.diff(recording.time), TICK_S, atol=1e-6)


@pytest.mark.skipif(not Path("/dev/full").exists(), reason="skipped: no /dev/full")
@pytest.mark.parametrize("real_time", [False, True])
@pytest.mark.parametrize("which", [".raw", ".csv"])
def test_a_full_disk_ends_with_the_power_off(tmp_path, which, real_time):
    device = EmulatedDevice(real_time=real_time)
    with pytest.raises(BenchError, match="No space left"), Rig(device, options=FAST) as rig:
        log = rig.record(tmp_path / "a.csv")
        rig.wait(0.1)
        handle = "_raw" if which == ".raw" else "_csv"
        full = os.open("/dev/full", os.O_WRONLY)
        os.dup2(full, getattr(log, handle))  # at once: the thread that reads the board writes to it
        os.close(full)
        rig.set_voltage(3.0)
        rig.wait(2.0)
    device.pause(TICK_S)
    assert device.duty() == (0.0, 0.0)
    assert read_recording(tmp_path / "a.csv").n >= 15


@pty
def test_two_programs_on_one_port():
    cable = Cable(EmulatedDevice())
    with Rig(PortDevice(cable.port)) as first:
        with pytest.raises(BenchError, match="in use by another program"), Rig(PortDevice(cable.port)):
            pass
        first.wait(0.3)
        assert first.quality.damaged == 0
    cable.pull()


def test_a_port_that_is_not_there():
    with pytest.raises(BenchError, match="no such port"), Rig(PortDevice("/dev/ttyNONE")):
        pass


def _ports(monkeypatch, *devices):
    from serial.tools import list_ports
    from serial.tools.list_ports_common import ListPortInfo

    monkeypatch.setattr(list_ports, "comports", lambda: [ListPortInfo(d) for d in devices])


def test_the_only_board_is_found(monkeypatch):
    _ports(monkeypatch, "/dev/ttyS0", "/dev/ttyACM0")
    assert find_port() == "/dev/ttyACM0"


@pytest.mark.parametrize(
    ("devices", "words"), [(("/dev/ttyS0",), "--port sim"), (("/dev/ttyACM0", "/dev/ttyUSB1"), "choose one")]
)
def test_no_board_or_more_than_one(monkeypatch, devices, words):
    _ports(monkeypatch, *devices)
    with pytest.raises(BenchError, match=words):
        find_port()


@pytest.mark.parametrize(("protocol", "version"), [(2, "2.0.0"), (0, "0.1.0")])
def test_a_wrong_firmware_is_refused(protocol, version):
    device = EmulatedDevice(board=Board(protocol=protocol, version=version))
    with pytest.raises(BenchError, match=f"{version}.*flash the firmware"), Rig(device):
        pass


def test_an_exception_ends_with_the_power_off(board):
    device = board()
    with pytest.raises(ZeroDivisionError), Rig(device) as rig:
        rig.set_voltage(3.0)
        rig.wait(0.2)
        assert device.duty()[0] > 0.5
        _ = 1 / 0
    assert device.duty() == (0.0, 0.0)


def test_without_pyserial_the_error_says_what_to_install(monkeypatch):
    monkeypatch.setitem(sys.modules, "serial", None)
    with pytest.raises(BenchError, match=r"pip install pyserial"):
        PortDevice("/dev/ttyACM0").open()
