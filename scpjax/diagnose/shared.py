"""Effects that a fleet shares: is what several actuators have one effect of the same size, and have the others it too?

Each actuator alone says what it lacks; weak in each, an effect may be known by all together, and what one actuator
cannot tell from something else another may.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace

import numpy as np
from scipy.special import chdtrc

from scpjax.diagnose.at_once import Shared, fit_at_once, held, keys
from scpjax.diagnose.evidence import Evidence, compare
from scpjax.diagnose.fleet import Member, effects
from scpjax.diagnose.holdout import Split
from scpjax.diagnose.hypothesis import State, grown, moved, moving, owned_by, reduced, residual_on, trial_at
from scpjax.diagnose.rebuilt import Actuator, rebuilt
from scpjax.diagnose.restated import powers_of
from scpjax.diagnose.shared_effect import APART, HAS_IT, HAS_NOT, OPEN, Elsewhere, SharedEffect, Sharing
from scpjax.diagnose.trials import under_law
from scpjax.errors import ScpjaxError
from scpjax.fit.colour import Whitener
from scpjax.fit.fit import refine
from scpjax.fit.setup import UNKNOWN_POWER, Setup, what_there_is
from scpjax.fit.solve import make_room
from scpjax.physics.catalogue import applicable, mechanism
from scpjax.recordings.recording import Recording

_ELECTRIC = {"electric", "voltage", "current"}  # needs of what acts on the drive, whose values are in its unit


def sharing(
    members: Sequence[Member],
    recordings: Mapping[str, Sequence[Recording]],
    tell: Callable[[str], None] = lambda text: None,
) -> Sharing:
    """What diagnosed actuators share, each fitted again to its ``recordings``; nothing where no mechanism was named in
    two.
    """
    if not any(len(names) > 1 for names in effects(members).values()):
        return Sharing()
    actuators: list[Actuator] = []
    left_out: dict[str, str] = {}
    for m in members:
        if m.content is None:
            continue
        tell(f"{m.name} as it was diagnosed")
        make_room()
        try:
            actuators.append(rebuilt(m.name, m.content, recordings[m.name]))
        except (ScpjaxError, np.linalg.LinAlgError) as error:  # of one; the others are asked all the same
            left_out[m.name] = str(error)
    found = shared_effects(actuators, tell=tell)
    return Sharing(found.effects, {**left_out, **found.left_out})


def shared_effects(
    actuators: Sequence[Actuator], rules: Evidence | None = None, tell: Callable[[str], None] = lambda text: None
) -> Sharing:
    """Of every mechanism that two actuators or more have: whether the same values serve all, which they are with their
    errors, and whether the others have it too. Left out, with the reason, is what the recordings of an actuator do not
    share among themselves, what is stated in another unit, under a law that cannot act, or up to an unknown power.
    """
    rules = rules or Evidence()
    names = dict.fromkeys(name for a in actuators for name in a.state.names)
    found: list[SharedEffect] = []
    left: dict[str, str] = {}
    for name in names:
        have = [a for a in actuators if name in a.state.names]
        if len(have) < 2:
            continue
        tell(f"{name.replace('_', ' ')} in {len(have)} actuators at once")
        make_room()
        try:
            effect = _effect(have, [a for a in actuators if a not in have], name, rules, left, tell)
        except (ScpjaxError, np.linalg.LinAlgError) as error:  # of one effect; the others are asked all the same
            left[name] = str(error)
            continue
        found += [effect] if effect else []
    return Sharing(tuple(found), left)


def _effect(
    have: Sequence[Actuator],
    others: Sequence[Actuator],
    name: str,
    rules: Evidence,
    left: dict[str, str],
    tell: Callable[[str], None],
) -> SharedEffect | None:
    """What those that ``have`` a mechanism share of it, asked of the ``others``; ``left`` collects who was not asked.
    None where fewer than two can be.
    """

    def leave(apart: Sequence[Actuator], why: str) -> None:
        left.update({f"{name} in {a.name}": why for a in apart})

    able = [a for a in have if _is_one(a, name)]
    leave([a for a in have if a not in able], "it differs by recording there")
    if len(able) < 2:
        return None
    law = _usual_law(able, name)
    under = [_under(a, name, law) for a in able]
    usual = _usual([_form(a.state, name) for a in under])
    members = [a for a in under if _form(a.state, name) == usual]
    leave([a for a in under if a not in members], "its law, its sides or the unit of its drive differ from the others'")
    if _is_scaled(members, name):
        leave(members, "it is known only up to the power that the drive makes")
        return None
    if len(members) < 2:
        return None
    references = _references(members, name)
    effect, shared = _served([_with_references(a, name, references) for a in members], {a.name: a for a in able}, name)
    elsewhere = {}
    for a in others if effect.is_shared else ():
        tell(f"{name.replace('_', ' ')} in {a.name}")
        make_room()
        elsewhere[a.name] = _elsewhere(a, effect, shared.inner, members, rules)
    return replace(effect, elsewhere=elsewhere)


def _is_one(a: Actuator, name: str) -> bool:
    """Whether a mechanism has the same values in all recordings of an actuator."""
    return not any(key.split(".")[0] == name for key in a.state.setup.structure.own)


def _usual_law(able: Sequence[Actuator], name: str) -> str:
    """The law under which most have a mechanism; of several the first."""
    laws = [a.state.laws[name] for a in able]
    return max(dict.fromkeys(laws), key=laws.count)


def _under(a: Actuator, name: str, law: str) -> Actuator:
    """The actuator with a mechanism under a law, fitted again if it has another; as it is where that cannot act."""
    if a.state.laws[name] == law:
        return a
    return replace(a, state=under_law(a.state, name, law, a.parts) or a.state)


def _references(able: Sequence[Actuator], name: str) -> dict[str, float]:
    """The fixed numbers, in the middle of all actuators, for which a mechanism's values are stated."""
    fixed = [p.name for p in mechanism(name).parameters if p.fixed and p.name.startswith("reference")]
    where = [a.state.setup.structure.where for a in able]
    return {
        r: float(np.median([a.state.values[w[f"{name}.{r}"][0]] for a, w in zip(able, where, strict=True)]))
        for r in fixed
    }


def _with_references(a: Actuator, name: str, references: Mapping[str, float]) -> Actuator:
    """The actuator with a mechanism stated for these references, fitted again where they are not its own."""
    state, setup = a.state, a.state.setup
    where, law = setup.structure.where, state.laws[name]
    value, before = state.values, {r: state.values[where[f"{name}.{r}"]][0] for r in references}
    if before == dict(references):
        return a
    m = setup.structure.mechanism(name)
    for p in m.free_parameters(m.laws.index(law)):
        powers = powers_of(f"{name}.{p.name}", law) or {}
        value[where[f"{name}.{p.name}"]] *= np.prod([(before[r] / references[r]) ** n for r, n in powers.items()])
    return replace(a, state=_fitted(state, a.parts, value, _fixing(setup.fixed, where, name, references)))


def _fixing(
    fixed: np.ndarray, where: Mapping[str, np.ndarray], name: str, references: Mapping[str, float]
) -> np.ndarray:
    fixed = fixed.copy()
    for r, number in references.items():
        fixed[where[f"{name}.{r}"]] = number
    return fixed


def _fitted(state: State, parts: Split, value: np.ndarray, fixed: np.ndarray) -> State:
    """A hypothesis fitted to the training part from some values, with others held."""
    setup = replace(state.setup, fixed=fixed)
    trial, _, cost = refine(setup, parts.train, trial_at(setup, value, np.asarray(state.trial.laws)))
    return State(setup, trial, residual_on(trial, parts.whole, setup), cost)


def _form(state: State, name: str) -> tuple[object, ...]:
    """What is the same wherever values of a mechanism mean the same: its law, its parameters (by side, or not), their
    units, and of what acts on the drive, what that is.
    """
    structure, m = state.setup.structure, state.setup.structure.mechanism(name)
    law = m.laws.index(state.laws[name])
    drive = structure.drive if _ELECTRIC & {*m.needs, *m.law_needs.get(law, ())} else ""
    units = tuple(structure.unit_of(p) for p in m.free_parameters(law))
    return keys(state, name), state.laws[name], units, drive


def _usual(forms: Sequence[tuple[object, ...]]) -> tuple[object, ...]:
    return max(dict.fromkeys(forms), key=forms.count)


def _is_scaled(members: Sequence[Actuator], name: str) -> bool:
    """Whether the values of a mechanism are in watts or joules, and the power of one actuator is not known."""
    state = members[0].state
    m = state.setup.structure.mechanism(name)
    units = [p.unit for p in m.free_parameters(m.laws.index(state.laws[name]))]
    unknown = any(n.startswith(UNKNOWN_POWER) for a in members for n in a.state.setup.notes)
    return unknown and any(u.startswith(("W", "J")) for u in units)


def _served(members: list[Actuator], own: Mapping[str, Actuator], name: str) -> tuple[SharedEffect, Shared]:
    """What the same values do for actuators, and those values. Where all having the same is unlikely, without the one
    that asks most for its own, until it is not; but for half of them nothing is shared, and it is told of all.
    """
    everyone = first = _together(members, own, name)
    left, apart = list(members), []
    while first[0].p < APART and len(left) > max(2, len(members) // 2 + 1):
        apart.append(left.pop(_farthest(left, own, first[1])).name)
        first = _together(left, own, name)
    if first[0].p < APART:
        return everyone
    return replace(first[0], apart=tuple(apart)), first[1]


def _farthest(members: Sequence[Actuator], own: Mapping[str, Actuator], shared: Shared) -> int:
    """Which actuator asks most for values of its own, by what it would ask for if it had no part in the shared ones."""
    total = np.linalg.pinv(sum(shared.information), hermitian=True)
    part = [float(np.trace(i @ total)) / len(shared.inner) for i in shared.information]
    asks = [_asks(own[a.name], s)[0] for a, s in zip(members, shared.states, strict=True)]
    return int(np.argmax([ask / max(1.0 - h, 1e-3) for ask, h in zip(asks, part, strict=True)]))


def _together(members: Sequence[Actuator], own: Mapping[str, Actuator], name: str) -> tuple[SharedEffect, Shared]:
    """Actuators with the same values of a mechanism, against each with its own."""
    shared = fit_at_once([a.state for a in members], [a.parts for a in members], name)
    asks = [_asks(own[a.name], s) for a, s in zip(members, shared.states, strict=True)]
    number, count = len(shared.inner), [n for _, n in asks]
    lost = max(sum(gain for gain, _ in asks), 0.0)
    free = [len(keys(own[a.name].state, name)) for a in members]
    delta = float(np.dot(free, np.log(count)) - number * np.log(sum(count)) - lost)
    state = members[0].state
    where = state.setup.structure.where
    fixed = [p.name for p in mechanism(name).parameters if p.fixed and p.name.startswith("reference")]
    effect = SharedEffect(
        name,
        state.laws[name],
        tuple(a.name for a in members),
        (),
        shared.estimates,
        delta,
        float(chdtrc(max(sum(free) - number, 1), lost)),
        (_held_out([own[a.name].state for a in members], members), _held_out(shared.states, members)),
        {r: float(state.values[where[f"{name}.{r}"][0]]) for r in fixed},
    )
    return effect, shared


def _held_out(states: Sequence[State], actuators: Sequence[Actuator]) -> float:
    """RMS residual of the held-out stretches of all, in units of the noise; no number where nothing is held out."""
    every = np.concatenate([s.residual[a.parts.is_held] for s, a in zip(states, actuators, strict=True)])
    return float(np.sqrt(np.mean(every**2))) if every.size else float("nan")


def _asks(own: Actuator, state: State) -> tuple[float, int]:
    """(fall of the training part's sum of squares by values of its own instead of shared ones, in units of what is left
    of it, of so many samples).
    """
    there = own.parts.is_train
    white = Whitener.learn(own.state.residual, there)
    (without, n), (with_own, _) = (white(s.residual, there) for s in (state, own.state))
    return (without - with_own) / max(with_own / max(n, 1), white.floor), n


def _elsewhere(
    a: Actuator, effect: SharedEffect, inner: np.ndarray, members: Sequence[Actuator], rules: Evidence
) -> Elsewhere:
    """What shared values do in an actuator in which the effect was not named: beside what was, and in the place of what
    could stand in for it; of these what has more evidence.
    """
    m, state = mechanism(effect.name), a.state
    instead = [n for n, others in a.stand_ins.items() if effect.name in others and n in state.names]
    found: list[Elsewhere] = []
    for place in ("", *instead):
        problem = grown(reduced(state.setup, place) if place else state.setup, m)
        if not applicable(m, what_there_is(problem.structure, problem.recordings), m.laws.index(effect.law)):
            return Elsewhere(OPEN, why="it cannot act there, or not be seen")
        begun = _begun(state, problem, effect)
        if _form(begun[0], m.name) != _form(members[0].state, m.name) or _is_scaled([*members, a], m.name):
            return Elsewhere(OPEN, why="its values would mean something else there")
        fitted = [after for b in begun if (after := held(b, a.parts, m.name, inner)) is not None]
        if not fitted:
            return Elsewhere(OPEN, why="its values are beyond what they may be there")
        best = min(fitted, key=lambda s: s.cost)
        what = compare(state, best, "", effect.law, a.parts, rules, moving(best) - moving(state))
        evidence = what.delta_bic + what.held_out_excess
        says = HAS_IT if evidence > rules.bic else HAS_NOT if evidence < -rules.bic else OPEN
        found.append(Elsewhere(says, evidence, what.held_out_gain, place))
    return max(found, key=lambda e: e.evidence)


def _begun(state: State, problem: Setup, effect: SharedEffect) -> list[State]:
    """A hypothesis with a shared effect before it is fitted: all else where it stands; and, as the base may have been
    bent to imitate it, the base as the data suggested at first.
    """
    m, where = problem.structure.mechanism(effect.name), problem.structure.where
    fixed = _fixing(problem.fixed, where, m.name, effect.references)
    problem = replace(problem, fixed=fixed)
    value, laws = moved(state, problem)
    laws[problem.structure.mechanisms.index(m)] = m.laws.index(effect.law)
    fresh = np.where(owned_by(problem, state.names, len(value)), value, np.asarray(problem.starts[0]))
    nothing = np.full_like(state.residual, np.inf)
    return [State(problem, trial_at(problem, v, laws), nothing, np.inf) for v in (value, fresh)]
