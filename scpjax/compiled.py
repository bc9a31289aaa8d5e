"""Programs that are compiled for one problem and run for seconds: compiled quickly."""

from __future__ import annotations

import threading
from collections.abc import Callable, Hashable
from functools import cache, wraps
from typing import Any, TypeVar

import equinox as eqx
import jax

from scpjax import kept as programs
from scpjax.kept import is_array, kept, key_of

_Function = TypeVar("_Function", bound=Callable[..., Any])
_QUICK = {
    "xla_backend_optimization_level": 1,
    "xla_cpu_use_fusion_emitters": False,
}


def quickly_compiled(function: _Function) -> _Function:
    """`equinox.filter_jit` of a program that is called from Python, with what XLA offers to compile a scan quickly.

    A scan over thousands of steps of small arrays takes longer to compile than to run; these options take a third or
    more off the first and leave the second as it is (``python benchmarks/compile.py``). The command line keeps what
    was traced between calls (`scpjax.kept`). Threads may call it at once: what they share is compiled once.
    """

    @cache
    def program() -> Any:
        options: Any = {"compiler_options": quick_options(jax.default_backend()) or None}
        return eqx.filter_jit(function, **options)

    @wraps(function)
    def call(*args: Any) -> Any:
        run = kept(function, args, lambda: quick_options("cpu"))
        if run is not None:
            return run([x for x in jax.tree.leaves(args) if is_array(x)])
        key = key_of(function, args)
        if key is None:
            return program()(*args)
        with _table:
            place = _compiled.setdefault(key, _Place())
        return place.filled(lambda: program().lower(*args).compile())(*args)

    return call  # type: ignore[return-value]


class _Place:
    """Where a compiled program is put by whoever asks for it first; others wait."""

    def __init__(self) -> None:
        self.lock, self.program = threading.Lock(), None

    def filled(self, make: Callable[[], Any]) -> Any:
        with self.lock:
            if self.program is None:
                self.program = make()
            return self.program


_compiled: dict[Hashable, _Place] = {}
_table = threading.Lock()


def forget() -> None:
    """Drop all compiled programs, those that JAX holds too."""
    with _table:
        _compiled.clear()
    programs.forget()
    jax.clear_caches()


@cache
def quick_options(backend: str) -> dict[str, Any]:
    """Options of `_QUICK` that this XLA knows, none on another backend than the CPU."""
    return {k: v for k, v in _QUICK.items() if backend == "cpu" and _known(k, v)}


def _known(option: str, value: Any) -> bool:
    try:
        jax.jit(lambda x: x + 1, compiler_options={option: value}).lower(1.0).compile()
    except jax.errors.JaxRuntimeError as error:
        if "No such compile option" in str(error):
            return False
        raise
    return True
