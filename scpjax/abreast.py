"""Work on all cores at once, by threads: compiled programs, LAPACK and LLVM run outside Python's lock."""

from __future__ import annotations

import os
from collections.abc import Callable, Iterable, Iterator
from concurrent.futures import ThreadPoolExecutor
from contextlib import contextmanager
from typing import TypeVar

_In = TypeVar("_In")
_Out = TypeVar("_Out")


def abreast(function: Callable[[_In], _Out], items: Iterable[_In]) -> list[_Out]:
    """``[function(x) for x in items]``, as many at a time as there are cores; the next is begun as soon as one is done.

    Where BLAS has threads of its own they wait for work by spinning, and nothing is gained: set
    ``OPENBLAS_NUM_THREADS=1`` before NumPy is imported, as the command line does.
    """
    todo = list(items)
    threads = min(cores(), len(todo))
    if threads < 2:
        return [function(x) for x in todo]
    with ThreadPoolExecutor(threads) as pool:
        return list(pool.map(function, todo))


@contextmanager
def meanwhile(function: Callable[[], object]) -> Iterator[None]:
    """Have something done in a thread of its own beside what is done within; both are done at the end. What it raises
    is raised there.
    """
    with ThreadPoolExecutor(1) as pool:
        done = pool.submit(function)
        yield
        done.result()


def cores() -> int:
    """Cores that this process may use."""
    if hasattr(os, "sched_getaffinity"):
        return len(os.sched_getaffinity(0))
    return os.cpu_count() or 1
