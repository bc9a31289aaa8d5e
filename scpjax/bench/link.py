"""The line to a board: reading, what every message does, waiting, commands and their answers."""

from __future__ import annotations

import contextlib
import threading
from collections import deque
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from typing import TypeVar

from scpjax.bench import messages as m
from scpjax.bench.device import AbstractDevice
from scpjax.bench.errors import BenchError, BoardFault, BoardReset, NoAnswer, PortLost
from scpjax.bench.frames import Decoder, command
from scpjax.bench.messages import Banner, Calibration, Event, Message, Reply, Resistance, Sample, parse
from scpjax.bench.parameters import TICK_S
from scpjax.bench.quality import Quality
from scpjax.errors import ScpjaxError

T = TypeVar("T")
Timed = tuple[float, Sample]


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


class Link:
    """A board on a device. A thread reads and takes messages in, or whoever waits where the device is in lock-step."""

    def __init__(self, device: AbstractDevice, options: RigOptions):
        self.device, self.options = device, options
        self.quality = Quality()
        self.banner: Banner | None = None
        self.last: Sample | None = None
        self.events: list[Event] = []
        self.resistances: list[Resistance] = []
        self.listener: Callable[[float, Sample], None] | None = None  # told every sample, by whoever reads
        lock = threading.RLock()
        self._news = threading.Condition(lock)
        self._trouble = threading.Condition(lock)  # of the same lock: for those who wait for nothing else
        self._decoder = Decoder()
        self._replies: dict[int, Reply] = {}
        self._asked: set[int] = set()
        self._samples: deque[Timed] = deque(maxlen=options.keep)
        self._calibration: Calibration | None = None
        self._number = 0
        self._beaten = 0.0
        self._failed: ScpjaxError | None = None
        self._cut: Event | None = None
        self._time = 0.0
        self._arrival: float | None = None
        self._every = options.every
        self._reader: threading.Thread | None = None
        self._leaving = threading.Event()

    def _keep_bytes(self, data: bytes) -> None:
        """Told what came before it is looked at. May raise `BenchError`."""

    def _keep_samples(self, samples: Sequence[Timed]) -> None:
        """Told the samples of a reading. May raise `BenchError`."""

    # -- coming and going ---------------------------------------------------------------------------------------

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
        self._ask("R", self._every)

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
            self._trouble.notify_all()

    def _pump(self, timeout: float) -> None:
        """Read once: to disk first, then parsed."""
        data = self.device.read(timeout)
        if not data:
            return
        arrival = self._arrival = self.device.now()
        with self._news:
            failed: ScpjaxError | None = None
            try:
                self._keep_bytes(data)
            except BenchError as error:
                failed = error
            fresh: list[Timed] = []
            for frame in self._decoder.feed(data):
                message = parse(frame)
                if message is None:
                    self._decoder.damaged += 1
                else:
                    self._take(message, arrival, fresh)
            self.quality.damaged, self.quality.stray = self._decoder.damaged, self._decoder.stray
            self._news.notify_all()
            if failed is not None:
                raise failed
            self._keep_samples(fresh)

    def _take(self, message: Message, arrival: float, fresh: list[Timed]) -> None:
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
            if not isinstance(self._failed, BoardReset):
                fresh.append((self._time, message))
        elif isinstance(message, Reply):
            if message.to in self._asked:
                self._replies[message.to] = message
        elif isinstance(message, Event):
            self.events.append(message)
            if message.what != m.TABLE_END:
                self._cut = message
                self._trouble.notify_all()
        elif isinstance(message, Calibration):
            self._calibration = message
        else:
            self.resistances.append(message)

    # -- waiting -------------------------------------------------------------------------------------------------

    def _until(
        self, done: Callable[[], T | None], timeout: float, what: str, *, beats: bool = False, looks: bool = True
    ) -> T:
        """Wait for a value, looking for it at every reading unless ``looks`` is False.

        **Raises** `NoAnswer` after ``timeout``, and what failed meanwhile.
        """
        told = self._news if looks else self._trouble
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
                    told.wait(min(left, 0.05))
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
            self._until(done, seconds, "", beats=True, looks=until is not None)

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

    # -- commands -----------------------------------------------------------------------------------------------

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
