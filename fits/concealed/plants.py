"""Actuators drawn at random, of the size of the ones that the literature reports.

Base equations, written out in `system.py`: C_th dT/dt = V^2/R - lambda T;  m x'' = C T - k x - beta x'.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

import numpy as np

Kind = Literal["te", "full", "plant", "joint"]
KINDS: tuple[Kind, ...] = ("te", "full", "plant", "joint")
FULL_DRIVE = 3.7  # V


@dataclass(frozen=True)
class Plant:
    """One actuator (or one of two equal ones of a joint), SI units; temperatures are in excess of the room's.

    ``kind``: te measures temperature; full temperature and displacement; plant displacement; joint both temperatures
    and the angle of a pulley that two actuators pull at from either side.
    """

    kind: Kind
    resistance: float  # ohm
    conductance: float  # W/K
    thermal_mass: float  # J/K
    mass: float  # kg
    stiffness: float  # N/m
    damping: float  # N s/m
    coefficient: float  # N/K
    ambient: float  # degC
    radius: float = 0.015  # m, joint only
    pulley_mass: float = 0.004  # kg, joint only

    @property
    def hottest(self) -> float:
        """Excess temperature at full drive for ever [K]."""
        return FULL_DRIVE**2 / (self.resistance * self.conductance)

    @property
    def travel(self) -> float:
        """Displacement at full drive for ever [m]; a joint's actuators have two springs to move."""
        return self.coefficient * self.hottest / (self.stiffness * self.sides)

    @property
    def settling(self) -> float:
        """Thermal time constant [s]."""
        return self.thermal_mass / self.conductance

    @property
    def sides(self) -> int:
        """Actuators."""
        return 2 if self.kind == "joint" else 1

    @property
    def moves(self) -> bool:
        """Whether there is a force balance."""
        return self.kind != "te"


def draw_plant(kind: Kind, rng: np.random.Generator) -> Plant:
    """A plant of a kind, rounded as a data sheet would be."""

    def between(low: float, high: float) -> float:
        return float(f"{np.exp(rng.uniform(np.log(low), np.log(high))):.4g}")

    resistance, conductance = between(0.9, 1.6), between(0.10, 0.17)
    thermal_mass, stiffness = between(0.9, 1.7), between(135.0, 250.0)
    hottest = FULL_DRIVE**2 / (resistance * conductance)
    return Plant(
        kind=kind,
        resistance=resistance,
        conductance=conductance,
        thermal_mass=thermal_mass,
        mass=between(0.12, 0.45),
        stiffness=stiffness,
        damping=between(3.5, 12.0),
        coefficient=float(f"{stiffness * between(0.008, 0.015) / hottest:.4g}"),
        ambient=round(float(rng.uniform(18.0, 27.0)), 1),
    )
