"""Models in files: ``model.json`` (schema ``scpjax.model/1``), exact to the last bit of every number."""

from __future__ import annotations

import difflib
import json
import math
import os
from collections.abc import Iterable, Mapping
from pathlib import Path
from typing import Any, NoReturn, get_args

import numpy as np

import scpjax
from scpjax.errors import ModelError
from scpjax.physics.catalogue import catalogue, from_file, origin
from scpjax.physics.mechanism import Mechanism
from scpjax.physics.model import Model
from scpjax.physics.structure import DriveKind, Structure
from scpjax.recordings.files import write_text

SCHEMA = "scpjax.model/1"


def save_model(model: Model, path: str | os.PathLike[str], *, extra: Mapping[str, Any] | None = None) -> Path:
    """Write a model; ``extra`` (plain values) is kept beside it, as the columns that it was fitted on.

    The file is written beside its place and moved there when whole. **Raises** `ModelError` for a value that
    is not finite.
    """
    path, s = Path(path), model.structure
    values = model.values()
    for key, value in {**values, "ambient_K": float(model.ambient)}.items():
        if not math.isfinite(value):
            raise ModelError(f"{key} is {value}", where=str(path), mend="a model is saved with finite values")
    pulley = {"radius_m": s.pulley_radius, "mass_kg": s.pulley_mass}
    content = {
        "schema": SCHEMA,
        "version": scpjax.__version__,
        "preset": s.name,
        "drive": s.drive,
        "thermal": s.thermal,
        "mechanical": s.mechanical,
        "sides": list(s.sides),
        "pulley": pulley if s.pulley_radius is not None else None,
        "distinct": list(s.distinct),
        "base": list(s.base),
        "mechanisms": [
            {"name": m.name, "law": m.laws[int(law)], **_where_from(m, path)}
            for m, law in zip(s.mechanisms, np.asarray(model.laws), strict=True)
        ],
        "parameters": {slot.key: {"value": values[slot.key], "unit": s.unit_of(slot.parameter)} for slot in s.slots},
        "ambient_K": float(model.ambient),
        "extra": dict(extra or {}),
    }
    write_text(path, json.dumps(content, indent=1, ensure_ascii=False, allow_nan=False) + "\n")
    return path


def _where_from(m: Mechanism, path: Path) -> dict[str, str]:
    """The user's file that defines a mechanism: from the folder of the model file, and in full."""
    file = origin(m)
    if file is None:
        return {}
    try:
        beside = os.path.relpath(file, path.parent.resolve())
    except ValueError:  # another drive
        beside = str(file)
    return {"file": beside, "file_was": str(file)}


def load_model(path: str | os.PathLike[str]) -> tuple[Model, dict[str, Any]]:
    """A model as it was saved, and the ``extra`` beside it.

    **Raises** `ModelError`, one line with the file, for anything in it that is not such a model.
    """
    path = Path(path)
    reader = _Reader(str(path), _read(path))
    s = reader.structure()
    laws = reader.laws(s.mechanisms)
    theta = np.asarray(reader.theta(s, laws))
    return Model(s, theta, np.asarray(laws), reader.number("ambient_K", None)), reader.get("extra", dict, {})


def _read(path: Path) -> dict[str, Any]:
    where = str(path)
    if path.is_dir():
        mend = f"name {path / 'model.json'}" if (path / "model.json").exists() else "name a model.json"
        raise ModelError("is a folder, not a model file", where=where, mend=mend)
    try:
        content = json.loads(path.read_text(encoding="utf-8-sig"))
    except FileNotFoundError as error:
        mend = "fit writes one: scpjax fit FILE --out DIR"
        raise ModelError("no such file", where=where, mend=mend) from error
    except OSError as error:
        raise ModelError(f"cannot be read ({error.strerror})", where=where, mend="check it") from error
    except UnicodeDecodeError as error:
        raise ModelError("is not text", where=where, mend="name a model.json") from error
    except json.JSONDecodeError as error:
        raise ModelError(
            f"is not JSON: {error.msg}", where=f"{where}:line {error.lineno}", mend="fit again, or repair it"
        ) from error
    found = content.get("schema") if isinstance(content, dict) else None
    if found != SCHEMA:
        problem = "is no model file" if found is None else f"holds {found!r}, not a model"
        raise ModelError(problem, where=where, mend=f'its "schema" must be "{SCHEMA}"')
    return content


class _Reader:
    """Reads keys of a model file, and knows the file for its complaints."""

    def __init__(self, where: str, content: dict[str, Any]):
        self.where, self.content = where, content

    def fail(self, problem: str, mend: str) -> NoReturn:
        raise ModelError(problem, where=self.where, mend=mend)

    def get(self, key: str, kind: type, default: Any = None) -> Any:
        value = self.content.get(key, default)
        if not isinstance(value, kind):
            self.fail(f'"{key}" is missing or no {_KINDS[kind]}', "fit again, or repair the file")
        return value

    def number(self, key: str, default: float | None) -> float:
        return self.finite(self.content.get(key, default), f'"{key}"')

    def finite(self, value: Any, what: str) -> float:
        if isinstance(value, bool) or not isinstance(value, int | float) or not math.isfinite(value):
            self.fail(f"{what} is not a number", "write a finite number, SI")
        return float(value)

    def names(self, key: str) -> tuple[str, ...]:
        values = self.get(key, list)
        if not all(isinstance(v, str) for v in values):
            self.fail(f'"{key}" is no list of names', "fit again, or repair the file")
        return tuple(values)

    def known(self, name: Any, kind: str, among: Iterable[str]) -> None:
        among = list(among)
        if name not in among:
            close = difflib.get_close_matches(str(name), among, n=1, cutoff=0.5)
            nearest = f"did you mean {close[0]!r}? " if close else ""
            self.fail(f"unknown {kind} {name!r}", f"{nearest}there are {', '.join(among)}")

    def define(self, name: str, row: dict[str, Any]) -> None:
        """Read the user's file that defines a mechanism."""
        places = [Path(self.where).parent / str(row["file"]), Path(str(row.get("file_was", row["file"])))]
        file = next((p for p in places if p.is_file()), None)
        if file is None:
            self.fail(f"the mechanism {name!r} is defined in {places[0]}, which is not there", "put the file back")
        from_file(file)

    def structure(self) -> Structure:
        rows = self.get("mechanisms", list)
        found: list[Mechanism] = []
        for row in rows:
            name = row.get("name") if isinstance(row, dict) else row
            if isinstance(row, dict) and "file" in row and name not in catalogue():
                self.define(str(name), row)
            self.known(name, "mechanism", catalogue())
            found.append(catalogue()[str(name)])
        drive, sides = self.get("drive", str), self.names("sides")
        self.known(drive, "drive", get_args(DriveKind))
        if sides not in (("",), ("agonist", "antagonist")):
            self.fail(f'"sides" are {list(sides)}', 'write [""] or ["agonist", "antagonist"]')
        pulley = self.get("pulley", dict) if self.content.get("pulley") is not None else None
        radius = None if pulley is None else self.finite(pulley.get("radius_m"), "pulley radius_m")
        try:
            return Structure(
                name=self.get("preset", str),
                mechanisms=tuple(found),
                sides=sides,
                thermal=self.get("thermal", bool),
                mechanical=self.get("mechanical", bool),
                drive=drive,
                pulley_radius=radius,
                pulley_mass=0.0 if pulley is None else self.finite(pulley.get("mass_kg"), "pulley mass_kg"),
                distinct=self.names("distinct"),
                base=self.names("base"),
            )
        except ModelError as error:
            if error.where:
                raise
            raise ModelError(error.problem, where=self.where, mend=error.mend) from error

    def laws(self, mechanisms: tuple[Mechanism, ...]) -> list[float]:
        out = []
        for m, row in zip(mechanisms, self.get("mechanisms", list), strict=True):
            law = (row.get("law") if isinstance(row, dict) else "") or m.laws[0]
            self.known(law, f"law of {m.name}", m.laws)
            out.append(float(m.laws.index(law)))
        return out

    def theta(self, s: Structure, laws: list[float]) -> list[float]:
        given = self.get("parameters", dict)
        for key in given:
            self.known(key, "parameter", s.index)
        theta = []
        law = {m.name: int(law) for m, law in zip(s.mechanisms, laws, strict=True)}
        for slot in s.slots:
            idle = not s.mechanism(slot.mechanism).serves(slot.parameter, law[slot.mechanism])
            if slot.key not in given and idle:  # a parameter of other laws that came after this file was written
                theta.append(self.finite(slot.parameter.null, slot.key))
                continue
            if slot.key not in given:
                unit = "" if slot.parameter.unit == "1" else f" in {s.unit_of(slot.parameter)}"
                mend = f"fit again, if an earlier version wrote the file, or give its value{unit}"
                self.fail(f"parameter {slot.key!r} is missing", mend)
            row = given[slot.key]
            value, unit = (row.get("value"), row.get("unit")) if isinstance(row, dict) else (row, None)
            if unit not in (None, s.unit_of(slot.parameter), slot.parameter.unit):  # the last: of earlier versions
                self.fail(f"{slot.key} is in {unit!r}", f"give it in {s.unit_of(slot.parameter)!r}")
            theta.append(self.finite(value, slot.key))
        return theta


_KINDS = {dict: "object", list: "list", str: "text", bool: "true or false"}

__all__ = ["SCHEMA", "load_model", "save_model"]
