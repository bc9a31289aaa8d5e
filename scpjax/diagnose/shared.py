"""Effects that a fleet shares: is what several actuators have one effect of the same size, and have the others it too?

Each actuator alone says what it lacks; weak in each, an effect may be known by all together, and what one actuator
cannot tell from something else another may.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace

import numpy as np
from scipy.special import chdtrc

from scpjax.diagnose.at_once import Shared, fit_at_once, held, keys
from scpjax.diagnose.evidence import Evidence, compare
from scpjax.diagnose.fleet import Member, effects
from scpjax.diagnose.holdout import Split
from scpjax.diagnose.hypothesis import State, grown, moved, moving, owned_by, reduced, residual_on, trial_at
from scpjax.diagnose.rebuilt import Actuator, rebuilt
from scpjax.diagnose.restated import powers_of
from scpjax.diagnose.trials import under_law
from scpjax.errors import ScpjaxError
from scpjax.fit.colour import Whitener
from scpjax.fit.fit import refine
from scpjax.fit.result import Estimate
from scpjax.fit.setup import UNKNOWN_POWER, Setup, laws_that_can_act
from scpjax.physics.catalogue import mechanism
from scpjax.recordings.recording import Recording

_APART = 0.01  # p-value of the same values in all, below which some have others
HAS_IT, HAS_NOT, OPEN = "has it", "has it not", "cannot be told"
"""What is said of an actuator in which a shared effect was not named."""


@dataclass(frozen=True)
class Sharing:
    """What a fleet shares; ``left_out``: why an actuator could not be asked, by name."""

    effects: tuple[SharedEffect, ...] = ()
    left_out: Mapping[str, str] = field(default_factory=dict)


@dataclass(frozen=True)
class Elsewhere:
    """A shared effect in an actuator in which it was not named: ``says`` whether it `HAS_IT`, by the ``evidence`` of
    all its samples, BIC of what was fitted and twice the log likelihood of what was held out: none of the shared values
    is fitted there. ``held_out_gain``: share by which the held-out RMS misfit falls; ``in_place_of``: what was named
    there and could stand in for it.
    """

    says: str
    evidence: float
    held_out_gain: float
    in_place_of: str = ""


@dataclass(frozen=True)
class SharedEffect:
    """An effect under one law in several actuators. ``actuators``: those that the same values serve, ``apart``: those
    that have it with values of their own. ``delta_bic``: of the same values against each its own; ``p``: of values that
    differ as much or more if all had the same (likelihood ratio). ``held_out``: RMS misfit of the held-out stretches of
    all in units of the noise, each with its own values and with the shared ones. ``references``: what ``parameters``
    are stated for.
    """

    name: str
    law: str
    actuators: tuple[str, ...]
    apart: tuple[str, ...]
    parameters: dict[str, Estimate]
    delta_bic: float
    p: float
    held_out: tuple[float, float]
    references: Mapping[str, float] = field(default_factory=dict)
    elsewhere: Mapping[str, Elsewhere] = field(default_factory=dict)

    @property
    def is_shared(self) -> bool:
        """Whether there is more evidence for the same values than for each its own."""
        return self.delta_bic > 0

    @property
    def says(self) -> str:
        """What is shared, or not, in a sentence."""
        what = f"{self.name} ({self.law})" if self.law else self.name
        if not self.is_shared:
            return f"{what} differs from actuator to actuator: one set of values does not serve all ({self._evidence})."
        values = ", ".join(
            f"{e.symbol or k} = {e.value:.3g} ({e.low:.3g} to {e.high:.3g}) {'' if e.unit == '1' else e.unit}".rstrip()
            for k, e in self.parameters.items()
        )
        beside = f"; with values of its own in {', '.join(self.apart)}" if self.apart else ""
        out = f"{what}: one set of values serves {len(self.actuators)} actuators, {values} ({self._evidence}){beside}."
        if where := self.having(HAS_IT):
            out += f" By these values it is also in {', '.join(where)}."
        if where := self.having(HAS_NOT):
            out += f" With these values it is not in {', '.join(where)}."
        return out

    @property
    def _evidence(self) -> str:
        chance = "p < 0.001" if self.p < 1e-3 else f"p = {self.p:.2g}"
        return f"BIC {self.delta_bic:+.3g} for it, {chance}"

    def having(self, says: str) -> tuple[str, ...]:
        """Actuators of which that is said."""
        return tuple(name for name, e in self.elsewhere.items() if e.says == says)


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
    actuators, left_out = [], {}
    for m in members:
        if m.content is None:
            continue
        tell(f"{m.name} as it was diagnosed")
        try:
            actuators.append(rebuilt(m.name, m.content, recordings[m.name]))
        except ScpjaxError as error:  # of one; the others are asked all the same
            left_out[m.name] = str(error)
    return Sharing(shared_effects(actuators, tell=tell), left_out)


def shared_effects(
    actuators: Sequence[Actuator], rules: Evidence | None = None, tell: Callable[[str], None] = lambda text: None
) -> tuple[SharedEffect, ...]:
    """Of every mechanism that two actuators or more have: whether the same values serve all, which they are with their
    errors, and whether the others have it too. What all recordings of an actuator do not share is left out, and what is
    known only up to an unknown power.
    """
    rules = rules or Evidence()
    names = dict.fromkeys(name for a in actuators for name in a.state.names)
    found = []
    for name in names:
        able = [a for a in actuators if name in a.state.names and _is_one(a, name)]
        if len(able) < 2:
            continue
        tell(f"{name.replace('_', ' ')} in {len(able)} actuators at once")
        law = _usual_law(able, name)
        members = _alike([_with_references(_under(a, name, law), name, _references(able, name)) for a in able], name)
        if len(members) < 2 or not _is_comparable(members, name):
            continue
        own = {a.name: a for a in able}
        effect, shared = _served(members, own, name)
        others = [a for a in actuators if name not in a.state.names] if effect.is_shared else []
        elsewhere = {}
        for a in others:
            tell(f"{name.replace('_', ' ')} in {a.name}")
            elsewhere[a.name] = _elsewhere(a, effect, shared.inner, rules)
        found.append(replace(effect, elsewhere=elsewhere))
    return tuple(found)


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


def _alike(members: Sequence[Actuator], name: str) -> list[Actuator]:
    """Those that have a mechanism as most do: under the same law, with the same drive, by side or not."""
    have = [(keys(a.state, name), a.state.laws[name], a.state.setup.structure.drive) for a in members]
    usual = max(dict.fromkeys(have), key=have.count)
    return [a for a, mine in zip(members, have, strict=True) if mine == usual]


def _is_comparable(members: Sequence[Actuator], name: str) -> bool:
    """Whether the values of a mechanism mean the same in all: not in watts or joules of a power that is not known."""
    state = members[0].state
    m = state.setup.structure.mechanism(name)
    units = [p.unit for p in m.free_parameters(m.laws.index(state.laws[name]))]
    unknown = any(n.startswith(UNKNOWN_POWER) for a in members for n in a.state.setup.notes)
    return not (unknown and any(u.startswith(("W", "J")) for u in units))


def _served(members: list[Actuator], own: Mapping[str, Actuator], name: str) -> tuple[SharedEffect, Shared]:
    """What the same values do for actuators, and those values. Where all having the same is unlikely, without the one
    that asks most for its own, until it is not; but for half of them nothing is shared, and it is told of all.
    """
    everyone = first = _together(members, own, name)
    left, apart = list(members), []
    while first[0].p < _APART and len(left) > max(2, len(members) // 2 + 1):
        asks = [_asks(own[a.name], s)[0] for a, s in zip(left, first[1].states, strict=True)]
        apart.append(left.pop(int(np.argmax(asks))).name)
        first = _together(left, own, name)
    effect, shared = first if first[0].p >= _APART else everyone
    return (replace(effect, apart=tuple(apart)), shared) if first[0].p >= _APART else everyone


def _together(members: Sequence[Actuator], own: Mapping[str, Actuator], name: str) -> tuple[SharedEffect, Shared]:
    """Actuators with the same values of a mechanism, against each with its own."""
    shared = fit_at_once([a.state for a in members], [a.parts for a in members], name)
    asks = [_asks(own[a.name], s) for a, s in zip(members, shared.states, strict=True)]
    number, count = len(shared.inner), [n for _, n in asks]
    lost = sum(gain for gain, _ in asks)
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
        float(chdtrc(max(sum(free) - number, 1), max(lost, 0.0))),
        (_held_out([own[a.name].state for a in members], members), _held_out(shared.states, members)),
        {r: float(state.values[where[f"{name}.{r}"][0]]) for r in fixed},
    )
    return effect, shared


def _held_out(states: Sequence[State], actuators: Sequence[Actuator]) -> float:
    """RMS residual of the held-out stretches of all, in units of the noise."""
    every = [s.residual[a.parts.is_held] for s, a in zip(states, actuators, strict=True)]
    return float(np.sqrt(np.mean(np.concatenate(every) ** 2)))


def _asks(own: Actuator, state: State) -> tuple[float, int]:
    """(fall of the training part's sum of squares by values of its own instead of shared ones, in units of what is left
    of it, of so many samples).
    """
    there = own.parts.is_train
    white = Whitener.learn(own.state.residual, there)
    (without, n), (with_own, _) = (white(s.residual, there) for s in (state, own.state))
    return (without - with_own) / max(with_own / max(n, 1), white.floor), n


def _elsewhere(a: Actuator, effect: SharedEffect, inner: np.ndarray, rules: Evidence) -> Elsewhere:
    """What shared values do in an actuator in which the effect was not named: beside what was, or in the place of what
    could stand in for it.
    """
    m, state = mechanism(effect.name), a.state
    instead = next((n for n, others in a.stand_ins.items() if effect.name in others and n in state.names), "")
    setup = reduced(state.setup, instead) if instead else state.setup
    problem = grown(setup, m)
    law = m.laws.index(effect.law)
    if law not in laws_that_can_act(problem, m):
        return Elsewhere(OPEN, 0.0, 0.0, instead)
    begun = _begun(state, problem, effect)
    if tuple(key.split(".", 1)[1] for key in keys(begun[0], m.name)) != tuple(effect.parameters):  # by side there
        return Elsewhere(OPEN, 0.0, 0.0, instead)
    best = min((held(b, a.parts, m.name, inner) for b in begun), key=lambda s: s.cost)
    extra = moving(best) - len(inner) - moving(state)  # the shared values are not of this actuator
    found = compare(state, best, "", effect.law, a.parts, rules, extra)
    evidence = found.delta_bic + found.held_out_excess
    says = HAS_IT if evidence > rules.bic else HAS_NOT if evidence < -rules.bic else OPEN
    return Elsewhere(says, evidence, found.held_out_gain, instead)


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
