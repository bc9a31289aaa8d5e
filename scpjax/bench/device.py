"""Where bytes go to and come from: a serial port, or a board in this process with a clock of its own."""

from __future__ import annotations

import abc
import contextlib
import threading
import time
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from scpjax.bench.emulator import Board
from scpjax.bench.errors import BenchError, PortLost
from scpjax.bench.parameters import TICK_S, BoardConfig
from scpjax.bench.world import Still, World, convert

if TYPE_CHECKING:
    import serial

BAUD = 115200
Duty = tuple[float, float]


class AbstractDevice(abc.ABC):
    """A byte stream with a clock.

    ``lock_step``: time passes only in `read` and `pause`, so that a run is as fast as the machine and the same each
    time. Otherwise it is the wall clock, and `read` may be called from a thread of its own.
    """

    name: str = "board"
    lock_step: bool = False

    @abc.abstractmethod
    def open(self) -> None:
        """Begin; a second call after `close` begins anew. **Raises** `BenchError`."""

    @abc.abstractmethod
    def close(self) -> None:
        """End; never raises, and may be called twice."""

    @abc.abstractmethod
    def read(self, timeout: float) -> bytes:
        """What has come, waiting at most ``timeout`` [s] for the first byte. **Raises** `PortLost`."""

    @abc.abstractmethod
    def write(self, data: bytes) -> None:
        """Send all of it. **Raises** `PortLost`."""

    def now(self) -> float:
        """Seconds of this device's clock, which never goes back."""
        return time.monotonic()


class PortDevice(AbstractDevice):
    """A serial port (or pseudo-terminal), held for this program alone. Needs pyserial."""

    def __init__(self, port: str, *, baud: int = BAUD):
        self.name, self.baud = port, baud
        self._port: serial.Serial | None = None

    def open(self) -> None:
        """**Raises** `BenchError` for a port that is not there, may not be opened or belongs to another program."""
        serial = pyserial()
        try:
            self._port = serial.Serial(self.name, self.baud, timeout=0, write_timeout=0.5, exclusive=True)
        except serial.SerialException as error:
            text = str(error)
            if "exclusively lock" in text or "busy" in text.lower():
                raise BenchError(
                    "is in use by another program", where=self.name, mend="close it (another scpjax rig, a monitor)"
                ) from error
            if "Permission" in text:
                raise BenchError(
                    "may not be opened", where=self.name, mend="join its group: sudo usermod -aG dialout $USER"
                ) from error
            there = ", ".join(ports()) or "none"
            raise BenchError("no such port", where=self.name, mend=f"plug the board in; ports here: {there}") from error

    def close(self) -> None:
        port, self._port = self._port, None
        if port is not None:
            with contextlib.suppress(OSError, pyserial().SerialException):
                port.close()

    def read(self, timeout: float) -> bytes:
        # not readline(): its timeout begins anew with each byte, and a stream without newlines would hang it
        port = self._need()
        try:
            if port.timeout != timeout:  # setting it configures the port anew
                port.timeout = timeout
            first = port.read(1)
            return first + port.read(port.in_waiting) if first else b""
        except (
            OSError,
            TypeError,
            AttributeError,
        ) as error:  # pyserial's own is an OSError; the others: closed under it
            raise PortLost("the port is gone", where=self.name, mend="plug the board in again") from error

    def write(self, data: bytes) -> None:
        port = self._need()
        try:
            port.write(data)
        except (OSError, TypeError, AttributeError) as error:
            raise PortLost("the port is gone", where=self.name, mend="plug the board in again") from error

    def _need(self) -> serial.Serial:
        if self._port is None:
            raise PortLost("the port is closed", where=self.name, mend="open it first")
        return self._port


class BoardDevice(AbstractDevice):
    """A board in this process before a `World`; what kind of board, a subclass says.

    ``real_time``: the clock is the wall's, and `read` passes as many ticks as are due; else lock-step.
    """

    def __init__(self, world: World | None = None, *, real_time: bool = False):
        self.world = Still() if world is None else world
        self.lock_step = not real_time
        self.ticks = 0
        self._out = bytearray()
        self._began: float | None = None
        self._lock = threading.RLock()
        self._open = False

    @abc.abstractmethod
    def _tick(self) -> bytes:
        """Pass 5 ms of board and world."""

    @abc.abstractmethod
    def _take(self, data: bytes) -> None:
        """Bytes for the board."""

    @abc.abstractmethod
    def reset(self) -> None:
        """Press the reset button, as opening a port does on an Arduino."""

    @abc.abstractmethod
    def duty(self) -> Duty:
        """Shares of the supply at the channels now."""

    def open(self) -> None:
        with self._lock:
            self._out.clear()
            if self.ticks:
                self.reset()
            self._began = time.monotonic() - self.ticks * TICK_S
            self._open = True

    def close(self) -> None:
        self._open = False

    def now(self) -> float:
        return self.ticks * TICK_S if self.lock_step else time.monotonic()

    def write(self, data: bytes) -> None:
        with self._lock:
            self._check()
            self._take(data)

    def read(self, timeout: float) -> bytes:
        if self.lock_step:
            with self._lock:
                self._check()
                for _ in range(max(1, round(timeout / TICK_S))):
                    if self._out:
                        break
                    self._pass()
                return self._given()
        deadline = time.monotonic() + timeout
        while True:
            with self._lock:
                self._check()
                self._catch_up()
                if self._out or time.monotonic() >= deadline:
                    return self._given()
            time.sleep(TICK_S / 2)

    def pause(self, seconds: float) -> None:
        """Pass time though nobody reads, as when a host stalls; what the board sends in it waits to be read."""
        with self._lock:
            for _ in range(round(seconds / TICK_S)):
                self._pass()

    def _pass(self) -> None:
        self._out += self._tick()
        self.ticks += 1

    def _catch_up(self) -> None:
        assert self._began is not None
        while self._began + (self.ticks + 1) * TICK_S <= time.monotonic():
            self._pass()

    def _given(self) -> bytes:
        out = bytes(self._out)
        self._out.clear()
        return out

    def _check(self) -> None:
        if not self._open:
            raise PortLost("the port is closed", where=self.name, mend="open it first")


class EmulatedDevice(BoardDevice):
    """The board in Python (`scpjax.bench.emulator.Board`)."""

    name = "emulator"

    def __init__(
        self,
        world: World | None = None,
        *,
        config: BoardConfig | None = None,
        real_time: bool = False,
        seed: int = 0,
        board: Board | None = None,
    ):
        super().__init__(world, real_time=real_time)
        self.board = Board(config) if board is None else board
        self._rng = np.random.default_rng(seed)

    def _tick(self) -> bytes:
        duty = self.duty()
        if self.board.sense is not None:  # off while the wire is measured
            duty = (0.6 * duty[0], 0.6 * duty[1])
        self.world.advance(duty, TICK_S)
        return self.board.tick(convert(self.world, self._rng))

    def _take(self, data: bytes) -> None:
        self.board.receive(data)

    def reset(self) -> None:
        self.board.reset()

    def duty(self) -> Duty:
        a, b = self.board.driven
        return a / 255, b / 255


def pyserial() -> Any:
    """The module ``serial``. **Raises** `BenchError` that says how to install it."""
    try:
        import serial
    except ImportError as error:
        raise BenchError("pyserial is not installed", mend="run: pip install pyserial") from error
    return serial


_BOARDS = ("arduino", "ch340", "usb serial", "usb-serial", "cp210", "ft232", "ttyacm", "ttyusb", "usbmodem")


def ports() -> list[str]:
    """Serial ports of this machine, those that look like an Arduino first."""
    pyserial()
    from serial.tools import list_ports

    found = [p for p in list_ports.comports() if p.device is not None]

    def likely(port: Any) -> bool:
        words = f"{port.device} {port.description} {port.manufacturer}".lower()
        return any(w in words for w in _BOARDS)

    return [p.device for p in sorted(found, key=lambda p: (not likely(p), p.device))]


def _is_serial(name: str) -> bool:
    """Whether a port's name, in small letters, is that of a board; cu.Bluetooth-Incoming-Port of a Mac is not."""
    return name.startswith("com") or any(w in name for w in ("ttyacm", "ttyusb", "usbmodem", "usbserial"))


def find_port() -> str:
    """The port of the only board there is.

    **Raises** `BenchError` where there is none, or more than one.
    """
    there = [p for p in ports() if _is_serial(Path(p).name.lower())]
    if not there:
        raise BenchError("no board found", mend="plug it in, give --port, or try the bench with --port sim")
    if len(there) > 1:
        raise BenchError(f"{len(there)} ports: {', '.join(there)}", mend="choose one with --port")
    return there[0]
