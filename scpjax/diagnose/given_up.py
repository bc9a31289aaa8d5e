"""Names given up: those that do not reach the noise, or only as something else would; and what is said instead."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

from scpjax.diagnose.beyond import Beyond, balances, closure, correction, in_place_of, one_reaction
from scpjax.diagnose.choice import Choice
from scpjax.diagnose.doubtful import acting_at_once, asking_for_more, impossible, nothing_stays, strained
from scpjax.diagnose.evidence import Evidence, ahead, is_better
from scpjax.diagnose.holdout import Split
from scpjax.diagnose.hypothesis import State
from scpjax.diagnose.patience import ENDLESS, Patience
from scpjax.diagnose.remainder import (
    AT_NOISE,
    MUCH,
    form_at_most,
    leaves_much,
    level,
    missed,
    share_left,
    takes_most,
    unexplained,
)
from scpjax.diagnose.trials import without

_NEAR_NOISE = 4.0  # ratio of residual to noise, up to which what is left may be the form of a law
_SOMEWHAT = 0.1  # of the held-out misfit, that may stay without a last name where a correction explains all of it
_COMPLETE = 0.1  # of the misfit: what a closure alone may leave to be an explanation in place of names
_FAR_BETTER = 0.5  # ratio of what it leaves to what the names leave, below which they are false
_MANY = 2.0  # times the evidence for a name, that a closure must be ahead of one which stands at an end


def nothing_explains(base: State, choice: Choice, learned: Beyond | None, parts: Split) -> bool:
    """Whether something is missing, no name is given, and no closure takes away most of it."""
    if choice.state.names or choice.free or level(base, parts) <= AT_NOISE:
        return False
    return learned is None or not takes_most(base, learned.state, parts)


def beyond_names(
    parts: Split, base: State, choice: Choice, rules: Evidence, where: Sequence[str], patience: Patience = ENDLESS
) -> tuple[Choice, Beyond | None]:
    """What is to be said when the named mechanisms do not reach the noise; late by ``patience`` nothing
    is learned beyond those that stay, nor a correction of their laws.

    Names are false if a closure without them does far better on the held-out misfit, and explains nearly all of it or
    they leave much; or if they leave much clearly above the noise (`leaves_much`); or if they ask for more than their
    laws allow; or, where they leave little, if one acts at once, or a single one stands at an end, and a closure alone
    does better. A closure is learned beyond the names that stay; in their balances, as a correction of their laws,
    where they leave little near the noise. A last name that came where little was left, or a little more if the names
    miss the noise and it does not, is false if such a correction does better in its place, and so is one of which
    beside the closure nothing stays.
    """
    alone = _instead_of_doubtful(base, choice.state, parts, rules) if form_at_most(base, choice.state, parts) else None
    if alone is not None:
        return outdone(choice, choice.state, base, parts), alone
    ends = asking_for_more(choice.state, parts)
    if ends:
        fewer, learned = _without_them(parts, base, _fewer(choice, [*ends], base, parts), rules, where, patience)
        return _told_of(fewer, choice, ends, base, parts), learned
    return _without_them(parts, base, choice, rules, where, patience)


def _without_them(
    parts: Split, base: State, choice: Choice, rules: Evidence, where: Sequence[str], patience: Patience
) -> tuple[Choice, Beyond | None]:
    """What is to be said of names of which none asks for more than its law allows."""
    if level(choice.state, parts) <= AT_NOISE:
        return form_rather_than_name(parts, base, choice, rules, patience)
    choice, learned = _beyond(parts, base, choice, rules, where, patience)
    if learned is None:
        return choice, None
    near = level(choice.state, parts) <= _NEAR_NOISE
    corrected = near and form_at_most(base, choice.state, parts)  # which can do what the law it corrects does
    gone = [n for n in choice.state.names if nothing_stays(learned.state, n, parts, at_least_only=corrected)]
    if not gone:
        return choice, learned
    return _beyond(parts, base, _fewer(choice, gone, base, parts), rules, where, ENDLESS)  # as it was learned for all


def _fewer(choice: Choice, gone: Sequence[str], base: State, parts: Split) -> Choice:
    """The choice without some of its names."""
    state = choice.state
    for name in gone:
        state = without(state, name, parts)
    return choice.with_only(state) if state.names else Choice(base, choice.ranking, {}, {})


def _told_of(choice: Choice, before: Choice, ends: dict[str, tuple[str, ...]], base: State, parts: Split) -> Choice:
    """The choice with what is told of names that asked for more than their laws allow."""
    names = before.state.names if not choice.state.names else tuple(ends)
    left = share_left(base, before.state, parts.is_held)
    return replace(choice, given_up=(names, left), overstretched=choice.overstretched | ends)


def outdone(before: Choice, best: State, base: State, parts: Split) -> Choice:
    """Nothing named, as what was learned in the place of the names, which led to ``best``, does better."""
    names = before.state.names or ((before.free,) if before.free else ())
    if not names:  # what was given up before stays told of
        return before
    left = share_left(base, best, parts.is_held)
    return Choice(base, before.ranking, {}, {}, given_up=(names, left), outdone=True)


def _beyond(
    parts: Split, base: State, choice: Choice, rules: Evidence, where: Sequence[str], patience: Patience
) -> tuple[Choice, Beyond | None]:
    whole, left = (missed(base, s, parts) for s in (base, choice.state))
    most = max(left / max(whole, 1e-300), share_left(base, choice.state, parts.is_train))
    if form_at_most(base, choice.state, parts):
        fewer, corrected = _corrected_rather_than_named(parts, base, choice, rules, patience)
        if corrected is not None:
            return fewer, corrected
        near = level(choice.state, parts) <= _NEAR_NOISE
        corrected = correction(choice.state, parts, rules, patience) if near else None
        if corrected is not None and level(corrected.state, parts) <= AT_NOISE:
            return choice, corrected
        reaction = one_reaction(base, choice.state, parts, rules, patience)
        if reaction is not None:
            return outdone(choice, choice.state, base, parts), reaction
        return choice, corrected if near else closure(choice.state, parts, rules, patience=patience)
    decides = bool(choice.state.names) and not leaves_much(base, choice.state, parts)  # whether they are told
    alone = closure(base, parts, rules, where, patience=ENDLESS if decides else patience)
    if not choice.state.names:
        return choice, alone
    much = left > MUCH * whole
    by_closure = whole if alone is None else missed(base, alone.state, parts)
    better = by_closure < _FAR_BETTER * left and (much or by_closure < _COMPLETE * whole)
    if better or leaves_much(base, choice.state, parts):
        return Choice(base, choice.ranking, {}, {}, given_up=(choice.state.names, most)), alone
    return choice, closure(choice.state, parts, rules, patience=patience)


def form_rather_than_name(
    parts: Split, base: State, choice: Choice, rules: Evidence, patience: Patience = ENDLESS
) -> tuple[Choice, Beyond | None]:
    """What is to be said when the names reach the noise: a last name that came where little was left is false if a
    correction of the form of the others' laws has more evidence in its place and predicts better. So are all where one
    asks for more than its law allows or acts at once, if a closure that is none of them predicts better, or for more
    than nature allows, if one predicts as well; a single one with a parameter at its end, if one does far better; and
    several about the heat of which a reaction alone does better.
    """
    ends = asking_for_more(choice.state, parts)
    never = impossible(choice.state, parts)
    ends |= {n: (*ends.get(n, ()), *what) for n, what in never.items()}
    where = balances(choice.state)
    alone = in_place_of(base, choice.state, parts, rules, where, impossible=bool(never)) if ends else None
    alone = alone or _instead_of_doubtful(base, choice.state, parts, rules)
    alone = alone or one_reaction(base, choice.state, parts, rules, patience)
    if alone is not None:
        return _told_of(Choice(base, choice.ranking, {}, {}, outdone=not ends), choice, ends, base, parts), alone
    fewer, corrected = _corrected_rather_than_named(parts, base, choice, rules, patience)
    if corrected is None or not is_better(corrected.state, choice.state, parts, rules):
        return (replace(choice, overstretched=never) if never else choice), None
    return fewer, corrected


def _instead_of_doubtful(base: State, state: State, parts: Split, rules: Evidence) -> Beyond | None:
    """A closure anywhere that explains the same as names one of which acts at once, and better; or as a single name of
    which a parameter stands at its end, where it has far more evidence too: that name may well be right, and of many
    closures the best one was taken.
    """
    at_once = bool(acting_at_once(state, parts))
    if not (at_once or (len(state.names) == 1 and strained(state))):
        return None
    found = in_place_of(base, state, parts, rules, as_well=at_once)
    return found if found is None or at_once or ahead(found.state, state, parts, rules) > _MANY * rules.bic else None


def _corrected_rather_than_named(
    parts: Split, base: State, choice: Choice, rules: Evidence, patience: Patience
) -> tuple[Choice, Beyond | None]:
    """The names but the last, and a correction of their laws, where they leave little, at most 4 times the noise; no
    correction where the last name does better. They may leave up to a tenth of the held-out misfit, in place of a
    twentieth, where all names miss the noise and the correction reaches it.
    """
    state = choice.state
    if len(state.names) < 2:
        return choice, None
    fewer, held = without(state, state.names[-1], parts), parts.is_held
    little = form_at_most(base, fewer, parts)
    somewhat = level(state, parts) > AT_NOISE and share_left(base, fewer, held) <= _SOMEWHAT
    if not (little or somewhat) or level(fewer, parts) > _NEAR_NOISE:
        return choice, None
    corrected = correction(fewer, parts, rules, patience)
    if corrected is None or unexplained(corrected.state, held) >= unexplained(state, held):
        return choice, None
    if not little and level(corrected.state, parts) > AT_NOISE:
        return choice, None
    return choice.with_only(fewer), corrected
