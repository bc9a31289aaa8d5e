"""What differs by recording? Asked where what all recordings share does not explain them.

A parameter of a mechanism already named has a value for each recording where a score test, from the Jacobian of the
shared one split by recording, promises much (Rao, Proc. Camb. Phil. Soc. 44 (1948) 50). A room that differs by
recording has several values for each, so what it promises is first told from how the outputs respond to heat in each
recording (`scpjax.diagnose.latent`), and only what takes away much is fitted.
"""

from __future__ import annotations

import itertools
from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np

from scpjax.diagnose.evidence import Comparison, Evidence, compare
from scpjax.diagnose.holdout import Split
from scpjax.diagnose.hypothesis import State, grown, moved, trial_at
from scpjax.diagnose.latent import Misfit, hats
from scpjax.diagnose.locate import Binned
from scpjax.diagnose.trials import at_rest
from scpjax.fit.problem import Trial
from scpjax.fit.setup import Setup, names_of, restructured, what_there_is
from scpjax.fit.solve import evaluate, stack
from scpjax.physics.catalogue import applicable, mechanism

ROOM = "ambient_drift"
OWN: dict[str, tuple[str, ...]] = {
    "linear": ("drift",),
    "settling": ("drift",),
    "cycling": ("drift", "quadrature"),
    "excursion": ("drift", "begin", "end"),
}
"""By law of the room, what differs by recording; the time constant is shared."""

_MOST = 8  # recordings, with values for each of which a model may still be fitted
_KNOTS = 120  # of a recording, between which heat is linear
_SHARE = 0.3  # of the misfit beyond the noise, that what differs must promise to take away
_TRIED = 2  # parameters of mechanisms already named
_RIVAL = 0.8  # of what the best course promises, with which another is fitted too
_SETTLING = (0.03, 0.07, 0.15, 0.3, 0.7)  # time constants tried, as shares of the longest recording
_CYCLES, _FINE, _QUICKEST = 0.7, 4, 12  # in the longest recording, at least; tried per cycle more; knots in a cycle
_QUICK = (0.01, 0.03, 0.06, 0.12)  # time constants of an excursion tried, as shares of the longest recording
_PLACES = np.linspace(0.0, 0.98, 50)  # of a recording, that are tried for its ends
_LATER = 1.5  # times the longest recording: when what never comes back begins to
_SWEEPS = 5  # over all recordings, in which each takes its best beside what the others have


def with_own(setup: Setup, *own: str) -> Setup:
    """The problem with parameters ("mechanism.parameter") that differ by recording."""
    return restructured(setup, setup.structure.with_own(names_of(setup.recordings), *own))


def own_room(state: State, split: Split, rules: Evidence) -> Comparison | None:
    """The room under the best of its laws with a course of its own in each recording, added to a hypothesis; None where
    it is named already, cannot act here, or has no evidence.
    """
    setup, room = state.setup, mechanism(ROOM)
    n = len(setup.recordings)
    able = applicable(room, what_there_is(setup.structure, setup.recordings))
    if ROOM in state.names or not able or not 2 <= n <= _MOST:
        return None
    felt = _Felt(Misfit(setup, split.train, state.trial, _to_fit(split)))
    found: list[Comparison] = []
    for course in _promising(felt) if felt.finite else ():
        problem = with_own(grown(setup, room), *(f"{ROOM}.{p}" for p in OWN[course.law]))
        after = at_rest(problem, split, [_begun(state, problem, course)], max_steps=80)
        extra = problem.structure.count_free(ROOM, room.laws.index(course.law))
        found.append(compare(state, after, ROOM, course.law, split, rules, extra))
    return max((c for c in found if c.accepted), key=lambda c: c.delta_bic, default=None)


def _to_fit(split: Split) -> Binned:
    """Where there is something to fit to; of what the states were meanwhile nothing is asked."""
    idle = np.zeros(split.is_train.shape[:2])
    return Binned(np.zeros(split.is_train.shape), split.is_train, idle, idle, None, None, None)


def released(state: State, split: Split, rules: Evidence) -> State | None:
    """The hypothesis with that parameter of its mechanisms differing by recording which then explains most; None where
    there is no evidence for any.
    """
    found = []
    for key in _differing(state, split):
        problem = with_own(state.setup, key)
        value, laws = moved(state, problem)
        after = at_rest(problem, split, [trial_at(problem, value, laws)], max_steps=80)
        found.append(compare(state, after, "", "", split, rules, len(problem.structure.recordings) - 1))
    best = max((c for c in found if c.accepted), key=lambda c: c.delta_bic, default=None)
    return None if best is None else best.state


def _differing(state: State, split: Split) -> list[str]:
    """Parameters ("mechanism.parameter") that a score test would have differ by recording, most promising first."""
    setup, n = state.setup, len(state.setup.recordings)
    if setup.structure.system or not 2 <= n <= _MOST:
        return []
    here = evaluate(stack([state.trial]), split.train, setup.space)
    size = split.train.target.size
    residual, jacobian = np.asarray(here.residual[0])[:size], np.asarray(here.jacobian[0])[:size]
    index = np.asarray(state.trial.index)
    recording = np.repeat(np.arange(n), size // n)
    finite = np.all(np.isfinite(jacobian), axis=0)
    imitated, _ = np.linalg.qr(jacobian[:, finite & np.any(jacobian != 0, axis=0)])
    left = residual - imitated @ (imitated.T @ residual)
    beyond = max(float(left @ left) - float(np.sum(residual != 0)), 1e-300)
    gains: dict[str, float] = {}
    for slot in setup.structure.slots:
        at = np.flatnonzero(finite & (index == slot.index))
        if slot.mechanism not in state.names or slot.recording or not len(at):
            continue
        each = np.where(recording[:, None] == np.arange(n), jacobian[:, at], 0.0)
        each = each - imitated @ (imitated.T @ each)
        u, s, _ = np.linalg.svd(each, full_matrices=False)
        u = u[:, s > 1e-6 * max(float(np.linalg.norm(jacobian[:, at])), 1e-300)]
        gains[f"{slot.mechanism}.{slot.parameter.name}"] = float(np.sum((u.T @ left) ** 2)) / beyond
    able = sorted((key for key, gain in gains.items() if gain > _SHARE), key=lambda key: -gains[key])
    return able[:_TRIED]


@dataclass(frozen=True)
class Course:
    """A course of the room in each recording: ``size`` [W] of its heat (r, q), by law, and the ``times`` [s] at which
    it changes, where it does at once.
    """

    law: str
    share: float  # of the misfit beyond the noise
    time_constant: float
    size: np.ndarray
    times: np.ndarray | None = None  # (r, 2)


class _Felt:
    """How the outputs respond to heat at knots of each recording."""

    def __init__(self, misfit: Misfit):
        b = misfit.binned
        there = np.any(b.there, axis=2)
        bins = int(b.there.shape[1])
        gap = max(bins // _KNOTS, 1)
        count = -(-bins // gap) + 1
        self.knots = [np.arange(count) * gap * float(w) for w in misfit.widths]
        self.spans = [
            float(w) * (np.flatnonzero(t).max(initial=0) + 1) for w, t in zip(misfit.widths, there, strict=True)
        ]
        heats = [place for place in misfit.places if place.startswith("heat")]  # of a joint, one for each side
        felt = np.sum([misfit.responses(place, [hats(bins, gap, count)] * len(self.knots)) for place in heats], axis=0)
        self._gram, self._along = felt.T @ felt, felt.T @ misfit.target
        self.beyond = max(float(misfit.target @ misfit.target) - len(misfit.target), 1e-300)

    @property
    def finite(self) -> bool:
        """False where the hypothesis, linear about rest, runs away."""
        return bool(np.all(np.isfinite(self._gram)) and np.all(np.isfinite(self._along)))

    def taken(self, shapes: Sequence[np.ndarray]) -> tuple[float, np.ndarray]:
        """(share of the misfit beyond the noise that goes, sizes (r, q)) by heats of given shapes (knots, q) in each
        recording.
        """
        q, n = shapes[0].shape[1], len(self.knots[0])
        whole = np.zeros((n * len(shapes), q * len(shapes)))
        for i, shape in enumerate(shapes):
            whole[n * i : n * (i + 1), q * i : q * (i + 1)] = shape
        inner, outer = whole.T @ self._gram @ whole, whole.T @ self._along
        size = np.linalg.lstsq(inner, outer, rcond=1e-9)[0]
        return min(float(outer @ size) / self.beyond, 1.0), size.reshape(len(shapes), q)

    def beside(self, i: int, shapes: np.ndarray, others: Sequence[tuple[int, np.ndarray]]) -> np.ndarray:
        """What each of some shapes (knots, m) of heat in recording ``i`` takes away, of the sum of squares, beside
        ``others``, shapes (knots,) in recordings, whose sizes are free.
        """
        n, heats = len(self.knots[0]), np.zeros((len(self._along), len(others)))
        for j, (at, other) in enumerate(others):
            heats[n * at : n * (at + 1), j] = other
        mine = slice(n * i, n * (i + 1))
        cross = shapes.T @ self._gram[mine] @ heats
        within = np.linalg.pinv(heats.T @ self._gram @ heats, hermitian=True)
        inner = np.einsum("km,kl,lm->m", shapes, self._gram[mine, mine], shapes)
        least = 1e-9 * inner
        inner = inner - np.einsum("mj,jl,ml->m", cross, within, cross)
        outer = shapes.T @ self._along[mine] - cross @ within @ (heats.T @ self._along)
        return np.where(inner > least, outer**2 / np.where(inner > least, inner, 1.0), 0.0)


def _promising(felt: _Felt) -> list[Course]:
    """Courses worth fitting, most promising first."""
    longest = max(felt.spans)
    found = [
        _best(felt, "linear", (longest,), lambda t, tau: (t / tau)[:, None]),
        _best(felt, "settling", [longest * s for s in _SETTLING], lambda t, tau: -np.expm1(-t / tau)[:, None]),
        _best(felt, "cycling", _cycles(felt), lambda t, tau: np.stack([np.sin(t / tau), 1 - np.cos(t / tau)], axis=1)),
        max((_excursion(felt, longest * quick) for quick in _QUICK), key=lambda c: c.share),
    ]
    most = max(c.share for c in found)
    return sorted((c for c in found if c.share > max(_SHARE, _RIVAL * most)), key=lambda c: -c.share)


def _cycles(felt: _Felt) -> np.ndarray:
    """Time constants of cycles tried, [s]."""
    longest = max(felt.spans)
    most = longest / (_QUICKEST * max(float(k[1]) for k in felt.knots))
    return longest / (2.0 * np.pi * np.arange(_CYCLES, max(most, 2 * _CYCLES), 1.0 / _FINE))


def _best(
    felt: _Felt, law: str, times: Sequence[float] | np.ndarray, shape: Callable[[np.ndarray, float], np.ndarray]
) -> Course:
    """The best of some time constants shared by all recordings, for a law."""
    tried = [(*felt.taken([shape(k, float(tau)) for k in felt.knots]), float(tau)) for tau in times]
    share, size, tau = max(tried, key=lambda t: t[0])
    return Course(law, share, tau, size)


def _excursion(felt: _Felt, tau: float) -> Course:
    """The best two changes in each recording beside those in the others, for a time constant: one after another, then
    each again beside all the others.
    """
    places = [span * _PLACES for span in felt.spans]
    tried = [
        -np.expm1(-np.maximum(knots[:, None] - at, 0.0) / tau) for knots, at in zip(felt.knots, places, strict=True)
    ]
    chosen: dict[tuple[int, int], int] = {}  # by recording and which of its changes
    for sweep in range(_SWEEPS):
        for which, i in itertools.product((sweep,) if sweep < 2 else (0, 1), range(len(tried))):
            others = [(j, tried[j][:, at]) for (j, k), at in chosen.items() if (j, k) != (i, which)]
            chosen[i, which] = int(np.argmax(felt.beside(i, tried[i], others)))
    both = [sorted((chosen[i, 0], chosen[i, 1])) for i in range(len(tried))]
    share, size = felt.taken([each[:, at] for each, at in zip(tried, both, strict=True)])
    return Course("excursion", share, tau, size, np.array([p[at] for p, at in zip(places, both, strict=True)]))


def _begun(state: State, problem: Setup, course: Course) -> Trial:
    """The hypothesis with a course of the room, not yet fitted."""
    value, laws = moved(state, problem)
    s, room = problem.structure, mechanism(ROOM)
    low, high = next(p.bounds for p in room.parameters if p.name == "drift")
    conductance = float(value[s.where["newton_cooling.conductance"][0]])
    reference = float(problem.fixed[s.index[f"{ROOM}.reference"]])
    size = course.size / (conductance * reference)
    if course.law == "linear":
        size = size * float(problem.fixed[s.index[f"{ROOM}.reference_time"]]) / course.time_constant
    if course.times is not None:  # it comes back by as much as it went
        back = size[:, 0] * size[:, 1] < 0.0
        size = np.where(back, (size[:, 0] - size[:, 1]) / 2, size[:, 0])[:, None]
        value[s.where[f"{ROOM}.begin"]] = np.maximum(course.times[:, 0], 2e-3 * problem.scales.duration)
        value[s.where[f"{ROOM}.end"]] = np.where(back, course.times[:, 1], _LATER * problem.scales.duration)
    size = np.clip(size, 0.9 * low, 0.9 * high)
    value[s.where[f"{ROOM}.drift"]] = size[:, 0]
    value[s.where[f"{ROOM}.time_constant"]] = course.time_constant
    if course.law == "cycling":
        value[s.where[f"{ROOM}.quadrature"]] = size[:, 1]
    for name in ("reference", "reference_time"):
        value[s.where[f"{ROOM}.{name}"]] = problem.fixed[s.index[f"{ROOM}.{name}"]]
    laws[next(i for i, m in enumerate(s.mechanisms) if m.name == ROOM)] = room.laws.index(course.law)
    return trial_at(problem, value, laws)
