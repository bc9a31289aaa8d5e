"""One effect of the catalogue under a law that the catalogue does not hold: told by what it depends on.

A force that is the temperature's alone is a nonlinear thermal force whatever its curve, and a stiffness that falls with
temperature a softening. Where no mechanism alone comes down to the noise, such curves are fitted in place of laws: as
soon as the first name takes most of the misfit, else when all is named that is to be.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import partial

import numpy as np

from scpjax.diagnose.choice import Choice
from scpjax.diagnose.curve import Curve, curves, finer, forms_named
from scpjax.diagnose.evidence import EQUIVALENTS, Evidence, ahead, are_equal, chance_against, is_better
from scpjax.diagnose.holdout import Split
from scpjax.diagnose.hypothesis import State
from scpjax.diagnose.patience import ENDLESS, Patience
from scpjax.diagnose.remainder import AT_NOISE, level
from scpjax.fit.setup import Setup, what_there_is
from scpjax.physics.catalogue import applicable, mechanism
from scpjax.physics.curves import PIECES, Form

_TOLD_BY = PIECES[1]  # pieces by which forms are told from each other: with more of them any form comes as near


@dataclass(frozen=True)
class Free:
    """A curve that is a mechanism of the catalogue; ``names``: it, and those that no curve would tell from it."""

    curve: Curve
    names: tuple[str, ...]
    probability: float

    def choice(self, base: State, tried: Choice) -> Choice:
        """As what is chosen, after what was tried: of the names of a curve the one whose laws came nearest first."""
        near = {r.name: r.delta_bic for r in reversed(tried.ranking) if r.round == 1}
        name = max(named_by(self.curve.form, base.setup), key=lambda n: near.get(n, -np.inf))
        others = [n for n in self.names if n != name]
        return Choice(base, tried.ranking, {name: self.probability}, {name: tuple(others)}, free=name)


def free_law(base: State, rival: State, split: Split, rules: Evidence) -> Free | None:
    """The mechanism that under a law of its own comes down to the noise alone, with more evidence than ``rival`` (what
    the laws of the catalogue made of it); None where none does, or where a curve that has no name is as likely.
    """
    names_of = partial(named_by, setup=base.setup)
    able = curves(base, split, rules, allowed=lambda form: bool(names_of(form)))
    found = [finer(c, base, split, rules, most=_TOLD_BY) for c in able]
    able = [c for c in found if _fitted(c, split) <= AT_NOISE and is_better(c.state, rival, split, rules)]
    if not able:
        return None
    best = max(able, key=lambda c: ahead(c.state, base, split, rules))
    nameless = curves(base, split, rules, allowed=lambda form: not names_of(form))
    if any(ahead(finer(c, base, split, rules, most=_TOLD_BY).state, best.state, split, rules) > 0 for c in nameless):
        return None
    alike = [c for c in able if c is not best and are_equal(c.state, best.state, base, split, rules)]
    names = dict.fromkeys(n for c in (best, *alike) for n in names_of(c.form))
    best = finer(best, base, split, rules)
    return Free(best, tuple(names)[: EQUIVALENTS + 1], chance_against(best.state, rival, split, rules))


def one_for_several(
    base: State, choice: Choice, split: Split, rules: Evidence, patience: Patience = ENDLESS
) -> Free | None:
    """One mechanism under a law of its own that predicts what several named ones do, all of which a curve in a balance
    could be; None where none does, or late by ``patience``. It is as likely as the least likely of them.
    """
    state = choice.state
    where = {subsystem for n in state.names for subsystem in _where(n) or ("",)}
    if len(state.names) < 2 or len(where) > 1 or "" in where or patience.late("one name in place of several"):
        return None
    names_of = partial(named_by, setup=base.setup)
    able = curves(base, split, rules, [*where], allowed=lambda form: bool(names_of(form)))
    found = [finer(c, base, split, rules, most=_TOLD_BY) for c in able]
    found = [c for c in found if are_equal(c.state, state, base, split, rules)]
    if not found:
        return None
    best, *others = sorted(found, key=lambda c: -ahead(c.state, base, split, rules))
    names = dict.fromkeys(n for c in (best, *others) for n in names_of(c.form))
    return Free(best, tuple(names)[: EQUIVALENTS + 1], min(choice.probability[n] for n in state.names))


def nameless(
    base: State, choice: Choice, split: Split, rules: Evidence, patience: Patience = ENDLESS
) -> tuple[Curve, ...]:
    """Terms that are no mechanism of the catalogue and predict what a single name at the noise does, in its balance: a
    loss that grows with the contraction, where the contraction follows the temperature. None beside several names, or
    late by ``patience``.
    """
    state = choice.state
    if len(state.names) != 1 or level(state, split) > AT_NOISE:
        return ()
    where = _where(state.names[0])
    if not where or patience.late("terms that would do as well as the name"):
        return ()
    names_of = partial(named_by, setup=base.setup)
    found = curves(base, split, rules, where, allowed=lambda form: not names_of(form) and form.variable != "time")
    return tuple(c for c in found if are_equal(c.state, state, base, split, rules))


def named_by(form: Form, setup: Setup) -> tuple[str, ...]:
    """The mechanisms that a curve of a form may be, of those that can act in this model: what lacks of the heat of a
    source of power is no sag of a supply.
    """
    there = what_there_is(setup.structure, setup.recordings)
    return tuple(n for n in form.names if applicable(mechanism(n), there))


def _where(name: str) -> list[str]:
    """The balances in which a curve may be a mechanism."""
    return [*dict.fromkeys(subsystem for subsystem, _ in forms_named([name]))]


def _fitted(curve: Curve, split: Split) -> float:
    """RMS misfit in units of the noise of what was fitted, in the column where it is greatest: a curve has to go on
    beyond what it was fitted to, and need not do so at the noise.
    """
    return level(curve.state, replace(split, is_held=np.zeros_like(split.is_held)))
