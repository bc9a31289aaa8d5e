"""One set of values of a mechanism for several actuators, fitted to all their recordings at once.

Everything else each actuator has for itself, and is fitted again for any set of values that is tried: what is minimised
is a function of the few shared values alone (variable projection; Golub, Pereyra, SIAM J. Numer. Anal. 10 (1973) 413),
with the Jacobian after Kaufman, BIT 15 (1975) 49.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from scipy.optimize import least_squares

from scpjax.abreast import abreast
from scpjax.diagnose.holdout import Split
from scpjax.diagnose.hypothesis import State, moving_parameters, residual_on, trial_at, width
from scpjax.errors import FitError
from scpjax.fit.data import Data
from scpjax.fit.fit import refine
from scpjax.fit.identifiability import at_limit, uncertainty
from scpjax.fit.problem import Trial
from scpjax.fit.result import Estimate
from scpjax.fit.solve import evaluate, stack

_MOST = 40  # sets of values tried
_LIMIT = 0.0025  # of the range between the bounds, nearer than which to their ends a value is at its limit


@dataclass(frozen=True, eq=False)
class Shared:
    """Values shared, and what is left with them. ``inner``: ln(value) or value, as the parameters' scale is;
    ``information`` about them (p, p) of each actuator; ``states`` of the actuators, all fitted to the training part.
    """

    inner: np.ndarray
    information: tuple[np.ndarray, ...]
    states: tuple[State, ...]
    estimates: dict[str, Estimate]


def places(state: State, name: str) -> np.ndarray:
    """Where the values of a mechanism lie that its law moves."""
    m = state.setup.structure.mechanism(name)
    free = m.free_parameters(m.laws.index(state.laws[name]))
    return np.concatenate([state.setup.structure.where[f"{name}.{p.name}"] for p in free])


def keys(state: State, name: str) -> tuple[str, ...]:
    """Keys of the values of a mechanism that its law moves."""
    return tuple(state.setup.space.keys[i] for i in places(state, name))


def fit_at_once(states: Sequence[State], splits: Sequence[Split], name: str) -> Shared:
    """The mechanism ``name``, which all have under the same law, with the same values in all: fitted to the training
    part of all, which is what ``states`` and ``inner`` are of; ``estimates`` and ``information`` are of a fit to all
    data from there.
    """
    actuators = [_One(s, p.train, name) for s, p in zip(states, splits, strict=True)]
    inner = _solved(actuators, _middle(actuators))
    found = [one.at(inner).state(p) for one, p in zip(actuators, splits, strict=True)]
    whole = [_One(s, p.whole, name) for s, p in zip(found, splits, strict=True)]
    last = _solved(whole, inner)
    information = tuple(abreast(lambda one: one.at(last).information(), whole))
    return Shared(inner, information, tuple(found), _estimates(whole[0], last, information))


def held(state: State, split: Split, name: str, inner: np.ndarray) -> State | None:
    """The hypothesis fitted to the training part with the values of a mechanism held; None where they are beyond what
    they may be in it, as those of times go with the recordings.
    """
    one = _One(state, split.train, name)
    low, high = one.bounds()
    if np.any((inner < low) | (inner > high)):
        return None
    return one.at(inner).with_values_held(split)


def _middle(actuators: Sequence[_One]) -> np.ndarray:
    """The mean of each one's own values, weighed by what it knows of them."""
    known = abreast(lambda one: one.own.information(), actuators)
    mean = np.linalg.lstsq(sum(known), sum(k @ one.begun for k, one in zip(known, actuators, strict=True)), rcond=None)
    low, high = _bounds(actuators)
    inside = 0.01 * (high - low)
    return np.clip(
        mean[0], np.where(np.isfinite(low), low + inside, low), np.where(np.isfinite(high), high - inside, high)
    )


def _bounds(actuators: Sequence[_One]) -> tuple[np.ndarray, np.ndarray]:
    """What is within the bounds of all: those of times go with the recordings."""
    ends = [one.bounds() for one in actuators]
    return np.max([low for low, _ in ends], axis=0), np.min([high for _, high in ends], axis=0)


def _solved(actuators: Sequence[_One], begun: np.ndarray) -> np.ndarray:
    """The shared values of least squares, each actuator's residuals in units of what its own values leave of them."""
    low, high = _bounds(actuators)
    if np.any(low >= high):
        raise FitError("no value is within the bounds of all: their recordings are too different")
    scale = abreast(lambda one: one.own.scale(), actuators)

    def projected(inner: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        found = abreast(lambda one: one.at(inner).projected(), actuators)
        for i, ((r, j), one) in enumerate(zip(found, actuators, strict=True)):
            n = one.data.target.size
            r[:n], j[:n] = r[:n] / scale[i], j[:n] / scale[i]
            if i:  # what is shared is held to be likely once
                r[n + one.where], j[n + one.where] = 0.0, 0.0
        return np.concatenate([r for r, _ in found]), np.concatenate([j for _, j in found])

    span = np.where(np.isfinite(high - low), high - low, 1.0)
    solution = least_squares(
        lambda inner: projected(inner)[0],
        np.clip(begun, low + 1e-6 * span, high - 1e-6 * span),
        jac=lambda inner: projected(inner)[1],  # pyright: ignore[reportArgumentType]  # a callable may be given
        bounds=(low, high),
        x_scale="jac",
        ftol=1e-6,
        xtol=1e-6,
        max_nfev=_MOST,
    )
    return solution.x


def _estimates(one: _One, inner: np.ndarray, information: Sequence[np.ndarray]) -> dict[str, Estimate]:
    """Shared values with the errors that all actuators together leave them; each counts their prior, all it once."""
    total = sum(information) - (len(information) - 1) * np.diag(one.prior_information())
    std = np.sqrt(np.maximum(np.diag(np.linalg.pinv(total, hermitian=True)), 0.0))
    low, high = one.bounds()
    out = {}
    for i, key in enumerate(keys(one.start, one.name)):
        slot = one.start.setup.structure.slots[one.where[i]]
        value, ends = float(inner[i]), inner[i] + 1.96 * std[i] * np.array([-1.0, 1.0])
        error = float(std[i])
        if one.log[i]:
            value, ends = float(np.exp(value)), np.exp(np.clip(ends, -700.0, 700.0))
            error *= value
        unit = one.start.setup.structure.unit_of(slot.parameter)
        stands_at_end = bool(min(inner[i] - low[i], high[i] - inner[i]) < _LIMIT * (high[i] - low[i]))
        p = slot.parameter
        short = key.split(".", 1)[1]
        out[short] = Estimate(
            value, error, unit, float(ends[0]), float(ends[1]), p.description, p.symbol, stands_at_end
        )
    return out


class _One:
    """One actuator beside shared values of a mechanism, on some of its data."""

    def __init__(self, state: State, data: Data, name: str):
        self.start, self.data, self.name = state, data, name
        self.where = places(state, name)
        self.log = np.asarray(state.setup.space.bounds.log)[self.where]
        self.begun = np.asarray(state.setup.space.bounds.inner_of(state.values))[self.where]
        self._last = self.own
        self._known: dict[bytes, _Fitted] = {}

    @property
    def own(self) -> _Fitted:
        """The actuator with the values that it has."""
        return _Fitted(self, self.start.trial, self.start)

    def at(self, inner: np.ndarray) -> _Fitted:
        """The actuator with these values of the mechanism, all else fitted, from where it stood last."""
        key = np.asarray(inner).tobytes()
        if key not in self._known:
            setup, laws = self.start.setup, np.asarray(self.start.trial.laws)
            value = self._last.values()
            value[self.where] = np.where(self.log, np.exp(np.where(self.log, inner, 0.0)), inner)
            active = moving_parameters(setup, laws)
            active[self.where] = False
            fixed = setup.fixed.copy()
            fixed[self.where] = value[self.where]
            holding = replace(setup, fixed=fixed)
            trial, _, cost = refine(setup, self.data, holding.trial(value, active, laws, width(setup)), max_steps=40)
            rest = np.asarray(setup.space.values(trial.free, trial.fixed, trial.active))
            nothing = np.full_like(self.start.residual, np.inf)
            as_held = State(holding, trial, nothing, cost)
            self._last = self._known[key] = _Fitted(self, trial_at(setup, rest, laws), as_held)
        return self._known[key]

    def bounds(self) -> tuple[np.ndarray, np.ndarray]:
        """Ends of what the values may be, on the inner scale."""
        b = self.start.setup.space.bounds
        mid, half, finite = (np.asarray(x)[self.where] for x in (b.mid, b.half, b.finite))
        return np.where(finite, mid - half, -np.inf), np.where(finite, mid + half, np.inf)

    def prior_information(self) -> np.ndarray:
        """What their priors know of the values."""
        return np.asarray(self.start.setup.space.prior_spread)[self.where] ** -2.0


class _Fitted:
    """An actuator where all but the shared values is at its best: ``trial`` can move these too, ``held`` cannot."""

    def __init__(self, one: _One, trial: Trial, held: State):
        self.one, self.trial, self.held = one, trial, held

    def values(self) -> np.ndarray:
        """Physical values of everything."""
        space = self.one.start.setup.space
        return np.array(space.values(self.trial.free, self.trial.fixed, self.trial.active))

    def _steepness(self) -> np.ndarray:
        """Change of the shared values, on their inner scale, by the entry that a solver moves."""
        bounds, free = self.one.start.setup.space.bounds, np.asarray(self.trial.free[:-1])
        slope = np.asarray(bounds.slope(free))[self.one.where]
        return np.maximum(np.where(self.one.log, slope / self.values()[self.one.where], slope), 1e-9)

    def projected(self) -> tuple[np.ndarray, np.ndarray]:
        """Residuals (m,), and their Jacobian (m, p) by the shared values, of what nothing else can make up for: what
        stands at the end of its bounds cannot.
        """
        one, index, space = self.one, np.asarray(self.trial.index), self.one.start.setup.space
        here = evaluate(stack([self.trial]), one.data, space)
        r, jac = np.array(here.residual[0]), np.asarray(here.jacobian[0])
        mine = np.array([int(np.flatnonzero(index == i)[0]) for i in one.where])
        stuck = np.append(at_limit(self.trial, space), False)[index]
        others = np.setdiff1d(np.flatnonzero(~stuck), mine)
        rest = jac[:, others]
        size = np.linalg.norm(rest, axis=0)
        q, _ = np.linalg.qr(rest[:, size > 0] / size[size > 0])
        shared = jac[:, mine] / self._steepness()
        return r, shared - q @ (q.T @ shared)

    def scale(self) -> float:
        """Standard deviation of the residuals, in units of the noise's, as it counts for what is shared: with what
        their colour adds to it.
        """
        doubt = uncertainty(self.trial, self.one.data, self.one.start.setup.space)
        return float(np.sqrt(max(doubt.variance * doubt.inflation, 1e-12)))

    def information(self) -> np.ndarray:
        """What the actuator's data know of the shared values (p, p), on their inner scale, all else unknown."""
        one = self.one
        doubt = uncertainty(self.trial, one.data, one.start.setup.space)
        mine = [doubt.keys.index(one.start.setup.space.keys[i]) for i in one.where]
        steep = self._steepness()
        return np.linalg.pinv(doubt.covariance[np.ix_(mine, mine)] * np.outer(steep, steep), hermitian=True)

    def state(self, split: Split) -> State:
        """As a hypothesis, of which everything moves."""
        setup = self.one.start.setup
        residual = residual_on(self.trial, split.whole, setup)
        return State(setup, self.trial, residual, float(np.sum(residual[split.is_train] ** 2)))

    def with_values_held(self, split: Split) -> State:
        """As a hypothesis, of which the shared values do not move."""
        held = self.held
        residual = residual_on(held.trial, split.whole, held.setup)
        return replace(held, residual=residual, cost=float(np.sum(residual[split.is_train] ** 2)))
