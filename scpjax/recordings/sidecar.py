"""The TOML file beside a recording: what it holds, checked key by key."""

from __future__ import annotations

import difflib
import json
import re
import tomllib
from collections.abc import Iterable
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, cast, get_args

from scpjax.errors import RecordingError
from scpjax.recordings.recording import MODELS, Hold, Metadata
from scpjax.recordings.roles import split_names
from scpjax.recordings.table import read_text
from scpjax.units import UNITS

KEYS: dict[str, tuple[str, ...]] = {
    "recording": ("title", "source", "provenance", "hold", "model"),
    "roles": ("drive", "response"),
    "actuator": ("supply_V", "resistance_ohm", "moving_mass_kg"),
    "environment": ("ambient_degC",),
    "pulley": ("radius_m", "mass_kg"),
}
"""Sections and keys. ``[actuator]`` takes any number: the names of the parameters that are known."""

NEXT = "next"
"""How the drive runs between rows where each tells what was applied until its time, as of a logger that reads after it
has driven: that of the next row."""

_POSITIVE = ("resistance", "mass", "radius", "supply", "length", "diameter", "capacity")
_QUIET = {unit.suffix: unit for unit in UNITS if unit.suffix not in ("K", "pwm", "pct") and unit.offset == 0.0}
_SI = {"g": "kg", "mm": "m", "cm": "m", "mV": "V", "mA": "A", "mW": "W", "mN": "N", "ms": "s"}


@dataclass(frozen=True)
class Sidecar:
    """What the TOML says: roles and hold (None where it does not say), and the rest; ``next``: whether between rows the
    drive is that of the next one.
    """

    drive: tuple[str, ...] | None = None
    response: tuple[str, ...] | None = None
    hold: Hold | None = None
    next: bool = False
    metadata: Metadata = field(default_factory=Metadata)


def read_sidecar(path: str | Path, *, name: str = "", csv_path: str = "") -> Sidecar:
    """Read and check ``NAME.toml``; ``RecordingError`` names the line and the nearest right key."""
    text, where = read_text(path), str(path)
    try:
        data = tomllib.loads(text)
    except tomllib.TOMLDecodeError as error:
        line = re.search(r"line (\d+)", str(error))
        number = int(line[1]) if line else len(text.splitlines())
        problem = str(error).split(" (at")[0]
        raise RecordingError(
            f"is not TOML: {problem}",
            where=f"{where}:line {number}",
            mend='write key = value, text in "quotes"',
        ) from error
    checker = _Checker(where, text)
    checker.check_keys(data)
    recording, roles = data.get("recording", {}), data.get("roles", {})
    actuator = checker.actuator(data.get("actuator", {}))
    ambient = checker.number("environment", "ambient_degC", data.get("environment", {}).get("ambient_degC"))
    if ambient is not None and not -60 <= ambient <= 200:
        checker.fail("ambient_degC", f"ambient_degC = {ambient:g} is no ambient temperature", "give it in degC, not K")
    pulley = data.get("pulley", {})
    metadata = Metadata(
        title=checker.string("title", recording.get("title", "")),
        source=checker.string("source", recording.get("source", "")),
        provenance=checker.string("provenance", recording.get("provenance", "")),
        name=name,
        path=csv_path,
        model=checker.choice("model", recording.get("model"), MODELS),
        known=tuple((key, value) for key, value in actuator.items() if key != "supply_V"),
        ambient_K=None if ambient is None else ambient + 273.15,
        pulley_radius_m=checker.number("pulley", "radius_m", pulley.get("radius_m")),
        pulley_mass_kg=checker.number("pulley", "mass_kg", pulley.get("mass_kg")),
        supply_V=actuator.get("supply_V"),
    )
    hold = checker.choice("hold", recording.get("hold"), (*get_args(Hold), NEXT))
    return Sidecar(
        drive=checker.role("drive", roles),
        response=checker.role("response", roles),
        hold=cast("Hold | None", "zero_order" if hold == NEXT else hold),
        next=hold == NEXT,
        metadata=metadata,
    )


@dataclass(frozen=True)
class _Checker:
    """Knows the text, so that an error can name the line of a key."""

    where: str
    text: str

    def line(self, key: str) -> int:
        pattern = re.compile(rf"^\s*(\[\s*)?[\"']?{re.escape(key)}[\"']?\s*(=|\]|$)")
        return next((i for i, line in enumerate(self.text.splitlines(), 1) if pattern.match(line)), 1)

    def fail(self, key: str, problem: str, mend: str) -> None:
        raise RecordingError(problem, where=f"{self.where}:line {self.line(key)}", mend=mend)

    def unknown(self, key: str, shown: str, allowed: Iterable[str]) -> None:
        allowed = list(allowed)
        close = difflib.get_close_matches(key, allowed, n=1, cutoff=0.5)
        nearest = f"did you mean '{close[0]}'? " if close else ""
        self.fail(key, f"unknown {shown}", f"{nearest}use one of {', '.join(allowed)}")

    def check_keys(self, data: dict[str, Any]) -> None:
        for section, content in data.items():
            if section not in KEYS:
                shown = f"section [{section}]" if isinstance(content, dict) else f"key '{section}' above any section"
                self.unknown(section, shown, KEYS)
            if not isinstance(content, dict):
                self.fail(section, f"'{section}' is no section", f"write it as [{section}] on a line of its own")
            for key in content:
                if section != "actuator" and key not in KEYS[section]:
                    self.unknown(key, f"key '{key}' in [{section}]", KEYS[section])

    def string(self, key: str, value: Any) -> str:
        if not isinstance(value, str):
            self.fail(key, f"{key} is not text", f'write {key} = "..."')
        return value

    def choice(self, key: str, value: Any, allowed: tuple[str, ...]) -> str | None:
        if value is not None and value not in allowed:
            alias = {"zoh": "zero_order", "foh": "linear", "bl": "band_limited"}.get(str(value).lower())
            close = [alias] if alias else difflib.get_close_matches(str(value).lower(), allowed, n=1)
            nearest = f"did you mean '{close[0]}'? " if close else ""
            self.fail(key, f"unknown {key} '{value}'", f"{nearest}use one of {', '.join(allowed)}")
        return value

    def role(self, key: str, roles: dict[str, Any]) -> tuple[str, ...] | None:
        value = roles.get(key)
        if value is None:
            return None
        listed = isinstance(value, list) and all(isinstance(item, str) for item in value)
        if not (isinstance(value, str) or listed) or not split_names(value):
            self.fail(key, f"{key} names no column", f'write {key} = "COLUMN" or ["COLUMN", "COLUMN"]')
        return split_names(value)

    def number(self, section: str, key: str, value: Any) -> float | None:
        if value is None:
            return None
        if isinstance(value, bool) or not isinstance(value, int | float) or not abs(value) < float("inf"):
            self.fail(key, f"{key} in [{section}] is not a number", f"write {key} = 1.5, without quotes or units")
        if any(word in key for word in _POSITIVE) and value <= 0:
            self.fail(key, f"{key} = {value:g} is not positive", "check the sign and the value")
        return float(value)

    def actuator(self, section: dict[str, Any]) -> dict[str, float]:
        values: dict[str, float] = {}
        for key, raw in section.items():
            value = self.number("actuator", key, raw)
            assert value is not None
            stem, _, suffix = key.rpartition("_")
            if suffix in _SI and stem and not stem.endswith("_per"):
                key, value = f"{stem}_{_SI[suffix]}", _QUIET[suffix].to_si(value)
            close = difflib.get_close_matches(key, KEYS["actuator"], n=1, cutoff=0.8)
            if key not in KEYS["actuator"] and close and close[0].rpartition("_")[2] == key.rpartition("_")[2]:
                self.unknown(next(iter(k for k in section if k.startswith(stem))), f"key '{key}' in [actuator]", close)
            values[key] = value
        return values


def sidecar_text(metadata: Metadata, *, hold: str, drive: Iterable[str], response: Iterable[str]) -> str:
    """The TOML text of this metadata: ``read_sidecar`` gives it back."""
    ambient = None if metadata.ambient_K is None else round(metadata.ambient_K - 273.15, 9)
    sections: dict[str, dict[str, Any]] = {
        "recording": {
            "title": metadata.title or None,
            "source": metadata.source or None,
            "provenance": metadata.provenance or None,
            "hold": hold,
            "model": metadata.model,
        },
        "roles": {"drive": list(drive), "response": list(response)},
        "actuator": {"supply_V": metadata.supply_V, **dict(metadata.known)},
        "environment": {"ambient_degC": ambient},
        "pulley": {"radius_m": metadata.pulley_radius_m, "mass_kg": metadata.pulley_mass_kg},
    }
    blocks = []
    for section, content in sections.items():
        rows = [f"{key} = {_toml(value)}" for key, value in content.items() if value is not None]
        if rows:
            blocks.append("\n".join([f"[{section}]", *rows]))
    return "\n\n".join(blocks) + "\n"


def _toml(value: str | float | list[str]) -> str:
    if isinstance(value, list):
        return "[" + ", ".join(_toml(item) for item in value) + "]"
    return json.dumps(value).replace("\x7f", "\\u007f") if isinstance(value, str) else repr(float(value))
