"""Displacements of single actuators for varying voltage and weight: Tables 4.4 and 4.5."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from scpjax.recordings.thesis.manufacturing import SUPPLY_V
from scpjax.recordings.thesis.table import Table


@dataclass(frozen=True)
class VoltageSweep:
    """Displacement of one actuator with one weight, for growing voltages that were applied one after
    another.
    """

    code: int
    ply: int
    fiber_diameter_m: float
    length_m: float
    mass_kg: float
    pwm: tuple[int, ...]
    displacement_m: tuple[float, ...]

    @property
    def voltage_V(self) -> tuple[float, ...]:
        """Voltages as the thesis counts them, PWM / 255 of 3.7 V, not rounded."""
        return tuple(SUPPLY_V * count / 255.0 for count in self.pwm)


@dataclass(frozen=True)
class WeightSweep:
    """Largest displacement of one actuator at one voltage, for several weights."""

    code: int
    ply: int
    fiber_diameter_m: float
    length_m: float
    voltage_V: float
    mass_kg: tuple[float, ...]
    displacement_m: tuple[float, ...]


@dataclass(frozen=True)
class SteadyState:
    """A row of Table 4.4 as arrays (k,): volts and metres, with the load in kg."""

    code: int
    mass_kg: float
    voltage_V: np.ndarray
    displacement_m: np.ndarray


_PWM: dict[float, tuple[int, ...]] = {0.23: (100, 125, 150, 175, 200, 225)}
_PWM[0.33] = (*_PWM[0.23], 235)
_PWM[0.45] = (*_PWM[0.23], 245)
_VOLT = {0.23: 3.26, 0.33: 3.41, 0.45: 3.55}


def _volts(ply: int, mm: float, cm: float, grams: float, code: int, *displaced_mm: float) -> VoltageSweep:
    moved = tuple(x * 1e-3 for x in displaced_mm)
    return VoltageSweep(code, ply, mm * 1e-3, cm * 1e-2, grams * 1e-3, _PWM[mm], moved)


def _loads(ply: int, mm: float, cm: float, code: int, *pairs: tuple[float, float]) -> WeightSweep:
    masses, moved = tuple(g * 1e-3 for g, _ in pairs), tuple(x * 1e-3 for _, x in pairs)
    return WeightSweep(code, ply, mm * 1e-3, cm * 1e-2, _VOLT[mm], masses, moved)


TABLE_4_4 = Table(
    "Thesis Table 4.4: displacement of nine actuators for growing voltages, the training weight hung",
    (
        _volts(1, 0.23, 7.5, 82.7, 16, 3.7, 4.8, 5.8, 8.2, 9.7, 11.4),
        _volts(1, 0.33, 7.5, 160.4, 2, 2.7, 4.1, 4.8, 5.6, 6.6, 8.7, 9.7),
        _volts(1, 0.45, 7.5, 299.7, 3, 3.6, 4.6, 6.1, 6.6, 8.2, 9.2, 10.2),
        _volts(1, 0.23, 10.5, 82.7, 7, 5.6, 8.2, 9.4, 12.4, 12.8, 16.5),
        _volts(1, 0.33, 10.5, 160.4, 8, 3.7, 5.8, 6.6, 8.8, 11.7, 13.3, 14.3),
        _volts(1, 0.45, 10.5, 299.7, 9, 5.3, 5.8, 8.2, 10.4, 12.2, 13.3, 15.8),
        _volts(2, 0.23, 7.5, 200.8, 4, 4.3, 4.8, 6.8, 8.2, 9.7, 10.2),
        _volts(2, 0.33, 7.5, 412.9, 5, 2.6, 3.6, 4.8, 5.1, 6.6, 7.1, 7.7),
        _volts(2, 0.45, 7.5, 754.6, 6, 2.6, 4.1, 4.6, 5.6, 6.3, 7.7, 8.7),
    ),
    "Sonar readings; PWM 235 was used with 0.33 mm fibre only, 245 with 0.45 mm only.",
)

TABLE_4_5 = Table(
    "Thesis Table 4.5: largest displacement of nine actuators at one voltage, three weights each",
    (
        _loads(1, 0.23, 7.5, 16, (40.4, 11.8), (59.8, 13.3), (82.7, 12.8)),
        _loads(1, 0.33, 7.5, 2, (82.7, 15.3), (129.4, 13.3), (160.4, 9.4)),
        _loads(1, 0.45, 7.5, 3, (150.9, 13.3), (223.8, 13.3), (299.7, 12.2)),
        _loads(1, 0.23, 10.5, 7, (40.4, 17.3), (59.8, 14.8), (82.7, 14.3)),
        _loads(1, 0.33, 10.5, 8, (82.7, 17.3), (129.4, 16.3), (160.4, 16.8)),
        _loads(1, 0.45, 10.5, 9, (150.9, 15.0), (223.8, 16.6), (299.7, 15.5)),
        _loads(2, 0.23, 7.5, 4, (123.1, 9.2), (160.4, 11.2), (200.8, 11.2)),
        _loads(2, 0.33, 7.5, 5, (251.1, 6.6), (330.7, 7.7), (412.9, 8.2)),
        _loads(2, 0.45, 7.5, 6, (456.5, 8.8), (599.0, 8.8), (754.6, 8.3)),
    ),
    "Does not repeat Table 4.4 under the same conditions (actuator 16, 82.7 g: 12.8 mm, there 11.4 mm).",
)


def table_4_4_recordings() -> tuple[SteadyState, ...]:
    """Each row of Table 4.4 as arrays: voltage (k,) V and displacement (k,) m, k = 6 or 7."""
    return tuple(
        SteadyState(row.code, row.mass_kg, np.array(row.voltage_V), np.array(row.displacement_m)) for row in TABLE_4_4
    )
