"""All mechanisms by name: the files in ``scpjax/physics/mechanisms``, those of installed packages, and a user's own.

A package offers mechanisms by entry points of the group ``scpjax.mechanisms`` that name a module or a class. A user's
file is read by `from_file` (and tried by `scpjax.simulate.trial.use`).
A fixed parameter of either keeps the value that it was given; only this package's references follow the recordings.
"""

from __future__ import annotations

import importlib
import importlib.util
import inspect
import math
import os
import pkgutil
import sys
from collections.abc import Collection, Iterable, Mapping
from functools import cache
from importlib.metadata import entry_points
from pathlib import Path
from types import ModuleType
from typing import get_args

from scpjax.errors import ModelError
from scpjax.physics import mechanisms as _room
from scpjax.physics.mechanism import Mechanism, Subsystem
from scpjax.physics.system import System, fault

GROUP = "scpjax.mechanisms"
_files: dict[Path, tuple[Mechanism, ...]] = {}  # read in this process, so that a class is made once


@cache
def _shipped() -> dict[str, Mechanism]:
    found: dict[str, Mechanism] = {}
    for info in pkgutil.iter_modules(_room.__path__):
        found |= {m.name: m for m in _within(importlib.import_module(f"{_room.__name__}.{info.name}"))}
    return found


@cache
def _installed() -> dict[str, Mechanism]:
    """Mechanisms of installed packages. **Raises** `ModelError` for one that cannot be loaded or is not whole."""
    found: dict[str, Mechanism] = {}
    for point in entry_points(group=GROUP):
        where = f"entry point {point.value}"
        try:
            given = point.load()
        except Exception as error:  # whatever a foreign package does when imported
            raise ModelError(f"cannot be loaded: {error}", where=where, mend="mend or uninstall its package") from error
        mine = _within(given) if isinstance(given, ModuleType) else [given()] if _is_mechanism(given) else []
        _check_new(mine, where, {**_shipped(), **found})
        found |= {m.name: m for m in mine}
    return found


def catalogue() -> dict[str, Mechanism]:
    """All mechanisms by name, base ones and left-out ones."""
    return {**_shipped(), **_installed(), **{m.name: m for each in _files.values() for m in each}}


def from_file(path: str | os.PathLike[str]) -> tuple[Mechanism, ...]:
    """The mechanisms that a Python file defines; in the catalogue from now on. The file is run.

    **Raises** `ModelError` for a file that is missing, cannot be run or defines none, and for a mechanism that is not
    whole or whose name is taken.
    """
    path = Path(path)
    where, place = str(path), path.resolve()
    if place in _files:
        return _files[place]
    if not path.is_file():
        raise ModelError("no such file", where=where, mend="name a Python file that defines a Mechanism")
    name = f"scpjax_user_{path.stem}_{len(_files)}"
    spec = importlib.util.spec_from_file_location(name, place)
    if path.suffix != ".py" or spec is None or spec.loader is None:
        raise ModelError("is no Python file", where=where, mend="name a .py file that defines a Mechanism")
    module = importlib.util.module_from_spec(spec)
    sys.modules[name] = module
    try:
        spec.loader.exec_module(module)
    except Exception as error:  # whatever the user's file does when run
        del sys.modules[name]
        line = error.lineno if isinstance(error, SyntaxError) else _line(error, place)
        at = f"{where}:line {line}" if line else where
        raise ModelError(f"cannot be run: {type(error).__name__}: {error}", where=at, mend="mend the file") from error
    found = _within(module)
    _check_new(found, where, catalogue())
    _files[place] = tuple(found)
    return _files[place]


def forget(path: str | os.PathLike[str]) -> None:
    """Take the mechanisms of a file out of the catalogue."""
    _files.pop(Path(path).resolve(), None)


def origin(m: Mechanism) -> Path | None:
    """The user's file that a mechanism came from; None for one of this or another package."""
    return next((path for path, mine in _files.items() if any(type(o) is type(m) for o in mine)), None)


def is_shipped(m: Mechanism) -> bool:
    """Whether the parameters of a mechanism are this package's (maybe inherited), not a user's or another package's."""
    given = next(kind for kind in type(m).__mro__ if "parameters" in vars(kind))
    return given.__module__.startswith(f"{_room.__name__}.")


def mechanism(name: str) -> Mechanism:
    """The mechanism of that name."""
    known = catalogue()
    if name not in known:
        raise ModelError(f"no mechanism named {name!r}", mend=f"the catalogue has {sorted(known)}")
    return known[name]


def systems() -> dict[str, System]:
    """Base models of the user's own, by name."""
    return {name: m for name, m in catalogue().items() if isinstance(m, System)}


def left_out() -> tuple[Mechanism, ...]:
    """Mechanisms that a base model leaves out, by name."""
    return tuple(m for _, m in sorted(catalogue().items()) if not (m.is_base or m.learned))


NEEDS = (
    *("electric", "voltage", "current"),
    *("thermal", "mechanical", "joint"),
    *("temperature_output", "displacement_output"),
)
"""What a mechanism or law may need: a drive that is electric, in volts (or pwm), in amperes; an energy balance, a force
balance, two actuators that pull against each other; a thermometer, a displacement or angle sensor. Beside these, the
name of a base of the user's own."""


def applicable(m: Mechanism, have: Collection[str], law: int | None = None) -> bool:
    """Whether a mechanism (under a law, or under any) can act in a model that has those of `NEEDS`."""
    laws = range(len(m.laws)) if law is None else (law,)
    return set(m.needs) <= set(have) and any(set(m.law_needs.get(i, ())) <= set(have) for i in laws)


def _is_mechanism(kind: object) -> bool:
    return inspect.isclass(kind) and issubclass(kind, Mechanism) and hasattr(kind, "name")


def _within(module: ModuleType) -> list[Mechanism]:
    """One of each class that a module, or one below it, defines: a package may gather its classes in ``__init__``."""
    name = module.__name__
    kinds = [kind for _, kind in inspect.getmembers(module, _is_mechanism)]
    mine = [k for k in kinds if k.__module__ == name or k.__module__.startswith(f"{name}.")]
    return [kind() for kind in dict.fromkeys(mine)]  # once each, also where a class goes by two names


def _line(error: Exception, path: Path) -> int | None:
    """Where in a file an error came up."""
    line, trace = None, error.__traceback__
    while trace is not None:
        if Path(trace.tb_frame.f_code.co_filename) == path:
            line = trace.tb_lineno
        trace = trace.tb_next
    return line


def _check_new(found: Iterable[Mechanism], where: str, taken: Mapping[str, Mechanism]) -> None:
    """**Raises** `ModelError` where there is none, a name is taken, or a mechanism is not whole."""
    found = list(found)
    if not found:
        raise ModelError(
            "defines no Mechanism with a name",
            where=where,
            mend="write a class that inherits from scpjax.physics.mechanism.Mechanism and has a name",
        )
    for m in found:
        if m.name in taken or sum(o.name == m.name for o in found) > 1:
            raise ModelError(f"the name {m.name!r} is taken", where=where, mend="choose another name")
        bases = {o.name for o in (*found, *taken.values()) if isinstance(o, System)}
        problem = fault(m) if isinstance(m, System) else _fault(m, bases)
        if problem:
            raise ModelError(f"{m.name}: {problem[0]}", where=where, mend=problem[1])


def _fault(m: Mechanism, bases: Collection[str]) -> tuple[str, str] | None:
    """What a left-out mechanism lacks, and the mend."""
    for text in ("title", "equation", "source", "says"):
        if not str(getattr(m, text, "")).strip():
            return f"has no {text}", f'write {text} = "..."'
    if getattr(m, "subsystem", None) not in get_args(Subsystem):
        return f"subsystem is {getattr(m, 'subsystem', None)!r}", f"use one of {', '.join(get_args(Subsystem))}"
    if not m.parameters:
        return "has no parameters", "a mechanism needs one that says how strong it is"
    needs = {*m.needs, *(n for each in m.law_needs.values() for n in each)}
    if not needs <= {*NEEDS, *bases}:
        known = ", ".join((*NEEDS, *sorted(bases)))
        return f"needs {sorted(needs - {*NEEDS, *bases})}", f"what can be needed is {known}"
    if m.subsystem == "balance" and not needs & set(bases):
        return "acts in a balance that no base has", 'name the base in needs = ("...",)'
    for p in m.parameters:
        if p.null is None:
            return f"{p.name} has no null value", "give null=..., the value at which the mechanism vanishes"
        if not (p.fixed or math.isfinite(p.spread)):
            return f"{p.name} has no prior", "give spread=..., how far from typical it may well be"
    if not m.starts or any(len(start) != len(m.parameters) for start in m.starts):
        return "starts do not give a value for each parameter", "write starts = ((first, second, ...),)"
    for start in m.starts:
        for value, p in zip(start, m.parameters, strict=True):
            if not (p.fixed or p.time or p.bounds[0] <= value <= p.bounds[1]):
                return f"a start of {p.name} lies outside its bounds {p.bounds}", "start inside them"
    return None
