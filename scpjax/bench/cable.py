"""A pseudo-terminal between a board in this process and a program that opens a port: for tests and for trying things.

It has no modem lines, and opening it does not reset the board; its speed is that of the machine.
"""

from __future__ import annotations

import contextlib
import os
import select
import threading
import time
import tty

from scpjax.bench.device import BoardDevice
from scpjax.bench.parameters import TICK_S


class Cable:
    """Runs a lock-step board at real time in a thread and joins it to a pseudo-terminal, whose name is ``port``."""

    def __init__(self, device: BoardDevice):
        self.device = device
        device.open()
        self._master, self._slave = os.openpty()
        tty.setraw(self._master)
        tty.setraw(self._slave)
        os.set_blocking(self._master, False)
        self.port = os.ttyname(self._slave)
        self.late = 0
        self._pulled = threading.Event()
        self._thread = threading.Thread(target=self._run, name="scpjax-cable", daemon=True)
        self._thread.start()

    def _run(self) -> None:
        due = time.monotonic()
        waiting = b""
        while not self._pulled.is_set():
            due += TICK_S
            delay = due - time.monotonic()
            if delay > 0:
                self._pulled.wait(delay)
            elif delay < -1.0:
                self.late += 1
                due = time.monotonic()
            if self._pulled.is_set():
                break
            with contextlib.suppress(BlockingIOError):
                if select.select([self._master], [], [], 0)[0]:
                    self.device.write(os.read(self._master, 4096))
            waiting = (waiting + self.device.read(TICK_S))[-4096:]
            with contextlib.suppress(BlockingIOError):
                waiting = waiting[os.write(self._master, waiting) :] if waiting else b""

    def babble(self, data: bytes) -> None:
        """Put bytes on the line that no board sent."""
        with contextlib.suppress(BlockingIOError):
            os.write(self._master, data)

    def pull(self) -> None:
        """Pull it: the port is gone for the program, the board goes on alone (`BoardDevice.pause`)."""
        if self._pulled.is_set():
            return
        self._pulled.set()
        self._thread.join(5.0)
        os.close(self._slave)
        os.close(self._master)
