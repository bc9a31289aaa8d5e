"""What the host may set on the board. ``rig/firmware/parameters.h`` holds the same table; a test compares them."""

from __future__ import annotations

import struct
from dataclasses import dataclass, fields, replace
from typing import TYPE_CHECKING, Literal

if TYPE_CHECKING:
    from scpjax.physics.model import Model

May = Literal["free", "lower", "raise"]
TICK_HZ = 200
TICK_S = 1 / TICK_HZ


@dataclass(frozen=True, kw_only=True)
class BoardConfig:
    """What a board is built with (``rig/firmware/config.h``): the most that it will ever do, and its thermal model.

    Units are those of the names; the thermal model ``C dT/dt = V^2 / R - lambda (T - ambient)``, thesis (3.2), heats
    in the board's mind and is best taken rather too hot.
    """

    supply_V: float = 3.7
    max_temperature_C: float = 120.0
    margin_K: float = 2.0
    max_energy_J: float = 1000.0
    sustained_power_W: float = 6.0
    max_on_s: float = 600.0
    max_current_A: float = 9.0
    host_timeout_s: float = 1.0
    model_resistance_ohm: float = 1.07
    model_conductance_W_per_K: float = 0.14
    model_thermal_mass_J_per_K: float = 1.1
    model_ambient_C: float = 25.0
    ntc_nominal_ohm: float = 100e3
    ntc_beta_K: float = 3950.0
    ntc_fixed_ohm: float = 10e3
    current_V_per_A: float = 0.4

    def flags(self) -> str:
        """As ``CONFIG`` of the firmware's Makefile."""
        return " ".join(f"-D{f.name.upper()}={getattr(self, f.name)!r}f" for f in fields(self))

    def suited_to(self, model: Model, share: float = 0.05) -> BoardConfig:
        """With the thermal model of an actuator's, taken too hot by ``share``; the hotter of two."""
        cool, values = 1 - share, model.values()

        def least(name: str) -> float:
            return min(v for k, v in values.items() if k.split("@")[0] == name)

        gain = max(v for k, v in values.items() if k.split("@")[0] == "joule_heating.gain")
        return replace(
            self,
            model_resistance_ohm=round(cool / gain, 6),
            model_conductance_W_per_K=round(cool * least("newton_cooling.conductance"), 6),
            model_thermal_mass_J_per_K=round(cool * least("newton_cooling.thermal_mass"), 6),
            model_ambient_C=round(float(model.ambient) - 273.15, 3),
        )


@dataclass(frozen=True)
class Parameter:
    """One number on the board; ``may`` says whether the host may set it freely or only lower or raise it."""

    index: int
    name: str
    low: float
    high: float
    may: May

    def accepts(self, value: float, now: float) -> bool:
        """Whether the board takes this value while it holds ``now``."""
        if not self.low <= value <= self.high:
            return False
        return not ((self.may == "lower" and value > now) or (self.may == "raise" and value < now))


_ROWS: tuple[tuple[str, float, float, May], ...] = (
    ("kp", -1e6, 1e6, "free"),
    ("ki", -1e6, 1e6, "free"),
    ("kd", -1e6, 1e6, "free"),
    ("n", 1e-3, 200.0, "free"),
    ("effort_limit", 0.0, float("nan"), "free"),  # supply squared
    ("position_scale", -1e6, 1e6, "free"),
    ("position_zero", -1e6, 1e6, "free"),
    ("position_source", 0.0, 2.0, "free"),
    ("max_temperature", 0.0, 1000.0, "lower"),
    ("max_energy", 0.0, 1e6, "lower"),
    ("sustained_power", 0.0, 1e6, "lower"),
    ("max_on", 0.0, 1e6, "lower"),
    ("max_current", 0.0, 1e6, "lower"),
    ("host_timeout", 0.05, 1e6, "lower"),
    ("model_resistance", 0.01, 1e6, "lower"),
    ("model_conductance", 1e-4, 1e6, "lower"),
    ("model_thermal_mass", 1e-2, 1e6, "lower"),
    ("model_ambient", -40.0, 1000.0, "raise"),
    ("channels", 1.0, 2.0, "free"),  # that a loop on the board drives
)
NAMES = tuple(row[0] for row in _ROWS)


def table(config: BoardConfig) -> tuple[tuple[Parameter, ...], list[float]]:
    """The parameters of a board and their values after a reset."""
    parameters = tuple(
        Parameter(i, name, low, config.supply_V**2 if name == "effort_limit" else high, may)
        for i, (name, low, high, may) in enumerate(_ROWS)
    )
    start = {
        "kp": 0.5,
        "ki": 0.12,
        "kd": 0.47,
        "n": 5.84,
        "effort_limit": config.supply_V**2,
        "position_scale": 0.0659824,
        "position_zero": 2046.0,
        "position_source": 0.0,
        "max_temperature": config.max_temperature_C,
        "max_energy": config.max_energy_J,
        "sustained_power": config.sustained_power_W,
        "max_on": config.max_on_s,
        "max_current": config.max_current_A,
        "host_timeout": config.host_timeout_s,
        "model_resistance": config.model_resistance_ohm,
        "model_conductance": config.model_conductance_W_per_K,
        "model_thermal_mass": config.model_thermal_mass_J_per_K,
        "model_ambient": config.model_ambient_C,
        "channels": 2.0,
    }
    return parameters, [single(start[name]) for name in NAMES]


def single(value: float) -> float:
    """Rounded to the board's single precision."""
    return struct.unpack("<f", struct.pack("<f", value))[0]


def to_bits(value: float) -> int:
    """The 32 bits of a number in single precision, as they go over the wire."""
    return struct.unpack("<I", struct.pack("<f", value))[0]


def from_bits(bits: int) -> float:
    """The number of 32 bits in single precision."""
    return struct.unpack("<f", struct.pack("<I", bits & 0xFFFFFFFF))[0]
