"""Faults: whatever breaks, the power goes off, nothing received is lost, nothing wrong is believed, nothing is left."""

import multiprocessing
import os
import random
import signal
import subprocess
import sys
import textwrap
import threading
import time
import zlib
from pathlib import Path

import boards
import numpy as np
import pytest

from scpjax.bench.cable import Cable
from scpjax.bench.device import EmulatedDevice, PortDevice, find_port
from scpjax.bench.emulator import Board
from scpjax.bench.errors import BenchError, BoardFault, NoAnswer, PortLost
from scpjax.bench.frames import LONGEST, Decoder, decode
from scpjax.bench.guard import Inputs
from scpjax.bench.messages import parse
from scpjax.bench.parameters import TICK_S
from scpjax.bench.quality import Quality
from scpjax.bench.rig import Rig, RigOptions
from scpjax.recordings.files import read_recording

pty = pytest.mark.skipif(not hasattr(os, "openpty"), reason="skipped: no pseudo-terminals here")
PULLS = 100 if boards.FULL_SIZE else 3
FRAMES = 1_000_000 if boards.FULL_SIZE else 20_000
FAST = RigOptions(every=1)


@pytest.fixture(autouse=True)
def _nothing_is_left():
    yield
    deadline = time.monotonic() + 3
    while time.monotonic() < deadline and _ours():
        time.sleep(0.02)
    assert _ours() == []
    assert multiprocessing.active_children() == []


def _ours():
    return [t.name for t in threading.enumerate() if t.name.startswith("scpjax")]


class Kept(PortDevice):
    """A port that remembers every byte it gave."""

    def __init__(self, port: str):
        super().__init__(port)
        self.given = b""

    def read(self, timeout: float) -> bytes:
        data = super().read(timeout)
        self.given += data
        return data


def off_after(device) -> float:
    """Seconds of the board's own time until both channels are off, the host gone."""
    for k in range(round(3 / TICK_S)):
        if device.duty() == (0.0, 0.0):
            return k * TICK_S
        device.pause(TICK_S)
    raise AssertionError("still on after 3 s")


# -- the cable -------------------------------------------------------------------------------------------------------


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


# -- the line --------------------------------------------------------------------------------------------------------


def _frames(n: int, seed: int) -> list[bytes]:
    board, rng = Board(), random.Random(seed)
    board.tick(Inputs())
    board.stream_every = 1
    out = []
    for _ in range(n):
        board.counts = [rng.randrange(256), rng.randrange(256)]
        board.memory.temperature = [25.0, 25.0]
        board.memory.energy = board.memory.on = [0.0, 0.0]
        out.append(board.tick(Inputs((*(rng.randrange(4093) for _ in range(3)), 0, 0, 0))))
    return out


DIGITS = b"0123456789ABCDEF,"


def _other_byte(rng: random.Random, byte: int) -> int:
    return (byte + 1 + rng.randrange(255)) % 256


def _other_digit(rng: random.Random, byte: int) -> int:
    return rng.choice([d for d in DIGITS if d != byte])


def _flipped(rng: random.Random, byte: int) -> int:
    return byte ^ 1 << rng.randrange(8)


@pytest.mark.parametrize(
    "damage", [_other_byte, _other_digit, _flipped], ids=["any byte", "another digit", "a bit flipped"]
)
def test_no_wrong_value_among_frames_with_one_byte_in_a_hundred_damaged(damage):
    rng = random.Random(1)
    decoder, quality = Decoder(), Quality()
    sent = accepted = 0
    while sent < FRAMES:
        lines = _frames(20_000, sent)
        true = {line[1:-1] for line in lines}
        noise = bytearray(b"".join(lines))
        at = -1
        while (at := at + 1 + int(np.log(1 - rng.random()) / np.log(0.99))) < len(noise):
            noise[at] = damage(rng, noise[at])
        for i in range(0, len(noise), 4096):
            for frame in decoder.feed(bytes(noise[i : i + 4096])):
                message = parse(frame)
                if message is None or not quality.number(message.sequence):
                    continue
                accepted += 1
                body = ",".join((frame.kind, *frame.fields)).encode()
                assert b"%b*%08X" % (body, zlib.crc32(body)) in true
        sent += len(lines)
        quality.restart()
    assert 0.5 * sent < accepted < 0.7 * sent  # 0.99^49 of them are whole
    assert decoder.damaged > 0.3 * sent


def test_lost_bytes_and_frames_are_counted():
    lines = _frames(100, 0)
    data = b"".join(lines[:40] + lines[50:])  # ten frames lost
    data = data[:25] + data[26:1000] + data[1010:]
    decoder, quality = Decoder(), Quality()
    for frame in decoder.feed(data):
        message = parse(frame)
        assert message is not None
        assert quality.number(message.sequence)
    assert decoder.damaged + quality.frames in (90, 89)
    assert quality.lost == 100 - quality.frames - 1  # the first was damaged


def test_frames_that_come_again_are_dropped():
    quality = Quality()
    assert [quality.number(n) for n in (5, 6, 6, 4, 7, 0xFFFF, 8)] == [True, True, False, False, True, False, True]
    assert quality.stale == 3


def test_the_wrap_of_sequence_and_clock_is_no_gap(board):
    device = EmulatedDevice()
    with Rig(device, options=FAST) as rig:
        rig.wait(0.1)
        device.board.sequence = 0xFFF0
        device.board.clock_us = (1 << 32) - 100_000
        rig.quality.restart()
        rig.wait(0.5)
        assert rig.quality.lost == 0
        assert rig.quality.clock.jumps == 0


@pty
def test_a_babbling_port_does_not_hang_us():
    master, slave = os.openpty()
    stop = threading.Event()

    def babble():
        while not stop.is_set():
            os.write(master, bytes(random.randrange(11, 256) for _ in range(512)))

    os.set_blocking(master, True)
    thread = threading.Thread(target=babble, name="scpjax-babble", daemon=True)
    thread.start()
    began = time.monotonic()
    rig = Rig(PortDevice(os.ttyname(slave)), options=RigOptions(handshake_s=1.0))
    with pytest.raises(NoAnswer, match="no scpjax board answers"), rig:
        pass
    assert time.monotonic() - began < 6.0
    assert len(rig._decoder._line) <= LONGEST + 65536
    stop.set()
    os.read(slave, 65536)
    thread.join(3.0)
    os.close(slave)
    os.close(master)


@pty
def test_babble_in_mid_stream_is_passed_over(tmp_path):
    cable = Cable(EmulatedDevice())
    with Rig(PortDevice(cable.port), options=FAST) as rig:
        rig.wait(0.2)
        for _ in range(20):
            cable.babble(os.urandom(200).replace(b"\n", b"x"))
            rig.wait(0.02)
        good = rig.quality.samples
        rig.wait(0.3)
        assert rig.quality.samples - good > 40
        assert rig.quality.damaged + rig.quality.stray > 0
    cable.pull()


# -- the host --------------------------------------------------------------------------------------------------------


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
import sys
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
        os.close(getattr(log, handle))
        setattr(log, handle, os.open("/dev/full", os.O_WRONLY))
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
    with pytest.raises(BenchError, match=r"pip install 'scpjax\[rig\]'"):
        PortDevice("/dev/ttyACM0").open()


def test_a_frame_is_what_zlib_says():
    assert decode(b"H,0001*%08X" % zlib.crc32(b"H,0001")) is not None
    assert decode(b"H,0001*00000000") is None
