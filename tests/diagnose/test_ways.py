"""A round on a way: what is tried and named, and which ways are gone on. The fits are played."""

from dataclasses import replace

import pytest
from diagnose.playing import Played, chosen, played, put

from scpjax.diagnose import select, ways
from scpjax.diagnose.evidence import Comparison, Evidence
from scpjax.diagnose.own import ROOM


def test_what_had_evidence_for_the_first_name_contends_later(monkeypatch):
    """Those with most of it; not what had none, nor what is named by then."""
    played(monkeypatch, {"a": 500.0, "b": 700.0, "c": 995.0, "d": 600.0, "ab": 300.0})
    told, try_all = [], ways.try_all

    def asked(state, *args, contenders, **more):
        told.append((state.names, contenders))
        return try_all(state, *args, contenders=contenders, **more)

    put(monkeypatch, "try_all", asked)
    chosen()
    contenders = dict(told)
    assert [contenders[names] for names in ((), ("a",), ("a", "b"))] == [[], ["d", "b"], ["d"]]


def test_where_two_are_close_the_next_round_decides(monkeypatch):
    """``a`` is a little ahead at first, but only with ``b`` is the noise reached."""
    asked = played(monkeypatch, {"a": 500.0, "b": 510.0, "ac": 300.0, "bc": 1.0})
    assert chosen() == {"b", "c"}
    assert set(asked) == {(), ("a",), ("b",)}


def test_where_one_is_far_ahead_only_it_is_followed(monkeypatch):
    asked = played(monkeypatch, {"a": 500.0, "b": 530.0, "ac": 1.0, "bc": 0.5})
    assert chosen() == {"a", "c"}
    assert ("b",) not in asked


def _predicting_no_better(monkeypatch, *names: str) -> None:
    """As first name, or as those named in this order, they are not accepted, however well they fit."""
    try_all = ways.try_all

    def asked(state, *args, **more):
        found = try_all(state, *args, **more)
        return [replace(c, accepted=False, held_out_gain=-0.1) if "".join(c.state.names) in names else c for c in found]

    put(monkeypatch, "try_all", asked)


@pytest.mark.parametrize(
    ("far", "b", "wanted"), [(True, 510.0, {"b", "c"}), (True, 530.0, {"a", "c"}), (False, 510.0, {"a", "c"})]
)
def test_where_the_noise_is_no_scale_what_fits_as_well_is_gone_on_with_on_trust(monkeypatch, far, b, wanted):
    """``b`` predicts no better alone, but only with it is the noise reached; if its fit is about as close as that of
    ``a``, and not nearer the noise, where that speaks against it.
    """
    asked = played(monkeypatch, {"a": 500.0, "b": b, "ac": 300.0, "bc": 1.0})
    _predicting_no_better(monkeypatch, "b")
    put(monkeypatch, "no_scale", lambda *_: far)
    put(monkeypatch, "prune", lambda state, *_: Played((), 1000.0) if state.names == ("b",) else state)
    assert chosen() == wanted
    assert (("b",) in asked) is ("b" in wanted)


@pytest.mark.parametrize("least", [False, True])
def test_only_a_first_name_is_trusted_and_none_that_is_at_its_least(monkeypatch, least):
    asked = played(monkeypatch, {"a": 500.0, "b": 510.0, "ac": 400.0, "ad": 405.0, "acd": 395.0})
    _predicting_no_better(monkeypatch, "b", "ad")
    put(monkeypatch, "no_scale", lambda *_: True)
    put(monkeypatch, "at_its_least", lambda *_: least)
    chosen()
    assert (("b",) in asked) is not least
    assert ("a", "c") in asked
    assert ("a", "d") not in asked  # beside a first name only those accepted, as ever


@pytest.mark.parametrize("far", [False, True])
def test_where_the_noise_is_no_scale_what_fits_contends_later_though_it_predicts_no_better(monkeypatch, far):
    played(monkeypatch, {"a": 500.0, "b": 700.0, "ac": 300.0})
    _predicting_no_better(monkeypatch, "b")
    put(monkeypatch, "no_scale", lambda *_: far)
    told, try_all = {}, ways.try_all

    def asked(state, *args, contenders, **more):
        told[state.names] = contenders
        return try_all(state, *args, contenders=contenders, **more)

    put(monkeypatch, "try_all", asked)
    chosen()
    assert told["a",] == (["b"] if far else [])


@pytest.mark.parametrize(("better", "wanted"), [(0.95, {"a", "c"}), (0.8, {"b", "c"})])
def test_what_predicts_clearly_better_is_followed_as_well(monkeypatch, better, wanted):
    """However far it is behind in evidence, and though another one is closer."""
    misfits = {"a": 500.0, "b": 600.0, "d": 510.0, "ac": 1.0, "bc": 0.5, "cd": 1.0}
    asked = played(monkeypatch, misfits, {"a": 1.0, "b": better, "d": 0.99})
    assert chosen() == wanted
    assert asked == [(), ("a",), ("b",) if better < 0.9 else ("d",)]


@pytest.mark.parametrize(("gone", "left"), [("b", 500.0), ("ab", 1000.0)])
def test_what_is_pruned_as_soon_as_it_is_named_leaves_its_place_to_the_next(monkeypatch, gone, left):
    """Beside ``a``, ``b`` promises more than ``c`` by far and is not missed, nor is ``a`` then; no round is spent on
    ``a`` again, nor on the base.
    """
    asked = played(monkeypatch, {"a": 500.0, "ab": 100.0, "ac": 300.0, "acd": 1.0})
    keep = lambda s: Played(tuple(n for n in s.names if n not in gone), left) if "b" in s.names else s  # noqa: E731
    put(monkeypatch, "prune", lambda state, split, rules, base=None: keep(state))
    found = select.choose(Played((), 1000.0), None, Evidence(), None)  # type: ignore[arg-type]
    assert set(found.state.names) == {"a", "c", "d"}
    assert asked == [(), ("a",), ("a", "c")]
    assert found.probability["c"] > 0.99  # nor was it a rival


def with_rooms(monkeypatch, misfits: dict[str, float]) -> list[tuple[str, ...]]:
    """Plays a room that differs by recording, which leaves these misfits beside names; beside what it was asked for."""
    asked: list[tuple[str, ...]] = []

    def own_room(state, split, rules):
        asked.append(state.names)
        left = misfits.get("".join(sorted(state.names)))
        if left is None or ROOM in state.names:
            return None
        now = Played((*state.names, ROOM), left, ("room.drift",))
        fall = state.cost - left
        return Comparison(now, ROOM, "cycling", fall, 0.5, fall, 0.5, True)

    put(monkeypatch, "own_room", own_room)
    return asked


def test_a_room_that_differs_is_asked_for_where_no_name_reaches_the_noise(monkeypatch):
    """And taken at once where it does, beside the first names or none."""
    for first, wanted in ((300.0, {ROOM}), (1.0, {"a"})):
        played(monkeypatch, {"a": first})
        rooms = with_rooms(monkeypatch, {"": 1.0})
        assert chosen() == wanted
        assert rooms == ([()] if first > 1.0 else [])


def test_a_room_that_differs_may_be_the_first_name_of_another_way(monkeypatch):
    """With it the noise has to be reached, as it can take many forms."""
    for last in (1.0, 100.0):
        played(monkeypatch, {"a": 500.0, "ab": 300.0} | joined("ab", 250.0, last))
        with_rooms(monkeypatch, {"": 700.0})
        assert chosen() == ({"a", "b", ROOM} if last == 1.0 else {"a", "b"})


def joined(names: str, first: float, last: float) -> dict[str, float]:
    """What the first of two names, then both, leave beside the room."""
    key = lambda *some: "".join(sorted([*some, ROOM]))  # noqa: E731
    return {key(names[0]): first, key(*names): last}


def test_a_parameter_that_differs_is_kept_where_the_noise_is_reached(monkeypatch):
    for left, wanted in ((1.0, ("a.size",)), (200.0, ())):
        played(monkeypatch, {"a": 500.0})
        own = lambda state, *_, left=left: Played(state.names, left, ("a.size",)) if state.names == ("a",) else None  # noqa: E731
        put(monkeypatch, "released", own)
        asked = played(monkeypatch, {"a": 500.0})
        put(monkeypatch, "released", own)
        found = select.choose(Played((), 1000.0), None, Evidence(), None)  # type: ignore[arg-type]
        assert (found.state.names, found.state.setup.structure.own) == (("a",), wanted)
        assert asked == ([()] if left == 1.0 else [(), ("a",)])  # what does not reach it is no way to go on from


def test_what_is_named_as_well_was_no_rival(monkeypatch):
    """``a`` and ``b`` were as likely as each other at first; ``c``, which was too, is not named."""
    played(monkeypatch, {"a": 500.0, "b": 500.0, "ab": 1.0})
    found = select.choose(Played((), 1000.0), None, Evidence(), None)  # type: ignore[arg-type]
    assert found.probability == pytest.approx({"a": 1.0, "b": 1.0})
    played(monkeypatch, {"a": 500.0, "b": 500.0, "c": 500.0, "ab": 1.0})
    found = select.choose(Played((), 1000.0), None, Evidence(), None)  # type: ignore[arg-type]
    assert found.probability == pytest.approx({"a": 0.5, "b": 1.0})


@pytest.mark.parametrize(("small", "names"), [(300.0, {"a"}), (495.0, {"a", "c"})])
def test_beyond_a_first_name_what_is_behind_something_too_small_is_not_named(monkeypatch, small, names):
    """Beside ``a``, ``b`` has more evidence than ``c`` but takes too little away to be named."""
    played(monkeypatch, {"a": 500.0, "ab": small, "ac": 497.0 - 12.0})
    put(monkeypatch, "worthwhile", lambda before, after, *_: "b" not in after.names)
    assert chosen() == names
    played(monkeypatch, {"b": 300.0, "c": 500.0})
    put(monkeypatch, "worthwhile", lambda before, after, *_: "b" not in after.names)
    assert chosen() == {"c"}  # of first names what is worth it leads


def test_what_reaches_the_noise_ends_it_however_close_another_is(monkeypatch):
    asked = played(monkeypatch, {"a": 1.0, "b": 1.5, "bc": 0.5})
    assert chosen() == {"a"}
    assert asked == [()]


def test_the_others_stay_where_a_name_that_is_none_led_them(monkeypatch):
    """``b`` gains by what ``a`` then does, and is pruned; nothing else gains anything."""
    played(monkeypatch, {"a": 500.0, "ab": 100.0})
    without_b = lambda s: Played(("a",), 90.0) if "b" in s.names else s  # noqa: E731
    put(monkeypatch, "prune", lambda state, split, rules, base=None: without_b(state))
    found = select.choose(Played((), 1000.0), None, Evidence(), None)  # type: ignore[arg-type]
    assert (found.state.names, found.state.cost) == (("a",), 90.0)
