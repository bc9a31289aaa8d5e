"""Boards for tests: the emulator everywhere, the compiled firmware in simavr where it can be built."""

import os
import tempfile
from pathlib import Path

import pytest

from rig.simulation.firmware import SimulatedDevice, build, missing
from scpjax.bench import messages as m
from scpjax.bench.device import BoardDevice, EmulatedDevice
from scpjax.bench.frames import Decoder, command, encode
from scpjax.bench.messages import parse
from scpjax.bench.parameters import NAMES, TICK_S, BoardConfig, to_bits
from scpjax.bench.world import World

KINDS = ("emulator", "firmware")
FULL_SIZE = bool(os.environ.get("SCPJAX_BENCH"))
"""Whether the long forms of these tests run: SCPJAX_BENCH=1."""

_built: dict[str, tuple[Path, Path]] = {}


def make(kind: str, world: World | None = None, *, config: BoardConfig | None = None, seed: int = 0) -> BoardDevice:
    """A board of a kind with a configuration, in lock-step."""
    if kind == "emulator":
        return EmulatedDevice(world, config=config, seed=seed)
    if missing():
        pytest.skip(f"skipped: not installed: {missing()} (rig/simulation/install.sh)")
    key = "" if config is None else config.flags()
    if key not in _built:
        _built[key] = build(Path(tempfile.mkdtemp(prefix="scpjax-firmware-")), config)
    return SimulatedDevice(*_built[key], world, seed=seed + 1)


class Talk:
    """A host without manners: sends what it is told, and gives what came back."""

    def __init__(self, device: BoardDevice):
        self.device, self.decoder, self.number = device, Decoder(), 0
        device.open()
        self.wait(0.1)

    def wait(self, seconds: float) -> list:
        """Messages of the next seconds."""
        self.device.pause(seconds)
        data = b""
        while part := self.device._given():
            data += part
        return [parse(f) for f in self.decoder.feed(data)]

    def send(self, kind: str, *fields: int) -> int:
        self.number += 1
        self.device.write(command(kind, self.number, fields))
        return self.number

    def raw(self, data: bytes) -> None:
        self.device.write(data)

    def body(self, text: str) -> None:
        self.device.write(encode(text))

    def ask(self, kind: str, *fields: int) -> m.Reply:
        """The answer to a command."""
        number = self.send(kind, *fields)
        for _ in range(10):
            for message in self.wait(TICK_S):
                if isinstance(message, m.Reply) and message.to == number:
                    return message
        raise AssertionError(f"no answer to {kind}")

    def set(self, name: str, value: float) -> m.Reply:
        return self.ask("V", NAMES.index(name), to_bits(value))

    def until_off(self, most: float) -> float:
        """Seconds until both channels are off."""
        for k in range(round(most / TICK_S)):
            if self.device.duty() == (0.0, 0.0):
                return k * TICK_S
            self.wait(TICK_S)
        raise AssertionError(f"on for more than {most} s")


def of(kind: type, messages: list) -> list:
    """Those messages that are of a kind."""
    return [x for x in messages if isinstance(x, kind)]
