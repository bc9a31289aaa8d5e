"""How the selection goes: which ways it follows, when it ends, what it takes back. The fits are played."""

from dataclasses import replace

import numpy as np
import pytest
from diagnose.playing import Played, chosen, played, put

from scpjax.diagnose import select
from scpjax.diagnose.evidence import Comparison, Evidence
from scpjax.diagnose.patience import Patience


def test_the_program_for_a_next_round_is_made_ready_where_there_will_be_one(monkeypatch):
    for misfits, times in (({"a": 500.0, "ab": 1.0}, 1), ({"a": 1.0}, 0), ({"a": 995.0}, 0)):
        asked: list[object] = []
        played(monkeypatch, misfits)
        put(monkeypatch, "ready_beside_names", asked.append)
        chosen()
        assert len(asked) == times, misfits


def test_out_of_patience_no_third_round_or_other_way_is_begun(monkeypatch):
    """What two rounds found is told; at the noise nothing was left, and nothing is said."""
    asked = played(monkeypatch, {"a": 500.0, "b": 510.0, "ab": 300.0, "bc": 200.0, "abc": 1.0})
    patience = Patience(0.0)
    found = select.choose(Played((), 1000.0), None, Evidence(), None, patience=patience)  # type: ignore[arg-type]
    assert (found.state.names, asked) == (("a", "b"), [(), ("a",)])  # nor is b followed, which is close to a
    assert "--minutes" in patience.notes()[0]
    played(monkeypatch, {"a": 1.0})
    patience = Patience(0.0)
    select.choose(Played((), 1000.0), None, Evidence(), None, patience=patience)  # type: ignore[arg-type]
    assert patience.notes() == ()


def test_patience_ends_when_it_is_over():
    now, later = Patience(0.0), Patience(3600.0)
    assert now.over()
    assert not later.over()
    assert not Patience().over()
    assert later.notes() == ()


def test_what_comes_after_the_search_is_cut_short_half_as_much_later(monkeypatch):
    patience, short = Patience(600.0), Patience(6.0)
    passed = dict.fromkeys((patience, short), 0.0)
    monkeypatch.setattr(Patience, "passed", lambda self: passed[self])
    assert not patience.over()
    passed[patience] = 899.0
    assert patience.over()
    assert not patience.late("closures")
    assert [note[:40] for note in patience.notes()] == ["the search was ended after 10 minutes, still away"[:40]]
    passed[patience] = 901.0
    assert patience.late("closures")
    assert patience.late("filters")
    assert "after 15 minutes this was left out or cut short: closures; filters;" in patience.notes()[1]
    passed[short] = 65.0
    assert not short.late("closures"), "a minute is left at least"
    passed[short] = 67.0
    assert short.late("closures")


def test_another_way_may_begin_with_any_name_that_predicts_clearly_better(monkeypatch):
    """``e`` has less evidence than four others, and predicts best."""
    misfits = {"a": 400.0, "b": 450.0, "c": 480.0, "d": 510.0, "e": 600.0, "ab": 300.0, "ef": 1.0}
    asked = played(monkeypatch, misfits, {"e": 0.5})
    assert chosen() == {"e", "f"}
    assert asked[:3] == [(), ("a",), ("e",)]


def test_where_it_ends_away_from_the_noise_another_way_is_gone(monkeypatch):
    """``a`` imitates what ``b`` and ``c`` do together."""
    asked = played(monkeypatch, {"a": 500.0, "b": 900.0, "ac": 300.0, "bc": 1.0})
    assert chosen() == {"b", "c"}
    assert asked.index(("a", "c")) < asked.index(("b",))


def test_no_other_way_is_gone_where_the_names_are_mended(monkeypatch):
    """Before it is: what the exchange of names brings to the noise is told; else the better of that and of the way."""
    costs = {"a": 500.0, "b": 900.0, "ac": 300.0, "bc": 100.0}
    mended = []

    def mend(choice):
        mended.append(choice.state.names)
        cost = after.get("".join(sorted(choice.state.names)), choice.state.cost)
        return replace(choice, state=Played(choice.state.names, cost))

    def told() -> float:
        found = select.choose(Played((), 1000.0), None, Evidence(), None, mend=mend)  # type: ignore[arg-type]
        return found.state.cost  # type: ignore[return-value]

    after = {"ac": 1.0}
    asked = played(monkeypatch, costs)
    assert told() == 1.0
    assert ("b",) not in asked
    after = {"ac": 200.0, "bc": 50.0}
    played(monkeypatch, costs)
    mended.clear()
    assert told() == 50.0
    assert mended == [("a", "c"), ("b", "c")]
    after = {"ac": 80.0}
    asked = played(monkeypatch, costs)
    mended.clear()
    assert told() == 80.0
    assert ("b",) in asked
    assert mended == [("a", "c")]


@pytest.mark.parametrize(("ac", "bc"), [(300.0, 1.0), (302.0, 300.0)])
def test_what_speaks_for_the_first_name_of_another_way_is_the_whole_way(monkeypatch, ac, bc):
    """Alone ``b`` is nowhere; with ``c`` it does as much better than ``a`` with ``c`` as BIC says."""
    played(monkeypatch, {"a": 500.0, "b": 900.0, "ac": ac, "bc": bc, "c": 970.0})
    found = select.choose(Played((), 1000.0), None, Evidence(), None)  # type: ignore[arg-type]
    assert found.probability["b"] == pytest.approx(1 / (1 + np.exp(-(ac - bc) / 2)))


def test_what_speaks_for_a_name_that_leads_further_than_another_is_its_lead(monkeypatch):
    """``b`` had less evidence than ``a`` when both were tried, predicted better, and does so by another law."""
    played(monkeypatch, {"a": 500.0, "b": 600.0}, {"a": 1.0, "b": 0.8})
    for left, name, likely in ((499.0, "b", 1 / (1 + np.exp(-0.5))), (300.0, "b", 1.0), (501.0, "a", 1.0)):
        put(monkeypatch, "other_laws", lambda s, n, *_, left=left: Played(s.names, left) if n == "b" else s)
        found = select.choose(Played((), 1000.0), None, Evidence(), None)  # type: ignore[arg-type]
        assert found.state.names == (name,)
        assert found.probability[name] == pytest.approx(likely)


@pytest.mark.parametrize("better", [True, False])
def test_the_order_in_which_the_same_names_are_reached_does_not_make_one_unlikely(monkeypatch, better):
    """``a`` and ``d``, which imitates it, were far ahead of ``b``, which predicted better; each way names the other one
    then, and it does not matter by which they are fitted a little closer.
    """
    misfits = {"a": 500.0, "b": 900.0, "d": 500.0, "ab": 200.0}
    played(monkeypatch, misfits, {"a": 1.0, "b": 0.8, "d": 1.0})
    closer = ("b", "a") if better else ("a", "b")
    put(monkeypatch, "other_laws", lambda s, n, *_: Played(s.names, 150.0) if s.names == closer else s)
    found = select.choose(Played((), 1000.0), None, Evidence(), None)  # type: ignore[arg-type]
    assert set(found.state.names) == {"a", "b"}
    assert found.probability == pytest.approx({"a": 1.0, "b": 1.0})


def by_way_of_c(monkeypatch, alone: dict[str, float], both: float) -> None:
    """Plays a selection in which ``a`` and ``c`` leave these misfits alone, and ``a`` is found only beside ``c``."""
    played(monkeypatch, {})

    def with_one_more(state, split, rules, catalogue, **more):
        after = {(): alone, ("c",): {"a": both}}.get(state.names, {})
        found = [(n, Played((*state.names, n), left)) for n, left in after.items()]
        return [Comparison(s, n, "", state.cost - s.cost, 0.5, 50.0, 0.5, True) for n, s in found]

    put(monkeypatch, "try_all", with_one_more)


def test_told_first_is_what_alone_explained_most(monkeypatch):
    """``a`` with ``c`` cannot be reached by way of ``a``, which is ahead, but by way of ``c``."""
    by_way_of_c(monkeypatch, {"a": 500.0, "c": 900.0}, 1.0)
    found = select.choose(Played((), 1000.0), None, Evidence(), None)  # type: ignore[arg-type]
    assert found.state.names == ("a", "c")
    assert found.probability["c"] > 0.99


@pytest.mark.parametrize(("worth", "names"), [(True, {"a", "c"}), (False, {"a"})])
def test_another_way_that_only_adds_a_name_has_to_be_worth_it(monkeypatch, worth, names):
    """``c`` beside ``a``, found by way of ``c``, takes a little more away than ``a`` alone."""
    by_way_of_c(monkeypatch, {"a": 10.0, "c": 900.0}, 8.0)
    put(monkeypatch, "worthwhile", lambda before, after, *_: worth or before.names != ("a",))
    assert chosen() == names


def test_another_way_that_falls_behind_is_left(monkeypatch):
    asked = played(monkeypatch, {"a": 500.0, "b": 900.0, "ac": 300.0, "bc": 400.0, "bcd": 1.0})
    assert chosen() == {"a", "c"}
    assert ("b",) in asked
    assert ("b", "c") not in asked


def test_the_search_can_be_ended_with_the_first_name(monkeypatch):
    asked = played(monkeypatch, {"a": 500.0, "ab": 1.0})
    found = select.choose(Played((), 1000.0), None, Evidence(), None, enough=lambda s: s.names == ("a",))  # type: ignore[arg-type]
    assert set(found.state.names) == {"a"}
    assert asked == [()]


def test_the_search_can_be_ended_with_names_that_shorter_steps_take_to_the_noise(monkeypatch):
    asked = played(monkeypatch, {"a": 500.0, "ab": 5.0, "abc": 1.0})
    put(monkeypatch, "at_noise", lambda state, split, level=1.0: state.cost <= level)
    tried = []

    def resolve(state):
        tried.append(set(state.names))
        return True

    found = select.choose(Played((), 1000.0), None, Evidence(), None, resolve=resolve)  # type: ignore[arg-type]
    assert set(found.state.names) == {"a", "b"}
    assert tried == [{"a", "b"}]  # it is not asked far from the noise
    assert ("a", "b") not in asked


def test_the_same_names_by_two_ways_are_gone_on_from_once(monkeypatch):
    asked = played(monkeypatch, {"a": 500.0, "b": 505.0, "ab": 200.0, "abc": 1.0})
    assert chosen() == {"a", "b", "c"}
    assert [set(names) for names in asked].count({"a", "b"}) == 1


def test_a_way_that_the_second_round_has_gone_is_not_gone_again(monkeypatch):
    """``b``, close to ``a`` in the first round, was gone on with beside it; ``c``, which was not, is."""
    asked = played(monkeypatch, {"a": 500.0, "b": 505.0, "c": 700.0, "ad": 300.0, "bd": 400.0, "ce": 350.0})
    assert chosen() == {"a", "d"}
    assert [names for names in asked if len(names) == 1] == [("a",), ("b",), ("c",)]


def test_what_differs_by_recording_does_not_take_the_place_of_another_name(monkeypatch):
    """``a`` with a value for each recording comes near the noise, and what is left beside it is worth no name; beside
    ``a`` with one for all it is.
    """
    asked = played(monkeypatch, {"a": 100.0, "ab": 1.0})
    put(monkeypatch, "at_noise", lambda state, split, level=1.0: state.cost <= (40 if level > 1 else 1))
    put(monkeypatch, "released", lambda state, *_: Played(("a",), 40.0, ("a.rate",)) if state.cost == 100 else None)
    put(monkeypatch, "worthwhile", lambda before, *_: not before.own)
    found = select.choose(Played((), 1000.0), None, Evidence(), None)  # type: ignore[arg-type]
    assert (found.state.names, found.state.setup.structure.own) == (("a", "b"), ())
    assert asked == [(), ("a",), ("a",)]


def test_two_are_asked_for_their_laws_before_a_third_is_sought(monkeypatch):
    asked = played(monkeypatch, {"a": 500.0, "ab": 100.0, "abc": 1.0})
    put(monkeypatch, "laws_of_two", lambda s, *_: Played(s.names, 1.0) if len(s.names) == 2 else s)
    assert chosen() == {"a", "b"}
    assert asked == [(), ("a",)]
