"""Values that can be read but hardly be meant: a wrong unit, a column under another's name."""

from __future__ import annotations

import difflib
from collections.abc import Sequence

import numpy as np

from scpjax.errors import ScpjaxError
from scpjax.recordings.recording import Recording
from scpjax.recordings.roles import RESPONSES
from scpjax.units import STEM_QUANTITY, parse_column

LOOK = "look again: "
"""How such a note begins."""

_ROOM = (278.15, 313.15)  # K
_ROOM_COLUMNS = ("ambient_degC", "ambient_degF", "ambient_K")
_COLDEST = 253.15  # K
_HOTTEST = 573.15  # K; nylon melts at 490 to 540 K
_TRAVEL = (5e-5, 1.0)  # m, between least and greatest reading
_ANGLE = 4 * np.pi  # rad
_GREATEST = {"voltage": (100.0, "V"), "current": (100.0, "A"), "power": (2e3, "W")}
_SLOWEST = 30.0  # s between samples


def doubts(recording: Recording) -> tuple[str, ...]:
    """What to look at again before a result is believed, in one sentence each with the mend; nothing is changed."""
    r = recording
    name = r.metadata.name or "the recording"
    out = []
    period = float(np.median(np.diff(r.time)))
    if period > _SLOWEST:
        out.append(f"{name}: samples are {period:.4g} s apart; stamps in milliseconds belong in a column time_ms")
    for c in (*r.input_channels, *r.output_channels):
        is_input = c in r.input_channels
        values = r.input(c.stem) if is_input else r.output(c.stem)[r.weight(c.stem) > 0]
        if not values.size:
            continue
        low, high = float(np.min(values)), float(np.max(values))
        where = f"{name}, {c.column}"
        kind = c.stem.split("_")[0]
        if kind == "temperature" and (high > _HOTTEST or low < _COLDEST):
            out.append(
                f"{where}: {low - 273.15:.4g} to {high - 273.15:.4g} degC; is it in kelvin (temperature_K), raw "
                "counts, or another quantity?"
            )
        elif kind == "displacement" and not _TRAVEL[0] < high - low < _TRAVEL[1]:
            out.append(
                f"{where}: all of its travel is {1e3 * (high - low):.4g} mm; is it in m or cm (displacement_m, "
                "displacement_cm)?"
            )
        elif kind == "angle" and high - low > _ANGLE:
            out.append(f"{where}: turns by {np.degrees(high - low):.4g} deg; is it in another unit?")
        elif kind in _GREATEST and max(-low, high) > _GREATEST[kind][0]:
            unit = _GREATEST[kind][1]
            out.append(f"{where}: reaches {max(-low, high):.4g} {unit}; is it in thousandths ({c.stem}_m{unit})?")
    for column in r.metadata.unread:
        meant = _meant(column, [c.stem for c in r.input_channels], [c.stem for c in r.output_channels])
        if meant:
            out.append(f"{name}: the column {column} is not read; is it {meant}?")
        elif column in _ROOM_COLUMNS and r.metadata.ambient_K is None:
            out.append(
                f"{name}: the column {column} is not read; give the room's temperature as ambient_degC in the .toml"
            )
    if r.metadata.quasi_static:
        out.append(f"{name}: no time was recorded, so a sample counts as a second; add a column time_s if there is one")
    return tuple(LOOK + text for text in out)


def _meant(column: str, drives: Sequence[str], there: Sequence[str]) -> str:
    """The response that a column which is not read may have been meant as, by its unit and nearly its name."""
    try:
        stem, unit = parse_column(column)
    except ScpjaxError:  # no unit that we know: a column of something else
        return ""
    joint = any(d.endswith("agonist") for d in drives)
    stems = [s for s in RESPONSES if STEM_QUANTITY[s.split("_")[0]] == unit.quantity and s not in (*drives, *there)]
    stems = [s for s in stems if joint or not s.endswith("agonist")]
    words = {s: s for s in stems} | {_SHORT[s]: s for s in stems if s in _SHORT}
    close = difflib.get_close_matches(stem.lower(), words, n=1, cutoff=0.75)
    return f"{words[close[0]]}_{unit.suffix}" if close and words[close[0]] != stem else ""


_SHORT = {"temperature": "temp", "displacement": "disp"}


def doubts_of_ambient(name: str, ambient: float) -> tuple[str, ...]:
    """The same of an ambient temperature [K] that was taken from a thermometer."""
    if _ROOM[0] < ambient < _ROOM[1]:
        return ()
    return (
        f"{LOOK}{name}: it begins at {ambient - 273.15:.4g} degC, which is no room's temperature; is it in degF, is it "
        "another column's, or did it begin warm (then say ambient_degC in the .toml)?",
    )
