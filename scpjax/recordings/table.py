"""A CSV file as columns of numbers: fast where it is clean, and naming the line where it is not."""

from __future__ import annotations

import csv
import difflib
import io
import re
from collections.abc import Iterable, Iterator
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from scpjax.errors import RecordingError

CLOCKS = {"time_s": 1.0, "time_ms": 1e-3, "index": 1.0}
"""Columns that give the time, with their scale to seconds; ``index`` only counts samples."""

_A_TIME = re.compile(r"(time|t|timestamp|sec|secs|seconds)([ _(\[]*(s|ms|sec|seconds|millis)[)\]]?)?", re.IGNORECASE)
"""Names of a column that gives the time, though not as we write it; beside one, ``index`` counts rows."""

_MILLISECONDS = ("ms", "msec", "millis", "milliseconds")

MISSING = ("", "nan", "na", "n/a", "null", "none", "-")
_DELIMITERS = {",": "comma", ";": "semicolon", "\t": "tab"}


@dataclass(frozen=True)
class Table:
    """The text of a CSV file with its header taken apart: ``names`` of the columns, ``body`` below them."""

    where: str
    names: tuple[str, ...]
    delimiter: str
    body: str
    header_line: int

    def line(self, row: int) -> int:
        """The number in the file (from 1) of the line that holds data row ``row`` (from 0)."""
        return next((line for k, (line, _) in enumerate(_rows(self)) if k == row), self.header_line)

    def place(self, row: int) -> str:
        """``FILE:line N`` of data row ``row``."""
        return f"{self.where}:line {self.line(row)}"

    @property
    def clock(self) -> str:
        """The column that gives the time; ``RecordingError`` where there is none."""
        for name in CLOCKS:
            if name in self.names and not (name == "index" and any(map(_A_TIME.fullmatch, self.names))):
                return name
        close = [name for name in self.names if name.lower().startswith(("time", "t_", "t ", "t(", "sec", "milli"))]
        close += [name for name in self.names if name.lower() in _MILLISECONDS and name not in close]
        close.sort(key=lambda name: not _A_TIME.fullmatch(name))
        close += difflib.get_close_matches("time_s", self.names, n=1)
        mend = _as_a_clock(close[0]) if close else "name the column of times in seconds 'time_s'"
        raise RecordingError(
            f"no column 'time_s' among {', '.join(self.names)}", where=f"{self.where}: header", mend=mend
        )


def read_table(path: str | Path) -> Table:
    """Open a CSV file: ``RecordingError`` where it is not there, not text, empty or has no usable header."""
    text = read_text(path)
    where = str(path)
    lines = text.splitlines(keepends=True)
    start = next((i for i, line in enumerate(lines) if _is_data(line)), None)
    if start is None:
        raise RecordingError("the file is empty", where=f"{where}:line 1", mend="record again, or export again")
    header = lines[start].strip()
    delimiter = max(_DELIMITERS, key=header.count)
    cells = next(iter(csv.reader([header], delimiter=delimiter)))
    names = tuple(name.strip().strip('"').strip() for name in cells)
    place = f"{where}:line {start + 1}"
    if all(_number(name) is not None for name in names):
        raise RecordingError("the file has no header", where=place, mend="add a first line: time_s,voltage_V,...")
    if len(names) < 2:
        raise RecordingError(f"only one column '{header}'", where=place, mend="separate the columns with commas")
    if "" in names:
        raise RecordingError(
            f"column {names.index('') + 1} has no name",
            where=place,
            mend="name it or remove the stray delimiter",
        )
    twice = [name for name in names if names.count(name) > 1]
    if twice:
        raise RecordingError(f"column '{twice[0]}' is there twice", where=place, mend="remove or rename one")
    return Table(where, names, delimiter, "".join(lines[start + 1 :]), start + 1)


def read_text(path: str | Path) -> str:
    """The text of a file, without a byte order mark; ``RecordingError`` where it cannot be read."""
    path = Path(path)
    if path.is_dir():
        files = sorted(p.name for p in path.glob("*.csv"))[:3]
        raise RecordingError(
            "is a folder, not a file",
            where=str(path),
            mend=f"name a file in it{', such as ' + files[0] if files else ''}",
        )
    try:
        raw = path.read_bytes()
    except FileNotFoundError as error:
        there = [p.name for p in path.parent.glob(f"*{path.suffix}")] if path.parent.is_dir() else []
        close = difflib.get_close_matches(path.name, there, n=1)
        mend = f"did you mean '{close[0]}'?" if close else "check the name and the folder"
        raise RecordingError("no such file", where=str(path), mend=mend) from error
    except OSError as error:
        raise RecordingError(f"cannot be read ({error.strerror})", where=str(path), mend="check it") from error
    if raw.startswith((b"\xff\xfe", b"\xfe\xff")):
        raise RecordingError("is UTF-16 text", where=f"{path}:line 1", mend="save it as CSV UTF-8")
    try:
        text = raw.decode("utf-8-sig")
    except UnicodeDecodeError as error:
        line = raw[: error.start].count(b"\n") + 1
        raise RecordingError("is not UTF-8 text", where=f"{path}:line {line}", mend="save it as CSV UTF-8") from error
    if "\0" in text:
        line = text[: text.index("\0")].count("\n") + 1
        raise RecordingError("holds binary data", where=f"{path}:line {line}", mend="export it as a CSV file again")
    return text


def read_columns(
    table: Table, wanted: tuple[str, ...], optional: tuple[str, ...], *, anything: bool = False
) -> dict[str, np.ndarray]:
    """The ``wanted`` columns (n,) as float64; an empty cell is NaN in an ``optional`` column, else an error. So is
    ``anything`` there that is no finite number, if told.

    Raises ``RecordingError`` naming the line for ragged rows, text in a cell, an infinite value or a
    missing one.
    """
    values = _read_fast(table)
    columns = (
        _read_slow(table, wanted, optional, anything)
        if values is None
        else {name: values[:, table.names.index(name)] for name in wanted}
    )
    if columns[wanted[0]].size == 0:
        raise RecordingError(
            "only a header, no rows",
            where=f"{table.where}:line {table.header_line}",
            mend="record again, or export again",
        )
    for name in optional if anything else ():
        columns[name] = np.where(np.isinf(columns[name]), np.nan, columns[name])
    for name in wanted:
        bad = np.isinf(columns[name]) if name in optional else ~np.isfinite(columns[name])
        if bad.any():
            row = int(np.argmax(bad))
            word = "is infinite" if np.isinf(columns[name][row]) else "has no value"
            raise RecordingError(
                f"column '{name}' {word}", where=table.place(row), mend="repair the cell or remove the row"
            )
    return columns


def _as_a_clock(name: str) -> str:
    """How to make a column the clock: milliseconds by another name, other units of time by their values."""
    words = re.findall(r"[a-zµμ]+", name.lower())
    if words[-1:] and words[-1] in _MILLISECONDS:
        return f"rename '{name}' to 'time_ms'"
    if len(words) < 2 or words[-1] in ("s", "sec", "secs", "second", "seconds"):
        return f"rename '{name}' to 'time_s'"
    return f"name the times 'time_s', in seconds: '{name}' does not say that it is in these"


def _is_data(line: str) -> bool:
    text = line.strip()
    return bool(text) and not text.startswith("#") and bool(text.strip(",;\t "))


def _read_fast(table: Table) -> np.ndarray | None:
    """All cells (n, columns) where every one is a number, else None."""
    if table.delimiter != "," or '"' in table.body or not table.body.strip():
        return None
    try:
        values = np.loadtxt(io.StringIO(table.body), delimiter=",", comments=None, ndmin=2)
    except ValueError:
        return None
    return values if values.size and values.shape[1] == len(table.names) else None


def _read_slow(
    table: Table, wanted: tuple[str, ...], optional: tuple[str, ...], anything: bool
) -> dict[str, np.ndarray]:
    index = [(name, table.names.index(name), name in optional) for name in wanted]
    values: dict[str, list[float]] = {name: [] for name in wanted}
    for line, row in _rows(table):
        place = f"{table.where}:line {line}"
        if len(row) == len(table.names) + 1 and not row[-1].strip():
            row = row[:-1]  # a delimiter at the end of the line
        if len(row) != len(table.names):
            raise RecordingError(
                f"{len(row)} cells where the header has {len(table.names)}",
                where=place,
                mend="repair or remove the line",
            )
        for name, column, may_miss in index:
            values[name].append(_cell(row[column], name, place, table.delimiter, may_miss, may_miss and anything))
    return {name: np.array(column) for name, column in values.items()}


def _rows(table: Table) -> Iterator[tuple[int, list[str]]]:
    """Data rows, each with the line (from 1) that it begins in; a quoted cell may go on in the next."""
    lines = enumerate(table.body.splitlines(), table.header_line + 1)
    kept = [(number, text) for number, text in lines if _is_data(text)]
    rows = csv.reader(_without_comments(text for _, text in kept), delimiter=table.delimiter, skipinitialspace=True)
    done = 0
    for row in rows:
        yield kept[done][0], row
        done = rows.line_num


def _without_comments(lines: Iterable[str]) -> Iterator[str]:
    """Each line up to a ``#`` after a space, unless that is in quotes; these may have begun in a line before."""
    quotes = 0
    for line in lines:
        starts = (found.start() for found in re.finditer(r"\s#", line))
        text = line[: next((at for at in starts if (quotes + line[:at].count('"')) % 2 == 0), None)]
        quotes += text.count('"')
        yield text


def _cell(cell: str, name: str, place: str, delimiter: str, may_miss: bool, anything: bool) -> float:
    text = cell.strip().strip('"').strip()
    if text.lower() in MISSING:
        if may_miss:
            return np.nan
        raise RecordingError(f"column '{name}' has no value", where=place, mend="fill it in or remove the row")
    value = _number(text.replace(",", ".") if delimiter != "," else text)
    if value is not None:
        return value
    if anything:
        return np.nan
    if re.fullmatch(r"[+-]?\d+,\d+", text):
        problem, mend = f"decimal comma '{text}' in column '{name}'", "export with decimal points"
    else:
        problem, mend = f"'{text}' in column '{name}' is not a number", "repair the cell or remove the row"
    raise RecordingError(problem, where=place, mend=mend)


def _number(text: str) -> float | None:
    if "_" in text:
        return None
    try:
        return float(text)
    except ValueError:
        return None
