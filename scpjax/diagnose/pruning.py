"""Which of the names are not missed?"""

from __future__ import annotations

from scpjax.abreast import abreast
from scpjax.diagnose.evidence import Evidence, compare
from scpjax.diagnose.holdout import Split
from scpjax.diagnose.hypothesis import State
from scpjax.diagnose.trials import without
from scpjax.diagnose.worth import worthwhile


def prune(state: State, split: Split, rules: Evidence, base: State | None = None) -> State:
    """Take out what is not missed: what a later mechanism has made superfluous, and the last one where it only led the
    others to a better fit. With ``base`` what is not worth it beside it is not missed either.
    """
    whole = state
    bare = dict(zip(whole.names, abreast(lambda name: without(whole, name, split), whole.names), strict=True))
    for name in whole.names:
        fewer = bare[name] if state is whole else without(state, name, split)
        m = state.setup.structure.mechanism(name)
        extra = state.setup.structure.count_free(name, m.laws.index(state.laws[name]))
        missed = compare(fewer, state, name, "", split, rules, extra).accepted
        if not missed or not (base is None or worthwhile(fewer, state, base, split, rules)):
            state = fewer
    return state
