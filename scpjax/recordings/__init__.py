"""Recordings: files, conditioning, sensors, excitations and the tables of the thesis."""

from scpjax.recordings.files import read_recording, read_recordings, write_recording
from scpjax.recordings.frames import from_pandas, to_pandas
from scpjax.recordings.recording import (
    Channel,
    Hold,
    Metadata,
    Recording,
    check_informative,
)

__all__ = [
    "Channel",
    "Hold",
    "Metadata",
    "Recording",
    "check_informative",
    "from_pandas",
    "read_recording",
    "read_recordings",
    "to_pandas",
    "write_recording",
]
