"""A learned closure in words: an expression with units, and what it says about the balance it stands in."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np

from scpjax.diagnose.closure import Learned, offers, place_of, references
from scpjax.diagnose.curve import Curve
from scpjax.diagnose.result import Closure
from scpjax.fit.result import Estimate
from scpjax.physics.curves import SYMBOLS
from scpjax.physics.structure import EFFORT_UNITS, DriveKind
from scpjax.physics.terms import Term

_RAISED = str.maketrans("0123456789", "⁰¹²³⁴⁵⁶⁷⁸⁹")
WHAT = {
    "learned_heat": ("heat lost", "W", "thermoelectric"),
    "learned_heat store": ("thermal mass greater by", "J/K", "thermoelectric"),
    "learned_force": ("force against contraction", "N", "thermomechanical"),
    "learned_reading temperature": ("thermometer reads too much by", "K", "sensor"),
    "learned_reading displacement": ("displacement reads too much by", "mm", "sensor"),
}
"""What stands in a place, in which unit, in which balance."""


def stands_for(place: str, variables: Sequence[str]) -> tuple[str, str, str]:
    """`WHAT` of a closure on these variables: heat by the drive alone is the drive's, and a displacement by the
    temperature (beside the drive, by its rate) is what gives way in series with the spring, as a sensor of displacement
    does not feel the wire.
    """
    what, unit, subsystem = WHAT[place]
    if subsystem == "thermoelectric" and list(variables) == ["drive"]:
        return what, unit, "drive"
    if (
        place == "learned_reading displacement"
        and "temperature" in variables
        and {*variables} <= {"temperature", "drive"}
    ):
        return "contraction in series with the spring", unit, "thermomechanical"
    return what, unit, subsystem


def _instead(found: Learned) -> tuple[str, ...]:
    """What a closure is not told from, as "displacement reads too much by = s(T, u)"."""
    if not found.instead:
        return ()
    variables = _variables(found, found.instead)
    symbols = [SYMBOLS["effort" if v == "drive" else v] for v in variables]
    return (f"{stands_for(place_of(found.instead[0]), variables)[0]} = s({', '.join(symbols)})",)


def _variables(found: Learned, keys: Sequence[str]) -> list[str]:
    """What some of the terms on offer depend on."""
    terms = {o.key: o.term for o in offers(found.state.setup)}
    return [*dict.fromkeys(v for key in keys for v in terms[key].variables)]


def in_words(found: Curve) -> str:
    """What stands for what, as "heat lost = T s(x)"."""
    return f"{stands_for(found.place, variables_of(found))[0]} = {found.form.name}"


def variables_of(found: Curve) -> list[str]:
    """What a curve depends on, in the words of reports."""
    form = found.form
    return [*dict.fromkeys("drive" if v == "effort" else v for v in (form.factor, form.variable) if v)]


def shown(drive: DriveKind) -> dict[str, tuple[str, float]]:
    """Unit in which each variable is written, and how many of it are in one of SI."""
    return {
        "temperature": ("K", 1.0),
        "displacement": ("mm", 1e3),
        "velocity": ("mm/s", 1e3),
        "effort": (EFFORT_UNITS[drive], 1.0),
    }


def of_base(values: Mapping[str, float], key: str) -> float:
    """A base parameter of a model, fitted or held; the mean where its sides differ."""
    found = [v for k, v in values.items() if k.split("@")[0] == key]
    return float(np.mean(found))


def describe(found: Learned, every: Mapping[str, Estimate], values: Mapping[str, float]) -> Closure:
    """The closure as an expression with units; ``every`` holds the estimates of its final fit by key, ``values`` all
    parameters of its model, the held ones too.
    """
    problem, place = found.state.setup, place_of(found.terms[0])
    terms = {o.key: o.term for o in offers(problem)}
    reference = references(problem)
    scale = scale_of(place, values, reference["reference_temperature"], reference["reference"])
    own_units = shown(problem.structure.drive)
    variables = _variables(found, found.terms)
    what, unit, subsystem = stands_for(place, variables)
    pieces, in_si = [], {}
    for key in found.terms:
        term, e = terms[key], every[key]
        factor = scale / term.unit_value(reference)
        words, units = _product(term, own_units)
        for name, (_, k) in own_units.items():
            factor /= k ** getattr(term, name)
        size = abs(e.value * factor)
        sign = ("" if not pieces else "+ ") if e.value >= 0 else "- "
        error = f" ± {abs(e.std * factor):.1g}" if np.isfinite(e.std) else ""
        pieces.append(f"{sign}({size:.3g}{error}) {unit}{units} {words}")
        in_si[key] = e
    return Closure(
        subsystem,
        place,
        tuple(variables),
        f"{what} = {' '.join(pieces)}",
        in_si,
        found.evidence.held_out_gain,
        found.evidence.delta_bic,
        equivalents=_instead(found),
    )


def scale_of(place: str, values: Mapping[str, float], temperature: float, displacement: float) -> float:
    """What one stands for in a place, in the unit of `WHAT`; references [K], [m]."""
    if place == "learned_heat":
        return of_base(values, "newton_cooling.conductance") * temperature
    if place == "learned_heat store":
        return of_base(values, "newton_cooling.thermal_mass")
    if place == "learned_force":
        return of_base(values, "elastic_spring.stiffness") * displacement
    return temperature if place == "learned_reading temperature" else 1e3 * displacement


def _product(term: Term, own_units: Mapping[str, tuple[str, float]]) -> tuple[str, str]:
    """("T x", "/(K mm)") of a term."""
    words, units = [], []
    for name, (unit, _) in own_units.items():
        power, symbol = getattr(term, name), SYMBOLS[name]
        if not power:
            continue
        raised = "" if power == 1 else str(power).translate(_RAISED)
        if name == "velocity" and not (term.odd and power == 1):
            words.append(f"|{symbol}|" if power == 1 else f"|{symbol}| {symbol}")
        else:
            words.append(symbol + raised)
        units.append(f"({unit}){raised}" if raised and not unit.isalpha() else unit + raised)
    return " ".join(words), f"/({' '.join(units)})"
