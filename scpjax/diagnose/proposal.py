"""The experiment that a diagnosis proposes, and its forms in files."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from jaxtyping import Float

CSV_NAME = "next_experiment.csv"
NO_EXPERIMENT = "next experiment: none; "  # begins the note of limits that left none


@dataclass(frozen=True, kw_only=True)
class NextExperiment:
    """A drive profile that separates the hypotheses which the present recordings leave close.

    ``expected_bits`` is the expected growth of the log-likelihood ratio [bits] of whichever hypothesis is true to the
    other, after the other has been fitted anew to all recordings (`scpjax.diagnose.separation`): the least over which
    is true, from the present estimates. ``pair_bits`` by (true, fitted). ``standard_bits`` is that of the best standard
    excitation within the same limits, ``repeat_bits`` of the present drive over and over for as long.

    ``drive`` (n, sides) in the unit of ``drive_columns``, at ``time`` (n,) [s], held from sample to sample.
    ``predicted`` holds by hypothesis and file column what it expects (n,), in the column's unit; ``left`` by (true,
    fitted) and column what the best imitation is still off at ``left_time`` [s]; ``noise`` the standard deviation that
    one sample is judged by. ``hottest`` [K] by hypothesis, of any heated part (empty where nothing is heated).
    """

    separates: tuple[str, ...]
    says: str
    drive_columns: tuple[str, ...]
    time: Float[np.ndarray, " n"]
    drive: Float[np.ndarray, "n sides"]
    expected_bits: float
    pair_bits: dict[tuple[str, str], float]
    repeat_bits: float
    standard: str
    standard_bits: float
    hottest: dict[str, float]
    hottest_allowed: dict[str, float]
    predicted: dict[str, dict[str, np.ndarray]]
    left_time: np.ndarray
    left: dict[tuple[str, str], dict[str, np.ndarray]]
    noise: dict[str, float]
    seconds: float

    def to_json(self) -> dict[str, Any]:
        """Plain values; ``voltage_csv`` names the file beside it."""
        return {
            "separates": list(self.separates[:2]),
            "hypotheses": list(self.separates),
            "says": self.says,
            "voltage_csv": CSV_NAME,
            "drive_columns": list(self.drive_columns),
            "duration_s": float(self.time[-1]),
            "samples": len(self.time),
            "expected_bits": self.expected_bits,
            "bits": [{"true": a, "fitted": b, "bits": v} for (a, b), v in self.pair_bits.items()],
            "repeat_bits": self.repeat_bits,
            "standard": self.standard,
            "standard_bits": self.standard_bits,
            "hottest_degC": {k: v - 273.15 for k, v in self.hottest.items()},
            "hottest_allowed_degC": {k: v - 273.15 for k, v in self.hottest_allowed.items()},
            "seconds": self.seconds,
        }

    def csv(self) -> str:
        """The profile as the text of a CSV file: ``time_s`` and the drive columns."""
        rows = "\n".join(
            ",".join((f"{t:.9g}", *(f"{v:.9g}" for v in row))) for t, row in zip(self.time, self.drive, strict=True)
        )
        return f"{','.join(('time_s', *self.drive_columns))}\n{rows}\n"
