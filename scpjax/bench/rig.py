"""A bench in use: `Rig`, which always ends with the power off."""

from __future__ import annotations

import contextlib
import os
import signal
import threading
from collections.abc import Iterator, Sequence
from types import FrameType, TracebackType
from typing import Any

from scpjax.bench import messages as m
from scpjax.bench.device import AbstractDevice
from scpjax.bench.errors import BenchError, NoAnswer, PortLost
from scpjax.bench.link import Link, RigOptions, Timed
from scpjax.bench.log import Log
from scpjax.bench.messages import Calibration, Reply, Resistance
from scpjax.bench.parameters import NAMES, TICK_S, from_bits, to_bits
from scpjax.bench.wiring import SOURCES, Wiring
from scpjax.errors import ScpjaxError

__all__ = ["Rig", "RigOptions"]


class Rig(Link):
    """A board on a device, as a context manager: on the way out, whatever the reason, the power is switched off.

    Signs of life go out only while this object is waited on (`wait`, `samples`, any command): a program that stalls
    loses the drive within a second, by the board's own watchdog. SIGTERM and SIGHUP end the block as an exception does.

    **Raises** on the way in `BenchError`: no board, another program on the port, a wrong version; and from every call
    `PortLost`, `BoardReset`, `BoardFault` (the board cut the power) or `BenchError` (the disk is full).
    """

    def __init__(self, device: AbstractDevice, wiring: Wiring | None = None, *, options: RigOptions | None = None):
        super().__init__(device, options or RigOptions())
        self.wiring = wiring or Wiring()
        self._log: Log | None = None
        self._began: float | None = None
        self._signals: dict[int, Any] = {}

    # -- coming and going ----------------------------------------------------------------------------------------

    def __enter__(self) -> Rig:
        self._catch_signals()
        try:
            self._connect()
        except BaseException:
            self._disconnect()
            self._release_signals()
            raise
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        try:
            with self._undisturbed():
                self.power_off()
                self._disconnect()
                self.end_recording()
        finally:
            self._release_signals()

    def power_off(self) -> bool:
        """Switch both channels off; never raises. False where the board could not be reached: its watchdog does it."""
        for _ in range(self.options.tries + 1):
            try:
                if self._ask("S", tries=1).status == m.OK:
                    return True
            except NoAnswer:
                continue
            except ScpjaxError:
                if self._lost():
                    return False
                self._failed = self._cut = None  # a full disk or a fault does not keep us from asking once more
        return False

    def _lost(self) -> bool:
        return isinstance(self._failed, PortLost)

    def _connect(self) -> None:
        super()._connect()
        if self.wiring.position.source in SOURCES:
            self.set("position_source", float(SOURCES.index(self.wiring.position.source)))

    # -- commands ------------------------------------------------------------------------------------------------

    def ask(self, kind: str, *fields: int) -> int:
        """Send a command and give the value of its answer. **Raises** `BenchError` when the board refuses."""
        return self._accepted(kind, self._ask(kind, *fields))

    def begin(self, kind: str, *fields: int) -> None:
        """Let a board that stands idle play or close a loop (``P``, ``C``). **Raises** `BenchError` when it refuses."""
        try:
            reply = self._ask(kind, *fields, tries=1)
        except NoAnswer:
            reply = self._ask(kind, *fields)
            if reply.status == m.BUSY:  # it had begun at the first: its answer was lost
                return
        self._accepted(kind, reply)

    def _accepted(self, kind: str, reply: Reply) -> int:
        if reply.status != m.OK:
            words = m.REFUSALS.get(reply.status, f"status {reply.status}")
            mend = "clear_fault() when it has cooled" if reply.status == m.FAULTY else "see scpjax.bench.messages"
            raise BenchError(f"command {kind} refused: {words}", where=self.device.name, mend=mend)
        return reply.value

    def stream(self, every: int) -> None:
        """A sample each ``every`` ticks of 5 ms; 0 for none."""
        self.ask("R", every)
        self._every = max(every, 1)

    @property
    def period(self) -> float:
        """Seconds from sample to sample."""
        return self._every * TICK_S

    def set_pwm(self, *counts: int) -> None:
        """Hold these PWM counts, 0 to 255, one for each side; not waited for, for loops on the host."""
        pair = (*counts, 0)[:2]
        self._send("W", *pair)

    def set_voltage(self, *volts: float) -> None:
        """Hold root mean square voltages [V], one for each side."""
        self.ask("W", *(*(int(p) for p in self.wiring.pwm(list(volts))), 0)[:2])

    def append(self, index: int, entries: Sequence[int]) -> int:
        """Append entries to the board's table, of which the first has this index; the room left after it.

        -1 where there is no room for them. **Raises** `BenchError` for an index that is not the next.
        """
        reply = self._ask("T", index & 0xFFFF, *entries)
        received, room = reply.value >> 16, reply.value & 0xFFFF
        if reply.status == m.FULL:
            return -1
        if reply.status != m.OK and received != (index + len(entries)) & 0xFFFF:  # else an answer was lost
            raise BenchError(
                f"table entry {index} refused; the board has {received}", where=self.device.name, mend="stop() first"
            )
        return room

    def stop(self) -> None:
        """Both channels off, the table empty."""
        self.ask("S")

    def clear_fault(self) -> None:
        """Clear what lasts. **Raises** `BenchError` while it is still too hot, or what else it was."""
        self.ask("F")
        with self._news:
            self._cut = None

    def hang(self) -> None:
        """Let the firmware hang, to see its hardware watchdog begin anew within 0.3 s (`BoardReset` while waiting).

        The board refuses where it would bring an actuator to a limit.
        """
        self._send("X", 0xDEAD)

    def get(self, name: str) -> float:
        """A parameter of the board (`scpjax.bench.parameters`)."""
        return from_bits(self.ask("U", _index(name)))

    def accepts(self, name: str, value: float) -> bool:
        """Set a parameter where the board takes this value for it; whether it did."""
        return self._ask("V", _index(name), to_bits(value)).status == m.OK

    def set(self, name: str, value: float) -> float:
        """Set a parameter; limits can only be made tighter. **Raises** `BenchError` when the board refuses."""
        return from_bits(self.ask("V", _index(name), to_bits(value)))

    def calibrate(self) -> Calibration:
        """Mean readings over 64 ticks with the power off; thermistors plugged in since the boot are found."""
        with self._news:
            self._calibration = None
        self.ask("K")
        return self._until(lambda: self._calibration, 2.0, "calibrate", beats=True)

    def resistance(self, side: int = 0) -> float:
        """Resistance [ohm] of a heater wire, by the sensing current (thesis 3.3.2); the drive pauses for 2 ms."""
        with self._news:
            seen = len(self.resistances)
        self.ask("Z", side)

        def new() -> Resistance | None:
            return self.resistances[seen] if len(self.resistances) > seen else None

        return self.wiring.resistance(self._until(new, 1.0, "resistance", beats=True))

    # -- recording -----------------------------------------------------------------------------------------------

    def _keep_bytes(self, data: bytes) -> None:
        if self._log is not None:
            self._log.raw(data)

    def _keep_samples(self, samples: Sequence[Timed]) -> None:
        if self._log is None or not samples:
            return
        if self._began is None:
            self._began = samples[0][0]
        began = self._began
        self._log.rows_of([(time - began, self.wiring.row(sample)) for time, sample in samples])

    def record(self, path: str | os.PathLike[str], *, title: str = "", known: dict[str, float] | None = None) -> Log:
        """Write what comes from now on to a file (CSV, TOML, raw bytes) until `end_recording`."""
        self.end_recording()
        log = Log(path, self.wiring, title=title, known=known)
        with self._news:
            log.raw(self._decoder.pending)
            self._began = None
            self._log = log
        return log

    def end_recording(self) -> None:
        """End the recording, if there is one."""
        with self._news:
            log, self._log = self._log, None
        if log is not None:
            with contextlib.suppress(ScpjaxError):  # a full disk must not hide why we leave
                log.close({"device": self.device.name, **self.quality.to_json()})

    def mark(self, text: str) -> float:
        """A remark in the recording at the time of the latest sample [s]; may come from any thread."""
        with self._news:
            at = self._time - (self._began or 0.0)
            if self._log is not None:
                self._log.mark(at, text)
            return at

    # -- signals -------------------------------------------------------------------------------------------------

    def _catch_signals(self) -> None:
        if threading.current_thread() is not threading.main_thread():
            return
        for number in (signal.SIGTERM, getattr(signal, "SIGHUP", None)):
            if number is not None:
                self._signals[number] = signal.signal(number, _leave)

    def _release_signals(self) -> None:
        for number, before in self._signals.items():
            signal.signal(number, signal.SIG_DFL if before is None else before)
        self._signals.clear()

    @contextlib.contextmanager
    def _undisturbed(self) -> Iterator[None]:
        """Further signals wait until the power is off."""
        if threading.current_thread() is not threading.main_thread():
            yield
            return
        before = {n: signal.signal(n, signal.SIG_IGN) for n in (signal.SIGINT, signal.SIGTERM)}
        try:
            yield
        finally:
            for number, handler in before.items():
                signal.signal(number, signal.SIG_DFL if handler is None else handler)


def _leave(number: int, frame: FrameType | None) -> None:
    raise SystemExit(128 + number)


def _index(name: str) -> int:
    if name not in NAMES:
        raise BenchError(f"no parameter {name!r}", mend=f"use one of {', '.join(NAMES)}")
    return NAMES.index(name)


def pairs(first: Sequence[int], second: Sequence[int]) -> list[int]:
    """Table entries of the counts of both channels."""
    return [int(a) << 8 | int(b) for a, b in zip(first, second, strict=True)]
