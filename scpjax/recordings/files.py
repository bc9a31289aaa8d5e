"""Read and write recordings: ``NAME.csv`` with an optional ``NAME.toml`` beside it.

The CSV has a header; the column ``time_s`` (or ``time_ms``; or ``index`` where no time was recorded) and
columns that carry their unit as a suffix: ``voltage_V``, ``temperature_degC``, ``displacement_mm``. An
empty cell in a response is a missing sample. The TOML may hold ``[recording] title source hold model``,
``[roles] drive response``, ``[actuator]`` with known values, ``[environment] ambient_degC`` and ``[pulley]
radius_m mass_kg``.
"""

from __future__ import annotations

import dataclasses
import os
import tempfile
from collections.abc import Iterable, Sequence
from pathlib import Path

import numpy as np

from scpjax.errors import RecordingError
from scpjax.recordings.frames import file_columns
from scpjax.recordings.recording import Channel, Hold, Recording
from scpjax.recordings.roles import choose_roles, is_temperature
from scpjax.recordings.sidecar import Sidecar, read_sidecar, sidecar_text
from scpjax.recordings.table import CLOCKS, Table, read_columns, read_table
from scpjax.recordings.validate import MIN_SAMPLES

COLDEST_K, HOTTEST_K = 193.15, 873.15


def read_recording(
    path: str | os.PathLike[str],
    *,
    drive: str | Sequence[str] | None = None,
    response: str | Sequence[str] | None = None,
    hold: Hold | None = None,
    model: str | None = None,
    require_outputs: bool = True,
) -> Recording:
    """Read one recording.

    ``model`` goes before that of the TOML: of ``tm`` the drive is a temperature. ``drive`` and ``response``
    name columns (comma separated, or a list) and go before ``[roles]`` of the TOML, which goes before the
    column names. Where the TOML does not say how the input runs between samples, it is as ``hold`` says;
    without that a temperature that drives runs linearly and everything else is held (zero order). Where the
    TOML says ``next``, a row's drive is taken a row earlier, and held. With ``require_outputs=False`` a file
    of inputs alone will do: responses that ``[roles]`` names may be missing from it, and cells of one that
    hold no reading count as empty, unless all do. Raises ``RecordingError``, one line with file, place,
    problem and mend.
    """
    path = Path(path)
    table = read_table(path)
    toml = path.with_suffix(".toml")
    sidecar = read_sidecar(toml, name=path.stem, csv_path=str(path)) if toml.exists() else Sidecar()
    metadata = dataclasses.replace(sidecar.metadata, name=path.stem, path=str(path))
    clock = table.clock
    said = sidecar.response
    if said is not None and not require_outputs:
        said = tuple(name for name in said if name in table.names)
    roles = choose_roles(
        [name for name in table.names if name != clock],
        model=model or metadata.model,
        drive=sidecar.drive if drive is None else drive,
        response=said if response is None else response,
        where=str(path),
        require_response=require_outputs,
    )
    wanted = (clock, *roles.drive, *roles.response)
    columns = read_columns(table, wanted, roles.response, anything=not require_outputs)
    time = columns[clock] * CLOCKS[clock]
    _check_time(table, time)
    channels = {name: Channel.parse(name) for name in (*roles.drive, *roles.response)}
    for name, channel in channels.items():
        if name in roles.response and not require_outputs:
            good = np.where(_implausible(channel, columns[name]), np.nan, columns[name])
            if np.any(np.isfinite(good)):
                columns[name] = good
            else:  # it is not a reading here and there that failed
                columns[name] = read_columns(table, (name,), (name,))[name]
        _check_plausible(table, channel, columns[name])
    warm = all(is_temperature(channels[name].stem) for name in roles.drive)
    hold = sidecar.hold or hold or ("linear" if warm else "zero_order")
    if sidecar.next:  # each row tells what was applied until then
        columns |= {name: np.append(columns[name][1:], columns[name][-1]) for name in roles.drive}
    return Recording.from_arrays(
        time,
        {name: columns[name] for name in roles.drive},
        {name: columns[name] for name in roles.response},
        hold=hold,
        metadata=dataclasses.replace(
            metadata, quasi_static=clock == "index", unread=tuple(n for n in table.names if n not in columns)
        ),
        require_outputs=require_outputs,
    )


def read_recordings(paths: Iterable[str | os.PathLike[str]]) -> tuple[Recording, ...]:
    """Read several recordings, each as ``read_recording`` does; ``RecordingError`` where there is none."""
    recordings = tuple(read_recording(path) for path in paths)
    if not recordings:
        raise RecordingError("no recording files", mend="name at least one CSV file")
    return recordings


def write_recording(recording: Recording, path: str | os.PathLike[str]) -> Path:
    """Write ``NAME.csv`` and ``NAME.toml`` in the units of the columns; missing samples are empty cells.

    Each file is written beside its place and moved there when whole, so that a file is never half written.
    Weights other than 0 and 1 are not kept. Returns the path of the CSV.
    """
    path = Path(path)
    if path.suffix != ".csv":
        raise RecordingError(f"'{path.name}' is no CSV file name", where=str(path), mend="end it in .csv")
    columns = file_columns(recording)
    if recording.metadata.quasi_static:
        columns = {"index": columns.pop("time_s"), **columns}
    cells = [["" if np.isnan(v) else f"{v:.15g}" for v in next(iter(columns.values()))]]
    cells += [["" if np.isnan(v) else f"{v:.12g}" for v in values] for values in list(columns.values())[1:]]
    body = "\n".join(",".join(row) for row in zip(*cells, strict=True))
    toml = sidecar_text(
        recording.metadata,
        hold=recording.hold,
        drive=[c.column for c in recording.input_channels],
        response=[c.column for c in recording.output_channels],
    )
    write_text(path.with_suffix(".toml"), toml)
    write_text(path, ",".join(columns) + "\n" + body + "\n")
    return path


def write_text(path: str | os.PathLike[str], text: str) -> None:
    """Write a text file (UTF-8) atomically: beside its place, then moved there."""
    path = Path(path)
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        handle, temporary = tempfile.mkstemp(prefix=f".{path.name}.", dir=path.parent)
    except OSError as error:
        raise RecordingError(
            f"cannot be written ({error.strerror})", where=str(path), mend="check the folder"
        ) from error
    try:
        with os.fdopen(handle, "w", encoding="utf-8", newline="\n") as file:
            file.write(text)
            file.flush()
            os.fsync(file.fileno())
        os.chmod(temporary, 0o644)
        os.replace(temporary, path)
    except OSError as error:
        os.unlink(temporary)
        raise RecordingError(
            f"cannot be written ({error.strerror})", where=str(path), mend="check the folder and the disk"
        ) from error


def _check_time(table: Table, time: np.ndarray) -> None:
    if time.size < MIN_SAMPLES:
        raise RecordingError(
            f"only {time.size} rows", where=table.place(time.size - 1), mend=f"record at least {MIN_SAMPLES}"
        )
    back = np.diff(time) <= 0
    if back.any():
        row = int(np.argmax(back)) + 1
        word = "repeats" if time[row] == time[row - 1] else "goes back"
        raise RecordingError(
            f"time {word}: {time[row]:.9g} s after {time[row - 1]:.9g} s",
            where=table.place(row),
            mend="remove the row, or sort the rows by time",
        )


def _implausible(channel: Channel, values: np.ndarray) -> np.ndarray:
    """Which values (n,) can be no temperature of an actuator, and no duty."""
    with np.errstate(invalid="ignore"):
        if channel.unit.quantity == "temperature":
            si = channel.unit.to_si(values)
            return (si < COLDEST_K) | (si > HOTTEST_K)
        return (values < 0) | (values > 255) if channel.unit.quantity == "duty" else np.zeros(values.shape, bool)


def _check_plausible(table: Table, channel: Channel, values: np.ndarray) -> None:
    bad = _implausible(channel, values)
    if not bad.any():
        return
    row = int(np.argmax(bad))
    problem, mend = (
        (f"pwm {values[row]:g} at line {table.line(row)} is not in 0..255", "write counts from 0 to 255")
        if channel.unit.quantity == "duty"
        else (
            f"{values[row]:g} {channel.unit.suffix} at line {table.line(row)} is no temperature here",
            "kelvin, Fahrenheit or ADC counts? convert to degC, and leave failed samples empty",
        )
    )
    raise RecordingError(problem, where=f"{table.where}: column {channel.column}", mend=mend)
