"""What is named: the search over the catalogue, the data mended beside what it finds, and curves that are one name."""

from __future__ import annotations

import time
from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np

from scpjax.diagnose.choice import Choice, Progress
from scpjax.diagnose.curve import Curve
from scpjax.diagnose.evidence import Evidence, is_better
from scpjax.diagnose.exchange import exchanged
from scpjax.diagnose.fewer import fewer
from scpjax.diagnose.final import resolved
from scpjax.diagnose.free import Free, free_law, one_for_several
from scpjax.diagnose.holdout import Split
from scpjax.diagnose.hypothesis import State, residual_on
from scpjax.diagnose.patience import Patience
from scpjax.diagnose.pruning import prune
from scpjax.diagnose.remainder import AT_NOISE, level, misfit, takes_most
from scpjax.diagnose.select import choose
from scpjax.diagnose.together import choose_together
from scpjax.diagnose.trials import afresh, at_rest, under_each_law, under_every_law
from scpjax.fit.data import Data
from scpjax.fit.fit import outliers, refine, settle
from scpjax.fit.gaps import find_gaps
from scpjax.fit.problem import Trial
from scpjax.fit.setup import Setup

_SPRING, _MASS = "elastic_spring.stiffness", "inertia.mass"
_TURNED = 0.5  # rad that a weight swings in a step, from which what acts on it may be unresolved
_LESS = 0.8  # of an output's mean square, left when jumps are timed anew: they had been mistimed


@dataclass(frozen=True)
class Found:
    """Where the search ended: the data as they are used from here on, the base model on them, what is named, and the
    curve where it goes by one.
    """

    parts: Split
    base: State
    choice: Choice
    curve: Curve | None = None
    notes: tuple[str, ...] = ()


@dataclass(frozen=True)
class _Seeker:
    """How names are sought: under the laws of the catalogue, or one mechanism by a curve."""

    catalogue: Setup
    rules: Evidence
    max_steps: int
    patience: Patience
    tell: Progress

    def choose(
        self, base: State, parts: Split, enough: Callable[[State], bool], resolve: Callable[[State], bool]
    ) -> Choice:
        """What is named; where that ends away from the noise, each name is set against what could stand in its place
        before other ways are gone, which takes longer.
        """
        return choose(
            base,
            parts,
            self.rules,
            self.catalogue,
            max_steps=self.max_steps,
            progress=self.tell,
            enough=enough,
            mend=lambda choice: self.exchange(choice, base, parts),
            resolve=resolve,
            patience=self.patience,
        )

    def exchange(self, choice: Choice, base: State, parts: Split) -> Choice:
        """Each name set against what could stand in its place."""
        self.tell("each name against what could stand in its place", 0.7)
        return exchanged(choice, base, parts, self.rules, self.catalogue, self.patience)

    def by_curve(self, base: State, rival: State, parts: Split) -> Free | None:
        """One mechanism under a law of its own that does better than what does not reach the noise."""
        if level(rival, parts) <= AT_NOISE or self.patience.late("mechanisms under laws of their own"):
            return None
        self.tell("each mechanism under a law of its own", 0.3)
        return free_law(base, rival, parts, self.rules)


def find_names(
    base: State,
    parts: Split,
    catalogue: Setup,
    rules: Evidence,
    *,
    max_steps: int = 40,
    patience: Patience | None = None,
    progress: Progress | None = None,
) -> Found:
    """What the base model leaves out, of ``catalogue`` (the problem with every candidate), judged by ``rules``.

    Jumps inside gaps are timed by the better model. Where those that the base model had timed, or wild samples that a
    strong misfit had concealed, stand out beside the first name, it is sought anew without them.
    """
    tell = progress or (lambda text, fraction: None)
    if base.setup.structure.system:
        choice = choose_together(base, parts, rules, catalogue, progress=tell, patience=patience)
        return Found(*_settled(parts, base, choice, rules))
    search = _Seeker(catalogue, rules, max_steps, patience or Patience(), tell)
    found, free = _searched(search, base, parts)
    if free is not None:
        return replace(found, choice=free.choice(found.base, found.choice), curve=free.curve)
    at_once = found.parts.whole.order > parts.whole.order or found.parts.whole.bin > parts.whole.bin
    choice = found.choice if at_once else search.exchange(found.choice, found.base, found.parts)
    if len(choice.state.names) > 1:  # beside laws that were exchanged not every name need be missed
        pruned = fewer(prune(choice.state, found.parts, rules, found.base), found.parts, rules, search.patience)
        if pruned.names != choice.state.names:
            choice = replace(choice.with_only(pruned), settled=choice.settled)
    notes = (*found.notes, *_together(choice))
    found = Found(*_settled(found.parts, found.base, choice, rules), notes=notes)
    found = _by_shorter_steps(found, search)
    free = one_for_several(found.base, found.choice, found.parts, rules, search.patience)
    if free is None:
        return found
    same = f"{' and '.join(found.choice.state.names)} together would predict the same as {free.names[0]} by its curve"
    return replace(found, choice=free.choice(found.base, found.choice), curve=free.curve, notes=(*found.notes, same))


def _together(choice: Choice) -> tuple[str, ...]:
    """What to tell of two names that no round has chosen."""
    if not choice.together:
        return ()
    return (
        f"round 2 compares single mechanisms: {' and '.join(choice.together)} were then tried together in place of "
        "what leads it, and explain more; by it alone either looks unlikely",
    )


def _searched(search: _Seeker, base: State, parts: Split) -> tuple[Found, Free | None]:
    """What the catalogue's laws explain, or one mechanism by a curve where that does better than a first name; jumps
    inside gaps timed by the first name and wild samples left out. Where those did not end the search, and it took
    longer than there is patience left, what it has named is fitted anew without them. Where the first name leaves much,
    curves wait for what is named in the end: several effects are no curve.
    """
    began, by_wild, waits = time.monotonic(), False, False
    free: Free | None = None
    timed: Split | None = None
    shorter: tuple[Split, State] | None = None
    notes: tuple[str, ...] = ()

    def by_curve(rival: State) -> bool:
        nonlocal free
        free = search.by_curve(base, rival, parts)
        return free is not None

    def first_by_curve(first: State) -> bool:
        nonlocal waits
        waits = not takes_most(base, first, parts)
        return not waits and by_curve(first)

    def wild_or_by_curve(first: State) -> bool:
        nonlocal by_wild
        wild = some and bool(_wild(first, parts).any())
        by_wild = wild and not search.patience.over()  # else the search could not begin anew
        return by_wild or (not wild and first_by_curve(first))

    def mistimed(first: State) -> bool:
        nonlocal timed
        left = bool(find_gaps(base.setup.data)) and search.patience.over()
        timed = None if left else _mistimed(first, parts, base)
        return timed is not None or wild_or_by_curve(first)

    def by_shorter_steps(leader: State) -> bool:
        nonlocal shorter
        if _rings(leader, parts):
            shorter = _shorter(leader, parts, search)
        return shorter is not None

    some = bool(np.any(np.asarray(parts.whole.weights) != np.asarray(base.setup.data.weights)))
    choice = search.choose(base, parts, mistimed, by_shorter_steps)
    if timed is not None:
        notes = (f"beside {choice.state.names[0]}, the first name tried, the drive changed in gaps at other times",)
        parts, shorter = timed, None
        trial, _, _ = refine(base.setup, parts.train, base.trial)
        base, began = state_at(base.setup, parts, trial), time.monotonic()
        choice = search.choose(base, parts, wild_or_by_curve, by_shorter_steps)
    wild = _wild(choice.state, parts) if some and choice.state.names else np.zeros(())
    if wild.any():
        more = f"{wild.sum()} more were, which stood out beside"
        parts = parts.with_weights(np.where(wild, 0.0, parts.whole.weights))
        trial, _, _ = refine(base.setup, parts.train, base.trial)
        base, free, shorter = state_at(base.setup, parts, trial), None, None
        if by_wild or search.patience.allows(time.monotonic() - began):
            notes = (*notes, f"{more} {choice.state.names[0]}, the first name tried")
            choice = search.choose(base, parts, first_by_curve, by_shorter_steps)
        else:
            notes = (*notes, f"{more} {' and '.join(choice.state.names)}; nothing else was sought without them")
            choice = replace(choice, state=at_rest(choice.state.setup, parts, [choice.state.trial]))
    if shorter is not None:
        return _resolved(Found(parts, base, choice, notes=notes), *shorter), None
    if free is None and (waits or not choice.state.names):
        by_curve(choice.state)
    return Found(parts, base, choice, notes=notes), free


def _by_shorter_steps(found: Found, search: _Seeker) -> Found:
    """What names come to by steps that are short enough for them, where that takes them to the noise."""
    parts, state = found.parts, found.choice.state
    if not state.names or level(state, parts) <= AT_NOISE:
        return found
    shorter = _shorter(state, parts, search)
    return found if shorter is None else _resolved(found, *shorter)


def _resolved(found: Found, fine: Split, state: State) -> Found:
    """What was found, on data by short enough steps and with the names as fitted there."""
    base = at_rest(found.base.setup, fine, [found.base.trial])
    return replace(found, parts=fine, base=base, choice=replace(found.choice, state=state))


def _shorter(state: State, parts: Split, search: _Seeker) -> tuple[Split, State] | None:
    """The data by steps that are short enough for a hypothesis, and it as fitted there, names that need such steps
    under every law again; None where they are already, that does not take it to the noise, or there is no patience
    left. By steps as long as the samples a law that is right may miss it.
    """
    if not any(m.may_need_short_steps for m in state.setup.structure.mechanisms) or search.patience.over():
        return None
    fine, state, _ = resolved(state, parts, search.patience)
    if fine is parts:
        return None
    search.tell("what is named, by shorter steps", 0.72)
    state = state if level(state, fine) <= AT_NOISE or search.patience.over() else afresh(state, fine)
    for name in state.names:
        if level(state, fine) <= AT_NOISE or search.patience.over():
            break
        if not state.setup.structure.mechanism(name).may_need_short_steps:
            continue
        other = under_every_law(state, name, fine)
        if is_better(other, state, fine, search.rules):
            state = other
    return None if level(state, fine) > AT_NOISE else (fine, state)


def _rings(state: State, parts: Split) -> bool:
    """Whether what moves would swing on its spring within a step: what acts on it is then hardly resolved."""
    slots = state.setup.structure.slots
    of = {key: [float(state.values[s.index]) for s in slots if s.key.split("@")[0] == key] for key in (_SPRING, _MASS)}
    if not all(of.values()):
        return False
    turns = np.sqrt(np.mean(of[_SPRING]) / np.mean(of[_MASS]))  # rad/s
    return bool(turns * np.max(np.asarray(parts.whole.grids.step)) > _TURNED)


def _settled(parts: Split, base: State, choice: Choice, rules: Evidence) -> tuple[Split, State, Choice]:
    """Jumps inside gaps timed by the model of what is named; without names that only made up for their times."""
    if not choice.state.names:
        return parts, base, choice
    state, timed = _timed(choice.state, parts, base)
    if timed is parts:
        return parts, base, choice
    trial, _, _ = refine(base.setup, timed.train, base.trial)
    base = state_at(base.setup, timed, trial)
    pruned = prune(state, timed, rules)
    if not pruned.names:
        return timed, base, Choice(base, choice.ranking, {}, {})
    return timed, base, choice.with_only(pruned) if pruned.names != state.names else replace(choice, state=state)


def _timed(state: State, parts: Split, base: State) -> tuple[State, Split]:
    """A hypothesis fitted to the drives whose jumps inside gaps it has timed, from what was recorded: how others had
    timed them is undone. As it is where there are no such gaps. All of the data time them, as they did for
    the base model: of those in held-out stretches nothing else tells. Parameters are fitted to the training part.
    """
    untimed = parts.whole.with_effort(np.asarray(base.setup.data.grids.effort))
    trial, data, _ = settle(state.setup, state.trial, untimed, drop_outliers=False)
    if data is untimed:
        return state, parts
    timed = _with_effort(parts, data)
    trial, _, _ = refine(state.setup, timed.train, trial)
    return state_at(state.setup, timed, trial), timed


def _mistimed(first: State, parts: Split, base: State) -> Split | None:
    """The data as a first name times jumps inside gaps, where it leaves clearly less of the misfit by that; by the law
    of it that then leaves least: beside times that are wrong another one may have come nearest.
    """
    if not find_gaps(base.setup.data):
        return None
    found = [_timed(law, parts, base) for law in (first, *under_each_law(first, first.names[0], parts))]
    state, timed = min(found, key=lambda each: each[0].cost)
    better = misfit(state, timed) < _LESS * misfit(first, parts)
    return timed if timed is not parts and bool(np.any(better)) else None


def _wild(state: State, parts: Split) -> np.ndarray:
    """Samples (r, n, y) that stand out alone beside a hypothesis, and are still in."""
    return outliers(state.setup, parts.whole, state.trial) != np.asarray(parts.whole.weights)


def state_at(setup: Setup, parts: Split, trial: Trial) -> State:
    """A hypothesis where a trial stands."""
    residual = residual_on(trial, parts.whole, setup)
    return State(setup, trial, residual, float(np.sum(residual[parts.is_train] ** 2)))


def _with_effort(parts: Split, data: Data) -> Split:
    effort = np.asarray(data.grids.effort)
    return Split(
        parts.train.with_effort(effort),
        parts.whole.with_effort(effort),
        parts.is_train,
        parts.is_held,
        parts.mask,
    )
