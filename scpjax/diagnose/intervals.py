"""Confidence intervals of what was named, by profile likelihood where the Jacobian does not tell them.

Of a threshold that lies between two levels of the drive, or of a law of which one number stands in for another, the
curvature at the best fit says little. So the ends of every interval from the Jacobian are looked at first: where the
sum of squares has not risen as it says, the parameter is held there and beyond and everything else fitted again, until
it has (Venzon, Moolgavkar, Appl. Statist. 37 (1988) 87; Bates, Watts, Nonlinear Regression Analysis (1988), ch. 6).
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace

import equinox as eqx
import numpy as np

from scpjax.diagnose.patience import ENDLESS, Patience
from scpjax.fit.data import Data
from scpjax.fit.identifiability import Uncertainty
from scpjax.fit.problem import Space, Trial
from scpjax.fit.result import Estimate
from scpjax.fit.setup import Setup
from scpjax.fit.solve import Solution, solve, stack

_NORMAL = 1.96  # standard errors of a 95 % interval: the root of the rise of the sum of squares at its ends
_AGREES = (1.4, 2.8)  # between which that root may be at the end that the Jacobian told
_CLOSE = 0.2  # to _NORMAL, from which an end is found
_JUMP = 3.0  # root beyond which the rise is one of a step, and the end lies before it
_ROUNDS, _STEPS = 8, 16  # values tried for an end; steps of a fit at each
_FARTHEST = 3.0  # times as far as the last value, that the next one may be
_ASTRAY = 10.0  # root beyond which the Jacobian does not tell where everything else then is
_NARROW = 0.03  # of its distance from the best fit, to which an end is enclosed
_EDGE = 0.99  # of the way to the end of a parameter's bounds, as far as it is held
_TOLERANCE = 0.05  # half the fall of the sum of squares in one step with which a fit has come to rest


@dataclass
class _End:
    """One end of an interval that is sought: of the entry ``entry``, on the ``side`` (-1, 1) of where it is best."""

    entry: int
    side: int
    best: float  # the entry where all is best; here and below unconstrained, as `scpjax.parameter.Bounded` has it
    edge: float  # as far as it is held
    at: float  # where it is held next
    free: np.ndarray  # everything, from where it is fitted next: as it was where the entry was held farthest within
    inside: tuple[float, float] = (0.0, 0.0)  # (distance from the best, root of the rise) that are within, farthest
    outside: tuple[float, float] | None = None
    done: bool = False
    tried: list[float] = field(default_factory=list)

    def learn(self, root: float, ended: np.ndarray) -> None:
        """From the root of the rise where it was held, and where everything then was; says where it is held next, or
        that it is found.
        """
        far = abs(self.at - self.best)
        self.tried.append(far)
        if root < _NORMAL:
            if far > self.inside[0]:
                self.inside, self.free = (far, root), ended
        elif far > self.inside[0]:  # what is nearer than one that is within is no end
            self.outside = (far, root)
        beyond = root < _NORMAL and far >= abs(self.edge - self.best) * (1.0 - 1e-9)
        if abs(root - _NORMAL) < _CLOSE or beyond or len(self.tried) == _ROUNDS:
            self.done = True
            return
        (low, little), high = self.inside, self.outside
        if high is None:
            next_ = far * float(np.clip(_NORMAL / max(root, 1e-3), 1.2, _FARTHEST))
        elif high[0] - low < _NARROW * high[0]:
            self.done = True
            return
        else:
            share = (_NORMAL - little) / max(high[1] - little, 1e-9)
            next_ = low + (high[0] - low) * float(np.clip(share, 0.2, 0.8))
        self.at = self.best + self.side * min(next_, abs(self.edge - self.best))
        self.free = self.free.copy()
        self.free[self.entry] = self.at

    @property
    def found(self) -> float | None:
        """Where it ends; None where the sum of squares never rose enough, within its bounds or as far as was tried."""
        if self.outside is None:
            near = abs(self.inside[1] - _NORMAL) < _CLOSE
            return self.best + self.side * self.inside[0] * _NORMAL / self.inside[1] if near else None
        (low, little), (high, much) = self.inside, self.outside
        if much > _JUMP:
            return self.best + self.side * high
        share = (_NORMAL - little) / max(much - little, 1e-9)
        return self.best + self.side * (low + share * (high - low))


class _Profiles:
    """A fit that has come to rest, of which some entries are held elsewhere."""

    def __init__(self, setup: Setup, trial: Trial, data: Data, doubt: Uncertainty):
        self._setup, self._trial, self._data = setup, trial, data
        self._space: Space = setup.space
        self._scale = doubt.variance * doubt.inflation
        # an idle place in that of a recording's own value is one more that all recordings depend on
        self._lanes = int(np.shape(trial.lanes)[1]) + bool(setup.structure.own)
        self.least = self._worth(trial, solve(stack([trial]), data, self._space, max_steps=1), 0)

    def _worth(self, trial: Trial, found: Solution, i: int) -> float:
        """Sum of squares where a trial ended, in units in which it rises by 1 for one standard error; of the priors of
        what `trial` holds too.
        """
        data, space = np.asarray(found.residual[i])[: self._data.target.size], self._space
        inner = np.asarray(space.bounds.to_inner(np.asarray(found.free[i])[:-1]))
        spread, active = np.asarray(space.prior_spread), np.asarray(self._trial.active)
        there = active & np.isfinite(spread)
        priors = (inner - np.asarray(space.prior_mean))[there] / spread[there]
        return float(data @ data) / self._scale + float(priors @ priors)

    def held(self, entry: int, free: np.ndarray) -> Trial:
        """The trial from ``free``, with one of its entries held there."""
        space = self._space
        values = np.asarray(space.bounds.to_value(free[:-1]))
        fixed, active = np.asarray(self._trial.fixed).copy(), np.asarray(self._trial.active).copy()
        fixed[entry], active[entry] = values[entry], False
        everything = np.array(space.values(self._trial.free, self._trial.fixed, self._trial.active))
        everything = np.where(active, values, everything)
        width, laws = len(self._trial.index), np.asarray(self._trial.laws)
        made = replace(self._setup, fixed=fixed).trial(everything, active, laws, width, self._lanes)
        return eqx.tree_at(lambda t: t.free, made, free.copy())

    def rises(self, trials: Sequence[Trial], steps: int) -> tuple[np.ndarray, np.ndarray]:
        """(root of the rise of the sum of squares, free vectors) where trials end after some steps."""
        found = solve(stack(trials), self._data, self._space, max_steps=steps, tolerance=_TOLERANCE)
        worth = np.array([self._worth(t, found, i) for i, t in enumerate(trials)])
        worth = np.where(np.isfinite(worth), worth, np.inf)
        self.least = min(self.least, float(worth.min()))
        return np.sqrt(np.maximum(worth - self.least, 0.0)), np.asarray(found.free)


def profiled(
    setup: Setup,
    trial: Trial,
    data: Data,
    doubt: Uncertainty,
    every: Mapping[str, Estimate],
    patience: Patience = ENDLESS,
) -> dict[str, Estimate]:
    """Estimates with the intervals of everything named in the model by profile likelihood where they differ from those
    of the Jacobian (``doubt``), of a trial that has come to rest on ``data``; an end that is never reached is that of
    its bounds. Late by ``patience`` none is sought, and one that was not found by then stays as it was.
    """
    named = {m.name for m in setup.structure.mechanisms if not (m.is_base or m.learned)}
    slots = [s for s in setup.structure.slots if s.mechanism in named and s.key in every]
    if not slots or patience.late("intervals by profile likelihood"):
        return dict(every)
    profiles = _Profiles(setup, trial, data, doubt)
    ends = [end for s in slots for end in _ends(s.index, s.key, trial, doubt, setup.space, every[s.key])]
    roots, _ = profiles.rises([profiles.held(e.entry, e.free) for e in ends], 1)
    for e, root in zip(ends, roots, strict=True):
        if not root < _ASTRAY:
            e.free = np.where(np.arange(len(e.free)) == e.entry, e.at, np.asarray(trial.free))
    sought = [e for e, root in zip(ends, roots, strict=True) if not _AGREES[0] < root < _AGREES[1]]
    while sought and not patience.late("intervals by profile likelihood"):
        roots, free = profiles.rises([profiles.held(e.entry, e.free) for e in sought], _STEPS)
        for e, root, ended in zip(sought, roots, free, strict=True):
            e.learn(float(root), ended)
        sought = [e for e in sought if not e.done]
    out, space = dict(every), setup.space
    for s in slots:
        mine = [e for e in ends if e.entry == s.index and e.done]
        if mine:
            out[s.key] = _with(every[s.key], mine, space)
    return out


def _ends(entry: int, key: str, trial: Trial, doubt: Uncertainty, space: Space, estimate: Estimate) -> list[_End]:
    """Both ends of an interval from the Jacobian, with everything else where it then is by it."""
    bounds, best = space.bounds, np.asarray(trial.free)
    half = float(np.asarray(bounds.half)[entry])
    finite = bool(np.asarray(bounds.finite)[entry])
    edge = half * float(np.arctanh(_EDGE)) if finite else np.inf
    value = np.array(space.values(trial.free, trial.fixed, trial.active))
    which = doubt.keys.index(key)
    along = doubt.covariance[:, which] / max(float(doubt.covariance[which, which]), 1e-300)
    entries = [space.keys.index(k) for k in doubt.keys]
    out = []
    for side, end in ((-1, estimate.low), (1, estimate.high)):
        value[entry] = end
        at = float(np.asarray(bounds.to_free(value, 1.0 - _EDGE))[entry])
        if side * (at - best[entry]) <= 1e-9 * max(abs(best[entry]), 1.0):  # it stands at the end of its bounds
            continue
        free = best.copy()
        free[entries] += along * (at - best[entry])
        free[entry] = at
        out.append(_End(entry, side, float(best[entry]), side * edge, at, free))
    return out


def _with(estimate: Estimate, ends: Sequence[_End], space: Space) -> Estimate:
    """An estimate with ends that were found, and the standard error that goes with them."""
    low, high = estimate.low, estimate.high
    for e in ends:
        unbounded = e.side * e.inside[0] + e.best  # the farthest that was tried
        beyond = e.side * np.inf if np.isfinite(e.edge) else unbounded
        free = np.zeros(space.size)
        free[e.entry] = beyond if e.found is None else e.found
        at = float(np.asarray(space.bounds.to_value(free))[e.entry])
        low, high = (at, high) if e.side < 0 else (low, at)
    return replace(estimate, low=low, high=high, std=(high - low) / (2.0 * _NORMAL))
