"""Drive profiles that a rig can play: its limits, standard excitations within them, and levels that can be moved."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from scpjax.errors import FitError
from scpjax.recordings import excitation
from scpjax.recordings.recording import Channel, Recording
from scpjax.units import Unit

_NODES = 600  # of the grid on which a profile is designed, at most
_LEVELS = 120
_FARTHER = 1.5  # times as far as it was seen to, may what is driven no farther be predicted to move
_ENDS = {"pwm": (0.0, 255.0)}  # by unit, of a drive that has any


@dataclass(frozen=True, kw_only=True)
class Limits:
    """What the rig allows; None: as in the present recordings.

    ``lowest``, ``highest`` drive in the SI unit of its column (V, W, A; counts of pwm; K); ``hottest`` [K] that any
    heated part, or the temperature that drives, may become, by every hypothesis; ``duration`` [s] (that of the longest
    recording); ``period`` [s] between samples; ``slew`` greatest change of the drive per second (None: it may jump).
    What is predicted to move stays `near` what was seen whatever they are.
    """

    lowest: float | None = None
    highest: float | None = None
    hottest: float | None = None
    duration: float | None = None
    period: float | None = None
    slew: float | None = None


@dataclass(frozen=True)
class Frame:
    """Limits put in, and the grids: ``count`` samples ``period`` apart, ``n`` nodes of ``every`` samples each."""

    low: float
    high: float
    period: float
    count: int
    every: int
    sides: int
    slew: float | None
    resolution: float  # of the drive, SI: what is written are whole multiples

    @property
    def n(self) -> int:
        return -(-self.count // self.every)

    @property
    def step(self) -> float:
        """Between nodes, s."""
        return self.period * self.every

    @property
    def coolest(self) -> float:
        """The drive that does least: 0, or what lies nearest."""
        return float(np.clip(0.0, self.low, self.high))

    @property
    def levels(self) -> int:
        """Levels of a profile, each held equally long."""
        return min(_LEVELS, self.n // 3)

    def spread(self, levels: Float[np.ndarray, "m sides"]) -> Float[np.ndarray, "n sides"]:
        """Levels as nodes."""
        return levels[self.slot]

    @property
    def slot(self) -> np.ndarray:
        """Which level each node (n,) belongs to."""
        return np.arange(self.n) * self.levels // self.n

    def gathered(self, nodes: Float[np.ndarray, "n sides"], mean: bool = False) -> Float[np.ndarray, "m sides"]:
        """Sum (or mean) of nodes by level."""
        total = np.zeros((self.levels, nodes.shape[1]))
        np.add.at(total, self.slot, nodes)
        return total / np.bincount(self.slot)[:, None] if mean else total

    def played(self, nodes: Float[np.ndarray, "n sides"]) -> Float[np.ndarray, "n sides"]:
        """What the rig makes of nodes: never faster than ``slew``."""
        return (
            nodes if self.slew is None else np.asarray(_followed(jnp.asarray(nodes), self._most(self.step), self.rest))
        )

    def played_slope(self, nodes: np.ndarray, by: Float[np.ndarray, "n sides"]) -> Float[np.ndarray, "n sides"]:
        """Derivative by the nodes of what is played, weighted ``by``."""
        if self.slew is None:
            return by
        return np.asarray(_followed_slope(jnp.asarray(nodes), self._most(self.step), self.rest, jnp.asarray(by)))

    def samples(self, nodes: Float[np.ndarray, "n sides"]) -> Float[np.ndarray, "count sides"]:
        """Every sample that is played, in whole multiples of the resolution and within all limits."""
        u = np.repeat(nodes, self.every, axis=0)[: self.count]
        if self.slew is not None:  # rounded towards where it came from
            u = np.asarray(_followed(jnp.asarray(u), self._most(self.period), self.rest))
        return self.samples_of(u)

    def samples_of(self, u: Float[np.ndarray, "count sides"]) -> Float[np.ndarray, "count sides"]:
        """Samples in whole multiples of the resolution, rounded towards the coolest drive."""
        away = (u - self.coolest) / self.resolution
        grid = self.coolest + np.sign(away) * np.floor(np.abs(away) + 1e-9) * self.resolution
        grid = np.round(grid / self.resolution) * self.resolution
        low, high = np.ceil(self.low / self.resolution - 1e-9), np.floor(self.high / self.resolution + 1e-9)
        grid = np.clip(grid, low * self.resolution, high * self.resolution)
        return grid if self.slew is None else self._held_to_slew(grid)

    def _held_to_slew(self, u: np.ndarray) -> np.ndarray:
        """Rounding may have made a change too fast: the same, in whole multiples no greater than the slew."""
        most = np.floor(self._most(self.period) / self.resolution + 1e-9) * self.resolution
        if most <= 0:
            raise FitError(
                f"a slew of {self.slew:g} per second is less than one step of the drive in a sample",
                mend="allow a faster slew, or sample more slowly",
            )
        out, last = u.copy(), np.full(u.shape[1], np.round(self.rest / self.resolution) * self.resolution)
        for i in range(len(u)):
            last = out[i] = last + np.clip(u[i] - last, -most, most)
        return out

    def _most(self, step: float) -> float:
        assert self.slew is not None
        return self.slew * step

    @property
    def rest(self) -> float:
        """The drive before the experiment."""
        return self.coolest


@eqx.filter_jit
def _followed(nodes: Array, most: float | Array, before: float | Array) -> Array:
    def follow(u: Array, wanted: Array) -> tuple[Array, Array]:
        u = u + jnp.clip(wanted - u, -most, most)
        return u, u

    return jax.lax.scan(follow, jnp.full(nodes.shape[1], before, nodes.dtype), nodes)[1]


@eqx.filter_jit
def _followed_slope(nodes: Array, most: float | Array, before: float | Array, by: Array) -> Array:
    return jax.vjp(lambda u: _followed(u, most, before), nodes)[1](by)[0]


def frame(
    limits: Limits,
    recordings: Sequence[Recording],
    channels: Sequence[Channel],
    finest: float = np.inf,
    *,
    most: float = np.inf,
) -> Frame:
    """Limits with what the recordings show where nothing is told, the drive no higher than ``most``; nodes at most
    ``finest`` [s] apart.

    **Raises** `FitError` for limits that leave no experiment.
    """
    _possible(limits, channels[0].unit)
    values = np.concatenate([r.inputs.ravel() for r in recordings])
    low = float(values.min()) if limits.lowest is None else limits.lowest
    high = min(float(values.max()) if limits.highest is None else limits.highest, most)
    period = float(np.median([r.period for r in recordings])) if limits.period is None else limits.period
    duration = max(r.duration for r in recordings) if limits.duration is None else limits.duration
    unit = channels[0].unit
    if not low < high:
        ends = f"{unit.from_si(low):g} to {unit.from_si(high):g} {unit.suffix}"
        higher = "give a higher greatest drive" if high < most else "allow a higher temperature"
        raise FitError(f"a drive from {ends} leaves nothing to choose", mend=higher)
    if not (period > 0 and duration >= 60 * period):
        raise FitError(
            f"{duration:g} s at a sample every {period:g} s is too short an experiment",
            mend=f"allow at least {60 * period:g} s",
        )
    if limits.slew is not None and not limits.slew > 0:
        raise FitError(f"a slew of {limits.slew:g}", mend="give a positive one, in units of the drive per second")
    count = int(np.floor(duration / period + 1e-6)) + 1
    every = max(1, min(-(-count // _NODES), round(finest / period) if np.isfinite(finest) else count))
    resolution = 1.0 if unit.suffix == "pwm" else 10.0 ** np.floor(np.log10(high - low)) / 1000
    return Frame(low, high, period, count, every, len(channels), limits.slew, resolution)


def _possible(limits: Limits, unit: Unit) -> None:
    """Whether limits are numbers, of a drive those that its unit has. **Raises** `FitError` where they are not."""
    names = {"lowest": "a least drive", "highest": "a greatest drive", "hottest": "a limit on temperature"}
    for key, value in vars(limits).items():
        if value is not None and not np.isfinite(value):
            raise FitError(f"{names.get(key, f'a {key}')} of {value:g}", mend="give a number, or leave it out")
    low, high = _ENDS.get(unit.suffix, (-np.inf, np.inf))
    for value in (limits.lowest, limits.highest):
        if value is not None and not low <= value <= high:
            raise FitError(
                f"a drive of {value:g} {unit.suffix} is outside {low:g} to {high:g}",
                mend="give one inside, in the unit of its column",
            )


def near(
    seen: Float[np.ndarray, "2 y"], rest: Float[np.ndarray, "2 y"], more: float, *, both_ways: bool = False
) -> Float[np.ndarray, "2 y"]:
    """(least, greatest) of outputs up to which a prediction is believed, and a rig is safe: half as far again as what
    was ``seen`` and what a ``rest`` shows, times how much ``more`` than then the limits allow. ``both_ways``: 0 is in
    the middle, as of a joint.
    """
    low, high = np.minimum(seen[0], rest[0]), np.maximum(seen[1], rest[1])
    if both_ways:
        high = np.maximum(np.abs(low), np.abs(high))
        low = -high
    further = (_FARTHER * max(more, 1.0) - 1.0) * (high - low)
    return np.stack([low - further, high + further])


def standards(f: Frame, response: float) -> dict[str, Float[np.ndarray, "n sides"]]:
    """Standard excitations (n, sides) over the whole range by name; ``response`` [s] is the slowest of the actuator.

    A joint gets each on its agonist, with the antagonist at rest and with it driven the opposite way.
    """
    at: dict[str, Any] = {"duration_s": f.n * f.step, "period_s": f.step}
    whole = f.n * f.step
    ends: dict[str, Any] = {"low": f.low, "high": f.high}
    span, rest = f.high - f.coolest, f.coolest
    slow = 2.0 / whole
    quick = min(max(1.0 / (4 * response), 3.0 / whole), 0.1 / f.step)
    hold = max(min(response, whole / 8), 2 * f.step)
    brief = max(hold / 5, 2 * f.step)
    middle, half = (f.high + f.low) / 2, (f.high - f.low) / 2
    made = {
        "step": excitation.step(**at, amplitude=span, offset=rest),
        "rest, then step": excitation.step(**at, amplitude=span, offset=rest, start_s=whole / 3),
        "step up and down": excitation.step_difference(
            **at, amplitude=span, offset=rest, up_s=whole / 10, down_s=whole * 0.55
        ),
        "stair": excitation.stair(**at, **ends),
        "triangle": excitation.triangle(**at, **ends, frequency_hz=slow),
        "sawtooth": excitation.sawtooth(**at, **ends, frequency_hz=2 * slow),
        "slow sine": excitation.sine(**at, amplitude=half, offset=middle, frequency_hz=slow, phase_rad=-np.pi / 2),
        "quick sine": excitation.sine(**at, amplitude=half, offset=middle, frequency_hz=quick, phase_rad=-np.pi / 2),
        "slow square": excitation.square(**at, **ends, frequency_hz=2 * slow),
        "quick square": excitation.square(**at, **ends, frequency_hz=quick),
        "multilevel": excitation.multilevel_random(**at, **ends, hold_s=hold),
        "brief multilevel": excitation.multilevel_random(**at, **ends, hold_s=brief, seed=1),
    }
    out: dict[str, np.ndarray] = {}
    for name, (_, u) in made.items():
        u = np.clip(np.asarray(u, float)[: f.n], f.low, f.high)
        if f.sides == 1:
            out[name] = u[:, None]
        else:
            out[name] = np.stack([u, np.full(f.n, rest)], axis=1)
            out[f"{name}, opposed"] = np.stack([u, f.high + f.low - u], axis=1)
    return out


def again(f: Frame, recording: Recording, order: Sequence[int]) -> Float[np.ndarray, "n sides"]:
    """The drive of a recording, from its start and over and over, at the nodes; ``order`` of its columns by side."""
    time = np.mod(f.step * np.arange(f.n), recording.duration + recording.period)
    left = np.clip(
        np.searchsorted(recording.time - recording.time[0], time + 1e-9, side="right") - 1, 0, recording.n - 1
    )
    return np.clip(recording.inputs[left][:, list(order)], f.low, f.high)
