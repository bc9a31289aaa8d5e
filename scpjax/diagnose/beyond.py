"""What is learned beyond names, or in their place: a form of the law, a curve, a reaction that uses itself up, or what
swings along.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from scpjax.diagnose.closure import Learned, learn, offers
from scpjax.diagnose.curve import Curve, bend, forms_named
from scpjax.diagnose.evidence import Evidence, ahead, is_better
from scpjax.diagnose.holdout import Split
from scpjax.diagnose.hypothesis import State
from scpjax.diagnose.mode import Mode, carried_along
from scpjax.diagnose.patience import ENDLESS, Patience
from scpjax.diagnose.reaction import Reaction, reacting
from scpjax.diagnose.remainder import AT_NOISE, level, unexplained
from scpjax.diagnose.result import Latent

_BEHIND = 0.05  # of the misfit in excess of the noise: by which a balance that is in question too may answer for less
_HEATED = ("drive", "thermoelectric", "sensor")  # where names act that a reaction may look like, one by a heat

Beyond = Learned | Curve | Reaction | Mode
"""What is learned beyond names, or in their place."""


def able(lacking: Sequence[Latent], base: State, parts: Split) -> tuple[str, ...]:
    """Balances and sensors that can answer for the misfit of the base model nearly as well as the best of them."""
    there = parts.is_train | parts.is_held
    excess = unexplained(base, there) / max(float(np.sum(base.residual[there] ** 2)), 1e-300)
    least = max(m.explained for m in lacking) - _BEHIND * excess
    return tuple(dict.fromkeys(balance_of(m.subsystem) for m in lacking if m.explained >= least))


def closure(
    state: State, parts: Split, rules: Evidence, where: Sequence[str] = (), patience: Patience = ENDLESS
) -> Beyond | None:
    """What is learned beyond a hypothesis: a form, a reaction that uses itself up, or what swings along. Of those that
    come down to the noise what has more evidence, else what predicts better; None where none is better than none. Here
    and below nothing is begun any more once it is late by ``patience``.
    """
    tried = (form(state, parts, rules, where, patience), *_with_states(state, parts, rules, where, patience))
    found = [f for f in tried if f is not None]
    whole = [f for f in found if level(f.state, parts) <= AT_NOISE]
    if whole:
        return max(whole, key=lambda f: ahead(f.state, state, parts, rules))
    return min(found, key=lambda f: unexplained(f.state, parts.is_held), default=None)


def _with_states(
    state: State, parts: Split, rules: Evidence, where: Sequence[str], patience: Patience
) -> list[Reaction | Mode | None]:
    """Closures with states of their own, where they may stand (anywhere when that is not said)."""
    able: list[Reaction | Mode | None] = []
    if not where or "thermoelectric" in where:
        able.append(reacting(state, parts, rules, patience))
    if not where or "thermomechanical" in where:
        able.append(carried_along(state, parts, rules, patience))
    return able


def form(
    state: State, parts: Split, rules: Evidence, where: Sequence[str] = (), patience: Patience = ENDLESS
) -> Learned | Curve | None:
    """A curve of one variable if it comes down to the noise, else what predicts better, that or a sum of terms; None
    where neither is better than none.
    """
    curve = bend(state, parts, rules, where, patience)
    if curve is not None and level(curve.state, parts) <= AT_NOISE:
        return curve
    found = [f for f in (learn(state, parts, rules, where, patience), curve) if f is not None]
    return min(found, key=lambda f: unexplained(f.state, parts.is_held), default=None)


def correction(state: State, parts: Split, rules: Evidence, patience: Patience = ENDLESS) -> Learned | Curve | None:
    """A form that is learned in the balances of the named mechanisms."""
    return form(state, parts, rules, balances(state), patience)


def in_place_of(
    base: State,
    state: State,
    parts: Split,
    rules: Evidence,
    where: Sequence[str] = (),
    *,
    as_well: bool = False,
    impossible: bool = False,
) -> Beyond | None:
    """A closure ``where`` it may stand (anywhere when none is given) that is none of the names of a hypothesis, reaches
    the noise, and predicts the held-out stretches better. Such names being unlikely, it need not have more evidence;
    where it has, it is enough to predict them ``as_well``, and of ``impossible`` names whatever evidence it has.
    """

    def predicts(s: State) -> bool:
        mine, its = (float(np.sum(h.residual[parts.is_held] ** 2)) for h in (s, state))
        enough = impossible or (as_well and ahead(s, state, parts, rules) > 0.0)
        return mine < its or (enough and mine < its + rules.held_out)

    found: list[Beyond | None] = [f(base, parts, rules, where) for f in (bend, learn)]
    found += _with_states(base, parts, rules, where, ENDLESS)
    able = [
        f
        for f in found
        if f is not None and level(f.state, parts) <= AT_NOISE and _is_none_of(f, state) and predicts(f.state)
    ]
    return max(able, key=lambda f: ahead(f.state, base, parts, rules), default=None)


def one_reaction(
    base: State, state: State, parts: Split, rules: Evidence, patience: Patience = ENDLESS
) -> Reaction | None:
    """A reaction alone that reaches the noise and does better than several names, or one that does not reach it, about
    the heat and its reading.
    """
    acting = {state.setup.structure.mechanism(n).subsystem for n in state.names}
    several = len(state.names) > 1 or level(state, parts) > AT_NOISE
    if not several or not acting <= {*_HEATED} or "thermoelectric" not in map(balance_of, acting):
        return None
    found = reacting(base, parts, rules, patience)
    if found is None or level(found.state, parts) > AT_NOISE or not is_better(found.state, state, parts, rules):
        return None
    return found


def _is_none_of(learned: Beyond, state: State) -> bool:
    """Whether a closure depends on what no law of a name of ``state`` would: a term of it on other variables than a
    curve that is the name.
    """
    if isinstance(learned, Reaction | Mode):
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


def balances(state: State) -> list[str]:
    """Where the names of a hypothesis act."""
    return [balance_of(state.setup.structure.mechanism(n).subsystem) for n in state.names]
