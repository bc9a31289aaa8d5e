"""What is connected to the board and what its counts mean, both ways; kept in ``bench.toml``.

Conversions are ratiometric: a sum of four of 10 bits, so that volts are ``5 (counts + 2) / 4096``.
"""

from __future__ import annotations

import dataclasses
import difflib
import functools
import math
import os
import tomllib
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, Literal, get_args

import numpy as np

from scpjax.bench.errors import BenchError
from scpjax.bench.messages import Resistance, Sample
from scpjax.recordings.files import write_text
from scpjax.recordings.recording import Metadata
from scpjax.recordings.sensors import (
    ZERO_C,
    divider_resistance,
    divider_voltage,
    thermistor_resistance,
    thermistor_temperature,
)

Source = Literal["potentiometer", "echo", "encoder", "none"]
SOURCES: tuple[Source, ...] = ("potentiometer", "echo", "encoder")
"""What the board can read a position from, by its parameter ``position_source``."""
REFERENCE_V = 5.0
FULL = 4096
"""Counts of a whole reference voltage."""
ECHO_UNIT_S = 0.5e-6
POTENTIOMETER_RAD = math.radians(270.0) / FULL
"""Angle of one count of a potentiometer of 270 degrees."""


@dataclass(frozen=True, kw_only=True)
class Thermistors:
    """NTC from 5 V to the tap, ``fixed_ohm`` from there to ground, on A0 and A1. ``fitted``: whether there are any."""

    fitted: bool = True
    nominal_ohm: float = 100e3
    beta_K: float = 3950.0
    fixed_ohm: float = 10e3

    def temperature(self, counts: Any) -> Any:
        """Kelvin of counts; NaN where the thermistor is open or shorted."""
        volts = REFERENCE_V * (np.asarray(counts, float) + 2.0) / FULL
        good = (np.asarray(counts) > 12) & (np.asarray(counts) < 4080)
        ohms = divider_resistance(np.where(good, volts, 1.0), fixed_ohm=self.fixed_ohm, supply_V=REFERENCE_V)
        kelvin = thermistor_temperature(ohms, nominal_ohm=self.nominal_ohm, beta_K=self.beta_K)
        return np.where(good, kelvin, np.nan)

    def reading(self, counts: int) -> float:
        """Kelvin of the counts of one sample, looked up; NaN as `temperature`."""
        return self._table[counts] if 0 <= counts < FULL else math.nan

    @functools.cached_property
    def _table(self) -> list[float]:
        return self.temperature(np.arange(FULL)).tolist()

    def volts(self, kelvin: Any) -> Any:
        """Volts at the tap."""
        ohms = thermistor_resistance(kelvin, nominal_ohm=self.nominal_ohm, beta_K=self.beta_K)
        return divider_voltage(ohms, fixed_ohm=self.fixed_ohm, supply_V=REFERENCE_V)


@dataclass(frozen=True, kw_only=True)
class Position:
    """A linear law from counts to the position: ``per_count (counts - zero)``, in m, or rad for a joint.

    Counts of an echo are 0.5 us of its duration (there and back); a longer echo is a longer actuator where
    ``per_count`` is negative. Where it is not given (NaN), a `Wiring` takes that of a potentiometer of 270 degrees on
    its pulley.
    """

    source: Source = "potentiometer"
    per_count: float = math.nan
    zero: float = FULL / 2

    def value(self, counts: Any) -> Any:
        """Position of counts."""
        return self.per_count * (np.asarray(counts, float) - self.zero)

    def counts(self, value: Any) -> Any:
        """Counts (not rounded) of a position."""
        return self.zero + np.asarray(value, float) / self.per_count


@dataclass(frozen=True, kw_only=True)
class Sensing:
    """Resistance of the heater wire by a constant current (thesis 3.3.2), amplified, on A4 and A5."""

    fitted: bool = True
    current_A: float = 0.125
    gain: float = 20.0

    def resistance(self, counts: float) -> float:
        """Ohms of counts."""
        return REFERENCE_V * (counts + 2.0) / FULL / self.gain / self.current_A

    def volts(self, ohms: float) -> float:
        """Volts at the input, which the reference limits."""
        return min(ohms * self.current_A * self.gain, REFERENCE_V)


@dataclass(frozen=True, kw_only=True)
class Wiring:
    """A bench: one actuator or a joint of two, its supply and sensors. SI; ``known`` as in ``[actuator]`` of files.

    ``current_V_per_A`` is the amplified shunt's at A3, ``ambient_K`` the room.
    """

    sides: Literal[1, 2] = 1
    supply_V: float = 3.7
    thermistors: Thermistors = field(default_factory=Thermistors)
    position: Position = field(default_factory=Position)
    sensing: Sensing = field(default_factory=Sensing)
    current_V_per_A: float = 0.4
    ambient_K: float | None = None
    pulley_radius_m: float = 0.015
    pulley_mass_kg: float = 0.0
    known: tuple[tuple[str, float], ...] = ()

    def __post_init__(self) -> None:
        if self.sides not in (1, 2):
            raise BenchError(f"a bench of {self.sides} actuators", mend="sides is 1, or 2 for a joint")
        if self.position.source not in get_args(Source):
            raise BenchError(f"no position sensor {self.position.source!r}", mend=f"use {', '.join(get_args(Source))}")
        for name in ("supply_V", "pulley_radius_m", "current_V_per_A"):
            if not 0 < getattr(self, name) < math.inf:
                raise BenchError(f"{name} is {getattr(self, name)}", mend="give a number above 0")
        if math.isnan(self.position.per_count):
            object.__setattr__(self, "position", dataclasses.replace(self.position, per_count=self._turn_per_count()))
        if not (math.isfinite(self.position.per_count) and self.position.per_count != 0):
            raise BenchError("the position does not change with its counts", mend="calibrate it, or give per_count")

    def _turn_per_count(self) -> float:
        """Position per count of a potentiometer of 270 degrees on the pulley: m of one actuator, rad of a joint."""
        if self.position.source in ("echo", "encoder"):
            unit = "m" if self.sides == 1 else "rad"
            raise BenchError(f"an {self.position.source} without per_count", mend=f"give per_count, {unit} per count")
        return POTENTIOMETER_RAD * (self.pulley_radius_m if self.sides == 1 else 1.0)

    @property
    def drives(self) -> tuple[str, ...]:
        """Columns of the drive."""
        return ("voltage_V",) if self.sides == 1 else ("voltage_agonist_V", "voltage_antagonist_V")

    @property
    def responses(self) -> tuple[str, ...]:
        """Columns of the sensors that are fitted."""
        warm = ("temperature_degC",) if self.sides == 1 else ("temperature_agonist_degC", "temperature_antagonist_degC")
        moved = ("displacement_mm",) if self.sides == 1 else ("angle_deg",)
        return (warm if self.thermistors.fitted else ()) + (moved if self.position.source != "none" else ())

    @property
    def degrees_per_count(self) -> float:
        """For the board's own controller: degrees of the pulley, which one actuator turns by its displacement."""
        return math.degrees(self.position.per_count / (1.0 if self.sides == 2 else self.pulley_radius_m))

    def voltage(self, pwm: Any) -> Any:
        """Root mean square volts of PWM counts: heat goes with the duty, ``V^2 = duty supply^2``."""
        return self.supply_V * np.sqrt(np.asarray(pwm, float) / 255.0)

    def pwm(self, voltage: Any) -> Any:
        """Nearest PWM counts of root mean square volts."""
        share = np.clip(np.asarray(voltage, float) / self.supply_V, 0.0, 1.0)
        return np.round(255.0 * share**2).astype(int)

    def row(self, sample: Sample) -> list[float]:
        """A sample in the units of the columns: drives, then responses."""
        out = [self.supply_V * math.sqrt(p / 255.0) for p in sample.pwm[: self.sides]]
        if self.thermistors.fitted:
            out += [self.thermistors.reading(c) - ZERO_C for c in sample.thermistors[: self.sides]]
        if self.position.source != "none":
            out.append(self.measured(sample) * (1e3 if self.sides == 1 else 180 / math.pi))
        return out

    def measured(self, sample: Sample) -> float:
        """Position of a sample, m or rad; NaN where an echo was lost."""
        if self.position.source == "echo" and sample.position == 0:
            return math.nan
        return self.position.per_count * (self.counted(sample) - self.position.zero)

    def counted(self, sample: Sample) -> int:
        """Counts of the position of a sample; those of an encoder have a sign."""
        raw = sample.position
        return raw - 0x10000 if self.position.source == "encoder" and raw & 0x8000 else raw

    def current(self, counts: float) -> float:
        """Mean current [A] of both channels."""
        return REFERENCE_V * (counts + 2.0) / FULL / self.current_V_per_A

    def resistance(self, reading: Resistance) -> float:
        """Wire resistance [ohm] of a reading."""
        return self.sensing.resistance(reading.counts)

    def angle(self, sample: Sample) -> float:
        """Angle [rad] of the pulley."""
        return self.measured(sample) / (1.0 if self.sides == 2 else self.pulley_radius_m)

    def metadata(self, title: str = "") -> Metadata:
        """What a recording of this bench says beside its samples."""
        return Metadata(
            title=title,
            source="scpjax rig",
            model=("plant" if self.thermistors.fitted or self.position.source != "none" else None)
            if self.sides == 1
            else "aaa",
            known=self.known,
            ambient_K=self.ambient_K,
            pulley_radius_m=self.pulley_radius_m if self.sides == 2 else None,
            pulley_mass_kg=(self.pulley_mass_kg or None) if self.sides == 2 else None,
            supply_V=self.supply_V,
        )


_PARTS: dict[str, type] = {"thermistors": Thermistors, "position": Position, "sensing": Sensing}


def save_wiring(wiring: Wiring, path: str | os.PathLike[str]) -> Path:
    """Write ``bench.toml``."""
    plain = [
        f"{f.name} = {_toml(getattr(wiring, f.name))}"
        for f in dataclasses.fields(wiring)
        if f.name not in (*_PARTS, "known") and getattr(wiring, f.name) is not None
    ]
    blocks = ["\n".join(plain)]
    for name, kind in _PARTS.items():
        part = getattr(wiring, name)
        rows = [f"{f.name} = {_toml(getattr(part, f.name))}" for f in dataclasses.fields(kind)]
        blocks.append("\n".join([f"[{name}]", *rows]))
    if wiring.known:
        blocks.append("\n".join(["[known]", *(f"{k} = {_toml(v)}" for k, v in wiring.known)]))
    path = Path(path)
    write_text(path, "\n\n".join(blocks) + "\n")
    return path


def load_wiring(path: str | os.PathLike[str]) -> Wiring:
    """Read ``bench.toml``; what it leaves out is as in `Wiring`.

    **Raises** `BenchError`, one line with the file, for what cannot be read or is misspelt.
    """
    where = str(path)
    try:
        content = tomllib.loads(Path(path).read_text(encoding="utf-8"))
    except OSError as error:
        mend = "scpjax rig calibrate writes one"
        raise BenchError(f"cannot be read ({error.strerror})", where=where, mend=mend) from error
    except (tomllib.TOMLDecodeError, UnicodeDecodeError) as error:
        raise BenchError(f"is not TOML: {error}", where=where, mend="write lines such as supply_V = 3.7") from error
    made: dict[str, Any] = {}
    for key, value in content.items():
        if key in _PARTS:
            made[key] = _part(_PARTS[key], value, f"{where} [{key}]")
        elif key == "known":
            numbers = value if isinstance(value, dict) else {"known": value}
            made[key] = tuple((k, _number(v, k, where)) for k, v in numbers.items())
        else:
            _check_key(key, Wiring, where)
            made[key] = value if key == "sides" else _number(value, key, where)
    try:
        return Wiring(**made)
    except BenchError as error:
        raise BenchError(error.problem, where=where, mend=error.mend) from error


def _part(kind: type, value: Any, where: str) -> Any:
    if not isinstance(value, dict):
        raise BenchError("is no section", where=where, mend="write it in [brackets] with its keys below")
    made: dict[str, Any] = {}
    for key, item in value.items():
        _check_key(key, kind, where)
        made[key] = item if isinstance(item, bool | str) else _number(item, key, where)
    return kind(**made)


def _check_key(key: str, kind: type, where: str) -> None:
    names = [f.name for f in dataclasses.fields(kind)]
    if key not in names:
        close = difflib.get_close_matches(key, names, n=1)
        nearest = f"did you mean {close[0]}? " if close else ""
        raise BenchError(f"unknown key {key!r}", where=where, mend=f"{nearest}it holds {', '.join(names)}")


def _number(value: Any, key: str, where: str) -> float:
    if isinstance(value, bool) or not isinstance(value, int | float) or not math.isfinite(value):
        raise BenchError(f"{key} is {value!r}, no finite number", where=where, mend=f"write {key} = 1.5 or the like")
    return float(value)


def _toml(value: Any) -> str:
    if isinstance(value, bool):
        return "true" if value else "false"
    return f'"{value}"' if isinstance(value, str) else repr(value)
