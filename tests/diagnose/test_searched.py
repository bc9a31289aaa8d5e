"""What ends a search with its first name: jumps timed anew, wild samples, a curve. The fits are played."""

import math
from types import SimpleNamespace

import numpy as np
import pytest

from scpjax.diagnose import naming
from scpjax.diagnose.choice import Choice
from scpjax.diagnose.patience import Patience

IN_TIME, OVER = (3600.0, math.inf), (0.0, math.inf)


class Search:
    """A search that names ``a`` first and then ``b`` as well, unless it is enough."""

    def __init__(self, patience, curve):
        self.patience, self.curve = Patience(*patience), curve
        self.began, self.rivals = 0, []

    def choose(self, base, parts, enough, resolve):
        self.began += 1
        first, both = (SimpleNamespace(names=names, setup=None, trial=None) for names in (("a",), ("a", "b")))
        ended = enough(first) or resolve(first)
        return Choice(first if ended else both, (), {}, {})  # type: ignore[arg-type]

    def by_curve(self, base, rival, parts):
        self.rivals.append(rival.names)
        return "curve" if self.curve else None


@pytest.fixture
def searched(monkeypatch):
    def searched(patience, *, wild=False, most=True, curve=False, gaps=False, shorter=False):
        weights = np.ones(1)
        whole = SimpleNamespace(weights=np.zeros(1))  # some samples were left out beside the base model
        parts = SimpleNamespace(whole=whole, train=None, with_weights=lambda weights: parts)
        base = SimpleNamespace(names=(), trial=None, setup=SimpleNamespace(data=SimpleNamespace(weights=weights)))
        monkeypatch.setattr(naming, "_wild", lambda *_: np.array([wild and search.began == 1]))
        monkeypatch.setattr(naming, "takes_most", lambda *_: most)
        monkeypatch.setattr(naming, "find_gaps", lambda _: gaps)
        monkeypatch.setattr(naming, "_timed", lambda *_: pytest.fail("timed jumps"))
        monkeypatch.setattr(naming, "refine", lambda *_: (None, True, 0.0))
        monkeypatch.setattr(naming, "_rings", lambda *_: shorter)
        by_steps = SimpleNamespace(names=("a",))
        monkeypatch.setattr(naming, "_shorter", lambda state, *_: ("fine", by_steps))
        monkeypatch.setattr(naming, "state_at", lambda *_: base)
        monkeypatch.setattr(naming, "at_rest", lambda *_: SimpleNamespace(names=("a", "b"), refitted=True))
        search = Search(patience, curve)
        found, free = naming._searched(search, base, parts)  # type: ignore[arg-type]
        return search, found.choice.state.names, free

    return searched


@pytest.mark.parametrize("curve", [False, True])
def test_a_curve_is_sought_beside_a_first_name_that_takes_most(searched, curve):
    search, names, free = searched(IN_TIME, curve=curve)
    assert search.rivals == [("a",)]
    assert (names, free) == ((("a",), "curve") if curve else (("a", "b"), None))


@pytest.mark.parametrize("curve", [False, True])
def test_beside_one_that_leaves_much_it_waits_for_what_is_named_in_the_end(searched, curve):
    search, names, free = searched(IN_TIME, most=False, curve=curve)
    assert search.rivals == [("a", "b")]
    assert (names, free) == (("a", "b"), "curve" if curve else None)


def test_wild_samples_beside_the_first_name_begin_the_search_anew(searched):
    search, names, _ = searched(IN_TIME, wild=True)
    assert search.began == 2
    assert names == ("a", "b")


def test_out_of_patience_they_do_not_end_a_search_that_cannot_begin_anew(searched):
    """What it has named is fitted anew without them."""
    search, names, free = searched(OVER, wild=True)
    assert search.began == 1
    assert names == ("a", "b")
    assert free is None


def test_out_of_patience_jumps_are_not_timed_anew_which_is_told_where_there_are_any(searched):
    assert searched(OVER, gaps=True)[0].patience.ended
    assert not searched(OVER, gaps=False)[0].patience.ended


def test_a_first_name_that_is_enough_by_shorter_steps_ends_the_search(searched):
    search, names, free = searched(IN_TIME, shorter=True)
    assert (search.began, names, free) == (1, ("a",), None)
    assert search.rivals == [("a",)]  # a curve was sought, before steps were tried
    _, names, _ = searched(IN_TIME)
    assert names == ("a", "b")


def test_what_steps_were_enough_for_before_wild_samples_were_out_is_not_told(searched):
    """The search begins anew, and with it what shorter steps make of a name."""
    search, names, _ = searched(IN_TIME, wild=True, shorter=True)
    assert (search.began, names) == (2, ("a",))
