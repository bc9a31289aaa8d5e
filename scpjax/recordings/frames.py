"""Recordings from and to pandas data frames; pandas is needed only when these are called."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING

import numpy as np

from scpjax.errors import RecordingError
from scpjax.recordings.recording import Hold, Metadata, Recording
from scpjax.recordings.roles import choose_roles

if TYPE_CHECKING:
    import pandas as pd


def from_pandas(
    frame: pd.DataFrame,
    *,
    drive: str | Sequence[str] | None = None,
    response: str | Sequence[str] | None = None,
    hold: Hold = "zero_order",
    metadata: Metadata | None = None,
) -> Recording:
    """A recording of a data frame with the columns of a file (``time_s``, ``voltage_V``); roles as there."""
    names = [str(name) for name in frame.columns]
    if "time_s" not in names:
        raise RecordingError(
            "no column 'time_s'", where="data frame", mend="add it: frame['time_s'] = frame.index * period"
        )
    model = None if metadata is None else metadata.model
    roles = choose_roles(names, model=model, drive=drive, response=response, where="data frame")
    return Recording.from_arrays(
        np.asarray(frame["time_s"]),
        {name: np.asarray(frame[name]) for name in roles.drive},
        {name: np.asarray(frame[name]) for name in roles.response},
        hold=hold,
        metadata=metadata,
    )


def to_pandas(recording: Recording) -> pd.DataFrame:
    """A data frame with the columns of the file in the units of the file; NaN where the weight is 0."""
    try:
        import pandas as pd
    except ImportError as error:
        raise RecordingError("pandas is not installed", mend="run: pip install pandas") from error
    return pd.DataFrame(file_columns(recording))


def file_columns(recording: Recording) -> dict[str, np.ndarray]:
    """``time_s`` and every channel (n,) in the units of the file; NaN where the weight is 0."""
    columns = {"time_s": recording.time}
    for i, channel in enumerate(recording.input_channels):
        columns[channel.column] = channel.unit.from_si(recording.inputs[:, i])
    for i, channel in enumerate(recording.output_channels):
        values = channel.unit.from_si(recording.outputs[:, i])
        columns[channel.column] = np.where(recording.weights[:, i] > 0, values, np.nan)
    return columns
