"""Which stretches of the recordings are kept out of fitting, to judge by."""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from scpjax.fit.data import Data

_MOST = 0.5  # of a recording's samples
_OTHERS = (((0.15, 0.25), (0.5, 0.6), (0.8, 0.9)), ((0.05, 0.15), (0.4, 0.5), (0.7, 0.8)))
_HALF = 0.52  # of a recording, after which its second half begins


@dataclass(frozen=True, eq=False)
class Split:
    """Training data, all data, and which bins belong to which."""

    train: Data
    whole: Data
    is_train: np.ndarray  # (r, k, y)
    is_held: np.ndarray
    mask: np.ndarray  # (r, n, y) samples held out

    def with_weights(self, weights: np.ndarray) -> Split:
        """The same stretches with other weights of the samples (wild ones: 0)."""
        return _split(self.whole.with_weights(weights), self.mask)

    @cached_property
    def others(self) -> tuple[Split, ...]:
        """The same data with other stretches held out: two sets, with these nine tenths of a recording, none of it
        twice; and the second half, as what changes with time is easily predicted between stretches that are known.
        """
        return *(split(self.whole, fractions) for fractions in _OTHERS), _split(self.whole, _second_half(self.whole))


def split(data: Data, fractions: tuple[tuple[float, float], ...] = ((0.25, 0.35), (0.6, 0.7), (0.9, 1.0))) -> Split:
    """Stretches of every recording, on whole bins, kept out of fitting; the simulation runs through them. None of one
    so short that whole bins would be most of it.
    """
    weights = np.asarray(data.weights)
    held = np.zeros(weights.shape, bool)
    at = np.asarray(data.grids.at)
    for i in range(weights.shape[0]):
        seen = np.flatnonzero(weights[i].sum(axis=1) > 0)
        last = at[i, seen[-1]] + 1
        for a, b in fractions:
            low, high = (round(f * last / data.bin) * data.bin for f in (a, b))
            high = last + 1 if b == 1.0 else high
            inside = (at[i] >= low) & (at[i] < high)
            inside[seen[-1] + 1 :] = False
            held[i, inside] = True
        if np.mean(held[i, seen]) > _MOST:
            held[i] = False
    return _split(data, held)


def _second_half(data: Data) -> np.ndarray:
    """Samples (r, n, y) of the second half of every recording, on whole bins: of its time, or where fewer were seen
    in the first, of what was seen.
    """
    weights, at = np.asarray(data.weights), np.asarray(data.grids.at)
    held = np.zeros(weights.shape, bool)
    for i in range(weights.shape[0]):
        seen = at[i, weights[i].sum(axis=1) > 0]
        low = round(_HALF * (seen[-1] + 1) / data.bin)
        at_most = seen[math.ceil((1 - _MOST) * len(seen))] if len(seen) > 1 else seen[-1] + data.bin
        held[i, (at[i] >= max(low, -(-at_most // data.bin)) * data.bin) & (at[i] <= seen[-1])] = True
    return held


def _split(data: Data, held: np.ndarray) -> Split:
    train = data.with_weights(np.where(held, 0.0, np.asarray(data.weights)))
    is_train = np.isfinite(np.asarray(train.norm))
    there = np.isfinite(np.asarray(data.norm))
    return Split(train, data, is_train & there, there & ~is_train, held)
