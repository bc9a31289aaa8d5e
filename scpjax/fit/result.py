"""What a fit says: estimates with error bars, scores, and curves to draw."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from scpjax.physics.model import Model


@dataclass(frozen=True)
class Estimate:
    """A parameter with its error bar, SI. ``low`` and ``high`` bound the 95 % confidence interval.

    ``at_limit``: it stands at the end of its bounds, so the data ask for more than the mechanism allows or do not
    bound it; the error bar is then that without the bounds, no wider than they are.
    """

    value: float
    std: float
    unit: str
    low: float
    high: float
    description: str = ""
    symbol: str = ""
    at_limit: bool = False

    def to_dict(self) -> dict[str, float | str | bool]:
        """For JSON."""
        plain = {"value": self.value, "std": self.std, "unit": self.unit, "low": self.low, "high": self.high}
        return plain | {"at_limit": self.at_limit}


@dataclass(frozen=True)
class Trace:
    """One column of one recording, in the file's unit, for figures. ``held_out`` marks samples not used in fitting."""

    recording: str
    column: str
    time: np.ndarray
    drive: np.ndarray  # (n, inputs)
    drive_columns: tuple[str, ...]
    measured: np.ndarray
    weights: np.ndarray
    base: np.ndarray
    extended: np.ndarray
    held_out: np.ndarray


@dataclass(frozen=True)
class Fit:
    """One actuator fitted.

    ``parameters`` by key (of the free ones), ``known`` those held; ``scores`` and ``noise`` per file column in the
    file's unit; ``rank`` of the data's information against the number of free parameters, and in words what the data
    leave open.
    """

    model: Model
    parameters: dict[str, Estimate]
    known: tuple[str, ...]
    scores: dict[str, dict[str, float]]
    noise: dict[str, float]
    rank: int
    n_free: int
    not_identifiable: tuple[str, ...]
    converged: bool
    notes: tuple[str, ...]
    traces: tuple[Trace, ...]
    cost: float  # sum of squared residuals in units of the noise
    n_data: int
    seconds: float
