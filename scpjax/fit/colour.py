"""Coloured residuals: what colour they have, and how much evidence they hold.

Residuals that slow physics or a drifting room has coloured repeat themselves; their sum of squares would count the
same evidence many times. An autoregressive filter learnt from them makes them white, and white ones pass unchanged.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

ORDER = 3


@dataclass(frozen=True)
class Whitener:
    """Autoregressive filter, coefficients (y, 3), 0 where residuals are white already."""

    colour: np.ndarray

    @classmethod
    def learn(cls, residual: np.ndarray, there: np.ndarray) -> Whitener:
        """From residuals (r, k, y), where there are any.

        A colour is believed only if the likelihood gains more than BIC asks for its three coefficients.
        """
        colour = np.zeros((residual.shape[2], ORDER))
        for j in range(residual.shape[2]):
            rows, targets = _lagged(residual[..., j], there[..., j])
            if len(targets) < 20 * ORDER:
                continue
            a = np.linalg.lstsq(rows, targets, rcond=None)[0]
            kept, total = np.mean((targets - rows @ a) ** 2), np.mean(targets**2)
            if len(targets) * np.log(total / max(kept, 1e-300)) > ORDER * np.log(len(targets)) + 6:
                colour[j] = a
        return cls(colour)

    @property
    def is_white(self) -> bool:
        """Nothing to filter."""
        return not np.any(self.colour)

    @property
    def floor(self) -> float:
        """Least variance of the filtered residuals that is believed: that of the noise where nothing is filtered."""
        return 1.0 if self.is_white else 1e-3

    def __call__(self, residual: np.ndarray, there: np.ndarray) -> tuple[float, int]:
        """(sum of squares, number) of residuals (r, k, y) after the filter."""
        total, number = 0.0, 0
        for j, a in enumerate(self.colour):
            if not np.any(a):
                total += float(np.sum(residual[..., j][there[..., j]] ** 2))
                number += int(there[..., j].sum())
            else:
                rows, targets = _lagged(residual[..., j], there[..., j])
                total += float(np.sum((targets - rows @ a) ** 2))
                number += len(targets)
        return total, number


def _lagged(x: np.ndarray, there: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    whole = there[:, ORDER:].copy()
    for lag in range(1, ORDER + 1):
        whole &= there[:, ORDER - lag : -lag]
    rows = np.stack([x[:, ORDER - lag : -lag][whole] for lag in range(1, ORDER + 1)], axis=-1)
    return rows, x[:, ORDER:][whole]
