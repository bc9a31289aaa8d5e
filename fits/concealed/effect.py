"""What an effect may change. Every hook has a default that changes nothing; `system.py` calls only those written."""

from __future__ import annotations

from typing import ClassVar

import numpy as np

from fits.concealed.plants import Kind, Plant

State = tuple[float, ...]
ALL: tuple[Kind, ...] = ("te", "full", "plant", "joint")
WARM: tuple[Kind, ...] = ("te", "full", "joint")  # temperature is measured
MOVING: tuple[Kind, ...] = ("full", "plant", "joint")


class Now:
    """One side at one instant: time t [s], volts u, temperature T [K above room], its rate dT, displacement x [m]."""

    __slots__ = ("T", "dT", "other_T", "other_u", "power", "side", "t", "u", "v", "x")

    def __init__(self) -> None:
        self.t = self.u = self.T = self.dT = self.x = self.v = self.power = self.other_T = self.other_u = 0.0
        self.side = 0


class Effect:
    """One piece of physics that the base equations leave out, under one law; its strength is 0 where it is absent.

    Other numbers of the law are drawn once by `draw` and kept in ``numbers``. ``own`` is this effect's states.
    """

    name: ClassVar[str]
    subsystem: ClassVar[str]
    laws: ClassVar[dict[str, tuple[Kind, ...]]]  # law: kinds of plant that it can be seen in
    catalogue: ClassVar[bool] = True
    first_guess: ClassVar[float] = 0.1  # of the strength
    most: ClassVar[float] = 1.0  # strength beyond which the law makes no sense
    states: int = 0  # per side

    def __init__(self, law: str, plant: Plant, rng: np.random.Generator):
        if law not in self.laws:
            raise ValueError(f"{self.name} has no law {law!r}; it has {', '.join(self.laws)}")
        self.law, self.plant, self.strength = law, plant, 0.0
        self.numbers: dict[str, float] = {}
        self.draw(rng)

    def draw(self, rng: np.random.Generator) -> None:
        """Numbers of the law other than its strength, and how many states it has."""

    def between(self, rng: np.random.Generator, name: str, low: float, high: float) -> float:
        """Draw a number (evenly in its logarithm where positive), note it under its name and give it."""
        x = np.exp(rng.uniform(np.log(low), np.log(high))) if low > 0 else rng.uniform(low, high)
        self.numbers[name] = float(f"{x:.4g}")
        return self.numbers[name]

    def dead_time(self) -> float:
        """Time by which the drive comes late [s]."""
        return 0.0

    def breaks(self, end: float) -> list[float]:
        """Instants in (0, end) at which something jumps [s]."""
        return []

    def volts(self, now: Now, u: float, own: State) -> float:
        """Volts at the wire, of those the drive was told."""
        return u

    def resistance(self, now: Now, ohm: float, own: State) -> float:
        """Resistance of the wire [ohm]."""
        return ohm

    def capacity(self, now: Now, joule_per_kelvin: float, own: State) -> float:
        """Thermal mass of the heated node [J/K]."""
        return joule_per_kelvin

    def heat(self, now: Now, own: State) -> float:
        """Heat into the heated node beside Joule's and Newton's [W]."""
        return 0.0

    def pulling(self, now: Now, kelvin: float, own: State) -> float:
        """Temperature that makes the force [K above room]."""
        return kelvin

    def pull(self, now: Now, newton: float, own: State) -> float:
        """Thermal force [N]."""
        return newton

    def stretch(self, now: Now, metre: float, own: State) -> float:
        """Displacement that the spring feels [m]."""
        return metre

    def spring(self, now: Now, newton: float, metre: float, own: State) -> float:
        """Elastic force [N] at the displacement that the spring feels."""
        return newton

    def force(self, now: Now, own: State) -> float:
        """Force beside thermal, elastic and viscous ones, in the direction of contraction [N]."""
        return 0.0

    def rates(self, now: Now, own: State) -> State:
        """Time derivatives of the own states."""
        return ()

    def sense_temperature(self, now: Now, kelvin: float, own: State) -> float:
        """Reading of the temperature sensor [K above room]."""
        return kelvin

    def sense_displacement(self, now: Now, metre: float, own: State) -> float:
        """Reading of the displacement sensor [m]."""
        return metre

    def truth(self) -> dict[str, object]:
        """As it stands in ``truth.json``."""
        return {"law": self.law, "strength": self.strength, "subsystem": self.subsystem, **self.numbers}
