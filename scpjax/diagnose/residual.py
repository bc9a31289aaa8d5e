"""Do residuals still hold structure? Whiteness, and independence of past input."""

from __future__ import annotations

import numpy as np
from scipy.special import chdtrc

from scpjax.fit.colour import Whitener

_LAGS = 20


def whiteness(residual: np.ndarray, there: np.ndarray, lags: int = _LAGS) -> float:
    """p-value of the Ljung-Box test that residuals (r, k) are white; recordings are pooled, gaps left out.

    Ljung, Box, Biometrika 65 (1978) 297. Small: structure is left.
    """
    x, n = _centred(residual, there)
    lags = min(lags, x.shape[1] // 5)
    if n < 3 * lags or lags < 1:
        return 1.0
    variance = np.sum(x**2)
    rho = np.array([np.sum(x[:, k:] * x[:, :-k]) for k in range(1, lags + 1)]) / (variance + 1e-300)
    q = n * (n + 2) * np.sum(rho**2 / (n - np.arange(1, lags + 1)))
    return float(chdtrc(lags, q))


def independence(residual: np.ndarray, drive: np.ndarray, there: np.ndarray, lags: int = _LAGS) -> float:
    """p-value of the test that residuals (r, k) do not depend on the drive (r, k) now or up to ``lags`` bins ago.

    Residuals are whitened by their own autoregressive filter and the drive goes through the same one; the share of
    the residuals that the filtered drive's lags explain is then chi-squared (Ljung, System Identification, 2nd ed.,
    16.6, with pre-whitening).
    """
    x, n = _centred(residual, there)
    lags = min(lags, x.shape[1] // 5)
    if n < 3 * lags or lags < 1 or not np.any(np.ptp(drive, axis=1)):
        return 1.0
    colour = Whitener.learn(x[..., None], there[..., None]).colour[0]

    def filtered(s: np.ndarray) -> np.ndarray:
        out = s.copy()
        for lag, a in enumerate(colour, start=1):
            out[:, lag:] -= a * s[:, :-lag]
        return out

    u = filtered(drive - drive.mean(axis=1, keepdims=True))
    shifted = np.stack([np.pad(u, ((0, 0), (k, 0)))[:, : u.shape[1]] for k in range(lags + 1)], axis=-1)
    skip = lags + len(colour)
    use = there[:, skip:]
    rows, e = shifted[:, skip:][use], filtered(x)[:, skip:][use]
    rows = rows - rows.mean(axis=0)
    gain, _, rank, _ = np.linalg.lstsq(rows, e - e.mean(), rcond=1e-8)
    left = e - e.mean() - rows @ gain
    explained = float(np.sum((rows @ gain) ** 2))
    variance = float(np.sum(left**2)) / max(len(e) - int(rank) - 1, 1)
    return float(chdtrc(max(int(rank), 1), explained / (variance + 1e-300)))


def _centred(residual: np.ndarray, there: np.ndarray) -> tuple[np.ndarray, int]:
    n = int(there.sum())
    mean = np.sum(np.where(there, residual, 0.0)) / max(n, 1)
    return np.where(there, residual - mean, 0.0), n
