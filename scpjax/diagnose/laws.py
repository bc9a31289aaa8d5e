"""Under which of its laws does a mechanism that was just named explain most?"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from scpjax.abreast import abreast
from scpjax.diagnose.evidence import Evidence, excess, is_better
from scpjax.diagnose.holdout import Split
from scpjax.diagnose.hypothesis import State, start_value, trial_at
from scpjax.diagnose.patience import Patience
from scpjax.diagnose.remainder import at_noise, misfit
from scpjax.diagnose.trials import HOPELESS, afresh, at_rest
from scpjax.fit.setup import laws_that_can_act
from scpjax.parameter import Parameter
from scpjax.physics.mechanism import Mechanism

_MUCH = 0.1  # of the base model's misfit, down to which a name's law is no matter yet: another name is missing
_WITHIN = 3.0**2  # mean square, in units of the noise's, down to which it is one whatever the base model leaves
_NEAR = 2.0  # sum of squares, in units of what another law leaves, from which a law is not worth a fit of its own


def other_laws(state: State, name: str, split: Split, rules: Evidence, base: State, patience: Patience) -> State:
    """A mechanism just named, under its wider laws from where it stands: they start best from a narrower fit. And under
    narrower ones, which may have lost against it only by where their fits began: afresh, unless it has reached the
    noise and they are hopeless beside it. What does not reach the noise by them is fitted under every other law that
    comes near, unless out of ``patience``; nor, as nothing is fitted afresh, where so much of the misfit of the
    ``base`` stays that another name is missing: beside that all are asked for their laws, as they are in the end of
    several names that miss the noise, so that out of ``patience`` none is here.
    """
    if len(state.names) > 1 and not at_noise(state, split) and patience.over():
        return state
    setup = state.setup
    m = setup.structure.mechanism(name)
    now = m.laws.index(state.laws[name])
    free_now = set(m.free_parameters(now))
    several, able = _is_one_of_several(state, base, split), laws_that_can_act(setup, m, now)
    narrower = [law for law in able if set(m.free_parameters(law)) < free_now]
    wider = [law for law in able if set(m.free_parameters(law)) > free_now]

    def again(law: int) -> State:
        after = _under(state, m, law, split, [p for p in m.free_parameters(law) if p not in free_now])
        behind = at_noise(state, split) and after.cost > HOPELESS * state.cost
        return after if several or behind or law in wider else afresh(after, split)

    best = state
    for law, after in zip([*narrower, *wider], abreast(again, [*narrower, *wider]), strict=True):
        if is_better(after, best, split, rules) if law in wider else not is_better(best, after, split, rules):
            best = after
    if at_noise(best, split) or _is_one_of_several(best, base, split) or patience.over():
        return best
    return _every_law(best, name, split, rules)


def _is_one_of_several(state: State, base: State, split: Split) -> bool:
    """Whether a hypothesis leaves more of a column's misfit than the law of what it names would make."""
    left, whole = excess(state, split), excess(base, split)
    return bool(np.any((left > _MUCH * whole) & (misfit(state, split) > _WITHIN)))


def _every_law(state: State, name: str, split: Split, rules: Evidence) -> State:
    """What does not reach the noise, under any other law of one of its mechanisms that comes near from where it stands,
    fitted afresh: neither before may have found its best fit.
    """
    setup = state.setup
    m = setup.structure.mechanism(name)
    now = m.laws.index(state.laws[name])
    free_now = m.free_parameters(now)
    others = [law for law in laws_that_can_act(setup, m, now) if law != now]

    def again(law: int) -> State | None:
        after = _under(state, m, law, split, [p for p in m.free_parameters(law) if p not in free_now])
        return afresh(after, split) if after.cost < _NEAR * state.cost else None

    best = state
    for after in abreast(again, others):
        if after is not None and is_better(after, best, split, rules):
            best = after
    return best


def _under(state: State, m: Mechanism, law: int, split: Split, added: Sequence[Parameter] = ()) -> State:
    """The hypothesis with one of its mechanisms under another law, fitted from where it stands."""
    setup, value, laws = state.setup, state.values, np.asarray(state.trial.laws).copy()
    for p in added:
        value[setup.structure.where[f"{m.name}.{p.name}"]] = start_value(setup, m, p)
    laws[next(i for i, other in enumerate(setup.structure.mechanisms) if other.name == m.name)] = law
    return at_rest(setup, split, [trial_at(setup, value, laws)], max_steps=80)
