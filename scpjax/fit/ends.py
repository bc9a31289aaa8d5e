"""Where fits ended: a trial that starts where another did, on the same data, ends where that did.

A search asks for the same fit again and again: a mechanism from where it starts, under a law, beside the same others.
"""

from __future__ import annotations

from collections import OrderedDict
from collections.abc import Hashable
from dataclasses import dataclass
from hashlib import blake2b
from threading import Lock

import jax
import numpy as np
from jaxtyping import Float

from scpjax.fit.data import Data
from scpjax.fit.problem import Space, Trial

_KEPT = 12  # data of which ends are kept: those of a search, held out in turn, and what it is set against


@dataclass(frozen=True)
class End:
    """Where a trial ended after ``steps``, of ``limit`` at most, and whether ``rested`` by a ``tolerance`` there."""

    free: Float[np.ndarray, " all+1"]
    cost: float
    rested: bool
    steps: int
    limit: int
    tolerance: float

    def is_of(self, limit: int, tolerance: float) -> bool:
        """Whether a fit with these ends here too: they only say where on its path it stops."""
        if self.rested:
            return tolerance == self.tolerance and limit > self.steps
        return limit == self.limit and tolerance <= self.tolerance


class Ends:
    """Ends by what was fitted to which data, of the last few of these."""

    def __init__(self) -> None:
        self._of: OrderedDict[int, tuple[Data, dict[Hashable, tuple[End, ...]]]] = OrderedDict()
        self._lock = Lock()

    def find(self, data: Data, key: Hashable, limit: int, tolerance: float) -> End | None:
        """The end of a fit; None of one that was not made."""
        with self._lock:
            known: tuple[End, ...] = ()
            if id(data) in self._of:
                self._of.move_to_end(id(data))
                known = self._of[id(data)][1].get(key, ())
        return next((end for end in known if end.is_of(limit, tolerance)), None)

    def keep(self, data: Data, key: Hashable, end: End) -> None:
        """Remember an end."""
        with self._lock:
            _, known = self._of.setdefault(id(data), (data, {}))  # held, so that no others get its id
            known[key] = (*known.get(key, ()), end)
            self._of.move_to_end(id(data))
            while len(self._of) > _KEPT:
                self._of.popitem(last=False)


def key_of(trial: Trial, space: Space) -> Hashable:
    """What a fit to some data depends on, but for where it stops."""
    digest = blake2b(digest_size=16)
    for leaf in jax.tree.leaves((trial, space)):
        x = np.asarray(leaf)
        digest.update(f"{x.dtype}{x.shape}".encode() + x.tobytes())
    return space.structure, space.locals, space.n_recordings, digest.digest()
