"""The firmware in Python, tick by tick: the same protocol, limits and controller as ``rig/firmware``.

For machines without the AVR's tools, for faults that a simulator cannot have, and for speed. The tests that say so run
on this and on the compiled firmware alike.
"""

from __future__ import annotations

import math
from collections import deque
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field

from scpjax.bench import messages as m
from scpjax.bench.frames import Frame, decode, encode
from scpjax.bench.parameters import NAMES, TICK_HZ, TICK_S, BoardConfig, from_bits, single, table, to_bits

CHANNELS = 2
SLOTS = 256
_AT = {name: i for i, name in enumerate(NAMES)}
_SHAPES = {"?": (0, 0), "H": (0, 0), "W": (2, 2), "R": (1, 1), "T": (2, 13), "P": (2, 2), "C": (2, 2), "V": (2, 2),
           "U": (1, 1), "K": (0, 0), "Z": (1, 1), "S": (0, 0), "F": (0, 0), "X": (1, 1)}  # fmt: skip
_FULL = 4 * 1024
_OPEN, _SHORTED = 4 * 3, 4 * 1020
_PATIENCE = 4
_HANG_S, _HANG_TICKS = 0.3, 50
_RECOVERED, _RECOVERED_K = 0.5, 10.0
_PINS = "3:9:A0:A1:A2:A3:A4:A5:7:8:5:6:2:4"
_LONGEST = 96
_POWER_ON, _EXTERNAL, _WATCHDOG = 1, 2, 8


@dataclass
class Inputs:
    """What the board reads in a tick: sums of four conversions at A0 to A5, the echo [0.5 us] and the encoder."""

    sums: Sequence[int] = (0, 0, 0, 0, 0, 0)
    echo: int = 0
    encoder: int = 0


@dataclass
class Memory:
    """What survives a reset: temperatures [degC], energies [J] and times on [s] of both channels."""

    temperature: list[float]
    energy: list[float] = field(default_factory=lambda: [0.0, 0.0])
    on: list[float] = field(default_factory=lambda: [0.0, 0.0])
    driven: list[int] = field(default_factory=lambda: [0, 0])


class Board:
    """One board: `receive` takes bytes from the host, `tick` passes 5 ms and gives the bytes for it.

    ``driven`` holds the PWM counts at the pins, ``counts`` those from the next tick on: what is to be applied is
    charged to the actuators first, so that nothing that comes later can take it back. Until the first `tick` after a
    reset nothing is sent.
    """

    def __init__(self, config: BoardConfig | None = None, version: str = "1.0.0", protocol: int = m.PROTOCOL):
        self.config = config or BoardConfig()
        self.version, self.protocol = version, protocol
        self.parameters, self._start = table(self.config)
        self.memory: Memory | None = None
        self.resets = -1
        self.clock_us = 0
        self.reset(_POWER_ON)

    # -- life ----------------------------------------------------------------------------------------------------

    def reset(self, cause: int = _EXTERNAL) -> None:
        """As the reset button (or the watchdog) does; what an actuator has had is remembered."""
        self.resets += 1
        self.cause = cause
        self.values = list(self._start)
        self.driven, self.counts = [0, 0], [0, 0]
        self.mode, self.fault = m.IDLE, m.NO_FAULT
        self.table: deque[int] = deque()
        self.given = self.taken = self.entries = 0
        self.per_entry, self.wait = 0, 0
        self.pids = [[0.0, 0.0], [0.0, 0.0]]  # integral, filtered
        self.host_age = 0
        self.stream_every = self.stream_wait = 0
        self.sense: int | None = None
        self.sensed: int | None = None
        self.calibration_left, self.calibration = 0, [0, 0, 0, 0]
        self.fitted = 0
        self.hot_for, self.lost_for, self.current_for = [0, 0], [0, 0], 0
        self.sequence = self.bad = 0
        self.hanging = 0
        self._line, self._inside = bytearray(), False
        self._out = bytearray()
        self._booting = True
        self.clock_us = 0
        self._find_threshold()

    def _boot(self, inputs: Inputs) -> None:
        self._booting = False
        self.inputs = inputs
        self._look_for_sensors()
        kept = self.memory
        if kept is None:
            ambient = self._get("model_ambient")
            self.memory = Memory([ambient, ambient])
        else:
            for c in range(CHANNELS):
                if kept.driven[c]:
                    self._heat(c, kept.driven[c], _HANG_S)
        memory = self._memory
        for c in range(CHANNELS):
            if self.fitted >> c & 1:
                memory.temperature[c] = max(memory.temperature[c], self._read_temperature(c))
        memory.driven = [0, 0]
        self._banner()

    @property
    def _memory(self) -> Memory:
        assert self.memory is not None
        return self.memory

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
            self._boot(inputs)
            return self._sent()
        self.sensed, self.sense = self.sense, None
        self._step()
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

    # -- safety --------------------------------------------------------------------------------------------------

    def _get(self, name: str) -> float:
        return self.values[_AT[name]]

    def _power(self, count: int) -> float:
        return count / 255 * self.config.supply_V**2 / self._get("model_resistance")

    def _heat(self, c: int, count: int, dt: float) -> None:
        mem, p = self._memory, self._power(count)
        lost = self._get("model_conductance") * (mem.temperature[c] - self._get("model_ambient"))
        mem.temperature[c] += dt * (p - lost) / self._get("model_thermal_mass")
        mem.energy[c] = max(0.0, mem.energy[c] + dt * (p - self._get("sustained_power")))
        mem.on[c] = max(0.0, mem.on[c] + (dt if count else -dt))

    @property
    def cut_out(self) -> float:
        """Temperature [degC] at which the power is cut."""
        return self._get("max_temperature") - self.config.margin_K

    def _find_threshold(self) -> None:
        c = self.config
        inverse = 1 / (self.cut_out + 273.15) - 1 / 298.15
        r = c.ntc_nominal_ohm * math.exp(c.ntc_beta_K * inverse)
        self.hot_sum = int(_FULL * c.ntc_fixed_ohm / (c.ntc_fixed_ohm + r))

    def _read_temperature(self, c: int) -> float:
        share = (self.inputs.sums[c] + 2.0) / _FULL
        r = self.config.ntc_fixed_ohm * (1 / share - 1)
        return 1 / (1 / 298.15 + math.log(r / self.config.ntc_nominal_ohm) / self.config.ntc_beta_K) - 273.15

    def _plausible(self, c: int) -> bool:
        return _OPEN <= self.inputs.sums[c] <= _SHORTED

    def _look_for_sensors(self) -> None:
        for c in range(CHANNELS):
            self.fitted |= self._plausible(c) << c

    def _watch(self) -> None:
        mem = self._memory
        for c in range(CHANNELS):
            self._heat(c, self.counts[c], TICK_S)
            mem.driven[c] = self.counts[c]
            seen = self.fitted >> c & 1
            hot = seen and self.inputs.sums[c] >= self.hot_sum
            lost = seen and not self._plausible(c)
            self.hot_for[c] = min(self.hot_for[c] + 1, _PATIENCE) if hot else 0
            self.lost_for[c] = min(self.lost_for[c] + 1, _PATIENCE) if lost else 0
        amperes = (self.inputs.sums[3] + 2.0) / _FULL * 5.0 / self.config.current_V_per_A
        self.current_for = min(self.current_for + 1, _PATIENCE) if amperes > self._get("max_current") else 0
        met, channel = self._met()
        self.host_age += 1
        if met and not self.fault:
            self.fault = met
            self._stop()
            self._event(met, channel)
        elif self.mode != m.IDLE and self.host_age > self._get("host_timeout") * TICK_HZ:
            self._stop()
            self._event(m.HOST_TIMEOUT, 0)

    def _met(self) -> tuple[int, int]:
        mem = self._memory
        for c in range(CHANNELS):
            if mem.temperature[c] >= self.cut_out:
                return m.HOT_BY_MODEL, c
            if self.hot_for[c] >= _PATIENCE:
                return m.HOT_BY_SENSOR, c
            if self.lost_for[c] >= _PATIENCE:
                return m.SENSOR_LOST, c
            if mem.energy[c] >= self._get("max_energy"):
                return m.OVER_ENERGY, c
            if mem.on[c] >= self._get("max_on"):
                return m.ON_TOO_LONG, c
        return (m.OVER_CURRENT if self.current_for >= _PATIENCE else m.NO_FAULT), 0

    def _may_clear(self) -> bool:
        mem = self._memory
        for c in range(CHANNELS):
            if mem.temperature[c] > self.cut_out - _RECOVERED_K or self.hot_for[c] or self.lost_for[c]:
                return False
            if mem.energy[c] > _RECOVERED * self._get("max_energy") or mem.on[c] > _RECOVERED * self._get("max_on"):
                return False
        return self.current_for == 0

    def _may_hang(self) -> bool:
        mem, joules = self._memory, _HANG_S * self._power(255)
        for c in range(CHANNELS):
            if mem.temperature[c] + joules / self._get("model_thermal_mass") >= self.cut_out or self.hot_for[c]:
                return False
            if mem.energy[c] + joules >= self._get("max_energy") or mem.on[c] + _HANG_S >= self._get("max_on"):
                return False
        return True

    # -- control -------------------------------------------------------------------------------------------------

    def _stop(self) -> None:
        self.mode = m.IDLE
        self.table.clear()
        self.given = self.taken = self.entries = 0
        self.driven, self.counts = [0, 0], [0, 0]

    def _step(self) -> None:
        if self.mode not in (m.PLAY, m.LOOP):
            return
        if self.wait:
            self.wait -= 1
            return
        if self.taken == self.entries or not self.table:
            how = m.TABLE_END if self.taken == self.entries else m.UNDERRUN
            self._stop()
            self._event(how, 0)
            return
        entry = self.table.popleft()
        self.taken += 1
        self.wait = self.per_entry - 1
        if self.mode == m.PLAY:
            self.counts = [entry >> 8, entry & 0xFF]
            return
        reference = (entry - 0x10000 if entry & 0x8000 else entry) * 0.01
        degrees = self._get("position_scale") * (self._counts_of_position() - self._get("position_zero"))
        dt = self.per_entry * TICK_S
        sides = ((0, 1.0), (1, -1.0))[: int(self._get("channels"))]
        self.counts = [self._count_of(self._pid(c, sign, reference - degrees, dt)) for c, sign in sides]
        self.counts += [0] * (CHANNELS - len(sides))

    def _pid(self, c: int, sign: float, error: float, dt: float) -> float:
        """Thesis (3.16)-(3.18), forward Euler; the clamp as in `scpjax.control.pid`."""
        integral, filtered = self.pids[c]
        push = dt * sign * self._get("ki") * error
        derivative = self._get("n") * (sign * self._get("kd") * error - filtered)
        asked = sign * self._get("kp") * error + integral + derivative
        effort = min(max(asked, 0.0), self._get("effort_limit"))
        if asked == effort or push * asked <= 0:
            integral += push
        self.pids[c] = [integral, filtered + dt * derivative]
        return effort

    def _count_of(self, effort: float) -> int:
        return int(255 * effort / self.config.supply_V**2 + 0.5)

    def _position(self) -> int:
        source = int(self._get("position_source"))
        return (self.inputs.sums[2], self.inputs.echo, self.inputs.encoder & 0xFFFF)[source]

    def _counts_of_position(self) -> int:
        raw = self._position()
        return raw - 0x10000 if self._get("position_source") >= 2 and raw & 0x8000 else raw

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
