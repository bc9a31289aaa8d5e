"""Many loops at the speed of the machine: vmapped in pieces that stay in its caches, on as many threads as it has."""

from __future__ import annotations

import os
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np

from scpjax.control.errors import ControlError


def batched(function: Callable[..., Any], *, size: int = 1024, threads: int | None = None) -> Callable[..., Any]:
    """``jax.vmap(function)`` over the leading axis, compiled once for pieces of ``size``, run on ``threads``.

    A loop's state is a few dozen numbers: a thousand loops abreast fill the vector units and still lie in the cache,
    ten thousand do not. The last piece is filled up with repetitions, which are cut off again. Not differentiable:
    for that, vmap.

    **Raises** `ControlError` for arguments without a common leading axis.
    """
    compiled = eqx.filter_jit(jax.vmap(function))
    count = threads or os.cpu_count() or 1

    def call(*arguments: Any) -> Any:
        sizes = {np.shape(x)[0] if np.ndim(x) else -1 for x in jax.tree.leaves(arguments)}
        if len(sizes) != 1 or -1 in sizes:
            raise ControlError(f"leading axes {sorted(sizes)}", mend="give every argument one entry per loop")
        n = sizes.pop()
        width = min(size, max(-(-n // count), 1))
        pieces = [
            jax.tree.map(lambda x, i=i: _filled(np.asarray(x)[i : i + width], width), arguments)
            for i in range(0, n, width)
        ]
        with ThreadPoolExecutor(count) as pool:
            results = list(pool.map(lambda piece: jax.block_until_ready(compiled(*piece)), pieces))
        return jax.tree.map(lambda *parts: jnp.concatenate(parts)[:n], *results)

    return call


def _filled(part: np.ndarray, width: int) -> np.ndarray:
    short = width - len(part)
    return np.concatenate([part, np.repeat(part[-1:], short, axis=0)]) if short else part
