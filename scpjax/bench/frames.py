"""Frames on the wire: ``$`` body ``*`` CRC-32 in eight hexadecimal digits, newline.

A body is a letter and fields between commas; from the board the first two fields are a sequence number (16 bits) and
the board's clock in microseconds (32 bits). CRC-32 (that of zlib) rather than 16 bits: with 1 % of all bytes replaced
by other digits, a million frames have some 10^5 with two or more wrong bytes, of which 16 bits would let one or two
pass.
"""

from __future__ import annotations

import re
import zlib
from collections.abc import Iterable
from dataclasses import dataclass, field

LONGEST = 200
"""Bytes of a frame, at most; what runs on for longer is no frame."""

_FRAME = re.compile(rb"([A-Z?])((?:,[0-9A-Za-z.:\-]+)*)\*([0-9A-F]{8})")


def encode(body: str) -> bytes:
    """The frame of a body such as ``W,0001,80,00``."""
    raw = body.encode("ascii")
    return b"$%b*%08X\n" % (raw, zlib.crc32(raw))


def command(kind: str, sequence: int, fields: Iterable[int] = ()) -> bytes:
    """A frame for the board: numbers in hexadecimal, the sequence number first."""
    return encode(",".join((kind, f"{sequence & 0xFFFF:04X}", *(f"{f:X}" for f in fields))))


@dataclass(frozen=True)
class Frame:
    """A frame whose CRC is right: its letter and fields."""

    kind: str
    fields: tuple[str, ...]


def decode(line: bytes) -> Frame | None:
    """The frame of what stands between ``$`` and the newline; None where it is damaged."""
    found = _FRAME.fullmatch(line)
    if found is None or zlib.crc32(line[:-9]) != int(found[3], 16):
        return None
    return Frame(found[1].decode(), tuple(found[2].decode().split(",")[1:]))


@dataclass
class Decoder:
    """Bytes as they come in, frames out; what is no frame is counted.

    ``damaged`` counts stretches between ``$`` and newline that are no frame, ``stray`` bytes outside of any, which a
    stream that was opened in the middle begins with. At most `LONGEST` bytes are kept, whatever comes.
    """

    damaged: int = 0
    stray: int = 0
    _line: bytearray = field(default_factory=bytearray)
    _inside: bool = False

    @property
    def pending(self) -> bytes:
        """The beginning of a frame that is not whole yet."""
        return b"$" + bytes(self._line) if self._inside else b""

    def feed(self, data: bytes) -> list[Frame]:
        """Frames that these bytes complete."""
        frames: list[Frame] = []
        parts = data.split(b"$")
        self._more(parts[0], frames)
        for part in parts[1:]:
            self.damaged += self._inside
            self._inside = True
            self._line.clear()
            self._more(part, frames)
        return frames

    def _more(self, part: bytes, frames: list[Frame]) -> None:
        if not self._inside:
            self.stray += len(part)
            return
        end = part.find(b"\n")
        self._line += part if end < 0 else part[:end]
        if len(self._line) > LONGEST:
            self._inside = False
            self.damaged += 1
        elif end >= 0:
            self._inside = False
            self.stray += len(part) - end - 1
            frame = decode(bytes(self._line.removesuffix(b"\r")))
            if frame is None:
                self.damaged += 1
            else:
                frames.append(frame)
