"""Traced programs kept between processes: found by what they are made of, not traced again.

JAX's own cache spares a process the compiling; but to look into it the program must have been traced, which takes
longer than all the rest. Here what was traced (StableHLO, by `jax.export`) is kept under what it was traced from: the
package's code, the versions of what it rests on, the arguments that are no arrays and the shapes of those that are.
Only what the package and the libraries below it define may be among the arguments; with anything else (a user's own
mechanism) nothing is kept.
"""

from __future__ import annotations

import contextlib
import hashlib
import io
import os
import pickle
import shutil
import sys
import tempfile
import threading
import time
import types
import zlib
from collections.abc import Callable, Hashable, Mapping, Sequence
from dataclasses import dataclass, fields, is_dataclass
from functools import cache
from importlib.metadata import version
from pathlib import Path
from typing import Any

import jax
import numpy as np
from jax.export import Exported, deserialize, export

_Run = Callable[[Sequence[Any]], Any]

_BELOW = ("jax", "jaxlib", "numpy", "equinox", "optimistix", "lineax", "diffrax", "jaxtyping")
_KNOWN = frozenset({"scpjax", *_BELOW, *sys.stdlib_module_names})
_DAYS = 30.0  # that programs of another version are kept for
_folder: Path | None = None
_loaded: dict[Any, _Run | None] = {}
_UNKNOWN: Any = object()
_one_at_a_time = threading.Lock()  # for what is loaded or traced


def keep_in(folder: Path | None) -> None:
    """From now on programs are kept in a folder; in none if None."""
    global _folder
    _folder = folder
    forget()


def forget() -> None:
    """Let go of the programs that this process has loaded; their files stay."""
    _loaded.clear()


def kept(function: Callable[..., Any], args: tuple[Any, ...], options: Callable[[], Mapping[str, Any]]) -> _Run | None:
    """What runs a function on arrays (those among ``args``, in order), loaded or traced and kept; None where programs
    are not kept, or not such ones.
    """
    if _folder is None or jax.default_backend() != "cpu":
        return None
    key = key_of(function, args)
    if key is None:
        return None
    if (found := _loaded.get(key, _UNKNOWN)) is not _UNKNOWN:  # without waiting for what another thread traces
        return found
    with _one_at_a_time:
        if (found := _loaded.get(key, _UNKNOWN)) is _UNKNOWN:
            _loaded[key] = found = _prepared(function, args, options, _folder)
        return found


def key_of(function: Callable[..., Any], args: tuple[Any, ...]) -> Hashable | None:
    """What a program is told from others by: its function, the arguments that are no arrays and the shapes of those
    that are; None where something among the arguments has no hash.
    """
    leaves, tree = jax.tree.flatten(args)
    key = (function, tree, tuple(jax.typeof(x) if is_array(x) else (type(x), x) for x in leaves))
    try:
        hash(key)
    except TypeError:
        return None
    return key


def is_array(x: Any) -> bool:
    """Whether an argument is traced."""
    return isinstance(x, jax.Array | np.ndarray | np.generic)


@dataclass(frozen=True)
class _Place:
    """Stands in what a function returns for its ``i``-th array."""

    i: int


def _prepared(
    function: Callable[..., Any], args: tuple[Any, ...], options: Callable[[], Mapping[str, Any]], folder: Path
) -> _Run | None:
    name = _name(function, args)
    if name is None:
        return None
    place = _shelf(folder) / name
    found = _load(place)
    if found is None:
        try:
            traced, returned = _trace(function, args)
        except (NotImplementedError, ValueError):  # of what cannot be kept; of all else the call itself tells
            return None
        _write(place, (bytes(traced.serialize()), returned))
        found = traced, returned
    return _runner(*found, options())


def _name(function: Callable[..., Any], args: tuple[Any, ...]) -> str | None:
    """The program's file name; None where something foreign is among the arguments."""
    rest = jax.tree.map(lambda x: None if is_array(x) else x, args)
    shapes = [
        (t.shape, t.dtype.str, bool(t.weak_type)) for t in (jax.typeof(x) for x in jax.tree.leaves(args) if is_array(x))
    ]
    made_of = io.BytesIO()
    try:
        pickler = _Pickler(made_of, protocol=5)
        pickler.fast = True  # writes equal things equally, be they one object or two
        pickler.dump((rest, shapes))
    except (_ForeignError, pickle.PicklingError, AttributeError, TypeError, ValueError):  # has no name to be found by
        return None
    what = f"{function.__module__}.{function.__qualname__}"
    return f"{what}-{hashlib.sha256(what.encode() + made_of.getvalue()).hexdigest()[:32]}"


class _ForeignError(Exception):
    pass


class _Pickler(pickle.Pickler):
    """For names only. Refuses what is defined elsewhere, whose code may change unseen; writes of a dataclass its
    fields, and not what it has worked out since.
    """

    def reducer_override(self, obj: Any) -> Any:
        if is_dataclass(obj) and not isinstance(obj, type):
            return type(obj), tuple((f.name, getattr(obj, f.name)) for f in fields(obj))
        if isinstance(obj, type | types.FunctionType) and obj.__module__.partition(".")[0] not in _KNOWN:
            raise _ForeignError(obj.__module__)
        return NotImplemented


def _shelf(folder: Path) -> Path:
    """Where programs of this version are; those of versions long unused are removed."""
    mine = folder / "programs" / _version()
    with contextlib.suppress(OSError):  # a folder that cannot be written to keeps nothing
        if not mine.exists():
            mine.mkdir(parents=True)
            for other in mine.parent.iterdir():
                if time.time() - other.stat().st_mtime > _DAYS * 86400:
                    shutil.rmtree(other, ignore_errors=True)
        os.utime(mine)
    return mine


@cache
def _code() -> tuple[str, ...]:
    """Versions of what the package rests on, and a digest of its own files."""
    here, digest = Path(__file__).parent, hashlib.sha256()
    for file in sorted(here.rglob("*.py")):
        digest.update(str(file.relative_to(here)).encode() + b"\0" + file.read_bytes() + b"\0")
    return (sys.version, *(version(n) for n in _BELOW), digest.hexdigest())


def _version() -> str:
    """Of all that a program depends on besides its function and arguments."""
    settings = sorted((k, v) for k, v in jax.config.values.items() if "cache" not in k)
    return hashlib.sha256(repr((_code(), settings)).encode()).hexdigest()[:16]


def _load(place: Path) -> tuple[Exported, Any] | None:
    """A program, and what it returns with a `_Place` for every array; None where none was kept or it was damaged."""
    try:
        traced, returned = pickle.loads(zlib.decompress(place.read_bytes()))
        return deserialize(bytearray(traced)), returned
    except (OSError, EOFError, ValueError, zlib.error, pickle.UnpicklingError):
        return None  # it is traced anew, and written over


def _trace(function: Callable[..., Any], args: tuple[Any, ...]) -> tuple[Exported, Any]:
    leaves, tree = jax.tree.flatten(args)
    returned: Any = None

    def flat(arrays: Sequence[Any]) -> list[Any]:
        nonlocal returned
        left = iter(arrays)
        found, shape = jax.tree.flatten(function(*tree.unflatten([next(left) if is_array(x) else x for x in leaves])))
        out = [x for x in found if is_array(x)]
        count = iter(range(len(out)))
        returned = shape.unflatten([_Place(next(count)) if is_array(x) else x for x in found])
        return out

    traced = export(jax.jit(flat))([x for x in leaves if is_array(x)])
    return traced, returned


def _runner(traced: Exported, returned: Any, options: Mapping[str, Any]) -> _Run:
    leaves, tree = jax.tree.flatten(returned)
    program = jax.jit(traced.call, compiler_options=dict(options) or None)
    compiled: list[Any] = []
    first = threading.Lock()

    def run(arrays: Sequence[Any]) -> Any:
        with first:  # threads that ask for one program at once have it compiled once
            if not compiled:
                compiled.append(program.lower(list(arrays)).compile())
        out = compiled[0](list(arrays))
        return tree.unflatten([out[x.i] if isinstance(x, _Place) else x for x in leaves])

    return run


def _write(place: Path, what: Any) -> None:
    """Whole or not at all; not where the disk does not let us."""
    with contextlib.suppress(OSError):
        handle, name = tempfile.mkstemp(dir=place.parent)
        try:
            with os.fdopen(handle, "wb") as file:
                file.write(zlib.compress(pickle.dumps(what, protocol=5), level=1))
            os.replace(name, place)
        except BaseException:
            os.unlink(name)
            raise
