"""The lines of the thesis's own sketches: ``millis<TAB>pwm<TAB>value`` at 9600 baud, every 50 to 61 ms.

``value`` is a temperature in degC, or the distance of the ultrasonic sensor in cm. The sketches close the port before
they print ``END``, so that it never comes: silence ends a recording too.
"""

from __future__ import annotations

import re
from collections.abc import Callable, Iterable, Iterator
from typing import Literal

import numpy as np

from scpjax.bench.device import AbstractDevice
from scpjax.bench.errors import BenchError
from scpjax.recordings.recording import Metadata, Recording

BAUD = 9600
Value = Literal["temperature", "distance"]
_LINE = re.compile(rb"\s*(\d{1,10})\t\s*(\d{1,3})\t\s*(-?\d+(?:\.\d+)?)\s*")
_LONGEST = 80
_JUMP_CM = 0.25  # beyond which the thesis took a reading of the sonar for a failed one
_LASTING = 3  # such readings in a row are no failure


def lines(
    device: AbstractDevice,
    *,
    silence: float = 2.0,
    most: float = 3600.0,
    keep: Callable[[bytes], object] | None = None,
) -> Iterator[bytes]:
    """Lines of a port that is open, until ``END``, ``silence`` [s] or ``most`` [s] have passed. Bytes without a newline
    are dropped beyond 80; ``keep`` is told all of them, before they are looked at."""
    pending = b""
    began = last = device.now()
    while device.now() - began < most:
        data = device.read(0.1)
        if not data:
            if device.now() - last > silence:
                return
            continue
        last = device.now()
        if keep is not None:
            keep(data)
        *whole, pending = (pending + data).split(b"\n")
        pending = pending[-_LONGEST:]
        for line in whole:
            if line.strip() == b"END":
                return
            yield line


def parse(rows: Iterable[bytes]) -> np.ndarray:
    """Times [ms], counts and values (n, 3) of the lines that are whole; others are left out, and so are those whose
    time goes back (the first line after opening may be cut)."""
    out: list[tuple[float, float, float]] = []
    for row in rows:
        found = _LINE.fullmatch(row)
        if found is None:
            continue
        t, pwm, value = (float(x) for x in found.groups())
        if pwm <= 255 and (not out or t > out[-1][0]):
            out.append((t, pwm, value))
    return np.array(out).reshape(-1, 3)


def recording(
    rows: Iterable[bytes], *, value: Value, supply_V: float = 3.7, nearer: bool = False, title: str = ""
) -> Recording:
    """The recording of such lines. A distance becomes a displacement from the first, contraction positive; ``nearer``:
    contraction brings the target nearer to the sonar (else it lifts it away). Jumps of more than 0.25 cm that do not
    last become missing samples, where the thesis repeated the reading before.

    **Raises** `BenchError` where fewer than 8 lines are whole.
    """
    table = parse(rows)
    if len(table) < 8:
        mend = "9600 baud? lines are millis<TAB>pwm<TAB>value"
        raise BenchError(f"{len(table)} lines of the thesis's form", mend=mend)
    time, pwm, read = (table[:, 0] - table[0, 0]) / 1000, table[:, 1], table[:, 2]
    meta = Metadata(title=title, source="the thesis's sketch", supply_V=supply_V)
    if value == "temperature":
        return Recording.from_arrays(time, {"pwm": pwm}, {"temperature_degC": read}, metadata=meta)
    away = read - read[0]
    moved = np.where(_steady(read), 10 * (-away if nearer else away), np.nan)
    return Recording.from_arrays(time, {"pwm": pwm}, {"displacement_mm": moved}, metadata=meta)


def _steady(read: np.ndarray) -> np.ndarray:
    """Which readings (n,) are no jumps: within 0.25 cm of the last good one, or the third of that kind in a row."""
    good, last, odd = np.ones(len(read), bool), read[0], 0
    for i, x in enumerate(read):
        odd = odd + 1 if abs(x - last) > _JUMP_CM else 0
        good[i] = odd in (0, _LASTING)
        if good[i]:
            last, odd = x, 0
    return good
