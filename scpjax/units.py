"""Units at the edges: file columns carry their unit as a suffix, everything inside is SI.

``displacement_mm`` is the stem ``displacement`` in millimetres; ``to_si`` makes metres of it. Temperatures
become kelvin, angles radian. Percent and PWM counts have no SI unit and stay as they are.
"""

from __future__ import annotations

import difflib
import math
from dataclasses import dataclass
from typing import TypeVar

from scpjax.errors import RecordingError

X = TypeVar("X")


@dataclass(frozen=True)
class Unit:
    """A unit of a file column: ``si_value = raw * scale + offset``.

    ``suffix`` is how a column name ends (``mm``), ``quantity`` what it measures (``length``), ``si`` the unit
    inside (``m``).
    """

    suffix: str
    quantity: str
    si: str
    scale: float = 1.0
    offset: float = 0.0

    def to_si(self, x: X) -> X:
        """The value in SI of ``x`` (number or array) in this unit."""
        return x * self.scale + self.offset  # type: ignore[operator]

    def from_si(self, x: X) -> X:
        """The value in this unit of ``x`` (number or array) in SI."""
        return (x - self.offset) / self.scale  # type: ignore[operator]


UNITS: tuple[Unit, ...] = (
    Unit("s", "time", "s"),
    Unit("ms", "time", "s", 1e-3),
    Unit("V", "voltage", "V"),
    Unit("mV", "voltage", "V", 1e-3),
    Unit("W", "power", "W"),
    Unit("mW", "power", "W", 1e-3),
    Unit("A", "current", "A"),
    Unit("mA", "current", "A", 1e-3),
    Unit("degC", "temperature", "K", 1.0, 273.15),
    Unit("K", "temperature", "K"),
    Unit("m", "displacement", "m"),
    Unit("cm", "displacement", "m", 1e-2),
    Unit("mm", "displacement", "m", 1e-3),
    Unit("N", "force", "N"),
    Unit("mN", "force", "N", 1e-3),
    Unit("rad", "angle", "rad"),
    Unit("deg", "angle", "rad", math.pi / 180.0),
    Unit("ohm", "resistance", "ohm"),
    Unit("kg", "mass", "kg"),
    Unit("g", "mass", "kg", 1e-3),
    Unit("pct", "percent", "pct"),
    Unit("Pa", "pressure", "Pa"),
    Unit("kPa", "pressure", "Pa", 1e3),
    Unit("bar", "pressure", "Pa", 1e5),
    Unit("psi", "pressure", "Pa", 6894.757293168361),
    Unit("pwm", "duty", "pwm"),
)
"""Every unit that a column name may end in."""

_BY_SUFFIX = {unit.suffix: unit for unit in UNITS}

STEM_QUANTITY: dict[str, str] = {
    "time": "time",
    "voltage": "voltage",
    "power": "power",
    "current": "current",
    "temperature": "temperature",
    "displacement": "displacement",
    "force": "force",
    "angle": "angle",
    "resistance": "resistance",
    "pressure": "pressure",
}
"""What a column is held to measure by the first word of its name."""


def get_unit(suffix: str) -> Unit:
    """The unit with this suffix; ``RecordingError`` naming the nearest one where there is none."""
    if suffix in _BY_SUFFIX:
        return _BY_SUFFIX[suffix]
    raise RecordingError(f"unknown unit '{suffix}'", mend=f"use one of {', '.join(_BY_SUFFIX)}")


def units_of(quantity: str) -> tuple[Unit, ...]:
    """All units in which ``quantity`` (``temperature``) may be written."""
    return tuple(unit for unit in UNITS if unit.quantity == quantity)


def parse_column(name: str, *, where: str = "", allow_unknown: bool = False) -> tuple[str, Unit]:
    """Stem and unit of a column name: ``temperature_agonist_degC`` is ``(temperature_agonist, degC)``.

    ``pwm`` and ``pwm_agonist`` have no suffix: their values are counts 0..255. With ``allow_unknown`` a
    suffix that is not a unit (``level_foo``) is kept, scale 1; but a stem whose quantity is known
    (``displacement_inch``) must always have one of its units. Raises ``RecordingError``.
    """
    where = where or f"column {name}"
    if name == "pwm" or name.startswith("pwm_"):
        return name, _BY_SUFFIX["pwm"]
    stem, _, suffix = name.rpartition("_")
    quantity = STEM_QUANTITY.get((stem or name).split("_")[0])
    unit = _BY_SUFFIX.get(suffix) if stem and not stem.endswith("_per") else None
    if unit is not None and (quantity in (None, unit.quantity) or allow_unknown):
        return stem, unit
    if quantity is not None:
        allowed = ", ".join(f"{stem_without_unit(name)}_{unit.suffix}" for unit in units_of(quantity))
        problem = f"column '{name}' has no unit" if not stem else f"column '{name}' has no unit of {quantity}"
        raise RecordingError(problem, where=where, mend=f"rename it to one of {allowed}")
    if allow_unknown:
        return (stem, Unit(suffix, "unknown", suffix)) if stem else (name, Unit("", "unknown", "1"))
    close = difflib.get_close_matches(suffix, _BY_SUFFIX, n=1)
    nearest = f"did you mean '{close[0]}'? " if close and stem else ""
    raise RecordingError(
        f"column '{name}' does not end in a known unit",
        where=where,
        mend=f"{nearest}use one of the suffixes {', '.join(f'_{s}' for s in _BY_SUFFIX)}",
    )


def stem_without_unit(name: str) -> str:
    """The name less a last part that looks like a unit: ``displacement_inch`` is ``displacement``."""
    stem, _, suffix = name.rpartition("_")
    return name if not stem or suffix in ("agonist", "antagonist") else stem
