"""Which columns are drives and which are responses: by their names, or as the user says."""

from __future__ import annotations

import difflib
from collections.abc import Sequence
from dataclasses import dataclass

from scpjax.errors import RecordingError
from scpjax.units import STEM_QUANTITY, parse_column, stem_without_unit

JOINT_DRIVES = (
    ("voltage_agonist", "voltage_antagonist"),
    ("pwm_agonist", "pwm_antagonist"),
)
DRIVES = ("voltage", "pwm", "power", "current")
RESPONSES = (
    "temperature",
    "temperature_agonist",
    "temperature_antagonist",
    "displacement",
    "force",
    "angle",
)


@dataclass(frozen=True)
class Roles:
    """Column names of the drives and responses."""

    drive: tuple[str, ...]
    response: tuple[str, ...]


def choose_roles(
    names: Sequence[str],
    *,
    model: str | None = None,
    drive: str | Sequence[str] | None = None,
    response: str | Sequence[str] | None = None,
    where: str = "",
    require_response: bool = True,
) -> Roles:
    """The drives and responses among the columns ``names``.

    What ``drive`` and ``response`` (comma separated, or a list) do not settle, the names do: the drive is
    the joint's pair of voltages (or pwm), else the first of voltage, pwm, power, current; for
    ``model="tm"`` it is the temperature where there is one. Responses are temperature, displacement, force
    and angle. Raises ``RecordingError`` where a named column is not there, has no usable unit, or no drive
    is found, or no response where one is required.
    """
    found = _find(names, model, drive is None, response is None, where)
    drives = _automatic_drives(found, model) if drive is None else _named(names, drive, "drive", where)
    if response is None:
        responses = tuple(found[stem] for stem in RESPONSES if stem in found and found[stem] not in drives)
    else:
        responses = _named(names, response, "response", where)
    for chosen, kind, example in (
        (drives, "drive", "voltage_V"),
        (responses, "response", "displacement_mm or temperature_degC"),
    ):
        if not chosen and (kind == "drive" or require_response):
            raise RecordingError(
                f"no column is the {kind} among {', '.join(names)}",
                where=where,
                mend=f'name one {example}, or say which it is: {kind} = "COLUMN" under [roles]',
            )
    both = [name for name in drives if name in responses]
    if both:
        raise RecordingError(
            f"column '{both[0]}' is drive and response", where=where, mend="choose another under [roles]"
        )
    return Roles(drives, responses)


def split_names(names: str | Sequence[str]) -> tuple[str, ...]:
    """``"a, b"`` or ``["a", "b"]`` as ``("a", "b")``."""
    parts = names.split(",") if isinstance(names, str) else list(names)
    return tuple(part.strip() for part in parts if part.strip())


def _automatic_drives(found: dict[str, str], model: str | None) -> tuple[str, ...]:
    if model == "tm" and "temperature" in found and len(found) > 1:
        return (found["temperature"],)
    for pair in JOINT_DRIVES:
        if any(stem in found for stem in pair):
            return tuple(found[stem] for stem in pair if stem in found)
    for stem in DRIVES:
        if stem in found:
            return (found[stem],)
    return ()


def _find(names: Sequence[str], model: str | None, drives: bool, responses: bool, where: str) -> dict[str, str]:
    """Columns by stem that may take a role without being named: those whose stem is one we know."""
    known = (*DRIVES, *(stem for pair in JOINT_DRIVES for stem in pair)) if drives else ()
    known += ("temperature",) if drives and model == "tm" else ()
    known += RESPONSES if responses else ()
    found: dict[str, str] = {}
    for name in names:
        if name not in known and stem_without_unit(name) not in known:
            continue
        stem, _ = parse_column(name, where=f"{where}: column {name}")
        if stem in found:
            raise RecordingError(
                f"columns '{found[stem]}' and '{name}' are both {stem}",
                where=f"{where}: column {name}",
                mend="remove one, or choose one under [roles]",
            )
        found[stem] = name
    return found


def _named(names: Sequence[str], chosen: str | Sequence[str], kind: str, where: str) -> tuple[str, ...]:
    columns = split_names(chosen)
    for column in columns:
        if column not in names:
            close = difflib.get_close_matches(column, names, n=1)
            nearest = f"did you mean '{close[0]}'? " if close else ""
            raise RecordingError(
                f"no column '{column}' for the {kind}",
                where=where,
                mend=f"{nearest}the columns are {', '.join(names)}",
            )
        parse_column(column, where=f"{where}: column {column}", allow_unknown=True)
    if len(set(columns)) < len(columns):
        raise RecordingError(f"a {kind} column is named twice", where=where, mend="name each once")
    return columns


def is_temperature(stem: str) -> bool:
    """Whether a column of this stem is held to be a temperature."""
    return STEM_QUANTITY.get(stem.split("_")[0]) == "temperature"
