"""The hypotheses with one mechanism more that are worth it, fitted: what promises most, and what a promise misses."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from functools import partial

import numpy as np

from scpjax.abreast import abreast, meanwhile
from scpjax.diagnose.holdout import Split
from scpjax.diagnose.hypothesis import Start, State, from_their_starts, grown, moved, starts_with, trial_at
from scpjax.diagnose.patience import Patience
from scpjax.diagnose.remainder import FAR, at_noise
from scpjax.diagnose.screen import Fresh, Promise
from scpjax.diagnose.trials import FEW, HOPELESS, NEARLY, TOLERANCE, go_on
from scpjax.fit.problem import CEILING, Trial
from scpjax.fit.setup import Setup
from scpjax.fit.solve import binned_of, evaluate, make_room, solve_all, stack
from scpjax.physics.mechanism import Mechanism

_LITTLE = 12.0  # promise less than which a mechanism is not worth fitting
_BEHIND = 0.2  # of the leader's promise, less than which it is not
_RIVAL = 0.9  # of the leader's gain, with which a trial goes on once a mechanism has reached the noise
_FAR_BEHIND = 0.6  # of it, less than which nothing more is fitted once a mechanism has reached the noise
_AT_LEAST, _AT_MOST, _LATER = 2, 5, 3  # mechanisms fitted; of them beside others already named
_GOOD = 0.75  # of the misfit in excess of the noise: where nothing fitted takes so much away, twice as many are; and
# beside others already named wherever nothing has reached the noise
_ABREAST = 0.8  # of the leader's promise, with which one is fitted too as long as nothing has reached the noise
_LEVEL = 0.9  # of it, with which one is fitted beside other names whatever has: nothing may tell the two apart
_COARSE = 1e-4  # half the fall of the sum of squares in one step, as a share of it, with which a trial need not go on
_NOISE = 1.05  # sum of squares, in units of that of the noise, up to which a trial has reached it
_LOST = 2.0**2  # mean square, in units of the noise's, down to which a first name comes near the noise
_STARTS, _STARTS_LATE = 8, 2  # of one mechanism, at most; out of patience
_AHEAD = 2  # programs compiled beside a fit


def promising(promises: Sequence[Promise]) -> list[Promise]:
    """Which mechanisms may be fitted: those not far behind the leader."""
    worth = [p for p in promises if p.gain >= _LITTLE]
    near = [p for p in worth if p.gain >= _BEHIND * worth[0].gain]
    return near if len(near) >= _AT_LEAST else worth[:_AT_LEAST]


def _best_starts(promise: Promise) -> list[Start]:
    """The best start of every law, then second ones, most promising first."""
    order = [int(i) for i in np.argsort(-promise.each, kind="stable")]
    laws = dict.fromkeys(promise.starts[i].law for i in order)
    first = [next(i for i in order if promise.starts[i].law == law) for law in laws]
    queue = first + [i for i in order if i not in first]
    return [promise.starts[i] for i in queue]


def fit_promising(
    state: State,
    split: Split,
    promises: Sequence[Promise],
    begun: Fresh | None,
    max_steps: int,
    tell: Callable[[str], None],
    contenders: Sequence[str] = (),
    patience: Patience | None = None,
) -> dict[str, dict[int, State]]:
    """By mechanism and law, the hypotheses with one mechanism more that were worth fitting; `fresh` ones among them.

    A promise is linear in what the base parameters can imitate: the right mechanism may promise less than others do.
    Where nothing that promised something comes near the noise, what is likeliest beside the base as the data suggested
    it at first is fitted there too, as the first name. Beside names, which may have been bent to imitate it, the right
    one may promise nothing at all: away from the noise, those that contended with the first name (``contenders``) are
    fitted too, all beginning anew. Out of ``patience`` only the few that promise most are fitted.
    """
    patience = patience or Patience()
    fits = _Fits(state, split, begun, max_steps, tell, patience)
    make_room()
    most = _LATER if state.names else _AT_MOST
    excess = max(state.cost - float(split.is_train.sum()), 0.0)
    worth = promising(promises)
    least = _LATER if state.names else _AT_LEAST
    sure = [p.mechanism for i, p in enumerate(worth) if i < least or p.gain >= _FAR_BEHIND * promises[0].gain]
    _compiled(sure[:_LATER], state, split)
    worth = worth[:most] + [p for p in promises if _is(p, begun)] + worth[most : 2 * most]

    def is_asked(i: int) -> bool:
        promise, behind = worth[i], not state.names and worth[i].gain < _ABREAST * promises[0].gain
        if promise.mechanism.name in fits.found or (fits.explained and promise.gain < _FAR_BEHIND * promises[0].gain):
            return False
        enough = fits.lead > _GOOD * excess and (fits.explained or behind)
        level = promise.gain >= _LEVEL * promises[0].gain and len(fits.found) < _AT_MOST
        return (i < most or not enough or level or _is(promise, begun)) and (i < least or not patience.over())

    fits.add_all(worth, is_asked)
    others = [p for p in promises if p.mechanism.name in contenders] if state.names else _likeliest(promises, begun)
    if not ((at_noise(state, split, FAR) if state.names else fits.reach(_LOST)) or patience.over()):
        fits.add_all(others, lambda i: not (fits.explained or others[i].mechanism.name in fits.found), bent=False)
    return fits.found


def _likeliest(promises: Sequence[Promise], begun: Fresh | None) -> list[Promise]:
    """What is likeliest beside the base as the data suggested it at first; everything where that blows up."""
    by_name = {p.mechanism.name: p for p in promises}
    return list(promises) if begun is None else [by_name[name] for name in begun.likeliest]


def _compiled(mechanisms: Sequence[Mechanism], state: State, split: Split) -> None:
    """Have the programs of several hypotheses compiled at once."""

    def ready(m: Mechanism) -> None:
        problem = grown(state.setup, m)
        evaluate(stack([trial_at(problem, *moved(state, problem))]), split.train, problem.space)

    abreast(ready, mechanisms)


@dataclass
class _Fits:
    """A hypothesis fitted with one mechanism more, with one after another, and what they have come to."""

    state: State
    split: Split
    begun: Fresh | None
    max_steps: int
    tell: Callable[[str], None]
    patience: Patience = field(default_factory=Patience)
    found: dict[str, dict[int, State]] = field(default_factory=dict)  # by mechanism and law
    lead: float = 0.0  # fall of the sum of squares by the closest
    explained: bool = False  # one of them has reached the noise

    def reach(self, level: float) -> bool:
        """Whether the hypothesis, or one with a mechanism more, is down to the noise to within ``level``."""
        every = (self.state, *(s for laws in self.found.values() for s in laws.values()))
        return any(at_noise(s, self.split, level) for s in every)

    def add_all(self, promises: Sequence[Promise], is_asked: Callable[[int], bool], *, bent: bool = True) -> None:
        """`add` those that are asked for by then; the programs of the next ones are compiled beside each fit."""
        for i, promise in enumerate(promises):
            if not is_asked(i):
                continue
            make_room()
            following = [p.mechanism for j, p in enumerate(promises) if j > i and is_asked(j)][:_AHEAD]
            with meanwhile(partial(_compiled, following, self.state, self.split)):
                self.add(promise, bent=bent)

    def add(self, promise: Promise, *, bent: bool = True) -> None:
        """Fit with a mechanism from where the hypothesis stands (``bent``) and, where that does not reach the noise
        and no other has, with everything at its start; out of patience only from the starts that promise most.
        """
        m, hurried = promise.mechanism, bent and self.patience.over()
        self.tell(m.name)
        problem = grown(self.state.setup, m)
        over = {s.law: s for s in starts_with(self.state, m, problem)}
        queue = _best_starts(promise)[: _STARTS_LATE if hurried else _STARTS]
        trials = [_transfer(s, over[s.law], problem) for s in queue] if bent else []
        if self.begun and _is(promise, self.begun):
            trials += [trial_at(problem, s.value, s.laws) for s in starts_with(self.begun.state, m, problem)]
        nearly = NEARLY if bent and not self.explained else _RIVAL
        found, solved, cost = self._closest(m, problem, trials, nearly)
        if not (hurried or self.explained or any(at_noise(s, self.split, FAR) for s in (self.state, *found.values()))):
            laws = [over[law].laws for law in dict.fromkeys(s.law for s in queue)]
            own = [trial_at(problem, from_their_starts(problem, which)[0], which) for which in laws]
            found, _, _ = self._closest(m, problem, own, nearly, solved, cost)
        self.found[m.name] = found
        self.explained = self.explained or any(at_noise(s, self.split) for s in found.values())

    def _closest(
        self,
        m: Mechanism,
        problem: Setup,
        trials: Sequence[Trial],
        nearly: float,
        before: Sequence[Trial] = (),
        costs: Sequence[float] = (),
    ) -> tuple[dict[int, State], list[Trial], list[float]]:
        """Some trials of a mechanism fitted: (the closest by law, all of them, what they cost), with those before."""
        if not trials:
            return {}, [], []
        state, split = self.state, self.split
        coarse = max(TOLERANCE, _COARSE * state.cost)
        solved, cost, _ = solve_all(trials, split.train, problem.space, max_steps=FEW, tolerance=coarse)
        self.lead = max(self.lead, float(state.cost - np.min(cost)))
        same, more = _as_close_as_others(solved, cost, coarse, state.cost), self.max_steps - FEW
        noise = np.sum(split.is_train)
        if np.min(cost) < _NOISE * noise <= state.cost:  # what is behind can only be a rival
            nearly = max(nearly, _RIVAL)
        if np.min(cost) < FAR * noise <= state.cost:  # near it, one of them is enough under any law but the closest's
            same |= _behind_under_their_laws(solved, cost)
        solved, cost = go_on(problem, split, solved, cost, same, state.cost, self.lead, more, nearly)
        solved, least = [*before, *solved], [*costs, *(float(c) for c in cost)]
        return _by_law(m, problem, split, solved, np.asarray(least), state), solved, least


def _as_close_as_others(solved: Sequence[Trial], cost: np.ndarray, coarse: float, before: float) -> np.ndarray:
    """Which of some trials (trials,) have come as close as a better one by the same laws, to within ``coarse``: to the
    same place, as it seems. Not those that have yet to come back to where all began, ``before``.
    """
    found, ends = np.zeros(len(cost), bool), {}
    for i in np.argsort(cost, kind="stable"):
        there = ends.setdefault(tuple(np.asarray(solved[i].laws)), [])
        if cost[i] >= before:
            break
        found[i] = any(cost[i] - c <= coarse for c in there)
        if not found[i]:
            there.append(cost[i])
    return found


def _behind_under_their_laws(solved: Sequence[Trial], cost: np.ndarray) -> np.ndarray:
    """Of the trials (trials,) by other laws than the closest one's: which are not the closest by theirs, or are
    hopeless beside that one.
    """
    laws = [tuple(np.asarray(trial.laws)) for trial in solved]
    order = np.argsort(cost, kind="stable")
    first = {laws[i]: i for i in reversed(order)}
    lead, worst = laws[order[0]], HOPELESS * cost[order[0]]
    return np.array([mine != lead and (first[mine] != i or cost[i] > worst) for i, mine in enumerate(laws)])


def _is(promise: Promise, begun: Fresh | None) -> bool:
    return begun is not None and begun.best is not None and promise.mechanism.name == begun.best.name


def _transfer(start: Start, like: Start, problem: Setup) -> Trial:
    """A start over the problem it was simulated in as a trial of a smaller one."""
    value = like.value.copy()
    m = start.mechanism
    for k, p in enumerate(m.parameters):
        value[problem.structure.where[f"{m.name}.{p.name}"]] = start.own[k]
    return trial_at(problem, value, like.laws)


def _by_law(
    m: Mechanism, problem: Setup, split: Split, solved: Sequence[Trial], cost: np.ndarray, before: State
) -> dict[int, State]:
    """The closest fit of each law."""
    which = next(i for i, other in enumerate(problem.structure.mechanisms) if other.name == m.name)
    best: dict[int, int] = {}
    for i in np.argsort(cost):
        best.setdefault(int(np.asarray(solved[i].laws)[which]), int(i))
    residuals = binned_of([solved[i] for i in best.values()], split.whole, problem.space)
    # a trial that blew up (its residuals are cut off) explains nothing
    residuals[np.any(np.abs(residuals) >= CEILING, axis=(1, 2, 3))] = 10.0 * np.abs(before.residual)
    return {
        law: State(problem, solved[i], r, float(cost[i])) for (law, i), r in zip(best.items(), residuals, strict=True)
    }
