"""What frames from the board mean. Counts are as read: four conversions of 10 bits summed, 0 to 4092."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

from scpjax.bench.frames import Frame

PROTOCOL = 1
NAME = "scpjax-rig"

IDLE, HOLD, PLAY, LOOP = range(4)
MODES = ("idle", "hold", "play", "loop")

(NO_FAULT, HOST_TIMEOUT, HOT_BY_MODEL, HOT_BY_SENSOR, OVER_CURRENT, OVER_ENERGY, ON_TOO_LONG, SENSOR_LOST, UNDERRUN,
 TABLE_END) = range(10)  # fmt: skip
FAULTS = {
    HOST_TIMEOUT: "nothing good came from the host for its timeout",
    HOT_BY_MODEL: "the board's thermal model reached the temperature limit",
    HOT_BY_SENSOR: "a thermistor read the temperature limit",
    OVER_CURRENT: "the current was above its limit",
    OVER_ENERGY: "an actuator had all the energy that it may have",
    ON_TOO_LONG: "an actuator was on for all the time that it may be",
    SENSOR_LOST: "a sensor was lost: a thermistor open or shorted, or no echo",
    UNDERRUN: "the table ran dry before its end",
    TABLE_END: "the table was played to its end",
}
LASTING = (HOT_BY_MODEL, HOT_BY_SENSOR, OVER_CURRENT, OVER_ENERGY, ON_TOO_LONG, SENSOR_LOST)
"""Faults that stay until they are cleared."""

OK, UNKNOWN, BAD_ARGUMENTS, OUT_OF_RANGE, FAULTY, BUSY, FULL = range(7)
REFUSALS = {
    UNKNOWN: "the board does not know the command",
    BAD_ARGUMENTS: "the board does not understand the arguments",
    OUT_OF_RANGE: "out of range, or it would loosen a limit",
    FAULTY: "a fault lasts",
    BUSY: "the board plays or closes a loop",
    FULL: "the board's table is full",
}


@dataclass(frozen=True, slots=True)
class Banner:
    """The board's greeting; limits in degC, J, W, s, A."""

    sequence: int
    stamp: int
    name: str
    protocol: int
    version: str
    reset_cause: int
    tick_hz: int
    pins: tuple[str, ...]
    max_temperature_C: int
    max_energy_J: int
    sustained_power_W: int
    max_on_s: int
    max_current_A: int


@dataclass(frozen=True, slots=True)
class Sample:
    """One reading; ``pwm`` is what was set on it, ``stamp`` [us] when it was taken."""

    sequence: int
    stamp: int
    pwm: tuple[int, int]
    mode: int
    fault: int
    fitted: int
    thermistors: tuple[int, int]
    position: int
    current: int


@dataclass(frozen=True, slots=True)
class Reply:
    """Answer to the command with number ``to``."""

    sequence: int
    stamp: int
    to: int
    status: int
    value: int


@dataclass(frozen=True, slots=True)
class Event:
    """Something happened by itself: a fault, or the end of a table."""

    sequence: int
    stamp: int
    what: int
    channel: int


@dataclass(frozen=True, slots=True)
class Calibration:
    """Sums over 64 ticks of both thermistors, position and current."""

    sequence: int
    stamp: int
    totals: tuple[int, int, int, int]

    TICKS = 64


@dataclass(frozen=True, slots=True)
class Resistance:
    """Reading of the wire's voltage under the sensing current."""

    sequence: int
    stamp: int
    channel: int
    counts: int


Message = Banner | Sample | Reply | Event | Calibration | Resistance


def parse(frame: Frame) -> Message | None:
    """The message of a frame; None where it is none of this protocol."""
    known = _READERS.get(frame.kind)
    if known is None:
        return None
    widths, read = known
    f = frame.fields
    if frame.kind == "B" and len(f) != len(widths) + 2:
        return _foreign(f)
    if len(f) != len(widths) + 2 or any(w and len(x) != w for x, w in zip(f, (4, 8, *widths), strict=True)):
        return None
    try:
        return read(int(f[0], 16), int(f[1], 16), f[2:])
    except ValueError:
        return None


def _banner(sequence: int, stamp: int, f: tuple[str, ...]) -> Banner:
    name, protocol, version, cause, tick, pins, *limits = f
    return Banner(
        sequence, stamp, name, int(protocol), version, int(cause, 16), int(tick), tuple(pins.split(":")),
        *(int(x) for x in limits),
    )  # fmt: skip


def _foreign(f: tuple[str, ...]) -> Banner | None:
    """The banner of another protocol: of it only name, protocol and version are known."""
    try:
        return Banner(int(f[0], 16), int(f[1], 16), f[2], int(f[3]), f[4], 0, 0, (), 0, 0, 0, 0, 0)
    except (ValueError, IndexError):
        return None


def _sample(sequence: int, stamp: int, f: tuple[str, ...]) -> Sample:
    driven, thermistors, position, current = (int(x, 16) for x in f)
    mode, fault, fitted = driven & 3, driven >> 2 & 15, driven >> 6 & 3
    pwm, warm = (driven >> 16, driven >> 8 & 0xFF), (thermistors >> 12, thermistors & 0xFFF)
    return Sample(sequence, stamp, pwm, mode, fault, fitted, warm, position, current)


def _reply(sequence: int, stamp: int, f: tuple[str, ...]) -> Reply:
    return Reply(sequence, stamp, *(int(x, 16) for x in f))


def _event(sequence: int, stamp: int, f: tuple[str, ...]) -> Event:
    return Event(sequence, stamp, *(int(x, 16) for x in f))


def _calibration(sequence: int, stamp: int, f: tuple[str, ...]) -> Calibration:
    a, b, c, d = (int(x, 16) for x in f)
    return Calibration(sequence, stamp, (a, b, c, d))


def _resistance(sequence: int, stamp: int, f: tuple[str, ...]) -> Resistance:
    return Resistance(sequence, stamp, *(int(x, 16) for x in f))


_READERS: dict[str, tuple[tuple[int, ...], Callable[..., Message]]] = {
    "B": ((0, 0, 0, 2, 0, 0, 0, 0, 0, 0, 0), _banner),
    "D": ((6, 6, 4, 3), _sample),
    "A": ((4, 1, 8), _reply),
    "E": ((2, 1), _event),
    "K": ((6, 6, 6, 6), _calibration),
    "Z": ((1, 3), _resistance),
}
