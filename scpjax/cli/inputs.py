"""Recordings and models as the command line names them."""

from __future__ import annotations

import dataclasses
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any, get_args

from scpjax.errors import ModelError, RecordingError, ScpjaxError
from scpjax.fit.data import outputs_among
from scpjax.fit.setup import KNOWN
from scpjax.physics.known import KNOWN_MODELS, known_model, with_drive
from scpjax.physics.model import Model
from scpjax.physics.presets import structure
from scpjax.physics.storage import load_model
from scpjax.physics.structure import DriveKind, Structure
from scpjax.recordings.files import read_recording
from scpjax.recordings.recording import Hold, Recording, place
from scpjax.recordings.roles import is_temperature, split_names
from scpjax.recordings.table import read_table
from scpjax.simulate.drive import drive_kind, drive_values
from scpjax.units import Unit, get_unit, parse_column


def read_files(
    paths: Sequence[str], *, drive: str | None, response: str | None, model: str | None = None
) -> list[Recording]:
    """The recordings of one actuator, for a model if one is asked for; a file may be named once."""
    seen: set[Path] = set()
    recordings = []
    for path in paths:
        if Path(path).resolve() in seen:
            raise RecordingError("is named twice", where=path, mend="name each file once")
        seen.add(Path(path).resolve())
        recordings.append(read_recording(path, drive=drive, response=response, model=model))
    return recordings


def read_input(path: str, *, structure: Structure, told: str | None, extra: Mapping[str, Any]) -> Recording:
    """A file as the input of a model; of its other columns only those that the model gives are read.

    ``extra`` lies beside a fitted model. The outputs may be missing.
    """
    names = read_table(path).names
    drive: str | list[str] | None = told
    if drive is None and extra.get("drive") and all(name in names for name in extra["drive"]):
        drive = list(extra["drive"])
    warm = [name for name in names if is_temperature(_stem(name))]
    if drive is None and structure.name == "tm" and len(warm) == 1:
        drive = warm
    driving = () if drive is None else split_names(drive)
    mine = [n for n in names if n in extra.get("response", ()) or _stem(n) in structure.outputs]
    hold: Hold | None = extra["hold"] if extra.get("hold") in get_args(Hold) else None
    recording = read_recording(
        path,
        drive=drive,
        response=[name for name in mine if name not in driving],
        hold=hold,
        require_outputs=False,
    )
    meta = recording.metadata
    if meta.supply_V is None and isinstance(extra.get("supply_V"), int | float):
        recording = recording.with_metadata(dataclasses.replace(meta, supply_V=float(extra["supply_V"])))
    return recording


def _stem(name: str) -> str:
    try:
        return parse_column(name, allow_unknown=True)[0]
    except ScpjaxError:
        return name


def named_model(name: str, path: str, told: str | None) -> tuple[Model, Recording, dict[str, Any]]:
    """A model (by name, or a file) and the input file for it, with the drive of the file."""
    if name not in KNOWN_MODELS:
        _check_name(name)
        model, extra = load_model(name)
        recording = read_input(path, structure=model.structure, told=told, extra=extra)
        return _in_the_room(fit_drive(model, recording), recording), recording, extra
    kind = structure("plant" if name == "thesis" else name, pulley_radius=1.0)
    recording = read_input(path, structure=kind, told=told, extra={})
    meta = recording.metadata
    try:
        model = known_model(
            name,
            drive=drive_kind(recording.input_channels[0].stem, name),
            pulley_radius=meta.pulley_radius_m,
            pulley_mass=meta.pulley_mass_kg,
            ambient=meta.ambient_K,
        )
    except ModelError as error:
        raise ModelError(error.problem, where=path, mend=error.mend) from error
    drive_values(model.structure, recording)
    return _in_the_room(model, recording), recording, {}


def _in_the_room(model: Model, recording: Recording) -> Model:
    """The model at the ambient temperature that the recording tells, if it does."""
    ambient = recording.metadata.ambient_K
    return model if ambient is None else Model(model.structure, model.theta, model.laws, ambient)


def _check_name(name: str) -> None:
    looks_like_file = name.endswith(".json") or "/" in name or "\\" in name or Path(name).exists()
    if not looks_like_file:
        raise ModelError(
            f"no model named '{name}'",
            mend=f"use {', '.join(KNOWN_MODELS)} or a model.json that fit has written",
        )


def fit_drive(model: Model, recording: Recording) -> Model:
    """The model with the drive of the recording: volts and pwm have the same gain, others must be as fitted.

    **Raises** `ModelError` where they are not.
    """
    drive_values(model.structure, recording)
    if model.structure.system:  # takes its drive as it is
        return model
    kind: DriveKind = drive_kind(recording.input_channels[0].stem, model.structure.name)
    mine = model.structure.drive
    if kind == mine:
        return model
    if {kind, mine} == {"voltage", "pwm"}:
        return with_drive(model, kind)
    raise ModelError(
        f"the drive {recording.input_channels[0].column} is no {mine}, which the model was made for",
        where=place(recording.metadata),
        mend="name the column with --drive",
    )


def output_columns(model: Model, recording: Recording, extra: Mapping[str, Any]) -> dict[str, tuple[int, Unit]]:
    """Output (its index) and unit by column name: as fitted, else as in the file, else degC, mm and deg."""
    stems = model.structure.outputs
    found: dict[int, tuple[str, Unit]] = {}
    for columns in (extra.get("response", ()), [c.column for c in recording.output_channels]):
        parsed = [parse_column(str(column), allow_unknown=True) for column in columns]
        for index, k in outputs_among(model.structure, [stem for stem, _ in parsed]).items():
            found.setdefault(index, (str(columns[k]), parsed[k][1]))
    own = model.structure.system
    for i, stem in enumerate(stems):
        suffix = _USUAL.get(stem.split("_")[0], "")
        usual = (own.outputs[i], own.channels[i][1]) if own else (f"{stem}_{suffix}", get_unit(suffix))
        found.setdefault(i, usual)
    return {found[i][0]: (i, found[i][1]) for i in range(len(stems))}


_USUAL = {"temperature": "degC", "displacement": "mm", "angle": "deg", "force": "N"}


def fixed_values(items: Sequence[str]) -> tuple[dict[str, float], dict[str, float]]:
    """``--fixed KEY=VALUE`` as values by parameter key, and as values by the names of ``[actuator]``."""
    keys: dict[str, float] = {}
    known: dict[str, float] = {}
    for item in items:
        key, equals, text = item.partition("=")
        where, mend = f"--fixed {item}", "write KEY=VALUE, such as elastic_spring.stiffness=100"
        if not equals or not key.strip():
            raise ModelError("is no KEY=VALUE", where=where, mend=mend)
        try:
            value = float(text)
        except ValueError as error:
            raise ModelError(f"'{text}' is not a number", where=where, mend=mend) from error
        if not abs(value) < float("inf"):
            raise ModelError("is not finite", where=where, mend=mend)
        (known if key.strip() in KNOWN else keys)[key.strip()] = value
    return keys, known


def with_known(recording: Recording, known: Mapping[str, float]) -> Recording:
    """The recording with these values of ``[actuator]``."""
    meta = recording.metadata
    merged = tuple({**dict(meta.known), **known}.items())
    return recording.with_metadata(dataclasses.replace(meta, known=merged))
