"""Ports and hosts for tests of what goes wrong."""

import os
import threading

import pytest

from scpjax.bench.device import PortDevice
from scpjax.bench.parameters import TICK_S
from scpjax.bench.rig import RigOptions

pty = pytest.mark.skipif(not hasattr(os, "openpty"), reason="skipped: no pseudo-terminals here")
FAST = RigOptions(every=1)


def ours():
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
