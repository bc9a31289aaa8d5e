"""A line that damages, loses, repeats and babbles."""

import os
import random
import threading
import time
import zlib

import boards
import numpy as np
import pytest
from ports import FAST, pty

from scpjax.bench.cable import Cable
from scpjax.bench.device import EmulatedDevice, PortDevice
from scpjax.bench.emulator import Board
from scpjax.bench.errors import NoAnswer
from scpjax.bench.frames import LONGEST, Decoder, decode
from scpjax.bench.guard import Inputs
from scpjax.bench.messages import parse
from scpjax.bench.quality import Quality
from scpjax.bench.rig import Rig, RigOptions

pytestmark = pytest.mark.usefixtures("nothing_is_left")


FRAMES = 1_000_000 if boards.FULL_SIZE else 20_000


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


def test_a_frame_is_what_zlib_says():
    assert decode(b"H,0001*%08X" % zlib.crc32(b"H,0001")) is not None
    assert decode(b"H,0001*00000000") is None
