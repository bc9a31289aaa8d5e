"""How the thesis' 19 actuators were made: Tables 3.2, 3.3, 3.4, B.1, B.2 and B.3."""

from __future__ import annotations

from dataclasses import dataclass

from scpjax.recordings.thesis.table import Table

ZERO_C = 273.15
SUPPLY_V = 3.7
"""Battery voltage, which the thesis gives to PWM 255."""


@dataclass(frozen=True)
class Coiling:
    """Twisting and coiling of one actuator; its length is that with the weight hung."""

    code: int
    fiber_diameter_m: float
    fiber_length_m: float
    mass_kg: float
    stress_Pa: float
    start_revolutions: int
    total_revolutions: int
    speed_rev_per_min: float
    coiled_length_m: float


@dataclass(frozen=True)
class Annealing:
    """Annealing of one actuator. 2 ply ones were folded onto themselves and not put in the oven."""

    code: int
    ply: int
    framed_length_m: float | None
    elongation_pct: float | None
    oven_K: float | None
    oven_s: float | None
    preheat_s: float | None
    annealed_length_m: float
    mounted_length_m: float


@dataclass(frozen=True)
class Training:
    """Joule training of one actuator; None where it was not trained. Elongation in percent of the mounted
    length.
    """

    code: int
    wire_length_m: float
    wire_resistance_ohm: float
    wire_turns: int
    voltage_V: float | None = None
    power_W: float | None = None
    on_s: float | None = None
    off_s: float | None = None
    mass_kg: float | None = None
    cycles: int | None = None
    trained_length_m: float | None = None
    elongation_pct: float | None = None


def _coiling(code: int, mm: float, cm: float, start: int, total: int, coiled_cm: float) -> Coiling:
    grams, megapascal = {0.23: (40.4, 9.53), 0.33: (82.7, 9.48), 0.45: (150.9, 9.30)}[mm]
    return Coiling(code, mm * 1e-3, cm * 1e-2, grams * 1e-3, megapascal * 1e6, start, total, 145.0, coiled_cm * 1e-2)


def _oven(code: int, framed_cm: float, elongation: float, annealed_cm: float, mounted_cm: float = 7.5) -> Annealing:
    return Annealing(
        code,
        1,
        framed_cm * 1e-2,
        elongation,
        135.0 + ZERO_C,
        720.0,
        300.0,
        annealed_cm * 1e-2,
        mounted_cm * 1e-2,
    )


def _folded(code: int, annealed_cm: float) -> Annealing:
    return Annealing(code, 2, None, None, None, None, None, annealed_cm * 1e-2, 0.075)


def _training(
    code: int,
    wire_cm: float,
    ohm: float,
    turns: int,
    volt: float,
    watt: float,
    on_s: float,
    off_s: float,
    grams: float,
    trained_cm: float,
    elongation: float,
) -> Training:
    return Training(
        code,
        wire_cm * 1e-2,
        ohm,
        turns,
        volt,
        watt,
        on_s,
        off_s,
        grams * 1e-3,
        10,
        trained_cm * 1e-2,
        elongation,
    )


TABLE_3_2 = Table(
    "Thesis Table 3.2: twisting and coiling of actuators 1 to 9",
    (
        _coiling(1, 0.23, 40, 400, 621, 8.1),
        _coiling(2, 0.33, 40, 305, 500, 8.8),
        _coiling(3, 0.45, 40, 220, 356, 8.6),
        _coiling(4, 0.23, 100, 975, 1557, 20.1),
        _coiling(5, 0.33, 100, 770, 1186, 21.7),
        _coiling(6, 0.45, 100, 555, 948, 21.9),
        _coiling(7, 0.23, 55, 545, 856, 11.5),
        _coiling(8, 0.33, 55, 440, 675, 11.2),
        _coiling(9, 0.45, 55, 315, 514, 12.0),
    ),
    "Speed read as 145 rev/min, broken in the scan ('14 15') and whole in Table B.1.",
)

TABLE_B_1 = Table(
    "Thesis Table B.1: twisting and coiling of actuators 10 to 19",
    (
        _coiling(10, 0.23, 40, 395, 618, 8.0),
        _coiling(11, 0.33, 40, 310, 523, 8.7),
        _coiling(12, 0.45, 40, 215, 363, 8.7),
        _coiling(13, 0.23, 100, 990, 1565, 20.0),
        _coiling(14, 0.33, 100, 790, 1223, 20.5),
        _coiling(15, 0.45, 100, 560, 907, 21.5),
        _coiling(16, 0.23, 40, 400, 621, 8.0),
        _coiling(17, 0.23, 40, 395, 618, 8.0),
        _coiling(18, 0.33, 40, 310, 526, 8.8),
        _coiling(19, 0.33, 40, 305, 511, 8.6),
    ),
)

TABLE_3_3 = Table(
    "Thesis Table 3.3: framing and annealing of actuators 1 to 9",
    (
        _oven(1, 9.5, 117.3, 9.5),
        _oven(2, 9.9, 112.5, 9.9),
        _oven(3, 9.4, 109.3, 9.4),
        _folded(4, 8.6),
        _folded(5, 9.3),
        _folded(6, 9.4),
        _oven(7, 12.7, 110.4, 12.7, 10.5),
        _oven(8, 12.2, 108.9, 12.2, 10.5),
        _oven(9, 13.2, 110.0, 13.2, 10.5),
    ),
    "Elongation is the framed over the coiled length of Table 3.2; columns of the scan were shifted and were "
    "put right by it.",
)

TABLE_B_2 = Table(
    "Thesis Table B.2: framing and annealing of actuators 10 to 19",
    (
        _oven(10, 9.1, 113.8, 9.1),
        _oven(11, 9.7, 111.5, 9.7),
        _oven(12, 9.6, 110.3, 9.6),
        _folded(13, 8.7),
        _folded(14, 8.8),
        _folded(15, 9.2),
        _oven(16, 9.1, 113.8, 9.1),
        _oven(17, 9.0, 112.5, 9.0),
        _oven(18, 9.9, 112.5, 9.9),
        _oven(19, 9.7, 112.8, 9.7),
    ),
    "Elongation is the framed over the coiled length of Table B.1.",
)

TABLE_3_4 = Table(
    "Thesis Table 3.4: copper wire and training of actuators 1 to 9",
    (
        _training(1, 45, 0.96, 190, 3.26, 11.10, 5, 20, 82.7, 9.3, 124.0),
        _training(2, 50, 1.07, 170, 3.41, 10.87, 8, 25, 160.4, 9.0, 120.0),
        _training(3, 61, 1.30, 155, 3.55, 9.72, 10, 30, 299.7, 8.0, 106.7),
        _training(4, 45, 0.96, 98, 3.26, 11.10, 5, 20, 200.8, 9.0, 120.0),
        _training(5, 51, 1.09, 100, 3.41, 10.67, 8, 25, 412.9, 8.5, 113.3),
        _training(6, 62, 1.33, 95, 3.55, 9.50, 15, 40, 754.6, 10.4, 138.7),
        _training(7, 52, 1.11, 205, 3.26, 9.60, 10, 30, 82.7, 11.3, 107.6),
        _training(8, 60, 1.28, 195, 3.41, 9.08, 12, 35, 160.4, 11.7, 111.4),
        _training(9, 72, 1.54, 185, 3.55, 8.21, 20, 40, 299.7, 11.2, 106.7),
    ),
    "Powers are (PWM/255 3.7 V)^2 / R before the voltage was rounded; resistance from wire length alone "
    "(0.10 mm, 1.68e-8 ohm m).",
)

TABLE_B_3 = Table(
    "Thesis Table B.3: copper wire and training of actuators 10 to 19",
    (
        Training(10, 0.43, 0.92, 190),
        Training(11, 0.48, 1.03, 160),
        Training(12, 0.62, 1.33, 160),
        _training(13, 46, 0.98, 100, 3.26, 10.88, 5, 20, 200.8, 9.0, 120.0),
        _training(14, 49, 1.05, 90, 3.41, 11.07, 8, 25, 412.9, 8.6, 114.7),
        _training(15, 61, 1.30, 85, 3.55, 9.72, 15, 40, 754.6, 8.2, 109.3),
        _training(16, 45, 0.96, 170, 3.26, 11.10, 5, 20, 82.7, 9.1, 121.3),
        _training(17, 45, 0.96, 185, 3.26, 11.10, 5, 20, 82.7, 8.7, 116.0),
        _training(18, 52, 1.11, 170, 3.41, 10.48, 8, 25, 160.4, 9.1, 121.33),
        _training(19, 52, 1.11, 170, 3.41, 10.48, 8, 25, 160.4, 9.0, 120.0),
    ),
    "Actuators 10 to 12 were not trained.",
)
