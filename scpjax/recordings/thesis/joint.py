"""The antagonistic joint (AAA) on the bench: Tables 4.8 to 4.12."""

from __future__ import annotations

import math
from dataclasses import dataclass

from scpjax.recordings.thesis.table import Table


@dataclass(frozen=True)
class Efficiency:
    """Energy of one full contraction. ``code`` is the actuator here, or the thesis' reference ``[n]``."""

    code: str
    conductive_fiber: bool
    ply: int
    fiber_diameter_m: float | None
    resistance_ohm: float
    wire: str
    voltage_V: float
    current_A: float
    power_W: float
    displacement_m: float | None
    duration_s: float
    mass_kg: float
    energy_J: float
    battery_s: float
    repetitions: int


@dataclass(frozen=True)
class JointTrial:
    """Largest joint angle of one trial with actuator 16 as agonist.

    The antagonist is actuator 17, or a passive spring of ``antagonist_stiffness_N_per_m``; ``return_s`` is
    the time back to the start, where it was measured.
    """

    voltage_V: float
    on_s: float
    agonist_mass_kg: float
    antagonist_mass_kg: float
    angle_rad: float
    rise_s: float
    off_s: float | None = None
    return_s: float | None = None
    antagonist_stiffness_N_per_m: float | None = None


@dataclass(frozen=True)
class Passive:
    """A passive antagonist; None where it has no such measure."""

    name: str
    length_m: float
    stiffness_N_per_m: float
    coils: int | None = None
    pitch_m: float | None = None
    wire_diameter_m: float | None = None
    diameter_m: float | None = None


def _energy(
    code: str,
    conductive: bool,
    ply: int,
    mm: float | None,
    ohm: float,
    wire: str,
    electric: tuple[float, float, float],
    displaced_mm: float | None,
    seconds: float,
    grams: float,
    joule: float,
    battery_s: float,
    repetitions: int,
) -> Efficiency:
    diameter = None if mm is None else mm * 1e-3
    moved = None if displaced_mm is None else displaced_mm * 1e-3
    return Efficiency(
        code,
        conductive,
        ply,
        diameter,
        ohm,
        wire,
        *electric,
        moved,
        seconds,
        grams * 1e-3,
        joule,
        battery_s,
        repetitions,
    )


TABLE_4_8 = Table(
    "Thesis Table 4.8: energy, battery life and repetitions of single actuators, here and in the literature",
    (
        _energy("16", False, 1, 0.23, 0.96, "copper", (3.26, 3.40, 11.10), 13.3, 5, 59.8, 55.50, 1080, 216),
        _energy("2", False, 1, 0.33, 1.07, "copper", (3.41, 3.19, 10.87), 15.3, 8, 82.7, 86.96, 1140, 142),
        _energy("3", False, 1, 0.45, 1.30, "copper", (3.55, 2.73, 9.72), 13.3, 10, 223.8, 97.20, 1320, 132),
        _energy("[16]", False, 1, 0.50, 2.02, "copper", (12.0, 5.94, 71.28), 10.0, 0.625, 200, 44.55, 600, 960),
        _energy("[23]", False, 1, 0.34, 1.14, "copper", (1.48, 1.30, 1.93), 13.0, 40, 200, 77.20, 2760, 69),
        _energy("[36]", False, 1, 0.50, 1.26, "nickel", (0.79, 0.63, 0.50), 8.5, 65, 200, 32.50, 5700, 87),
        _energy("[15]", False, 1, 0.77, 19.1, "nichrome", (4.58, 0.24, 1.1), None, 120, 204.08, 132.0, 15000, 125),
        _energy("[29]", True, 1, 0.20, 14.0, "", (3.78, 0.27, 1.02), 4.6, 25, 30, 25.50, 13320, 532),
        _energy("4", False, 2, 0.23, 0.96, "copper", (3.26, 3.40, 11.10), 11.2, 5, 200.8, 55.50, 1080, 216),
        _energy("5", False, 2, 0.33, 1.09, "copper", (3.41, 3.13, 10.67), 8.2, 8, 412.9, 85.36, 1140, 142),
        _energy("6", False, 2, 0.45, 1.33, "copper", (3.55, 2.67, 9.50), 8.8, 15, 599.0, 142.50, 1320, 88),
        _energy("[8]", True, 2, None, 4.0, "", (5.0, 1.25, 6.25), 8.0, 10, 50, 62.50, 2880, 288),
        _energy("[26]", True, 2, 0.20, 25.0, "", (15.0, 0.60, 9.0), 40.0, 25, 275.51, 225.0, 6000, 240),
        _energy("[2]", True, 2, 0.38, 25.0, "", (15.0, 0.60, 9.0), 10.0, 1, 100, 9.0, 6000, 6000),
    ),
    "Battery times are whole minutes of a 1 Ah battery.",
)


def _pairs(agonist_g: float, antagonist_g: float, *degrees: float) -> tuple[JointTrial, ...]:
    return tuple(
        JointTrial(3.26, on, agonist_g * 1e-3, antagonist_g * 1e-3, math.radians(angle), on)
        for on, angle in zip((5.0, 8.0, 10.0), degrees, strict=True)
    )


def _passive(
    stiffness: float, agonist_g: float, antagonist_g: float, *trials: tuple[float, float]
) -> tuple[JointTrial, ...]:
    times = ((5.0, 20.0), (8.0, 25.0), (10.0, 30.0))
    return tuple(
        JointTrial(3.26, on, agonist_g * 1e-3, antagonist_g * 1e-3, math.radians(angle), on, off, back, stiffness)
        for (on, off), (angle, back) in zip(times, trials, strict=True)
    )


TABLE_4_9 = Table(
    "Thesis Table 4.9: joint angles with two actuators (16 and 17)",
    (
        *_pairs(17.8, 18.3, 10, 17, 20),
        *_pairs(40.0, 40.4, 8, 13, 17),
        *_pairs(56.4, 66.3, 7, 12, 15),
        *_pairs(75.9, 82.7, 6, 9, 14),
    ),
    "Angles were read by eye from films. 56.4 g here is 56.2 g in Table 4.11, perhaps the same weight.",
)

TABLE_4_10 = Table(
    "Thesis Table 4.10: the spring and the rubber band that stood in for the antagonist",
    (
        Passive("spring", 0.072, 165.3, 31, 2.3e-3, 0.6e-3, 6.5e-3),
        Passive("rubber band", 0.075, 38.4),
    ),
    "Pitch and diameters are approximate.",
)

TABLE_4_11 = Table(
    "Thesis Table 4.11: joint angles with one actuator (16) and a spring",
    (
        *_passive(165.3, 34.2, 40.4, (3, 9), (8, 13), (9, 14)),
        *_passive(165.3, 40.4, 59.8, (5, 9), (8, 12), (10, 15)),
        *_passive(165.3, 56.2, 75.9, (2, 9), (7, 14), (8, 18)),
    ),
    "Angles and times were read by eye.",
)

TABLE_4_12 = Table(
    "Thesis Table 4.12: joint angles with one actuator (16) and a rubber band",
    (
        *_passive(38.4, 17.8, 9.0, (7, 9), (10, 14), (12, 14)),
        *_passive(38.4, 40.4, 30.5, (6, 9), (11, 11), (12, 12)),
        *_passive(38.4, 59.8, 51.2, (5, 9), (9, 14), (11, 16)),
        *_passive(38.4, 82.7, 75.9, (4, 7), (8, 11), (9, 13)),
    ),
    "Angles and times were read by eye.",
)
