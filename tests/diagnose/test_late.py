"""What comes after the search is not begun once it is late, and the user is told what was left."""

from collections.abc import Callable
from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from diagnose.heated import LOSS, base_of, recorded

from scpjax.diagnose.choice import Choice
from scpjax.diagnose.closure import learn
from scpjax.diagnose.curve import bend
from scpjax.diagnose.evidence import Evidence
from scpjax.diagnose.fewer import fewer
from scpjax.diagnose.free import nameless
from scpjax.diagnose.hypothesis import State
from scpjax.diagnose.mode import carried_along
from scpjax.diagnose.patience import Patience
from scpjax.diagnose.reaction import reacting
from scpjax.diagnose.rivals import added

RULES = Evidence()


@pytest.fixture(scope="module")
def lossy():
    base, parts = base_of(recorded(lambda _t, temperature, _x: 0.01 * LOSS * temperature**2))
    return base, parts, added(base, "nonlinear_heat_loss", parts)


def _at_noise(state: State) -> State:
    return replace(state, residual=np.zeros_like(state.residual))


@pytest.mark.parametrize(
    ("asked", "none", "told"),
    [
        (lambda base, parts, _, p: learn(base, parts, RULES, patience=p), None, "learning what no name explains"),
        (lambda base, parts, _, p: bend(base, parts, RULES, patience=p), None, "learning what no name explains"),
        (lambda base, parts, _, p: reacting(base, parts, RULES, p), None, "learning what no name explains"),
        (lambda base, parts, _, p: carried_along(base, parts, RULES, p), None, "learning what no name explains"),
        (
            lambda base, parts, named, p: nameless(base, Choice(_at_noise(named), (), {}, {}), parts, RULES, p),
            (),
            "terms that would do as well",
        ),
    ],
    ids=["sum of terms", "curve", "reaction", "mode", "nameless terms"],
)
def test_nothing_is_learned_late(lossy, asked: Callable[..., Any], none, told):
    late = Patience(0.0, 0.0)
    assert asked(*lossy, late) == none
    assert told in late.notes()[-1]


def test_a_single_name_is_not_told_that_something_was_left(lossy):
    _, parts, named = lossy
    late = Patience(0.0, 0.0)
    assert fewer(named, parts, RULES, late) is named
    assert late.notes() == ()
