"""A recording as it is made: every raw byte first, then the CSV row by row, its TOML, markers and quality beside it."""

from __future__ import annotations

import csv
import dataclasses
import io
import json
import os
from collections.abc import Sequence
from pathlib import Path
from typing import Any

from scpjax.bench.errors import BenchError
from scpjax.bench.wiring import Wiring
from scpjax.recordings.files import write_text
from scpjax.recordings.sidecar import sidecar_text


class Log:
    """``NAME.raw``, ``NAME.csv`` and ``NAME.toml``, written as things come; nothing is held back in memory.

    What the process had received when it was killed is on disk, and the CSV ends with a whole row.

    An earlier recording of this name is replaced, with its remarks and its quality.

    **Raises** `BenchError` where a file cannot be written (a full disk too).
    """

    def __init__(
        self, path: str | os.PathLike[str], wiring: Wiring, *, title: str = "", known: dict[str, float] | None = None
    ):
        self.path = Path(path)
        if self.path.suffix.lower() != ".csv":
            raise BenchError("is no CSV file name", where=str(path), mend="end it in .csv")
        meta = wiring.metadata(title)
        if known:
            meta = dataclasses.replace(meta, known=tuple({**dict(meta.known), **known}.items()))
        self.columns = ("time_s", *wiring.drives, *wiring.responses)
        if not wiring.responses:
            raise BenchError("nothing is measured", where=str(path), mend="connect a thermistor or a position sensor")
        try:
            self.path.parent.mkdir(parents=True, exist_ok=True)
            self._raw = os.open(self.path.with_suffix(".raw"), os.O_CREAT | os.O_WRONLY | os.O_TRUNC, 0o644)
            self._csv = os.open(self.path, os.O_CREAT | os.O_WRONLY | os.O_TRUNC, 0o644)
            for earlier in (".markers.csv", ".quality.json"):
                self.path.with_suffix(earlier).unlink(missing_ok=True)
        except OSError as error:
            raise _cannot(self.path, error) from error
        self.markers: list[tuple[float, str]] = []
        self.rows = 0
        write_text(
            self.path.with_suffix(".toml"),
            sidecar_text(meta, hold="zero_order", drive=wiring.drives, response=wiring.responses),
        )
        self._write(self._csv, (",".join(self.columns) + "\n").encode())

    def raw(self, data: bytes) -> None:
        """Bytes as they came."""
        self._write(self._raw, data)

    def rows_of(self, rows: Sequence[tuple[float, list[float]]]) -> None:
        """Samples: time [s] and the values of the columns after it; a NaN is an empty cell."""
        if rows:
            lines = [",".join((f"{t:.6f}", *("" if v != v else f"{v:.7g}" for v in values))) for t, values in rows]
            self._write(self._csv, ("\n".join(lines) + "\n").encode())
            self.rows += len(rows)

    def mark(self, time_s: float, text: str) -> None:
        """A remark at a time of the recording."""
        self.markers.append((time_s, text))
        out = io.StringIO()
        csv.writer(out, lineterminator="\n").writerows([("time_s", "marker"), *self.markers])
        write_text(self.path.with_suffix(".markers.csv"), out.getvalue())

    def close(self, quality: dict[str, Any] | None = None) -> None:
        """End; what was counted goes to ``NAME.quality.json``."""
        for handle in (self._raw, self._csv):
            if handle >= 0:
                os.close(handle)
        self._raw = self._csv = -1
        if quality is not None:
            write_text(self.path.with_suffix(".quality.json"), json.dumps(quality, indent=1) + "\n")

    def _write(self, handle: int, data: bytes) -> None:
        if handle < 0:
            return
        try:
            while data:
                data = data[os.write(handle, data) :]
        except OSError as error:
            raise _cannot(self.path, error) from error


def _cannot(path: Path, error: OSError) -> BenchError:
    return BenchError(f"cannot be written ({error.strerror})", where=str(path), mend="check the folder and the disk")
