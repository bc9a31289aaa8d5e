"""The firmware in Python, tick by tick: the same protocol, limits and controller as ``rig/firmware``.

For machines without the AVR's tools, for faults that a simulator cannot have, and for speed. The tests that say so run
on this and on the compiled firmware alike.
"""

from __future__ import annotations

from collections.abc import Callable

from scpjax.bench import messages as m
from scpjax.bench.frames import Frame, decode, encode
from scpjax.bench.guard import CHANNELS, Inputs
from scpjax.bench.onboard import SLOTS, Controls
from scpjax.bench.parameters import NAMES, TICK_HZ, TICK_S, BoardConfig, from_bits, single, to_bits

_SHAPES = {"?": (0, 0), "H": (0, 0), "W": (2, 2), "R": (1, 1), "T": (2, 13), "P": (2, 2), "C": (2, 2), "V": (2, 2),
           "U": (1, 1), "K": (0, 0), "Z": (1, 1), "S": (0, 0), "F": (0, 0), "X": (1, 1)}  # fmt: skip
_HANG_TICKS = 50
_PINS = "3:9:A0:A1:A2:A3:A4:A5:7:8:5:6:2:4"
_LONGEST = 96
_POWER_ON, _EXTERNAL, _WATCHDOG = 1, 2, 8


class Board(Controls):
    """One board: `receive` takes bytes from the host, `tick` passes 5 ms and gives the bytes for it.

    ``driven`` holds the PWM counts at the pins, ``counts`` those from the next tick on: what is to be applied is
    charged to the actuators first, so that nothing that comes later can take it back. Until the first `tick` after a
    reset nothing is sent.
    """

    def __init__(self, config: BoardConfig | None = None, version: str = "1.0.1", protocol: int = m.PROTOCOL):
        self.version, self.protocol = version, protocol
        self.resets = -1
        super().__init__(config or BoardConfig())
        self.reset(_POWER_ON)

    # -- life ---------------------------------------------------------------------------------------------------

    def reset(self, cause: int = _EXTERNAL) -> None:
        """As the reset button (or the watchdog) does; what an actuator has had is remembered."""
        self.resets += 1
        self.cause = cause
        self._forget()
        self.host_age = 0
        self.stream_every = self.stream_wait = 0
        self.sense: int | None = None
        self.sensed: int | None = None
        self.calibration_left, self.calibration = 0, [0, 0, 0, 0]
        self.sequence = self.bad = 0
        self.hanging = 0
        self._line, self._inside = bytearray(), False
        self._out = bytearray()
        self._booting = True
        self.clock_us = 0

    def tick(self, inputs: Inputs) -> bytes:
        """Pass 5 ms with these readings at their end; the bytes that the board sends in them."""
        self.clock_us += round(1e6 * TICK_S)
        self.inputs = inputs
        if self.hanging:
            self.hanging -= 1
            if self.hanging == 0:
                self.reset(_WATCHDOG)
            return b""
        if self._booting:
            self._booting = False
            self._remember()
            self._banner()
            return self._sent()
        self.sensed, self.sense = self.sense, None
        if self.mode == m.LOOP and self._get("position_source") == 1 and self._position() == 0:
            self._stop()
            self._event(m.SENSOR_LOST, 0)
        ended = self._step()
        if ended:
            self._event(ended, 0)
        self._watch()
        self.driven = list(self.counts)
        self._calibrate_tick()
        self._stream()
        if self.sensed is not None:
            self._send("Z", f"{self.sensed:X}", f"{inputs.sums[4 + self.sensed]:03X}")
            self.sensed = None
        return self._sent()

    def _sent(self) -> bytes:
        out = bytes(self._out)
        self._out.clear()
        return out

    def _watch(self) -> None:
        self._charge()
        met, channel = self._met()
        self.host_age += 1
        if met and not self.fault:
            self.fault = met
            self._stop()
            self._event(met, channel)
        elif self.mode != m.IDLE and self.host_age > self._get("host_timeout") * TICK_HZ:
            self._stop()
            self._event(m.HOST_TIMEOUT, 0)

    def _calibrate_tick(self) -> None:
        if not self.calibration_left:
            return
        s = self.inputs.sums
        for i, value in enumerate((s[0], s[1], self._position(), s[3])):
            self.calibration[i] += value
        self.calibration_left -= 1
        if self.calibration_left == 0:
            self._look_for_sensors()
            self._send("K", *(f"{v:06X}" for v in self.calibration))

    def _stream(self) -> None:
        if not self.stream_every:
            return
        if self.stream_wait:
            self.stream_wait -= 1
            return
        self.stream_wait = self.stream_every - 1
        s, (a, b) = self.inputs.sums, self.driven
        flags = self.mode | self.fault << 2 | self.fitted << 6
        self._send("D", f"{a:02X}{b:02X}{flags:02X}", f"{s[0]:03X}{s[1]:03X}", f"{self._position():04X}", f"{s[3]:03X}")

    # -- protocol ------------------------------------------------------------------------------------------------

    def _send(self, kind: str, *fields: str) -> None:
        self.sequence = (self.sequence + 1) & 0xFFFF
        self._out += encode(",".join((kind, f"{self.sequence:04X}", f"{self.clock_us & 0xFFFFFFFF:08X}", *fields)))

    def _event(self, what: int, channel: int) -> None:
        self._send("E", f"{what:02X}", f"{channel:X}")

    def _banner(self) -> None:
        limits = (self._get(n) for n in ("max_temperature", "max_energy", "sustained_power", "max_on", "max_current"))
        self._send("B", m.NAME, str(self.protocol), self.version, f"{self.cause:02X}", str(TICK_HZ), _PINS,
                   *(str(int(x)) for x in limits))  # fmt: skip

    def receive(self, data: bytes) -> None:
        """Bytes from the host."""
        if self.hanging or self._booting:
            return
        for byte in data:
            if byte == 0x24:  # $
                self.bad += self._inside
                self._inside = True
                self._line.clear()
            elif self._inside and byte == 0x0A:
                self._inside = False
                self._whole(bytes(self._line))
                if self.hanging:
                    return
            elif self._inside and byte != 0x0D:
                if len(self._line) == _LONGEST:
                    self._inside = False
                    self.bad += 1
                else:
                    self._line.append(byte)

    def _whole(self, line: bytes) -> None:
        frame = decode(line)
        try:
            numbers = None if frame is None else [_hexadecimal(f) for f in frame.fields]
        except ValueError:
            numbers = None
        if frame is None or not numbers or len(numbers) > 15:
            self.bad += 1
            return
        self.host_age = 0
        status, value = self._obey(frame, numbers[1:])
        if not self.hanging:
            self._send("A", f"{numbers[0] & 0xFFFF:04X}", f"{status:X}", f"{value:08X}")

    def _obey(self, frame: Frame, f: list[int]) -> tuple[int, int]:
        shape = _SHAPES.get(frame.kind)
        if shape is None:
            return m.UNKNOWN, 0
        if not shape[0] <= len(f) <= shape[1]:
            return m.BAD_ARGUMENTS, 0
        act: Callable[[list[int]], tuple[int, int] | int] = getattr(self, f"_do_{_WORDS[frame.kind]}")
        answer = act(f)
        return answer if isinstance(answer, tuple) else (answer, 0)

    def _do_hello(self, f: list[int]) -> int:
        self._banner()
        return m.OK

    def _do_beat(self, f: list[int]) -> tuple[int, int]:
        return m.OK, (self.bad & 0xFFFF) << 16 | self.fault << 8 | self.mode

    def _do_hold(self, f: list[int]) -> int:
        if self.fault:
            return m.FAULTY
        if self.mode not in (m.IDLE, m.HOLD):
            return m.BUSY
        if max(f) > 255:
            return m.OUT_OF_RANGE
        self.mode, self.counts = m.HOLD, list(f)
        return m.OK

    def _do_rate(self, f: list[int]) -> int:
        if f[0] > 255:
            return m.OUT_OF_RANGE
        self.stream_every, self.stream_wait = f[0], 0
        return m.OK

    def _do_table(self, f: list[int]) -> tuple[int, int]:
        status, free = m.OK, SLOTS - 1 - len(self.table)
        if len(f) - 1 > free:
            status = m.FULL
        else:
            for i, entry in enumerate(f[1:]):
                if (f[0] + i) & 0xFFFF != self.given:
                    status = m.OUT_OF_RANGE
                else:
                    self.table.append(entry & 0xFFFF)
                    self.given = (self.given + 1) & 0xFFFF
        return status, self.given << 16 | (SLOTS - 1 - len(self.table))

    def _do_play(self, f: list[int], mode: int = m.PLAY) -> int:
        if self.fault:
            return m.FAULTY
        if self.mode != m.IDLE:
            return m.BUSY
        if f[0] > 255 or f[1] > 0xFFFF:
            return m.OUT_OF_RANGE
        if not self.table or f[0] == 0 or f[1] == 0:
            return m.BAD_ARGUMENTS
        self.mode, self.per_entry, self.entries, self.wait = mode, f[0], f[1], 0
        self.counts, self.pids = [0, 0], [[0.0, 0.0], [0.0, 0.0]]
        self.stream_wait = 0  # in step with the table, so that a sample shows what the controller saw
        return m.OK

    def _do_loop(self, f: list[int]) -> int:
        return self._do_play(f, m.LOOP)

    def _do_set(self, f: list[int]) -> tuple[int, int]:
        if f[0] >= len(NAMES):
            return m.OUT_OF_RANGE, 0
        value = from_bits(f[1])
        if not self.parameters[f[0]].accepts(value, self.values[f[0]]):
            return m.OUT_OF_RANGE, 0
        self.values[f[0]] = single(value)
        self._find_threshold()
        return m.OK, to_bits(value)

    def _do_get(self, f: list[int]) -> tuple[int, int]:
        return (m.OUT_OF_RANGE, 0) if f[0] >= len(NAMES) else (m.OK, to_bits(self.values[f[0]]))

    def _do_calibrate(self, f: list[int]) -> int:
        if self.mode != m.IDLE:
            return m.BUSY
        self.calibration_left, self.calibration = m.Calibration.TICKS, [0, 0, 0, 0]
        return m.OK

    def _do_sense(self, f: list[int]) -> int:
        if f[0] >= CHANNELS:
            return m.OUT_OF_RANGE
        self.sense = f[0]
        return m.OK

    def _do_stop(self, f: list[int]) -> int:
        self._stop()
        return m.OK

    def _do_clear(self, f: list[int]) -> int:
        if self.fault and not self._may_clear():
            return m.FAULTY
        self.fault = m.NO_FAULT
        return m.OK

    def _do_hang(self, f: list[int]) -> int:
        if f[0] != 0xDEAD:
            return m.BAD_ARGUMENTS
        if not self._may_hang():
            return m.FAULTY
        self.hanging = _HANG_TICKS
        return m.OK


_WORDS = {"?": "hello", "H": "beat", "W": "hold", "R": "rate", "T": "table", "P": "play", "C": "loop", "V": "set",
          "U": "get", "K": "calibrate", "Z": "sense", "S": "stop", "F": "clear", "X": "hang"}  # fmt: skip


def _hexadecimal(text: str) -> int:
    if not text or len(text) > 8 or not set(text) <= set("0123456789ABCDEF"):
        raise ValueError(text)
    return int(text, 16)
