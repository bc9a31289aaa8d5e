"""Scores of a prediction against what was measured: thesis (C.14)-(C.16)."""

from __future__ import annotations

from typing import Any

import numpy as np


def _weighted(predicted: Any, actual: Any, weights: Any) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    predicted, actual = np.asarray(predicted, float), np.asarray(actual, float)
    if predicted.shape != actual.shape:
        raise ValueError(f"predicted {predicted.shape} and actual {actual.shape} differ in shape")
    w = np.ones_like(actual) if weights is None else np.asarray(weights, float)
    if not np.sum(w) > 0:
        raise ValueError("no sample has weight: nothing to score")
    return predicted, actual, w / np.sum(w)


def rmse(predicted: Any, actual: Any, weights: Any = None) -> float:
    """Root mean square error, thesis (C.14), in the unit of the signal. ``weights`` (n,) leave samples out."""
    p, a, w = _weighted(predicted, actual, weights)
    return float(np.sqrt(np.sum(w * (p - a) ** 2)))


def nrmse(predicted: Any, actual: Any, weights: Any = None) -> float:
    """Goodness of fit in percent, 100 for a perfect one and 0 for the mean, thesis (C.15)."""
    p, a, w = _weighted(predicted, actual, weights)
    spread = np.sqrt(np.sum(w * (a - np.sum(w * a)) ** 2))
    return float(100.0 * (1.0 - np.sqrt(np.sum(w * (p - a) ** 2)) / max(spread, 1e-300)))


def mae(predicted: Any, actual: Any, weights: Any = None) -> float:
    """Mean absolute error, thesis (C.16), in the unit of the signal."""
    p, a, w = _weighted(predicted, actual, weights)
    return float(np.sum(w * np.abs(p - a)))
