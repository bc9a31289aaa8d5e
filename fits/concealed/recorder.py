"""What a logger makes of the readings: noise, a resolution, skipped and wild samples; CSV and TOML."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Literal

import numpy as np

from fits.concealed.plants import Plant

Level = Literal["fine", "typical", "coarse"]
LEVELS: tuple[Level, ...] = ("fine", "typical", "coarse")
NOISE: dict[Level, tuple[float, float]] = {
    "fine": (0.05, 0.01),
    "typical": (0.15, 0.05),
    "coarse": (0.4, 0.15),
}  # K, mm
Mess = Literal["warm", "skipped", "outliers"]
MESS: tuple[Mess, ...] = ("warm", "skipped", "outliers")


@dataclass(frozen=True)
class Column:
    """One column of a file: what it is called, and value = offset + scale * SI reading."""

    name: str
    scale: float
    offset: float
    noise: float
    step: float  # resolution


def columns(plant: Plant, level: Level) -> list[Column]:
    """Columns of the responses of a plant, in the order of its readings; those not measured are called ''."""
    kelvin, mm = NOISE[level]
    degree = 180 / np.pi / plant.radius
    warm = [
        Column(f"temperature{side}_degC", 1.0, plant.ambient, kelvin, 0.05 if plant.sides == 1 else 0.0)
        for side in ([""] if plant.sides == 1 else ["_agonist", "_antagonist"])
    ]
    if plant.kind == "te":
        return warm
    if plant.kind == "joint":
        return [*warm, Column("angle_deg", degree, 0.0, mm * 1e-3 * degree, 0.0)]
    moved = Column("displacement_mm", 1e3, 0.0, mm, 0.002)
    return [*warm, moved] if plant.kind == "full" else [Column("", 1.0, 0.0, 0.0, 0.0), moved]


def record(
    path: Path,
    plant: Plant,
    level: Level,
    times: np.ndarray,
    volts: np.ndarray,
    readings: np.ndarray,
    rng: np.random.Generator,
    mess: tuple[Mess, ...] = (),
) -> dict[str, float]:
    """Write ``path`` and its .toml; gives the noise of each column [in the file's unit]."""
    n = len(times)
    names = ["voltage_V"] if plant.sides == 1 else ["voltage_agonist_V", "voltage_antagonist_V"]
    table = [times, *volts.T]
    noise = {}
    for column, clean in zip(columns(plant, level), readings.T, strict=True):
        if not column.name:
            continue
        seen = column.offset + column.scale * clean + column.noise * rng.standard_normal(n)
        if "outliers" in mess:
            wild = rng.random(n) < 0.006
            seen = seen + wild * column.noise * rng.choice([-1.0, 1.0], n) * rng.uniform(8, 50, n)
        if column.step:
            seen = np.round(seen / column.step) * column.step + 0.0
        names.append(column.name)
        table.append(seen)
        noise[column.name] = column.noise
    keep = np.ones(n, bool)
    if "skipped" in mess:
        keep = rng.random(n) > 0.15
        keep[:2] = keep[-1] = True
    path.parent.mkdir(parents=True, exist_ok=True)
    rows = [f"time_s,{','.join(names)}"]
    rows += [",".join(f"{x:.7g}" for x in row) for row in np.stack(table, axis=1)[keep]]
    path.write_text("\n".join(rows) + "\n", encoding="utf-8", newline="\n")
    path.with_suffix(".toml").write_text(_sidecar(plant), encoding="utf-8", newline="\n")
    return noise


def _sidecar(plant: Plant) -> str:
    text = f"[actuator]\nresistance_ohm = {plant.resistance:g}\nmoving_mass_kg = {plant.mass:g}\n"
    if plant.kind == "te":
        text = f"[actuator]\nresistance_ohm = {plant.resistance:g}\n"
    text += f"\n[environment]\nambient_degC = {plant.ambient:.1f}\n"
    if plant.kind == "joint":
        text += f"\n[pulley]\nradius_m = {plant.radius:g}\nmass_kg = {plant.pulley_mass:g}\n"
    return text
