"""How the selection goes: which hypotheses it fits, which ways it follows, what it takes back. The fits are played."""

from dataclasses import dataclass, replace
from types import SimpleNamespace

import numpy as np
import pytest

from scpjax.diagnose import evidence, select
from scpjax.diagnose.evidence import Comparison, Evidence
from scpjax.diagnose.patience import Patience


@dataclass(frozen=True)
class Played:
    """A hypothesis by its names, and the misfit (in units of the noise squared) that is told of it."""

    names: tuple[str, ...]
    cost: float
    own: tuple[str, ...] = ()

    @property
    def setup(self):
        """What differs by recording."""
        return SimpleNamespace(structure=SimpleNamespace(own=self.own))


def played(monkeypatch, misfits: dict[str, float], held_out: dict[str, float] | None = None) -> list[tuple[str, ...]]:
    """Plays a selection in which names, in the order of the alphabet, leave these misfits, and the same or others of
    what is held out; what was gone on from.
    """
    asked: list[tuple[str, ...]] = []

    def with_one_more(state, split, rules, catalogue, *, max_steps, tell, contenders):
        asked.append(state.names)
        assert not {*contenders} & {*state.names}
        assert state.names or not contenders
        found = []
        for name in "abcd":
            after = "".join(sorted({*state.names, name}))
            if name in state.names or after not in misfits:
                continue
            now = Played((*state.names, name), misfits[after], state.own)
            fall = state.cost - now.cost
            found.append(Comparison(now, name, "", fall, 0.5, fall, 0.5, fall > 12))
        return sorted(found, key=lambda c: -c.delta_bic)

    monkeypatch.setattr(select, "try_all", with_one_more)
    monkeypatch.setattr(select, "ready_beside_names", lambda catalogue: None)
    left = held_out or {}
    monkeypatch.setattr(select, "_held_out", lambda state, split: left.get("".join(sorted(state.names)), 1.0))
    monkeypatch.setattr(select, "own_room", lambda *_: None)
    monkeypatch.setattr(select, "released", lambda *_: None)
    monkeypatch.setattr(select, "afresh", lambda state, split: state)
    monkeypatch.setattr(select, "other_laws", lambda state, *_: state)
    monkeypatch.setattr(select, "prune", lambda state, split, rules, base=None: state)
    monkeypatch.setattr(select, "equals", lambda best, others, before, split: ())
    monkeypatch.setattr(select, "worthwhile", lambda *_: True)
    monkeypatch.setattr(select, "at_noise", lambda state, split, level=1.0: state.cost <= 1)
    monkeypatch.setattr(select, "is_better", lambda a, b, split, rules: a.cost < b.cost)
    monkeypatch.setattr(select, "ahead", lambda a, b, split, rules: b.cost - a.cost)
    monkeypatch.setattr(
        select, "in_order", lambda s, first, split: Played((first, *sorted({*s.names} - {first})), s.cost)
    )
    return asked


def chosen(misfit: float = 1000.0) -> set[str]:
    return set(select.choose(Played((), misfit), None, Evidence(), None).state.names)  # type: ignore[arg-type]


def test_what_had_evidence_for_the_first_name_contends_later(monkeypatch):
    """Those with most of it; not what had none, nor what is named by then."""
    played(monkeypatch, {"a": 500.0, "b": 700.0, "c": 995.0, "d": 600.0, "ab": 300.0})
    told, try_all = [], select.try_all

    def asked(state, *args, contenders, **more):
        told.append((state.names, contenders))
        return try_all(state, *args, contenders=contenders, **more)

    monkeypatch.setattr(select, "try_all", asked)
    chosen()
    contenders = dict(told)
    assert [contenders[names] for names in ((), ("a",), ("a", "b"))] == [[], ["d", "b"], ["d"]]


def test_the_program_for_a_next_round_is_made_ready_where_there_will_be_one(monkeypatch):
    for misfits, times in (({"a": 500.0, "ab": 1.0}, 1), ({"a": 1.0}, 0), ({"a": 995.0}, 0)):
        asked: list[object] = []
        played(monkeypatch, misfits)
        monkeypatch.setattr(select, "ready_beside_names", asked.append)
        chosen()
        assert len(asked) == times, misfits


def test_where_two_are_close_the_next_round_decides(monkeypatch):
    """``a`` is a little ahead at first, but only with ``b`` is the noise reached."""
    asked = played(monkeypatch, {"a": 500.0, "b": 510.0, "ac": 300.0, "bc": 1.0})
    assert chosen() == {"b", "c"}
    assert set(asked) == {(), ("a",), ("b",)}


def test_out_of_patience_no_third_round_or_other_way_is_begun(monkeypatch):
    """What two rounds found is told; at the noise nothing was left, and nothing is said."""
    asked = played(monkeypatch, {"a": 500.0, "b": 560.0, "ab": 300.0, "bc": 200.0, "abc": 1.0})
    patience = Patience(0.0)
    found = select.choose(Played((), 1000.0), None, Evidence(), None, patience=patience)  # type: ignore[arg-type]
    assert (found.state.names, asked) == (("a", "b"), [(), ("a",)])
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


def test_where_one_is_far_ahead_only_it_is_followed(monkeypatch):
    asked = played(monkeypatch, {"a": 500.0, "b": 530.0, "ac": 1.0, "bc": 0.5})
    assert chosen() == {"a", "c"}
    assert ("b",) not in asked


@pytest.mark.parametrize(("better", "wanted"), [(0.95, {"a", "c"}), (0.8, {"b", "c"})])
def test_what_predicts_clearly_better_is_followed_as_well(monkeypatch, better, wanted):
    """However far it is behind in evidence, and though another one is closer."""
    misfits = {"a": 500.0, "b": 600.0, "d": 510.0, "ac": 1.0, "bc": 0.5, "cd": 1.0}
    asked = played(monkeypatch, misfits, {"a": 1.0, "b": better, "d": 0.99})
    assert chosen() == wanted
    assert asked == [(), ("a",), ("b",) if better < 0.9 else ("d",)]


def test_what_is_pruned_as_soon_as_it_is_named_leaves_its_place_to_the_next(monkeypatch):
    """Beside ``a``, ``b`` promises more than ``c`` by far and is not missed; no round is spent on ``a`` again."""
    asked = played(monkeypatch, {"a": 500.0, "ab": 100.0, "ac": 300.0, "acd": 1.0})
    keep = lambda s: Played(tuple(n for n in s.names if n != "b"), 500.0) if "b" in s.names else s  # noqa: E731
    monkeypatch.setattr(select, "prune", lambda state, split, rules, base=None: keep(state))
    assert chosen() == {"a", "c", "d"}
    assert asked == [(), ("a",), ("a", "c")]


def test_where_it_ends_away_from_the_noise_another_way_is_gone(monkeypatch):
    """``a`` imitates what ``b`` and ``c`` do together."""
    asked = played(monkeypatch, {"a": 500.0, "b": 900.0, "ac": 300.0, "bc": 1.0})
    assert chosen() == {"b", "c"}
    assert asked.index(("a", "c")) < asked.index(("b",))


def with_rooms(monkeypatch, misfits: dict[str, float]) -> list[tuple[str, ...]]:
    """Plays a room that differs by recording, which leaves these misfits beside names; beside what it was asked for."""
    asked: list[tuple[str, ...]] = []

    def own_room(state, split, rules):
        asked.append(state.names)
        left = misfits.get("".join(sorted(state.names)))
        if left is None or select.ROOM in state.names:
            return None
        now = Played((*state.names, select.ROOM), left, ("room.drift",))
        fall = state.cost - left
        return Comparison(now, select.ROOM, "cycling", fall, 0.5, fall, 0.5, True)

    monkeypatch.setattr(select, "own_room", own_room)
    return asked


def test_a_room_that_differs_is_asked_for_where_no_name_reaches_the_noise(monkeypatch):
    """And taken at once where it does, beside the first names or none."""
    for first, wanted in ((300.0, {select.ROOM}), (1.0, {"a"})):
        played(monkeypatch, {"a": first})
        rooms = with_rooms(monkeypatch, {"": 1.0})
        assert chosen() == wanted
        assert rooms == ([()] if first > 1.0 else [])


def test_a_room_that_differs_may_be_the_first_name_of_another_way(monkeypatch):
    """With it the noise has to be reached, as it can take many forms."""
    for last in (1.0, 100.0):
        played(monkeypatch, {"a": 500.0, "ab": 300.0} | joined("ab", 250.0, last))
        with_rooms(monkeypatch, {"": 700.0})
        assert chosen() == ({"a", "b", select.ROOM} if last == 1.0 else {"a", "b"})


def joined(names: str, first: float, last: float) -> dict[str, float]:
    """What the first of two names, then both, leave beside the room."""
    key = lambda *some: "".join(sorted([*some, select.ROOM]))  # noqa: E731
    return {key(names[0]): first, key(*names): last}


def test_a_parameter_that_differs_is_kept_where_the_noise_is_reached(monkeypatch):
    for left, wanted in ((1.0, ("a.size",)), (200.0, ())):
        played(monkeypatch, {"a": 500.0})
        own = lambda state, *_, left=left: Played(state.names, left, ("a.size",)) if state.names == ("a",) else None  # noqa: E731
        monkeypatch.setattr(select, "released", own)
        asked = played(monkeypatch, {"a": 500.0})
        monkeypatch.setattr(select, "released", own)
        found = select.choose(Played((), 1000.0), None, Evidence(), None)  # type: ignore[arg-type]
        assert (found.state.names, found.state.setup.structure.own) == (("a",), wanted)
        assert asked == ([()] if left == 1.0 else [(), ("a",)])  # what does not reach it is no way to go on from


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


@pytest.mark.parametrize(
    ("gain", "held_out", "better"), [(5.0, 0.1, True), (5.0, -0.1, False), (-5.0, 0.1, False), (0.0, 0.1, False)]
)
def test_the_better_has_more_evidence_and_predicts_better(monkeypatch, gain, held_out, better):
    state = SimpleNamespace(trial=SimpleNamespace(active=np.zeros(3)))
    asked = Comparison(None, "", "", gain, held_out, 0.0, 0.0, False)  # type: ignore[arg-type]
    monkeypatch.setattr(evidence, "compare", lambda *_: asked)
    assert evidence.is_better(state, state, None, Evidence()) == better  # type: ignore[arg-type]


def test_what_is_named_as_well_was_no_rival(monkeypatch):
    """``a`` and ``b`` were as likely as each other at first; ``c``, which was too, is not named."""
    played(monkeypatch, {"a": 500.0, "b": 500.0, "ab": 1.0})
    found = select.choose(Played((), 1000.0), None, Evidence(), None)  # type: ignore[arg-type]
    assert found.probability == pytest.approx({"a": 1.0, "b": 1.0})
    played(monkeypatch, {"a": 500.0, "b": 500.0, "c": 500.0, "ab": 1.0})
    found = select.choose(Played((), 1000.0), None, Evidence(), None)  # type: ignore[arg-type]
    assert found.probability == pytest.approx({"a": 0.5, "b": 1.0})


@pytest.mark.parametrize(("ac", "bc"), [(300.0, 1.0), (302.0, 300.0)])
def test_what_speaks_for_the_first_name_of_another_way_is_the_whole_way(monkeypatch, ac, bc):
    """Alone ``b`` is nowhere; with ``c`` it does as much better than ``a`` with ``c`` as BIC says."""
    played(monkeypatch, {"a": 500.0, "b": 900.0, "ac": ac, "bc": bc, "c": 970.0})
    found = select.choose(Played((), 1000.0), None, Evidence(), None)  # type: ignore[arg-type]
    assert found.probability["b"] == pytest.approx(1 / (1 + np.exp(-(ac - bc) / 2)))


def test_told_first_is_what_alone_explained_most(monkeypatch):
    """``a`` with ``c`` cannot be reached by way of ``a``, which is ahead, but by way of ``c``."""
    played(monkeypatch, {})

    def with_one_more(state, split, rules, catalogue, *, max_steps, tell, contenders):
        after = {(): {"a": 500.0, "c": 900.0}, ("c",): {"a": 1.0}}.get(state.names, {})
        found = [(n, Played((*state.names, n), left)) for n, left in after.items()]
        return [Comparison(s, n, "", state.cost - s.cost, 0.5, 50.0, 0.5, True) for n, s in found]

    monkeypatch.setattr(select, "try_all", with_one_more)
    monkeypatch.setattr(select, "ready_beside_names", lambda catalogue: None)
    found = select.choose(Played((), 1000.0), None, Evidence(), None)  # type: ignore[arg-type]
    assert found.state.names == ("a", "c")
    assert found.probability["c"] > 0.99


@pytest.mark.parametrize(("worth", "names"), [(True, {"a", "c"}), (False, {"a"})])
def test_another_way_that_only_adds_a_name_has_to_be_worth_it(monkeypatch, worth, names):
    """``c`` beside ``a``, found by way of ``c``, takes a little more away than ``a`` alone."""
    played(monkeypatch, {})

    def with_one_more(state, split, rules, catalogue, *, max_steps, tell, contenders):
        after = {(): {"a": 10.0, "c": 900.0}, ("c",): {"a": 8.0}}.get(state.names, {})
        found = [(n, Played((*state.names, n), left)) for n, left in after.items()]
        return [Comparison(s, n, "", state.cost - s.cost, 0.5, 50.0, 0.5, True) for n, s in found]

    monkeypatch.setattr(select, "try_all", with_one_more)
    monkeypatch.setattr(select, "ready_beside_names", lambda catalogue: None)
    monkeypatch.setattr(select, "worthwhile", lambda before, after, *_: worth or before.names != ("a",))
    assert chosen() == names


@pytest.mark.parametrize(("small", "names"), [(300.0, {"a"}), (495.0, {"a", "c"})])
def test_beyond_a_first_name_what_is_behind_something_too_small_is_not_named(monkeypatch, small, names):
    """Beside ``a``, ``b`` has more evidence than ``c`` but takes too little away to be named."""
    played(monkeypatch, {"a": 500.0, "ab": small, "ac": 497.0 - 12.0})
    monkeypatch.setattr(select, "worthwhile", lambda before, after, *_: "b" not in after.names)
    assert chosen() == names
    played(monkeypatch, {"b": 300.0, "c": 500.0})
    monkeypatch.setattr(select, "worthwhile", lambda before, after, *_: "b" not in after.names)
    assert chosen() == {"c"}  # of first names what is worth it leads


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


def test_what_reaches_the_noise_ends_it_however_close_another_is(monkeypatch):
    asked = played(monkeypatch, {"a": 1.0, "b": 1.5, "bc": 0.5})
    assert chosen() == {"a"}
    assert asked == [()]


def test_the_same_names_by_two_ways_are_gone_on_from_once(monkeypatch):
    asked = played(monkeypatch, {"a": 500.0, "b": 505.0, "ab": 200.0, "abc": 1.0})
    assert chosen() == {"a", "b", "c"}
    assert [set(names) for names in asked].count({"a", "b"}) == 1


def test_what_only_led_the_others_to_a_better_fit_is_taken_out(monkeypatch):
    """``b`` was added, and without it the rest fits as well from where it stands now."""
    mechanism = SimpleNamespace(laws=("",))
    structure = SimpleNamespace(mechanism=lambda name: mechanism, count_free=lambda name, law: 1)
    setup = SimpleNamespace(structure=structure)

    def state(names):
        return SimpleNamespace(names=names, setup=setup, laws=dict.fromkeys(names, ""))

    monkeypatch.setattr(select, "without", lambda s, name, split: state(tuple(n for n in s.names if n != name)))
    missed = lambda fewer, s, name, *_: SimpleNamespace(accepted=name != "b")  # noqa: E731
    monkeypatch.setattr(select, "compare", missed)
    assert select.prune(state(("a", "b")), None, Evidence()).names == ("a",)  # type: ignore[arg-type]
    assert select.prune(state(("a", "c")), None, Evidence()).names == ("a", "c")  # type: ignore[arg-type]
    monkeypatch.setattr(select, "worthwhile", lambda fewer, s, base, split, worth: fewer.names != ("a",))
    base = state(())
    assert select.prune(state(("a", "c")), None, Evidence(), base).names == ("a",)  # type: ignore[arg-type]


def test_the_others_stay_where_a_name_that_is_none_led_them(monkeypatch):
    """``b`` gains by what ``a`` then does, and is pruned; nothing else gains anything."""
    played(monkeypatch, {"a": 500.0, "ab": 100.0})
    without_b = lambda s: Played(("a",), 90.0) if "b" in s.names else s  # noqa: E731
    monkeypatch.setattr(select, "prune", lambda state, split, rules, base=None: without_b(state))
    found = select.choose(Played((), 1000.0), None, Evidence(), None)  # type: ignore[arg-type]
    assert (found.state.names, found.state.cost) == (("a",), 90.0)
