"""A bench in use: `Rig`, which always ends with the power off."""

from __future__ import annotations

import contextlib
import os
import signal
import threading
from collections import deque
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from types import FrameType, TracebackType
from typing import Any, TypeVar

from scpjax.bench import messages as m
from scpjax.bench.device import AbstractDevice
from scpjax.bench.errors import BenchError, BoardFault, BoardReset, NoAnswer, PortLost
from scpjax.bench.frames import Decoder, command
from scpjax.bench.log import Log
from scpjax.bench.messages import Banner, Calibration, Event, Message, Reply, Resistance, Sample, parse
from scpjax.bench.parameters import NAMES, TICK_S, from_bits, to_bits
from scpjax.bench.quality import Quality
from scpjax.bench.wiring import Wiring
from scpjax.errors import ScpjaxError

T = TypeVar("T")


@dataclass(frozen=True, kw_only=True)
class RigOptions:
    """``every``: ticks of 5 ms from sample to sample; ``answer_s`` and ``tries`` of a command; ``handshake_s``: how
    long a board may take to boot; ``beat_s``: a sign of life to the board so often while waiting; ``keep``: samples
    kept for who reads them late (a recording has them all)."""

    every: int = 10
    answer_s: float = 0.3
    tries: int = 4
    handshake_s: float = 5.0
    beat_s: float = 0.25
    keep: int = 4096


class Rig:
    """A board on a device, as a context manager: on the way out, whatever the reason, the power is switched off.

    Signs of life go out only while this object is waited on (`wait`, `samples`, any command): a program that stalls
    loses the drive within a second, by the board's own watchdog. SIGTERM and SIGHUP end the block as an exception does.

    **Raises** on the way in `BenchError`: no board, another program on the port, a wrong version; and from every call
    `PortLost`, `BoardReset`, `BoardFault` (the board cut the power) or `BenchError` (the disk is full).
    """

    def __init__(self, device: AbstractDevice, wiring: Wiring | None = None, *, options: RigOptions | None = None):
        self.device, self.wiring = device, wiring or Wiring()
        self.options = options or RigOptions()
        self.quality = Quality()
        self.banner: Banner | None = None
        self.last: Sample | None = None
        self.events: list[Event] = []
        self.resistances: list[Resistance] = []
        self.listener: Callable[[float, Sample], None] | None = None  # told every sample, by whoever reads
        self._news = threading.Condition(threading.RLock())
        self._decoder = Decoder()
        self._replies: dict[int, Reply] = {}
        self._asked: set[int] = set()
        self._samples: deque[tuple[float, Sample]] = deque(maxlen=self.options.keep)
        self._calibration: Calibration | None = None
        self._number = 0
        self._beaten = 0.0
        self._failed: ScpjaxError | None = None
        self._cut: Event | None = None
        self._began: float | None = None
        self._time = 0.0
        self._arrival: float | None = None
        self._every = self.options.every
        self._log: Log | None = None
        self._reader: threading.Thread | None = None
        self._leaving = threading.Event()
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

    def _connect(self) -> None:
        self.device.open()
        self._failed, self._cut = None, None
        self._leaving.clear()
        self._decoder = Decoder()
        self.quality.restart(0.0 if self._arrival is None else max(self.device.now() - self._arrival, TICK_S))
        if not self.device.lock_step:
            self._reader = threading.Thread(target=self._read_on, name="scpjax-rig-reader", daemon=True)
            self._reader.start()
        self._handshake()
        self.stream(self.options.every)

    def _disconnect(self) -> None:
        self._leaving.set()
        reader, self._reader = self._reader, None
        if reader is not None:
            reader.join(2.0)
        self.device.close()
        if reader is not None and reader.is_alive():
            reader.join(2.0)

    def reconnect(self, timeout: float = 10.0) -> None:
        """Open a lost port anew, trying for ``timeout`` [s]; the drive stays off and a recording goes on after a gap.

        **Raises** `PortLost` when it does not come back.
        """
        deadline = self.device.now() + timeout
        while True:
            self._disconnect()
            try:
                self._connect()
                return
            except BenchError as error:
                if self.device.now() >= deadline:
                    raise PortLost(
                        f"did not come back within {timeout:g} s", where=self.device.name, mend="check the cable"
                    ) from error
            if self.device.lock_step:
                break
            self._leaving.wait(0.2)
        raise PortLost("did not come back", where=self.device.name, mend="check the cable")

    def _handshake(self) -> None:
        self.banner = None
        deadline = self.device.now() + self.options.handshake_s
        while self.banner is None:
            self._send("?")
            with contextlib.suppress(NoAnswer):
                self._until(lambda: self.banner, self.options.answer_s, "")
            if self.banner is None and self.device.now() >= deadline:
                raise NoAnswer(
                    "no scpjax board answers",
                    where=self.device.name,
                    mend="flash rig/firmware (make flash PORT=...), or choose another --port",
                )
        b = self.banner
        if b.name != m.NAME or b.protocol != m.PROTOCOL:
            raise BenchError(
                f"the board runs {b.name} {b.version} with protocol {b.protocol}, this program speaks {m.PROTOCOL}",
                where=self.device.name,
                mend="flash the firmware that came with this scpjax (rig/firmware: make flash PORT=...)",
            )

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

    # -- reading -------------------------------------------------------------------------------------------------

    def _read_on(self) -> None:
        while not self._leaving.is_set():
            try:
                self._pump(0.05)
            except ScpjaxError as error:
                self._fail(error)
                if isinstance(error, PortLost):
                    return

    def _fail(self, error: ScpjaxError) -> None:
        with self._news:
            if self._failed is None:
                self._failed = error
            self._news.notify_all()

    def _pump(self, timeout: float) -> None:
        """Read once: to disk first, then parsed."""
        data = self.device.read(timeout)
        if not data:
            return
        arrival = self._arrival = self.device.now()
        with self._news:
            failed: ScpjaxError | None = None
            if self._log is not None:
                try:
                    self._log.raw(data)
                except BenchError as error:
                    failed = error
            rows: list[tuple[float, list[float]]] = []
            for frame in self._decoder.feed(data):
                message = parse(frame)
                if message is None:
                    self._decoder.damaged += 1
                else:
                    self._take(message, arrival, rows)
            self.quality.damaged, self.quality.stray = self._decoder.damaged, self._decoder.stray
            if self._log is not None and failed is None:
                self._log.rows_of(rows)
            self._news.notify_all()
            if failed is not None:
                raise failed

    def _take(self, message: Message, arrival: float, rows: list[tuple[float, list[float]]]) -> None:
        if isinstance(message, Banner):
            began_anew = message.sequence == 1
            if began_anew:
                self.quality.restart()
                if self.banner is not None:
                    mend = "check its supply and the USB cable; the recording up to here is kept"
                    self._fail(BoardReset("the board began anew", where=self.device.name, mend=mend))
            self.quality.number(message.sequence)
            self.banner = message
            return
        if not self.quality.number(message.sequence):
            return
        if isinstance(message, Sample):
            self._time = self.quality.time_of(message, arrival, self._every * TICK_S)
            self.last = message
            if len(self._samples) == self._samples.maxlen:
                self.quality.unread += 1
            self._samples.append((self._time, message))
            if self.listener is not None:
                self.listener(self._time, message)
            if self._log is not None and not isinstance(self._failed, BoardReset):
                if self._began is None:
                    self._began = self._time
                rows.append((self._time - self._began, self.wiring.row(message)))
        elif isinstance(message, Reply):
            if message.to in self._asked:
                self._replies[message.to] = message
        elif isinstance(message, Event):
            self.events.append(message)
            if message.what != m.TABLE_END:
                self._cut = message
        elif isinstance(message, Calibration):
            self._calibration = message
        else:
            self.resistances.append(message)

    # -- waiting -------------------------------------------------------------------------------------------------

    def _until(self, done: Callable[[], T | None], timeout: float, what: str, *, beats: bool = False) -> T:
        """Wait for a value. **Raises** `NoAnswer` after ``timeout``, and what failed meanwhile."""
        deadline = self.device.now() + timeout
        while True:
            with self._news:
                self._check()
                found = done()
                if found is not None:
                    return found
                left = deadline - self.device.now()
                if left <= 1e-9:
                    mend = "check the cable, and that no other program holds the port"
                    raise NoAnswer(f"no answer to {what}", where=self.device.name, mend=mend)
                if not self.device.lock_step:
                    self._news.wait(min(left, 0.05))
            if self.device.lock_step:
                self._pump(min(left, 0.05))
            if beats:
                self._beat()

    def _check(self) -> None:
        if self._failed is not None:
            raise self._failed
        cut, self._cut = self._cut, None
        if cut is not None:
            side = ("agonist", "antagonist")[cut.channel & 1]
            mend = "let it cool, then clear the fault" if cut.what in m.LASTING else "keep waiting on the rig"
            raise BoardFault(
                f"the board cut the power: {m.FAULTS[cut.what]} ({side})", where=self.device.name, mend=mend
            )

    def _beat(self) -> None:
        if self.device.now() - self._beaten >= self.options.beat_s:
            self._send("H")

    def wait(self, seconds: float, until: Callable[[], bool] | None = None) -> None:
        """Let time pass with the board kept alive; ends early when ``until()`` is true."""

        def done() -> bool | None:
            return True if until is not None and until() else None

        with contextlib.suppress(NoAnswer):
            self._until(done, seconds, "", beats=True)

    def samples(self, seconds: float) -> Iterator[tuple[float, Sample]]:
        """Samples of the next ``seconds``, each with its time [s] on the board's clock, as they come."""
        with self._news:
            self._samples.clear()
        deadline = self.device.now() + seconds
        while (left := deadline - self.device.now()) > 1e-9:
            try:
                yield self._until(self._next_sample, left, "", beats=True)
            except NoAnswer:
                return

    def unread(self) -> list[tuple[float, Sample]]:
        """Samples that came since `samples` or this was last called, of which `RigOptions.keep` are kept."""
        with self._news:
            out = list(self._samples)
            self._samples.clear()
        return out

    def _next_sample(self) -> tuple[float, Sample] | None:
        return self._samples.popleft() if self._samples else None

    # -- commands ------------------------------------------------------------------------------------------------

    def _send(self, kind: str, *fields: int) -> int:
        self._number = (self._number + 1) & 0xFFFF
        self._beaten = self.device.now()
        try:
            self.device.write(command(kind, self._number, fields))
        except PortLost as error:
            self._fail(error)
            raise
        return self._number

    def _ask(self, kind: str, *fields: int, tries: int | None = None) -> Reply:
        """Send a command until it is answered; the board's commands may come twice without harm."""
        error: NoAnswer | None = None
        for _ in range(self.options.tries if tries is None else tries):
            number = self._send(kind, *fields)
            with self._news:
                self._asked.add(number)
            try:
                return self._until(lambda n=number: self._replies.get(n), self.options.answer_s, f"command {kind}")
            except NoAnswer as late:
                error = late
            finally:
                with self._news:
                    self._asked.discard(number)
                    self._replies.pop(number, None)
        assert error is not None
        raise error

    def ask(self, kind: str, *fields: int) -> int:
        """Send a command and give the value of its answer. **Raises** `BenchError` when the board refuses."""
        reply = self._ask(kind, *fields)
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
