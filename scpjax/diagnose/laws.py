"""Under which of its laws does a mechanism that was just named explain most?"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from scpjax.abreast import abreast
from scpjax.diagnose.evidence import Evidence, is_better
from scpjax.diagnose.holdout import Split
from scpjax.diagnose.patience import Patience
from scpjax.diagnose.trials import State, afresh, at_noise, at_rest, start_value, trial_at
from scpjax.fit.setup import laws_that_can_act
from scpjax.parameter import Parameter
from scpjax.physics.mechanism import Mechanism

_NEAR = 2.0  # sum of squares, in units of what another law leaves, from which a law is not worth a fit of its own


def other_laws(state: State, name: str, split: Split, rules: Evidence, patience: Patience) -> State:
    """A mechanism just named, under its wider laws from where it stands: they start best from a narrower fit. And under
    narrower ones, which may have lost against it only by where their fits began. What does not reach the noise by them
    is fitted under every other law that comes near, unless out of ``patience``.
    """
    setup = state.setup
    m = setup.structure.mechanism(name)
    free_now = set(m.free_parameters(m.laws.index(state.laws[name])))
    best = state
    for law in laws_that_can_act(setup, m):
        free = set(m.free_parameters(law))
        if free < free_now:
            after = afresh(_under(state, m, law, split), split)
            if not is_better(best, after, split, rules):
                best = after
    for law in laws_that_can_act(setup, m):
        added = [p for p in m.free_parameters(law) if p not in free_now]
        if added and free_now < set(m.free_parameters(law)):
            after = _under(state, m, law, split, added)
            if is_better(after, best, split, rules):
                best = after
    return best if at_noise(best, split) or patience.over() else _every_law(best, name, split, rules)


def _every_law(state: State, name: str, split: Split, rules: Evidence) -> State:
    """What does not reach the noise, under any other law of one of its mechanisms that comes near from where it stands,
    fitted afresh: neither before may have found its best fit.
    """
    setup = state.setup
    m = setup.structure.mechanism(name)
    free_now = m.free_parameters(m.laws.index(state.laws[name]))
    others = [law for law in laws_that_can_act(setup, m) if m.laws[law] != state.laws[name]]

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
