"""A closure by what swings along: something carried on a spring of its own, that pulls back or whose place is read.

Where its period may lie is read off the misfit: what the displacement simulated would set swinging at each period, and
how fast, is taken out of it by least squares. The fit begins at those that take away most.
"""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np
from scipy import signal

from scpjax.diagnose.evidence import Evidence
from scpjax.diagnose.expression import of_base
from scpjax.diagnose.holdout import Split
from scpjax.diagnose.hypothesis import State, grown, moved
from scpjax.diagnose.learned import Found, fitted_beyond
from scpjax.diagnose.locate import observe
from scpjax.diagnose.patience import ENDLESS, WHAT_NO_NAME_EXPLAINS, Patience
from scpjax.diagnose.result import Closure, Drawn
from scpjax.fit.identifiability import Uncertainty
from scpjax.fit.result import Estimate
from scpjax.fit.solve import make_room
from scpjax.physics.catalogue import mechanism
from scpjax.physics.mechanisms.learned_mode import LearnedMode

_NAME = LearnedMode.name
_KEYS = tuple(f"{_NAME}.{p}" for p in ("stiffness", "share", "period", "damping"))
_PLACE = "learned_force mode"
_CYCLES, _BINS = 4.0, 4.0  # of a period, in the longest recording and of it in a bin, between which it is sought
_TRIED, _FINE = 3, 20  # periods at which a fit begins; tried for every factor of 2
_BROAD = 0.1  # damping with which they are tried
_POINTS = 121
_STEP = 1e-4  # relative, of a parameter, over which a slope is taken
_FACTOR = 3.0  # factor below and above the frequency, over which it is drawn


class Mode(Found):
    """A mode found."""


def carried_along(state: State, split: Split, rules: Evidence, patience: Patience = ENDLESS) -> Mode | None:
    """What swings along beyond ``state``; None where none is better than none, no displacement is recorded, or it is
    late by ``patience``.
    """
    s = state.setup.structure
    if s.system or not s.mechanical or patience.late(WHAT_NO_NAME_EXPLAINS):
        return None
    periods = likeliest_periods(state, split)
    if not periods:
        return None
    make_room()
    problem = grown(state.setup, mechanism(_NAME))
    value, laws = moved(state, problem)
    begun, at = [], problem.structure.index
    for period in periods:
        value = value.copy()
        value[at[f"{_NAME}.period"]] = period
        begun.append((value, laws))
    found = fitted_beyond(state, split, rules, problem, begun, _KEYS)
    return None if found is None else Mode(found.state, found.evidence)


def likeliest_periods(state: State, split: Split) -> list[float]:
    """Periods [s] of what would swing along, that take most away from the misfit of a hypothesis, best first; none
    where no displacement is recorded.
    """
    s = state.setup.structure
    column = next((i for i, stem in enumerate(s.outputs) if stem in ("displacement", "angle")), None)
    b = observe(state.setup, split.whole, state.trial, state.residual)
    if column is None or b.displacement is None or not (split.is_train & b.there)[..., column].any():
        return []
    rows = (split.is_train & b.there)[..., column]
    widths = np.asarray(split.whole.grids.step) * split.whole.bin  # s, of a bin of each recording
    spans = [w * (np.flatnonzero(there)[-1] + 1) for w, there in zip(widths, rows, strict=True) if there.any()]
    longest, shortest = max(spans) / _CYCLES, _BINS * float(widths.max())
    if longest <= shortest:
        return []
    periods = np.geomspace(shortest, longest, 2 + int(_FINE * np.log2(longest / shortest)))
    target, moves = state.residual[..., column][rows], _moves(b.displacement, rows)
    target = target - moves @ np.linalg.lstsq(moves, target, rcond=None)[0]
    taken = np.array([_taken(target, moves, b.displacement, widths, rows, p) for p in periods])
    padded = np.concatenate([[-np.inf], taken, [-np.inf]])
    peaks = np.flatnonzero((taken >= padded[:-2]) & (taken >= padded[2:]))
    return [float(periods[i]) for i in sorted(peaks, key=lambda i: -taken[i])[:_TRIED]]


def _moves(x: np.ndarray, rows: np.ndarray) -> np.ndarray:
    """What the base model's own parameters may well take up (rows, ...): a displacement, its rate, and a constant."""
    each = [np.ones_like(x), x, np.gradient(x, axis=1)]
    return np.stack([a[rows] for a in each], axis=-1)


def _taken(
    target: np.ndarray, moves: np.ndarray, x: np.ndarray, widths: np.ndarray, rows: np.ndarray, period: float
) -> float:
    """How much of the sum of squares of ``target`` goes with what swings along at a period, as it is and by its rate;
    both without what goes with ``moves``.
    """
    w = 2.0 * np.pi / period
    swings = np.zeros((*x.shape, 2))
    for i, width in enumerate(widths):
        b, a = signal.bilinear([-1.0, 0.0, 0.0], [1.0, 2.0 * _BROAD * w, w * w], fs=1.0 / width)  # q - x for x
        swings[i, :, 0] = signal.lfilter(b, a, x[i] - x[i, 0])
        swings[i, :, 1] = np.gradient(swings[i, :, 0])
    waves = swings[rows]
    waves = waves - moves @ np.linalg.lstsq(moves, waves, rcond=None)[0]
    fit = waves @ np.linalg.lstsq(waves, target, rcond=1e-9)[0]
    return float(fit @ fit)


def draw_mode(found: Mode, every: Mapping[str, Estimate], values: Mapping[str, float], doubt: Uncertainty) -> Closure:
    """The closure as an expression with units, and how far it swings for a load that does so at each frequency, with a
    95 % band; arguments as of `scpjax.diagnose.distil.draw`.
    """
    stiffness, share, period, damping = (every[key] for key in _KEYS)
    spring = of_base(values, "elastic_spring.stiffness")

    says = (
        f"force against contraction = ({_rounded(stiffness, spring)}) N/m (x - q + 2 z/w d(x - q)/dt), and what is "
        f"read is x + ({_rounded(share)}) (q - x), with q that follows x as a mass on a spring does: period 2 pi/w = "
        f"({_rounded(period)}) s, damping z = ({_rounded(damping)})"
    )
    frequency = np.geomspace(1.0 / _FACTOR, _FACTOR, _POINTS) / period.value
    at = [doubt.keys.index(key) for key in _KEYS[2:]]
    here, own = _amplification(frequency, period.value, damping.value), (period, damping)
    nearby = [(period.value * (1 + _STEP), damping.value), (period.value, damping.value * (1 + _STEP))]
    slopes = [
        (_amplification(frequency, *of) - here) / _STEP * e.std / e.value for of, e in zip(nearby, own, strict=True)
    ]
    together = doubt.covariance[np.ix_(at, at)] / np.outer(doubt.std_free[at], doubt.std_free[at])
    spread = np.sqrt(np.maximum(np.einsum("if,ij,jf->f", slopes, together, slopes), 0.0))
    return Closure(
        "thermomechanical",
        _PLACE,
        ("displacement", "history"),
        says,
        {key: every[key] for key in _KEYS},
        found.evidence.held_out_gain,
        found.evidence.delta_bic,
        Drawn("frequency", "Hz", "|q/x|", "1", frequency, here, spread, "", here, 0.0),
        in_a_sentence=(
            f"something that swings along, with a period of {_rounded(period)} s and a damping ratio of "
            f"{_rounded(damping)}"
        ),
    )


def _rounded(of: Estimate, factor: float = 1.0) -> str:
    """An estimate in a unit ``factor`` of its own, with one standard error."""
    error = f" ± {of.std * factor:.1g}" if np.isfinite(of.std) else ""
    return f"{of.value * factor:.3g}{error}"


def _amplification(frequency: np.ndarray, period: float, damping: float) -> np.ndarray:
    """Amplitude of q for an amplitude of 1 of x."""
    loss = 2.0 * damping * period
    return np.abs(signal.freqresp(([loss, 1.0], [period**2, loss, 1.0]), w=frequency)[1])
