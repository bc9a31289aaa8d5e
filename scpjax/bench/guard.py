"""What the emulated board lets no command do: ``rig/firmware/safety.cpp`` in Python."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, field

from scpjax.bench import messages as m
from scpjax.bench.parameters import NAMES, TICK_S, BoardConfig, table

CHANNELS = 2
HANG_S = 0.3
"""That a reset by the watchdog may have cost."""

_AT = {name: i for i, name in enumerate(NAMES)}
_FULL = 4 * 1024
_OPEN, _SHORTED = 4 * 3, 4 * 1020
_PATIENCE = 4
_RECOVERED, _RECOVERED_K = 0.5, 10.0


@dataclass
class Inputs:
    """What the board reads in a tick: sums of four conversions at A0 to A5, the echo [0.5 us] and the encoder."""

    sums: Sequence[int] = (0, 0, 0, 0, 0, 0)
    echo: int = 0
    encoder: int = 0


@dataclass
class Memory:
    """What survives a reset: temperatures [degC], energies [J] and times on [s] of both channels."""

    temperature: list[float]
    energy: list[float] = field(default_factory=lambda: [0.0, 0.0])
    on: list[float] = field(default_factory=lambda: [0.0, 0.0])
    driven: list[int] = field(default_factory=lambda: [0, 0])


class Guard:
    """Parameters, limits and what each actuator has had. ``counts`` are to be driven from the next tick on: they are
    charged first, so that nothing that comes later can take it back."""

    def __init__(self, config: BoardConfig):
        self.config = config
        self.parameters, self._start = table(config)
        self.memory: Memory | None = None
        self.inputs = Inputs()
        self._forget()

    def _forget(self) -> None:
        """What a reset forgets."""
        self.values = list(self._start)
        self.counts = [0, 0]
        self.fitted = 0
        self.hot_for, self.lost_for, self.current_for = [0, 0], [0, 0], 0
        self._find_threshold()

    def _remember(self) -> None:
        """What a reset brings back: no reset makes an actuator cold."""
        self._look_for_sensors()
        if self.memory is None:
            ambient = self._get("model_ambient")
            self.memory = Memory([ambient, ambient])
        else:
            for c in range(CHANNELS):
                if self.memory.driven[c]:
                    self._heat(c, self.memory.driven[c], HANG_S)
        for c in range(CHANNELS):
            if self.fitted >> c & 1:
                self.memory.temperature[c] = max(self.memory.temperature[c], self._read_temperature(c))
        self.memory.driven = [0, 0]

    @property
    def _memory(self) -> Memory:
        assert self.memory is not None
        return self.memory

    def _get(self, name: str) -> float:
        return self.values[_AT[name]]

    def _power(self, count: int) -> float:
        return count / 255 * self.config.supply_V**2 / self._get("model_resistance")

    def _heat(self, c: int, count: int, dt: float) -> None:
        mem, p = self._memory, self._power(count)
        lost = self._get("model_conductance") * (mem.temperature[c] - self._get("model_ambient"))
        mem.temperature[c] += dt * (p - lost) / self._get("model_thermal_mass")
        mem.energy[c] = max(0.0, mem.energy[c] + dt * (p - self._get("sustained_power")))
        mem.on[c] = max(0.0, mem.on[c] + (dt if count else -dt))

    @property
    def cut_out(self) -> float:
        """Temperature [degC] at which the power is cut."""
        return self._get("max_temperature") - self.config.margin_K

    def _find_threshold(self) -> None:
        c = self.config
        inverse = 1 / (self.cut_out + 273.15) - 1 / 298.15
        r = c.ntc_nominal_ohm * math.exp(c.ntc_beta_K * inverse)
        self.hot_sum = int(_FULL * c.ntc_fixed_ohm / (c.ntc_fixed_ohm + r))

    def _read_temperature(self, c: int) -> float:
        share = (self.inputs.sums[c] + 2.0) / _FULL
        r = self.config.ntc_fixed_ohm * (1 / share - 1)
        return 1 / (1 / 298.15 + math.log(r / self.config.ntc_nominal_ohm) / self.config.ntc_beta_K) - 273.15

    def _plausible(self, c: int) -> bool:
        return _OPEN <= self.inputs.sums[c] <= _SHORTED

    def _look_for_sensors(self) -> None:
        for c in range(CHANNELS):
            self.fitted |= self._plausible(c) << c

    def _charge(self) -> None:
        """Charge what is about to be driven in this tick, and look at every sensor."""
        mem = self._memory
        for c in range(CHANNELS):
            self._heat(c, self.counts[c], TICK_S)
            mem.driven[c] = self.counts[c]
            seen = self.fitted >> c & 1
            hot = seen and self.inputs.sums[c] >= self.hot_sum
            lost = seen and not self._plausible(c)
            self.hot_for[c] = min(self.hot_for[c] + 1, _PATIENCE) if hot else 0
            self.lost_for[c] = min(self.lost_for[c] + 1, _PATIENCE) if lost else 0
        amperes = (self.inputs.sums[3] + 2.0) / _FULL * 5.0 / self.config.current_V_per_A
        self.current_for = min(self.current_for + 1, _PATIENCE) if amperes > self._get("max_current") else 0

    def _met(self) -> tuple[int, int]:
        mem = self._memory
        for c in range(CHANNELS):
            if mem.temperature[c] >= self.cut_out:
                return m.HOT_BY_MODEL, c
            if self.hot_for[c] >= _PATIENCE:
                return m.HOT_BY_SENSOR, c
            if self.lost_for[c] >= _PATIENCE:
                return m.SENSOR_LOST, c
            if mem.energy[c] >= self._get("max_energy"):
                return m.OVER_ENERGY, c
            if mem.on[c] >= self._get("max_on"):
                return m.ON_TOO_LONG, c
        return (m.OVER_CURRENT if self.current_for >= _PATIENCE else m.NO_FAULT), 0

    def _may_clear(self) -> bool:
        mem = self._memory
        for c in range(CHANNELS):
            if mem.temperature[c] > self.cut_out - _RECOVERED_K or self.hot_for[c] or self.lost_for[c]:
                return False
            if mem.energy[c] > _RECOVERED * self._get("max_energy") or mem.on[c] > _RECOVERED * self._get("max_on"):
                return False
        return self.current_for == 0

    def _may_hang(self) -> bool:
        mem, joules = self._memory, HANG_S * self._power(255)
        for c in range(CHANNELS):
            if mem.temperature[c] + joules / self._get("model_thermal_mass") >= self.cut_out or self.hot_for[c]:
                return False
            if mem.energy[c] + joules >= self._get("max_energy") or mem.on[c] + HANG_S >= self._get("max_on"):
                return False
        return True
