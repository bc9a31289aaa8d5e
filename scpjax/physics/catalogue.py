"""Finds every mechanism: one file each in ``scpjax/physics/mechanisms``."""

from __future__ import annotations

import importlib
import inspect
import pkgutil
from collections.abc import Collection
from functools import cache

from scpjax.errors import ModelError
from scpjax.physics import mechanisms as _room
from scpjax.physics.mechanism import Mechanism


@cache
def catalogue() -> dict[str, Mechanism]:
    """All mechanisms by name, base ones and left-out ones."""
    found: dict[str, Mechanism] = {}
    for info in pkgutil.iter_modules(_room.__path__):
        module = importlib.import_module(f"{_room.__name__}.{info.name}")
        for _, kind in inspect.getmembers(module, inspect.isclass):
            if issubclass(kind, Mechanism) and kind.__module__ == module.__name__:
                found[kind.name] = kind()
    return found


def mechanism(name: str) -> Mechanism:
    """The mechanism of that name."""
    if name not in catalogue():
        raise ModelError(f"no mechanism named {name!r}", mend=f"the catalogue has {sorted(catalogue())}")
    return catalogue()[name]


def left_out() -> tuple[Mechanism, ...]:
    """Mechanisms that a base model leaves out, by name."""
    return tuple(m for _, m in sorted(catalogue().items()) if not (m.is_base or m.learned))


NEEDS = (
    *("electric", "voltage", "current"),
    *("thermal", "mechanical", "joint"),
    *("temperature_output", "displacement_output"),
)
"""What a mechanism or law may need: a drive that is electric, in volts (or pwm), in amperes; an energy balance, a force
balance, two actuators that pull against each other; a thermometer, a displacement or angle sensor."""


def applicable(m: Mechanism, have: Collection[str], law: int | None = None) -> bool:
    """Whether a mechanism (under a law, or under any) can act in a model that has those of `NEEDS`."""
    laws = range(len(m.laws)) if law is None else (law,)
    return set(m.needs) <= set(have) and any(set(m.law_needs.get(i, ())) <= set(have) for i in laws)
