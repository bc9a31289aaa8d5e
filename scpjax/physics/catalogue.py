"""Finds every mechanism: one file each in ``scpjax/physics/mechanisms``."""

from __future__ import annotations

import importlib
import inspect
import pkgutil
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
    return tuple(m for _, m in sorted(catalogue().items()) if not m.is_base)


def applicable(m: Mechanism, *, electric: bool, thermal: bool, mechanical: bool, temperature_output: bool) -> bool:
    """Whether a mechanism can act in a model of that kind, seen through those sensors."""
    have = {
        "electric": electric,
        "thermal": thermal,
        "mechanical": mechanical,
        "temperature_output": temperature_output,
    }
    return all(have[n] for n in m.needs)
