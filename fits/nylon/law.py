"""The strain of drawn nylon as a law of the temperature, without time, and its fit to recordings of several moistures.

    strain = s0 + a (T' - 25 degC) + b f(T' - Tg),    T' what the fibre feels

f is a rounded corner of width W, a square (x^2/20 K beyond Tg), or an exponential of width W (about 55 degC). On the
way back T' stays until the oven is 2 w colder (a play of half-width w in temperature), or the strain stays until it
would have fallen by 2 h (a play in strain).
Plays are exact: Visintin, Differential Models of Hysteresis (1994), ch. III.
"""

from __future__ import annotations

import itertools
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy.optimize import least_squares

from scpjax.recordings.recording import Recording

NAMES = ("zero", "slope", "growth", "transition", "width", "loop")
"""s0 [pct], a [pct/K], b [pct/K], Tg [degC], W [K], and w [K] or h [pct]."""
CURVES = ("none", "corner", "bend", "exponential")
LOOPS = ("none", "temperature", "strain")
_START = np.array([0.0, 1e-3, 0.01, 55.0, 10.0, 2.0])
_LOW = np.array([-0.2, -0.02, 0.0, -20.0, 0.5, 0.0])
_HIGH = np.array([0.2, 0.05, 0.5, 110.0, 60.0, 20.0])


@dataclass(frozen=True)
class Sample:
    """A recording: temperature [degC] and strain [pct], (n,) in the order in which they were taken."""

    name: str
    temperature: np.ndarray
    strain: np.ndarray


def sample(recording: Recording) -> Sample:
    """Columns of a recording in the units of the file."""
    return Sample(recording.metadata.name, recording.inputs[:, 0] - 273.15, np.asarray(recording.outputs[:, 0]))


def play(x: np.ndarray, half_width: float) -> np.ndarray:
    """What follows x (n,) only when it is more than ``half_width`` away, from where x begins."""
    out, now = np.empty_like(x), x[0]
    for i, value in enumerate(x):
        now = min(max(now, value - half_width), value + half_width)
        out[i] = now
    return out


def strain(p: np.ndarray, temperature: np.ndarray, curve: str, loop: str) -> np.ndarray:
    """The law's strain [pct] for parameters in the order of NAMES."""
    zero, slope, growth, transition, width, size = p
    felt = play(temperature, size) if loop == "temperature" else temperature
    past = felt - transition
    if curve == "corner":
        more = 0.5 * (past + np.sqrt(past**2 + width**2))
    elif curve == "bend":
        more = np.maximum(past, 0.0) ** 2 / 20.0
    elif curve == "exponential":
        more = width * np.exp(np.minimum((felt - 55.0) / width, 50.0))
    else:
        more = np.zeros_like(past)
    out = zero + slope * (felt - 25.0) + growth * more
    return play(out, size) if loop == "strain" else out


def moves(curve: str, loop: str) -> tuple[str, ...]:
    """Parameters that a law has."""
    names = ["zero", "slope"]
    names += {"none": [], "bend": ["growth", "transition"], "exponential": ["growth", "width"]}.get(
        curve, ["growth", "transition", "width"]
    )
    return tuple(names + (["loop"] if loop != "none" else []))


@dataclass(frozen=True)
class Fitted:
    """A law fitted to one recording; ``n`` counts independent samples (what is left over is coloured)."""

    curve: str
    loop: str
    values: dict[str, float]
    std: dict[str, float]
    rmse: float
    bic: float
    n: float
    left_out: float  # RMS error [pct] of stretches of 8 samples left out of the fit


def _scale(loop: str, s: Sample) -> np.ndarray:
    """Start of every parameter for a recording."""
    start = _START.copy()
    start[2] = 0.02 * np.ptp(s.strain) + 1e-4
    start[5] = 2.0 if loop == "temperature" else 0.05 * np.ptp(s.strain)
    return start


def _least(s: Sample, curve: str, loop: str, keep: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """(parameters, residuals at all samples, Jacobian at those kept) of the best of several starts."""
    which = np.array([name in moves(curve, loop) for name in NAMES])
    best = None
    for transition, width in itertools.product((35.0, 55.0, 75.0), (5.0, 20.0)):
        begin = _scale(loop, s)
        begin[3], begin[4] = transition, width

        def miss(x: np.ndarray, begin: np.ndarray = begin) -> np.ndarray:
            p = begin.copy()
            p[which] = x
            return strain(p, s.temperature, curve, loop) - s.strain

        unit = np.maximum(np.abs(begin[which]), 1e-3)
        found = least_squares(
            lambda x, miss=miss: miss(x)[keep], begin[which], bounds=(_LOW[which], _HIGH[which]), x_scale=unit
        )
        if best is None or found.cost < best[0]:
            p = begin.copy()
            p[which] = found.x
            best = (found.cost, p, miss(found.x), found.jac)
        if curve == "none":
            break
    assert best is not None
    return best[1], best[2], best[3]


def independent(residual: np.ndarray) -> float:
    """Number of independent samples among coloured ones: n (1 - r)/(1 + r), r the first autocorrelation."""
    r = float(residual[1:] @ residual[:-1] / (residual @ residual))
    return len(residual) * (1 - max(r, 0.0)) / (1 + max(r, 0.0))


def compare(s: Sample) -> list[Fitted]:
    """All laws fitted to a recording, best BIC first; all count with the independent samples of the closest."""
    laws = list(itertools.product(CURVES, LOOPS))
    left = [_least(s, *law, np.ones(len(s.strain), bool))[1] for law in laws]
    n = independent(min(left, key=lambda r: float(r @ r)))
    return sorted((fit(s, *law, n=n) for law in laws), key=lambda f: f.bic)


def fit(s: Sample, curve: str, loop: str, *, n: float | None = None) -> Fitted:
    """A law fitted to a recording, with errors that count the colour of what is left over (``n`` when given)."""
    p, left, jacobian = _least(s, curve, loop, np.ones(len(s.strain), bool))
    names, n = moves(curve, loop), independent(left) if n is None else n
    which = [NAMES.index(name) for name in names]
    # the information of n samples, not of all: J'J n/len, and a variance that n samples leave
    variance = np.mean(left**2) * n / max(n - len(which), 1.0)
    covariance = np.linalg.pinv(jacobian.T @ jacobian * n / len(left)) * variance
    std = dict(zip(names, map(float, np.sqrt(np.diag(covariance))), strict=True))
    if "transition" in std and p[NAMES.index("transition")] < s.temperature.min() + 1.0:
        std["transition"] = float("inf")  # below what was recorded, wherever it is
    held = []
    for start in range(0, len(left), 24):
        out = (np.arange(len(left)) >= start) & (np.arange(len(left)) < start + 8)
        held.append(_least(s, curve, loop, ~out)[1][out])
    rms = lambda e: float(np.sqrt(np.mean(e**2)))  # noqa: E731
    return Fitted(
        curve,
        loop,
        {k: float(p[i]) for k, i in zip(names, which, strict=True)},
        std,
        rms(left),
        float(n * np.log(np.mean(left**2)) + len(names) * np.log(n)),
        n,
        rms(np.concatenate(held)),
    )


@dataclass(frozen=True)
class Shared:
    """One law for several recordings of which some parameters ``differ``; BIC over that of all parameters differing."""

    differ: tuple[str, ...]
    delta_bic: float
    rmse: dict[str, float]


def shared(samples: Sequence[Sample], curve: str, loop: str) -> list[Shared]:
    """All choices of which parameters differ between recordings (the zero always may), best first.

    Every recording is weighted by what the law leaves over when all its parameters are its own, and counts with its
    number of independent samples.
    """
    names = [n for n in moves(curve, loop) if n != "zero"]
    own = [_least(s, curve, loop, np.ones(len(s.strain), bool)) for s in samples]
    weight = [np.sqrt(independent(r) / len(r)) / np.sqrt(np.mean(r**2)) for _, r, _ in own]
    n = sum(independent(r) for _, r, _ in own)
    out = []
    for k in range(len(names) + 1):
        for differ in itertools.combinations(names, k):
            p = _together(samples, curve, loop, differ, [v for v, _, _ in own], weight)
            left = [strain(q, s.temperature, curve, loop) - s.strain for q, s in zip(p, samples, strict=True)]
            chi = sum(float((w * r) @ (w * r)) for w, r in zip(weight, left, strict=True))
            free = len(samples) * (1 + k) + len(names) - k
            rmse = {s.name: float(np.sqrt(np.mean(r**2))) for s, r in zip(samples, left, strict=True)}
            out.append((chi + free * np.log(n), Shared(differ, 0.0, rmse)))
    full = next(b for b, s in out if len(s.differ) == len(names))
    return [Shared(s.differ, float(b - full), s.rmse) for b, s in sorted(out, key=lambda pair: pair[0])]


def _together(
    samples: Sequence[Sample],
    curve: str,
    loop: str,
    differ: Sequence[str],
    own: Sequence[np.ndarray],
    weight: Sequence[float],
) -> list[np.ndarray]:
    """Parameters of every recording, those that may differ each of its own."""
    names = moves(curve, loop)
    each = [NAMES.index(n) for n in names if n == "zero" or n in differ]
    same = [NAMES.index(n) for n in names if n != "zero" and n not in differ]

    def spread(x: np.ndarray) -> list[np.ndarray]:
        out = []
        for i, mine in enumerate(own):
            p = mine.copy()
            p[same] = x[: len(same)]
            p[each] = x[len(same) + i * len(each) :][: len(each)]
            out.append(p)
        return out

    def miss(x: np.ndarray) -> np.ndarray:
        parts = zip(spread(x), samples, weight, strict=True)
        return np.concatenate([w * (strain(p, s.temperature, curve, loop) - s.strain) for p, s, w in parts])

    low, high = (np.concatenate([v[same], *[v[each]] * len(own)]) for v in (_LOW, _HIGH))
    best = None
    for middle in (np.median(own, axis=0), *own):
        start = np.concatenate([middle[same], *(p[each] for p in own)])
        start = np.clip(start, low + 1e-6 * (high - low), high - 1e-6 * (high - low))
        found = least_squares(miss, start, bounds=(low, high), x_scale=np.maximum(np.abs(start), 1e-3))
        if best is None or found.cost < best.cost:
            best = found
    assert best is not None
    return spread(best.x)


def at(s: Sample, celsius: float) -> tuple[float, float]:
    """(strain on the way up, strain on the way down) [pct] at a temperature, between samples."""
    top = int(np.argmax(s.temperature))
    up, down = slice(0, top + 1), slice(top, None)
    return (
        float(np.interp(celsius, s.temperature[up], s.strain[up])),
        float(np.interp(celsius, s.temperature[down][::-1], s.strain[down][::-1])),
    )
