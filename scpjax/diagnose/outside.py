"""Names that do not reach the noise: are they false, and what is learned in their place or beyond them?"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from scpjax.diagnose.choice import Choice
from scpjax.diagnose.closure import Learned, learn, offers
from scpjax.diagnose.curve import Curve, bend, forms_named
from scpjax.diagnose.evidence import Evidence, ahead, at_its_least, is_better
from scpjax.diagnose.holdout import Split
from scpjax.diagnose.reaction import Reaction, reacting
from scpjax.diagnose.result import Latent
from scpjax.diagnose.trials import State, misfit, strained, without
from scpjax.fit.identifiability import at_limit, estimates, held_back, uncertainty
from scpjax.fit.solve import outputs_of

AT_NOISE = 1.15  # ratio of residual to noise, in some column, up to which nothing more is asked for
_LITTLE_LEFT = 0.05  # of the held-out misfit in excess of the noise: what names may leave unsought
_NEAR_NOISE = 4.0  # ratio of residual to noise, up to which what is left may be the form of a law
_MUCH = 0.2  # of the misfit: what names may leave that is still no matter of a law's form
_CLEARLY = 2.5  # ratio of residual to noise, above which names that leave much are false
_NO_SCALE = 100.0  # ratio of the base model's residual to noise, above which the noise is no scale for a law's error
_HALF = 0.5  # of the misfit: what names may leave there
_BEHIND = 0.05  # of the misfit in excess of the noise: by which a balance that is in question too may answer for less
_COMPLETE = 0.1  # of the misfit: what a closure alone may leave to be an explanation in place of names
_MOST = 0.25  # of the held-out misfit, up to which a closure may leave and say where it lies: half in root mean square
_FAR_BETTER = 0.5  # ratio of what it leaves to what the names leave, below which they are false
_TOLD = 1.96  # standard errors: a time that is less is not told from none
_MANY = 2.0  # times the evidence for a name, that a closure must be ahead of one which stands at an end
_HEATED = ("drive", "thermoelectric", "sensor")  # where names act that a reaction may look like, one by a heat

Beyond = Learned | Curve | Reaction
"""What is learned beyond names, or in their place."""


def level(state: State, parts: Split) -> float:
    """RMS misfit in units of the noise, in the column where it is greatest."""
    return float(np.sqrt(np.max(misfit(state, parts))))


def _unexplained(state: State, there: np.ndarray) -> float:
    """Sum of squares, of the samples ``there``, beyond what the noise makes."""
    return max(float(np.sum(state.residual[there] ** 2) - there.sum()), 0.0)


def _share_left(base: State, state: State, there: np.ndarray) -> float:
    """Of what the base model leaves beyond the noise, of the samples ``there``, the share that a hypothesis leaves."""
    return _unexplained(state, there) / max(_unexplained(base, there), 1e-300)


def able(lacking: Sequence[Latent], base: State, parts: Split) -> tuple[str, ...]:
    """Balances and sensors that can answer for the misfit of the base model nearly as well as the best of them."""
    there = parts.is_train | parts.is_held
    excess = _unexplained(base, there) / max(float(np.sum(base.residual[there] ** 2)), 1e-300)
    least = max(m.explained for m in lacking) - _BEHIND * excess
    return tuple(dict.fromkeys(balance_of(m.subsystem) for m in lacking if m.explained >= least))


def closure(state: State, parts: Split, rules: Evidence, where: Sequence[str] = ()) -> Beyond | None:
    """What is learned beyond a hypothesis: a form, or a reaction that uses itself up. Of those that come down to the
    noise what has more evidence, else what predicts better; None where neither is better than none.
    """
    reaction = reacting(state, parts, rules) if not where or "thermoelectric" in where else None
    found = [f for f in (form(state, parts, rules, where), reaction) if f is not None]
    whole = [f for f in found if level(f.state, parts) <= AT_NOISE]
    if whole:
        return max(whole, key=lambda f: ahead(f.state, state, parts, rules))
    return min(found, key=lambda f: _unexplained(f.state, parts.is_held), default=None)


def form(state: State, parts: Split, rules: Evidence, where: Sequence[str] = ()) -> Learned | Curve | None:
    """A curve of one variable if it comes down to the noise, else what predicts better, that or a sum of terms; None
    where neither is better than none.
    """
    curve = bend(state, parts, rules, where)
    if curve is not None and level(curve.state, parts) <= AT_NOISE:
        return curve
    found = [f for f in (learn(state, parts, rules, where), curve) if f is not None]
    return min(found, key=lambda f: _unexplained(f.state, parts.is_held), default=None)


def swings_within_bins(state: State, before: State, parts: Split) -> bool:
    """Whether a hypothesis misses the single samples by more than ``before`` does, which it was chosen beyond: the load
    may ring in it with a period that the bins, to which it was fitted, average out.
    """

    data = parts.whole

    def missed(s: State) -> float:
        error = np.asarray(outputs_of(s.trial, data, s.setup.space)) - np.asarray(data.outputs)
        return float(np.sum(np.asarray(data.weights) * (error / np.asarray(data.sigma)) ** 2))

    return not missed(state) <= missed(before)


def nothing_explains(base: State, choice: Choice, learned: Beyond | None, parts: Split) -> bool:
    """Whether something is missing, no name is given, and no closure takes away most of it."""
    if choice.state.names or choice.free or level(base, parts) <= AT_NOISE:
        return False
    return learned is None or not takes_most(base, learned.state, parts)


def takes_most(base: State, state: State, parts: Split) -> bool:
    """Whether a closure beyond the base model takes away so much of the misfit that it says where that lies."""
    held = parts.is_held
    return _unexplained(state, held) <= _MOST * _unexplained(base, held)


def form_at_most(base: State, state: State, parts: Split) -> bool:
    """Whether names leave so little that it may be what the true law's form differs by from theirs."""
    whole, left = (_unexplained(s, parts.is_held) for s in (base, state))
    return bool(state.names) and left <= _LITTLE_LEFT * whole


def beyond_names(
    parts: Split, base: State, choice: Choice, rules: Evidence, where: Sequence[str]
) -> tuple[Choice, Beyond | None]:
    """What is to be said when the named mechanisms do not reach the noise.

    Names are false if a closure without them does far better on the held-out misfit, and explains nearly all of it or
    they leave much; or if they leave much, of that or of what they were fitted to, that stands clearly above the noise,
    where that is so small that no simple law comes near it more than half; or if they ask for more than their laws
    allow; or, where they leave little, if one acts at once, or a single one stands at an end, and a closure alone does
    better. A closure is learned beyond the names that stay; in their balances, as a correction of their laws, where
    they leave little. A last name that came where little was left is false if such a correction does better in its
    place, and so is one of which beside the closure nothing stays.
    """
    alone = _instead_of_doubtful(base, choice.state, parts, rules) if form_at_most(base, choice.state, parts) else None
    if alone is not None:
        return outdone(choice, choice.state, base, parts), alone
    ends = _asking_for_more(choice.state, parts)
    if ends:
        fewer, learned = _without_them(parts, base, _fewer(choice, ends, base, parts), rules, where)
        return _told_of(fewer, choice, ends, base, parts), learned
    return _without_them(parts, base, choice, rules, where)


def _without_them(
    parts: Split, base: State, choice: Choice, rules: Evidence, where: Sequence[str]
) -> tuple[Choice, Beyond | None]:
    """What is to be said of names of which none asks for more than its law allows."""
    if level(choice.state, parts) <= AT_NOISE:
        return form_rather_than_name(parts, base, choice, rules)
    choice, learned = _beyond(parts, base, choice, rules, where)
    if learned is None:
        return choice, None
    corrected = form_at_most(base, choice.state, parts)  # which can do what the law it corrects does
    gone = [n for n in choice.state.names if _nothing_stays(learned.state, n, parts, at_least_only=corrected)]
    if not gone:
        return choice, learned
    return _beyond(parts, base, _fewer(choice, gone, base, parts), rules, where)


def _fewer(choice: Choice, gone: Sequence[str], base: State, parts: Split) -> Choice:
    """The choice without some of its names."""
    state = choice.state
    for name in gone:
        state = without(state, name, parts)
    return choice.with_only(state) if state.names else Choice(base, choice.ranking, {}, {})


def _told_of(choice: Choice, before: Choice, ends: tuple[str, ...], base: State, parts: Split) -> Choice:
    """The choice with what is told of names that asked for more than their laws allow."""
    names = before.state.names if not choice.state.names else ends
    left = _share_left(base, before.state, parts.is_held)
    return replace(choice, given_up=(names, left), overstretched=ends)


def outdone(before: Choice, best: State, base: State, parts: Split) -> Choice:
    """Nothing named, as what was learned in the place of the names, which led to ``best``, does better."""
    names = before.state.names or ((before.free,) if before.free else ())
    if not names:  # what was given up before stays told of
        return before
    left = _share_left(base, best, parts.is_held)
    return Choice(base, before.ranking, {}, {}, given_up=(names, left), outdone=True)


def _beyond(
    parts: Split, base: State, choice: Choice, rules: Evidence, where: Sequence[str]
) -> tuple[Choice, Beyond | None]:
    held = parts.is_held
    whole, left = _unexplained(base, held), _unexplained(choice.state, held)
    most = max(_share_left(base, choice.state, there) for there in (held, parts.is_train))
    if form_at_most(base, choice.state, parts):
        fewer, corrected = _corrected_rather_than_named(parts, base, choice, rules)
        if corrected is not None:
            return fewer, corrected
        corrected = None if level(choice.state, parts) > _NEAR_NOISE else _correction(choice.state, parts, rules)
        if corrected is not None and level(corrected.state, parts) <= AT_NOISE:
            return choice, corrected
        reaction = _one_reaction(base, choice.state, parts, rules)
        if reaction is not None:
            return outdone(choice, choice.state, base, parts), reaction
        return choice, corrected
    alone = closure(base, parts, rules, where)
    if not choice.state.names:
        return choice, alone
    much = left > _MUCH * whole
    by_closure = whole if alone is None else _unexplained(alone.state, held)
    better = by_closure < _FAR_BETTER * left and (much or by_closure < _COMPLETE * whole)
    allowed = _HALF if level(base, parts) > _NO_SCALE else _MUCH
    if better or (most > allowed and level(choice.state, parts) > _CLEARLY):
        return Choice(base, choice.ranking, {}, {}, given_up=(choice.state.names, most)), alone
    return choice, closure(choice.state, parts, rules)


def _nothing_stays(state: State, name: str, parts: Split, *, at_least_only: bool) -> bool:
    """Whether a name has come to nothing beside a closure: fitted to the least that counts as a strength, or to what
    the data do not tell from none (all its 95 % intervals hold zero).
    """
    if at_its_least(state, name) or at_least_only:
        return at_its_least(state, name)
    m, setup = state.setup.structure.mechanism(name), state.setup
    strengths = [p for p in m.free_parameters(m.laws.index(state.laws[name])) if p.null == 0.0]
    if not strengths or any(p.bounds[0] > 0.0 for p in strengths):  # on a logarithmic scale none is infinitely far
        return False
    found = estimates(state.trial, setup.space, uncertainty(state.trial, parts.train, setup.space))
    keys = [s.key for s in setup.structure.slots if s.mechanism == name and s.parameter in strengths]
    return all(found[key].low <= 0.0 <= found[key].high for key in keys)


def form_rather_than_name(parts: Split, base: State, choice: Choice, rules: Evidence) -> tuple[Choice, Beyond | None]:
    """What is to be said when the names reach the noise: a last name that came where little was left is false if a
    correction of the form of the others' laws has more evidence in its place and predicts better. So are all where one
    asks for more than its law allows or acts at once, if a closure that is none of them predicts better; a single one
    with a parameter at its end, if one does far better; and several about the heat of which a reaction alone does
    better.
    """
    ends = _asking_for_more(choice.state, parts)
    alone = _in_place_of(base, choice.state, parts, rules, _balances(choice.state)) if ends else None
    alone = alone or _instead_of_doubtful(base, choice.state, parts, rules)
    alone = alone or _one_reaction(base, choice.state, parts, rules)
    if alone is not None:
        return _told_of(Choice(base, choice.ranking, {}, {}, outdone=not ends), choice, ends, base, parts), alone
    fewer, corrected = _corrected_rather_than_named(parts, base, choice, rules)
    if corrected is None or not is_better(corrected.state, choice.state, parts, rules):
        return choice, None
    return fewer, corrected


def _asking_for_more(state: State, parts: Split) -> tuple[str, ...]:
    """Names of which a parameter with strict bounds stands at their end though the recordings determine it: something
    else is imitated.
    """
    slots, space = {s.key: s for s in state.setup.structure.slots}, state.setup.space
    if not any(s.parameter.strict and s.mechanism in state.names for s in slots.values()):
        return ()
    beyond = held_back(state.trial, space, uncertainty(state.trial, parts.train, space))
    found = {slots[key].mechanism for key in beyond if key in slots and slots[key].parameter.strict}
    return tuple(n for n in state.names if n in found)


def _acting_at_once(state: State, parts: Split) -> tuple[str, ...]:
    """Names of which a time stands at the lower end of its bounds, or is less than a bin and not told from none: what
    they delay is delayed by nothing that was recorded, and a force that follows the drive itself may be imitated.
    """
    setup, moves = state.setup, np.asarray(state.trial.active)
    times = [s for s in setup.structure.slots if s.parameter.time and moves[s.index]]
    quickest = at_limit(state.trial, setup.space) & (np.asarray(state.trial.free[:-1]) < 0.0)
    short = [s for s in times if s.mechanism in state.names and state.values[s.index] < _bin_width(parts)]
    if short:
        told = estimates(state.trial, setup.space, uncertainty(state.trial, parts.train, setup.space))
        for s in short:
            quickest[s.index] |= not told[s.key].value > _TOLD * told[s.key].std
    found = {s.mechanism for s in times if quickest[s.index]}
    return tuple(n for n in state.names if n in found)


def _bin_width(parts: Split) -> float:
    """Seconds, of the recording in which a bin is longest."""
    return float(np.max(np.asarray(parts.whole.grids.step))) * parts.whole.bin


def _instead_of_doubtful(base: State, state: State, parts: Split, rules: Evidence) -> Beyond | None:
    """A closure anywhere that explains the same as names one of which acts at once, and better; or as a single name of
    which a parameter stands at its end, where it has far more evidence too: that name may well be right, and of many
    closures the best one was taken.
    """
    at_once = bool(_acting_at_once(state, parts))
    if not (at_once or (len(state.names) == 1 and strained(state))):
        return None
    found = _in_place_of(base, state, parts, rules, as_well=at_once)
    return found if found is None or at_once or ahead(found.state, state, parts, rules) > _MANY * rules.bic else None


def _in_place_of(
    base: State, state: State, parts: Split, rules: Evidence, where: Sequence[str] = (), *, as_well: bool = False
) -> Beyond | None:
    """A closure ``where`` it may stand (anywhere when none is given) that is none of the names of a hypothesis, reaches
    the noise, and predicts the held-out stretches better. Such names being unlikely, it need not have more evidence;
    where it has, it is enough to predict them ``as_well``.
    """

    def predicts(s: State) -> bool:
        mine, its = (float(np.sum(h.residual[parts.is_held] ** 2)) for h in (s, state))
        return mine < its or (as_well and mine < its + rules.held_out and ahead(s, state, parts, rules) > 0.0)

    found: list[Beyond | None] = [f(base, parts, rules, where) for f in (bend, learn)]
    if not where or "thermoelectric" in where:
        found.append(reacting(base, parts, rules))
    able = [
        f
        for f in found
        if f is not None and level(f.state, parts) <= AT_NOISE and _is_none_of(f, state) and predicts(f.state)
    ]
    return max(able, key=lambda f: ahead(f.state, base, parts, rules), default=None)


def _one_reaction(base: State, state: State, parts: Split, rules: Evidence) -> Reaction | None:
    """A reaction alone that reaches the noise and does better than several names, or one that does not reach it, about
    the heat and its reading.
    """
    acting = {state.setup.structure.mechanism(n).subsystem for n in state.names}
    several = len(state.names) > 1 or level(state, parts) > AT_NOISE
    if not several or not acting <= {*_HEATED} or "thermoelectric" not in map(balance_of, acting):
        return None
    found = reacting(base, parts, rules)
    if found is None or level(found.state, parts) > AT_NOISE or not is_better(found.state, state, parts, rules):
        return None
    return found


def _is_none_of(learned: Beyond, state: State) -> bool:
    """Whether a closure depends on what no law of a name of ``state`` would: a term of it on other variables than a
    curve that is the name.
    """
    if isinstance(learned, Reaction):
        return True
    if isinstance(learned, Curve):
        return not set(learned.form.names) & set(state.names)
    named = [{form.factor, form.variable} - {""} for _, form in forms_named(state.names)]
    terms = {o.key: o.term for o in offers(learned.state.setup)}
    variables = [{v.replace("drive", "effort") for v in terms[key].variables} for key in learned.terms]
    return not all(v in named for v in variables)


def balance_of(subsystem: str) -> str:
    """Where a closure can stand for what is missing there: what the drive lacks the heat balance lacks."""
    return "thermoelectric" if subsystem == "drive" else subsystem


def _correction(state: State, parts: Split, rules: Evidence) -> Learned | Curve | None:
    """A form that is learned in the balances of the named mechanisms."""
    return form(state, parts, rules, _balances(state))


def _balances(state: State) -> list[str]:
    """Where the names of a hypothesis act."""
    return [balance_of(state.setup.structure.mechanism(n).subsystem) for n in state.names]


def _corrected_rather_than_named(
    parts: Split, base: State, choice: Choice, rules: Evidence
) -> tuple[Choice, Beyond | None]:
    """The names but the last, and a correction of their laws; no correction where the last name does better."""
    state = choice.state
    if len(state.names) < 2:
        return choice, None
    fewer = without(state, state.names[-1], parts)
    if not form_at_most(base, fewer, parts) or level(fewer, parts) > _NEAR_NOISE:
        return choice, None
    corrected = _correction(fewer, parts, rules)
    held = parts.is_held
    if corrected is None or _unexplained(corrected.state, held) >= _unexplained(state, held):
        return choice, None
    return choice.with_only(fewer), corrected
