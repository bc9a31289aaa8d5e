"""The balances with effects put in, integrated stretch by stretch with LSODA (scipy), never across a jump.

C_th dT/dt = V^2/R - lambda T + heats        [W]
m x''      = F(T) - S(x) - beta x' + forces  [N];  joint: (2 m + m_p/2) x'' = F_1 - F_2, x_2 = -x_1, angle = x/r
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from itertools import pairwise
from typing import Any

import numpy as np
from scipy.integrate import odeint

from fits.concealed.effect import Effect, Now, State
from fits.concealed.plants import Plant

Written = list[tuple[Any, int]]  # (hook, index of its effect)
SMALL = {"T": 1e-6, "x": 1e-10, "v": 1e-10, "own": 1e-9}  # absolute tolerance of each kind of state


class IntegrationError(RuntimeError):
    """LSODA gave up."""


class System:
    """Right-hand side and sensors of one plant with effects. State: T per side, then x and v, then own states."""

    def __init__(self, plant: Plant, effects: Sequence[Effect] = ()):
        self.plant, self.effects, self.sides = plant, tuple(effects), plant.sides
        self._start = self.sides + (2 if plant.moves else 0)
        self._places: list[list[slice]] = []  # [side][effect]
        at = self._start
        for _ in range(self.sides):
            row = []
            for e in self.effects:
                row.append(slice(at, at + e.states))
                at += e.states
            self._places.append(row)
        self.size = at
        for hook in _HOOKS:
            setattr(self, f"_{hook}", self._written(hook))
        self._with_states = [(e.rates, i) for i, e in enumerate(self.effects) if e.states]
        self._now = [Now() for _ in range(self.sides)]
        for i, now in enumerate(self._now):
            now.side = i

    _volts: Written
    _resistance: Written
    _capacity: Written
    _heat: Written
    _pulling: Written
    _pull: Written
    _stretch: Written
    _spring: Written
    _force: Written
    _sense_temperature: Written
    _sense_displacement: Written

    def _written(self, hook: str) -> Written:
        plain = getattr(Effect, hook)
        return [(getattr(e, hook), i) for i, e in enumerate(self.effects) if getattr(type(e), hook) is not plain]

    def rates(self, t: float, z: Sequence[float], volts: Sequence[float]) -> list[float]:
        """Time derivative of every state."""
        out = [0.0] * self.size
        z = list(map(float, z))
        owns = self._look(t, z, volts)
        net = 0.0
        for side in range(self.sides):
            now, own = self._now[side], owns[side]
            out[side] = now.dT = self._warming(now, volts[side], own)
            if self.plant.moves:
                force = self._pushing(now, own)
                net += force if side == 0 else -force
        if self.plant.moves:
            p = self.plant
            moving = p.mass if self.sides == 1 else 2 * p.mass + 0.5 * p.pulley_mass
            out[self.sides], out[self.sides + 1] = z[self.sides + 1], net / moving
        for side in range(self.sides):
            for rates, i in self._with_states:
                out[self._places[side][i]] = rates(self._now[side], owns[side][i])
        return out

    def _look(self, t: float, z: list[float], volts: Sequence[float]) -> list[list[State]]:
        owns = []
        for side in range(self.sides):
            now = self._now[side]
            now.t, now.u, now.T = t, volts[side], z[side]
            if self.sides == 2:
                now.other_T, now.other_u = z[1 - side], volts[1 - side]
            if self.plant.moves:
                sign = 1.0 if side == 0 else -1.0
                now.x, now.v = sign * z[self.sides], sign * z[self.sides + 1]
            owns.append([tuple(z[place]) for place in self._places[side]])
        return owns

    def _warming(self, now: Now, u: float, own: list[State]) -> float:
        p = self.plant
        for hook, i in self._volts:
            u = hook(now, u, own[i])
        ohm, capacity = p.resistance, p.thermal_mass
        for hook, i in self._resistance:
            ohm = hook(now, ohm, own[i])
        now.power = u * u / ohm
        watt = now.power - p.conductance * now.T
        for hook, i in self._heat:
            watt += hook(now, own[i])
        for hook, i in self._capacity:
            capacity = hook(now, capacity, own[i])
        return watt / capacity

    def _pushing(self, now: Now, own: list[State]) -> float:
        p, kelvin, metre = self.plant, now.T, now.x
        for hook, i in self._pulling:
            kelvin = hook(now, kelvin, own[i])
        newton = p.coefficient * kelvin
        for hook, i in self._pull:
            newton = hook(now, newton, own[i])
        for hook, i in self._stretch:
            metre = hook(now, metre, own[i])
        elastic = p.stiffness * metre
        for hook, i in self._spring:
            elastic = hook(now, elastic, metre, own[i])
        total = newton - elastic - p.damping * now.v
        for hook, i in self._force:
            total += hook(now, own[i])
        return total

    def read(self, t: float, z: Sequence[float], volts: Sequence[float]) -> list[float]:
        """What the sensors show: temperatures [K above room], then displacement [m]; no noise yet."""
        self.rates(t, z, volts)  # fills in what the hooks look at
        owns = [[tuple(z[place]) for place in row] for row in self._places]
        out = []
        for side in range(self.sides):
            value = z[side]
            for hook, i in self._sense_temperature:
                value = hook(self._now[side], value, owns[side][i])
            out.append(value)
        if self.plant.moves:
            value = z[self.sides]
            for hook, i in self._sense_displacement:
                value = hook(self._now[0], value, owns[0][i])
            out.append(value)
        return out

    def tolerance(self) -> np.ndarray:
        """Absolute tolerance (states,)."""
        out = np.full(self.size, SMALL["own"])
        out[: self.sides] = SMALL["T"]
        if self.plant.moves:
            out[self.sides], out[self.sides + 1] = SMALL["x"], SMALL["v"]
        return out


_HOOKS = (
    "volts", "resistance", "capacity", "heat", "pulling", "pull", "stretch", "spring", "force",
    "sense_temperature", "sense_displacement",
)  # fmt: skip


def simulate(
    plant: Plant,
    effects: Sequence[Effect],
    volts: np.ndarray,
    period: float,
    *,
    before: tuple[Sequence[float], float] = ((), 0.0),
) -> np.ndarray:
    """Readings (n, columns) at k * period under ``volts`` (n, sides), each held for a period.

    From rest; ``before`` = (volts per side, seconds) is what it was driven with until t = 0. Times given to laws are
    counted from the start of the recording, and stand still before it.
    """
    system = System(plant, effects)
    z = np.zeros(system.size)
    first = list(before[0]) or [0.0] * system.sides
    if before[1] > 0:
        z = _stretch(lambda y, _: system.rates(0.0, y, first), z, np.array([0.0, before[1]]), system)[-1]
    times = np.round(np.arange(len(volts)) * period, 9)
    late = sum(e.dead_time() for e in effects)
    told = np.vstack([first, volts])
    jumps = np.flatnonzero(np.any(np.diff(told, axis=0) != 0, axis=1))
    levels: dict[float, list[float]] = {round(j * period + late, 9): told[j + 1].tolist() for j in jumps.tolist()}
    end = float(times[-1])
    extra = [round(b, 9) for e in effects for b in e.breaks(end)]
    edges = sorted({0.0, end, *(t for t in (*levels, *extra) if 0 < t < end)})
    level: list[float] = levels[0.0] if 0.0 in levels else told[0].tolist()
    states, held = np.zeros((len(times), system.size)), [level]
    states[0] = z
    for a, b in pairwise(edges):
        if a in levels:
            level = levels[a]
        inside = np.flatnonzero((times > a + 1e-9) & (times <= b + 1e-9))
        before_end = times[inside][times[inside] < b - 1e-9]
        found = _stretch(lambda y, t, u=level: system.rates(t, y, u), z, np.array([a, *before_end, b]), system)
        states[inside] = found[1 : 1 + len(inside)]
        held += [level] * len(inside)
        z = found[-1]
    return np.array([system.read(t, s, u) for t, s, u in zip(times.tolist(), states.tolist(), held, strict=True)])


def _stretch(rates: Callable[..., list[float]], z: np.ndarray, at: np.ndarray, system: System) -> np.ndarray:
    found, info = odeint(
        rates, z, at, rtol=1e-8, atol=system.tolerance(), mxstep=50_000, tcrit=[at[-1]], full_output=True
    )
    if info["message"] != "Integration successful.":
        raise IntegrationError(info["message"])
    return found
