"""Does what is missing swing with a period of its own, whatever the drive does: a fan, a thermostat, the mains? Or
does it repeat with the displacement: a pulley out of round, an encoder, a gear?

In every balance and sensor a swing of two harmonics, with a phase and size for each recording, as it is or in
proportion to the temperature, is put through the base model, and what it takes away from the misfit is a periodogram:
Lomb-Scargle with harmonics (VanderPlas, Astrophys. J. Suppl. 236 (2018) 16, section 6), of outputs that respond.
What repeats with the displacement does so in the same phase in all recordings.
"""

from __future__ import annotations

import itertools
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from scipy.optimize import minimize_scalar

from scpjax.diagnose.latent import READING, Misfit, hats
from scpjax.diagnose.result import Latent

_HARMONICS = (1, 2)
_CYCLES = 4.0  # in a recording, from which it has a say
_SHARE = 0.7  # of the misfit beyond the noise, that a swing has to take away
_REPEATS = 0.5  # correlation of the drive with itself a period later, from which the drive may be what swings
_SAME = 0.05  # of a share, that half a period may lack and still be the period
_KNOTS = 200  # of a recording, between which an input is linear
_PLACES = 8  # of them in a period, at the least
_TURNS, _MOST_TURNS = 2.0, 40.0  # in the range of displacement, between which it may repeat
_QUICK = 0.9  # quantile of the steps between bins, within which a turn is resolved
_FINE = 4  # periods tried per cycle more or less in the longest recording
_NEARLY = 0.8  # of the share of the likeliest swing, with which another is nearly as likely
_ABLE = 0.5  # of what the best balance can answer for, that another must, for a swing to be looked for in it


@dataclass(frozen=True)
class Rhythm:
    """Where something swings (a balance, and a `scpjax.diagnose.result.Latent`'s place), its period, and its share of
    the misfit beyond the noise.
    """

    subsystem: str
    place: str
    factor: str  # "temperature" where it is in proportion to that, else ""
    period: float  # [s], or [m] where it repeats with the displacement
    share: float
    variable: str = "time"

    @property
    def says(self) -> str:
        """In a sentence."""
        if self.variable == "time":
            return f"What is missing swings with a period of {self.period:.3g} s, whatever the drive does."
        return f"What is missing repeats with every {1e3 * self.period:.3g} mm of displacement."


def rhythms(misfit: Misfit, lacking: Sequence[Latent]) -> list[Rhythm]:
    """The swings that take away enough, in balances and sensors that could answer for the misfit (`missing`), likeliest
    first, with those that are nearly as likely. A balance before a reading that is hardly better, and where no
    thermometer was a force before a heat that is, which has to swing the more, the quicker it does; of a joint both
    sides swing.
    """
    best = max(m.explained for m in lacking)
    places = dict.fromkeys((m.subsystem, _of_both(m.place)) for m in lacking if m.explained > _ABLE * best)
    found = [r for subsystem, place in places for r in _of(misfit, place, subsystem)]
    guessed = {"sensor"}
    if not any(place.startswith("temperature") for place in misfit.places):
        guessed |= {"thermoelectric", "drive"}
    share = {r: r.share * (READING if r.subsystem in guessed else 1.0) for r in found}
    return sorted((r for r in found if share[r] > _NEARLY * max(share.values())), key=lambda r: -share[r])


def ripple(misfit: Misfit, radius: float = 1.0) -> Rhythm | None:
    """What repeats with the displacement and takes away enough, in the reading or as a force; a reading, of which it is
    mostly an error, before a force that is hardly better. ``radius`` [m] of a pulley, where the displacement recorded
    is an angle.
    """
    moved, there = misfit.binned.displacement, np.any(misfit.binned.there, axis=2)
    if moved is None:
        return None
    span = float(np.ptp(moved[there]))
    steps = np.abs(np.diff(moved, axis=1))[there[:, 1:] & there[:, :-1]]
    most = min(span / max(_PLACES * float(np.quantile(steps, _QUICK)), 1e-300), _MOST_TURNS)
    turns = np.arange(_TURNS, most, 1.0 / _FINE)
    found = []
    for place in ("displacement reading", "angle reading", "force"):
        if place in misfit.places and len(turns):
            pitch, share = _best_pitch(misfit, place, moved, span, turns)
            if share > _SHARE:
                subsystem = misfit.places[place].subsystem
                found.append(Rhythm(subsystem, place, "", pitch * radius, share, "displacement"))
    return max(found, key=lambda r: r.share * (1.0 if r.subsystem == "sensor" else READING), default=None)


def _best_pitch(misfit: Misfit, place: str, moved: np.ndarray, span: float, turns: np.ndarray) -> tuple[float, float]:
    """(pitch, share of the misfit beyond the noise) of what repeats in a place; of two alike, of which one is half the
    other, the shorter.
    """
    target, each = misfit.target, 2 * len(_HARMONICS)
    beyond = max(float(target @ target) - len(target), 1e-300)

    def shares(counts: np.ndarray) -> np.ndarray:
        angles = 2.0 * np.pi / span * moved[..., None, None] * counts[:, None] * np.array(_HARMONICS)
        waves = np.concatenate([np.cos(angles), np.sin(angles)], axis=-1).reshape(*moved.shape, -1)
        felt = misfit.responses(place, list(waves))
        felt = felt.reshape(len(felt), len(moved), len(counts), each).sum(axis=1)  # one phase for all recordings
        taken = []
        for i in range(len(counts)):
            inner, outer = felt[:, i].T @ felt[:, i], felt[:, i].T @ target
            taken.append(float(outer @ np.linalg.lstsq(inner, outer, rcond=1e-9)[0]))
        return np.minimum(np.array(taken) / beyond, 1.0)

    def nearby(count: float) -> tuple[float, float]:
        share = 0.0
        for fine in (1.0, 0.1, 0.01):
            counts = np.maximum(count + fine / _FINE * np.arange(-1.0, 1.001, 0.1), 0.5 * _TURNS)
            found = shares(counts)
            count, share = float(counts[int(np.argmax(found))]), float(found.max())
        return count, share

    best = nearby(float(turns[int(np.argmax(shares(turns)))]))
    twice = nearby(2 * best[0])  # resolved, as the second harmonic of the best was
    count, share = twice if twice[1] > best[1] - _SAME else best
    return span / count, share


def _of_both(place: str) -> str:
    """A place on one side of a joint, without the side."""
    return place.replace("_antagonist", "").replace("_agonist", "")


def _of(misfit: Misfit, place: str, subsystem: str) -> list[Rhythm]:
    """The best swing in a place, as it is and in proportion to the temperature, where that is enough."""
    drive = subsystem == "drive"  # what is lacking there is in proportion to the drive as it is
    sides = [name for name in misfit.places if _of_both(name) == place]
    b, alike = misfit.binned, np.ones_like(misfit.binned.drive)
    factors = {"": [alike for _ in sides]}
    if b.temperature is not None and not drive:
        factors["temperature"] = [_unit(t) for name in sides if (t := b.on(name).temperature) is not None]
    out = []
    for name, factor in factors.items():
        best = _best(_Swing(misfit, dict(zip(sides, factor, strict=True))))
        if best[1] > _SHARE:
            out.append(Rhythm(subsystem, place, name, *best))
    return out


def _unit(x: np.ndarray) -> np.ndarray:
    """In units of its greatest."""
    return x / np.abs(x).max()


def _best(swing: _Swing) -> tuple[float, float]:
    """(period, share) of the swing that takes away most; of two alike, of which one is half the other, the shorter."""
    cycles = np.arange(_CYCLES, swing.longest / swing.shortest, 1.0 / _FINE)
    if not len(cycles):
        return 0.0, 0.0
    most = float(cycles[int(np.argmax([swing.share(swing.longest / c) for c in cycles]))])

    def nearby(period: float) -> tuple[float, float]:
        within = period**2 / swing.longest / _FINE  # one step of the cycles tried
        bounds = (max(period - within, swing.shortest), period + within)
        found: Any = minimize_scalar(lambda p: -swing.share(p), bounds=bounds, method="bounded")
        return max(((p, swing.share(p)) for p in (period, float(found.x))), key=lambda f: f[1])

    best = nearby(swing.longest / most)
    half = nearby(best[0] / 2) if best[0] / 2 > swing.shortest else (0.0, 0.0)
    return half if half[1] > best[1] - _SAME else best


class _Swing:
    """What swings of any period take away from the misfit, in some places at once, in proportion to a factor (r, k) of
    each.
    """

    def __init__(self, misfit: Misfit, places: Mapping[str, np.ndarray]):
        b = misfit.binned
        there = np.asarray(np.any(b.there, axis=2))
        self._misfit, self._recording = misfit, np.nonzero(b.there)[0]
        self._spans = np.array([w * (np.flatnonzero(there[i])[-1] + 1) for i, w in enumerate(misfit.widths)])
        bins = int(b.there.shape[1])
        gap = max(bins // _KNOTS, 1)
        knots = -(-bins // gap) + 1
        self._knots = [np.arange(knots) * gap * width for width in misfit.widths]
        felt = [misfit.responses(p, [hats(bins, gap, knots) * f[:, None] for f in each]) for p, each in places.items()]
        self._response = np.concatenate(felt, axis=1)
        self._sides = len(places)
        self.longest = float(self._spans.max())
        self.shortest = _PLACES * max(float(k[1]) for k in self._knots)  # s, that the knots resolve
        self._grams: dict[tuple[int, ...], tuple[np.ndarray, np.ndarray, float, int]] = {}

    def share(self, period: float) -> float:
        """Of the misfit beyond the noise, in recordings that have a say."""
        lasting = [i for i, span in enumerate(self._spans) if span >= _CYCLES * period]
        own = tuple(i for i in lasting if self._repeats(i, period) < _REPEATS)
        if not own:
            return 0.0
        gram, along, total, rows = self._gram(own)
        n = len(self._knots[0])
        swing = np.zeros((gram.shape[0], 2 * len(_HARMONICS) * len(own) * self._sides))
        for j, (side, i) in enumerate(itertools.product(range(self._sides), own)):
            angles = np.outer(2.0 * np.pi * self._knots[i] / period, _HARMONICS)
            waves = np.concatenate([np.cos(angles), np.sin(angles)], axis=1)
            row, column = n * (side * len(self._knots) + i), waves.shape[1] * j
            swing[row : row + n, column : column + waves.shape[1]] = waves
        inner, outer = swing.T @ gram @ swing, swing.T @ along
        taken = float(outer @ np.linalg.lstsq(inner, outer, rcond=1e-9)[0])
        return min(taken / max(total - rows, 1e-300), 1.0)

    def _gram(self, own: tuple[int, ...]) -> tuple[np.ndarray, np.ndarray, float, int]:
        """(products of the responses, with the misfit, of the misfit, readings) over some recordings."""
        if own not in self._grams:
            rows = np.isin(self._recording, own)
            g, target = self._response[rows], self._misfit.target[rows]
            self._grams[own] = g.T @ g, g.T @ target, float(target @ target), len(target)
        return self._grams[own]

    def _repeats(self, i: int, period: float) -> float:
        """Correlation of the drive of a recording with itself a period later; of a joint that of the side with more."""
        b, found = self._misfit.binned, [0.0]
        time = b.time[i] - b.time[i, 0]
        now = time[time <= self._spans[i] - period]
        for drive in [own[1] for own in b.sides.values()] or [b.drive]:
            before, later = np.interp(now, time, drive[i]), np.interp(now + period, time, drive[i])
            if np.ptp(before) > 0.0 and np.ptp(later) > 0.0:
                found.append(float(np.corrcoef(before, later)[0, 1]))
        return max(found)
