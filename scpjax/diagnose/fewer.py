"""Does one of the names do without another, where it differs by recording?"""

from __future__ import annotations

from scpjax.diagnose.evidence import Evidence, is_better
from scpjax.diagnose.holdout import Split
from scpjax.diagnose.hypothesis import State
from scpjax.diagnose.own import released
from scpjax.diagnose.patience import ENDLESS, Patience
from scpjax.diagnose.remainder import FAR, at_noise
from scpjax.diagnose.trials import without

_BESIDE = 4.0  # sum of squares without a name, in units of that with it, up to which another may make up for it


def fewer(state: State, split: Split, rules: Evidence, patience: Patience = ENDLESS) -> State:
    """The hypothesis without a name that only made up for another one's differing by recording: with a value of that
    for each recording there is more evidence for the rest than for all. As it is where there is none such, or late
    by ``patience``.

    Names are chosen with values that all recordings share. A second one may then take up what the first differs by,
    down to the noise, where nothing asks any more whether it differs.
    """
    if len(state.names) < 2 or not at_noise(state, split, FAR):
        return state
    for name in state.names:
        if patience.late("whether a name does without another"):
            break
        bare = without(state, name, split)
        if bare.cost > _BESIDE * state.cost:
            continue
        own = released(bare, split, rules)
        if own is not None and is_better(own, state, split, rules):
            return fewer(own, split, rules, patience)
    return state
