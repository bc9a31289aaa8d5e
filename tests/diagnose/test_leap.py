"""Two mechanisms at once: which are tried, what reaches the noise, and where the selection asks for them. The fits are
played.
"""

from dataclasses import dataclass, replace
from types import SimpleNamespace

import numpy as np
import pytest
from diagnose.playing import Played, chosen, played, put

from scpjax.diagnose import leap as room
from scpjax.diagnose import naming, select
from scpjax.diagnose.evidence import Comparison, Evidence
from scpjax.diagnose.leap import leap, one_promises_the_rest
from scpjax.diagnose.patience import Patience
from scpjax.diagnose.result import Ranked
from scpjax.diagnose.ways import Branch, Search, Tried

NOISE = 10.0


@dataclass(frozen=True)
class _Mechanism:
    name: str
    is_base: bool = False
    laws: tuple[str, ...] = ("law",)


class _State(Played):
    @property
    def laws(self):
        return dict.fromkeys(self.names, "law")

    @property
    def setup(self):
        return SimpleNamespace(structure=SimpleNamespace(count_free=lambda name, law: 1))


def _search(patience: float = 1e9) -> Search:
    catalogue = SimpleNamespace(structure=SimpleNamespace(mechanisms=[_Mechanism(n) for n in "abcdx"]))
    split = SimpleNamespace(is_train=np.ones(int(NOISE), bool))
    return Search(_State((), 1e6), split, Evidence(), catalogue, 40, Patience(patience))  # type: ignore[arg-type]


def _played(
    monkeypatch,
    left: dict[str, float],
    promised: dict[str, dict[str, float]],
    anew: dict[str, float] | None = None,
    laws: dict[tuple[str, str], float] | None = None,
) -> list[str]:
    """Plays fits of names, in the order of the alphabet, that leave so much, and promises beside them; which were
    fitted. ``anew``: what they leave fitted afresh; ``laws``: and with one of them under another law.
    """
    fitted: list[str] = []

    def told(state):
        return "".join(sorted(state.names))

    def with_one(state, name, split, close):
        after = told(_State((*state.names, name), 0.0))
        fitted.append(after)
        return {name: _State((*state.names, name), left[after])} if after in left else {}

    def promises(state, split, catalogue, mechanisms):
        gain = promised[told(state)]
        known = [m for m in mechanisms if m.name in gain]
        found = [SimpleNamespace(mechanism=m, gain=gain[m.name]) for m in known]
        return sorted(found, key=lambda p: -p.gain)

    played = {
        "by_law": with_one,
        "screen": promises,
        "afresh": lambda state, split: _State(state.names, (anew or {}).get(told(state), state.cost)),
        "under_every_law": lambda state, name, split, hurried: _State(
            state.names, (laws or {}).get((told(state), name), state.cost)
        ),
        "prune": lambda state, *_: state,
        "level": lambda state, split: (state.cost / NOISE) ** 0.5,
        "at_noise": lambda state, split, within=1.0: state.cost <= NOISE * within,
        "compare": lambda a, b, name, law, split, rules, extra: _gained(b, name, a.cost - b.cost),
        "is_better": lambda a, b, split, rules: a.cost < b.cost,
        "chance_against": lambda a, b, split, rules: 1 / (1 + np.exp((a.cost - b.cost) / 2)),
    }
    for name, value in played.items():
        monkeypatch.setattr(room, name, value)
    return fitted


def _gained(state, name: str, bic: float) -> Comparison:
    return Comparison(state, name, "law", bic, 0.5, 50.0, 0.5, True)


def _round(costs: dict[str, float], beside: str = "x") -> Tried:
    accepted = [_gained(_State((beside, n), cost), n, 1000.0 - cost) for n, cost in costs.items()]
    ranking = (Ranked(beside, 5000.0, 0.5, 1.0, "law", 1), Ranked("a", 900.0, 0.5, 1.0, "law", 2))
    way = Branch(_State((beside,), 1000.0), ranking[:1], {beside: ()}, {}, {beside: ()})  # type: ignore[arg-type]
    return Tried(way, ranking, tuple(accepted), accepted, 900.0)


LEADER = _State(("x", "a"), 60.0)
PROMISED = {"bx": {"c": 300.0, "d": 250.0}, "cx": {"b": 350.0, "d": 340.0}, "dx": {"b": 100.0}}


def _asked(monkeypatch, left: dict[str, float], patience: float = 1e9) -> tuple[Branch | None, list[str]]:
    fitted = _played(monkeypatch, left, PROMISED)
    found = _round({"a": 60.0, "b": 400.0, "c": 410.0, "d": 500.0})
    return leap(_search(patience), found, LEADER, LEADER, lambda text: None), fitted  # type: ignore[arg-type]


def test_two_at_once_reach_what_neither_does_beside_what_imitates_both(monkeypatch):
    """``a`` leaves least of all alone; ``b`` and ``c`` are all there is. Both are told with what speaks for both."""
    found, fitted = _asked(monkeypatch, {"bcx": 10.0})
    assert found is not None
    assert found.state.names == ("x", "b", "c")
    assert fitted == ["cdx", "bcx"]
    assert found.chance("b") == found.chance("c") == pytest.approx(1.0)
    assert (found.ranking[-1].name, found.ranking[-1].round) == ("c", 3)
    assert found.together == ("b", "c")


def test_what_imitates_both_is_no_rival_of_what_was_named_before(monkeypatch):
    _played(monkeypatch, {"bcx": 10.0}, PROMISED)
    found = _round({"a": 60.0, "b": 400.0, "c": 410.0})
    rivals = tuple(_gained(_State((n,), 100.0), n, bic) for n, bic in (("x", 900.0), ("a", 990.0), ("d", 100.0)))
    found = replace(found, way=replace(found.way, tried={"x": rivals}))
    both = leap(_search(), found, LEADER, LEADER, lambda text: None)  # type: ignore[arg-type]
    assert found.way.chance("x") < 0.01
    assert both is not None
    assert both.chance("x") > 0.99


def test_each_is_tried_with_another_one_once_and_none_with_the_leader(monkeypatch):
    """The one that promises most beside ``c`` is ``b``, which was tried. What promises little is not."""
    found, fitted = _asked(monkeypatch, {"bcx": 80.0, "cdx": 10.0})
    assert found is not None
    assert fitted == ["cdx"]  # as promised it leaves 70, less than the other
    found, fitted = _asked(monkeypatch, {"bcx": 80.0, "cdx": 85.0})
    assert found is None
    assert fitted == ["cdx", "bcx"]


@pytest.mark.parametrize(("left", "names"), [(11.0, ("x", "b", "c")), (13.0, ("x", "c", "d"))])
def test_what_is_near_the_noise_may_be_outdone_by_what_is_closer(monkeypatch, left, names):
    found, fitted = _asked(monkeypatch, {"bcx": left, "cdx": 12.0})
    assert found is not None
    assert found.state.names == names
    assert fitted == ["cdx", "bcx"]
    ahead = 1 / (1 + np.exp(-0.5))  # of the other pair; what is in both has that for it which nothing else had
    assert [found.chance(n) for n in names[1:]] == pytest.approx([1.0 if n == "c" else ahead for n in names[1:]])


@pytest.mark.parametrize(("left", "names"), [(12.0, ("x", "b", "c")), (14.0, None)])
def test_what_only_comes_near_is_fitted_afresh_and_under_other_laws(monkeypatch, left, names):
    """Closest first; the law of the first name, ``x``, was chosen beside neither."""
    for more in ({"anew": {"bcx": left}}, {"laws": {("bcx", "x"): left}}):
        _played(monkeypatch, {"bcx": 80.0, "cdx": 85.0}, PROMISED, **more)
        found = leap(_search(), _round({"b": 400.0, "c": 410.0, "d": 500.0}), LEADER, LEADER, lambda text: None)  # type: ignore[arg-type]
        assert (found and found.state.names) == names


def test_two_at_once_are_better_than_what_the_search_has_come_to(monkeypatch):
    """Else they are none; what it has come to may have more names, of which the leader had none."""
    for cost, names in ((11.0, None), (13.0, ("x", "b", "c"))):
        _played(monkeypatch, {"bcx": 12.0}, PROMISED)
        found = _round({"b": 400.0, "c": 410.0})
        both = leap(_search(), found, LEADER, _State(("x", "a", "d"), cost), lambda text: None)  # type: ignore[arg-type]
        assert (both and both.state.names) == names
        if both:
            assert both.chance("b") == pytest.approx(1 / (1 + np.exp(-0.5)))


@pytest.mark.parametrize(("left", "reached"), [(NOISE * 1.3, True), (NOISE * 1.4, False), (NOISE * 9.5, False)])
def test_only_what_reaches_the_noise_counts(monkeypatch, left, reached):
    found, _ = _asked(monkeypatch, {"bcx": left, "cdx": 900.0})
    assert (found is not None) is reached


@pytest.mark.parametrize(("far", "tried"), [(1.0, ["bcx"]), (3.5, ["bcx"]), (5.0, [])])
def test_where_nothing_promises_to_come_near_nothing_is_tried(monkeypatch, far, tried):
    promised = {n: {"b": 300.0 * far, "c": 300.0 * far} for n in ("bx", "cx")}
    fitted = _played(monkeypatch, {"bcx": 80.0}, promised)
    found = _round({"b": 400.0 * far, "c": 400.0 * far})
    assert leap(_search(), found, LEADER, LEADER, lambda text: None) is None  # type: ignore[arg-type]
    assert fitted == tried


def test_what_is_not_missed_beside_the_other_is_not_named(monkeypatch):
    fitted = _played(monkeypatch, {"bcx": 10.0, "cdx": 900.0}, PROMISED)
    monkeypatch.setattr(room, "prune", lambda state, *_: _State(("x", "b"), 12.0))
    found = _round({"b": 400.0, "c": 410.0})
    assert leap(_search(), found, LEADER, LEADER, lambda text: None) is None  # type: ignore[arg-type]
    assert "bcx" in fitted


def test_out_of_patience_nothing_is_fitted(monkeypatch):
    found, fitted = _asked(monkeypatch, {"bcx": 10.0}, patience=0.0)
    assert (found, fitted) == (None, [])


@pytest.mark.parametrize(("gain", "all_of_it"), [(48.0, True), (30.0, False), (0.0, False)])
def test_a_single_one_may_promise_all_that_is_left(monkeypatch, gain, all_of_it):
    _played(monkeypatch, {}, {"ax": {"b": gain, "c": gain / 2}})
    assert one_promises_the_rest(_search(), LEADER) is all_of_it  # type: ignore[arg-type]
    _played(monkeypatch, {}, {"ax": {}})
    assert not one_promises_the_rest(_search(), LEADER)  # type: ignore[arg-type]


def _at_once(monkeypatch, promised: bool, both: float) -> list[tuple[str, ...]]:
    """Plays two at once that leave so much; what they were set against."""
    put(monkeypatch, "one_promises_the_rest", lambda search, state: promised)
    put(monkeypatch, "at_noise", lambda state, split, within=1.05: state.cost <= within)
    against: list[tuple[str, ...]] = []

    def two(search, found, leader, state, tell):
        assert found.way.state.names == ("d",)
        assert leader.names == ("d", "a")
        against.append(state.names)
        return replace(found.way, state=Played(("d", "b", "c"), both), own=dict.fromkeys("dbc", 1.0))

    put(monkeypatch, "leap", two)
    return against


@pytest.mark.parametrize("promised", [True, False])
def test_the_selection_asks_for_two_at_once_before_a_last_round_or_after_it(monkeypatch, promised):
    """Before it where no single one promises the rest; else the last round is gone first."""
    asked = played(monkeypatch, {"d": 500.0, "ad": 50.0, "bd": 300.0, "cd": 310.0, "abd": 30.0})
    against = _at_once(monkeypatch, promised, 1.0)
    assert chosen() == {"b", "c", "d"}
    assert against == [("d", "a", "b") if promised else ("d", "a")]
    assert (("d", "a") in asked) is promised


@pytest.mark.parametrize(
    ("promised", "both", "third", "names"),
    [
        (True, 1.0, 1.0, {"a", "b", "d"}),  # one more was all there was
        (False, 1.2, 1.0, {"a", "b", "d"}),  # two at once had come near, and it to the noise
        (False, 1.2, 1.3, {"b", "c", "d"}),
        (False, 1.0, 0.9, {"b", "c", "d"}),  # down to the noise: nothing more is asked for
    ],
)
def test_two_at_once_near_the_noise_do_not_end_the_selection(monkeypatch, promised, both, third, names):
    played(monkeypatch, {"d": 500.0, "ad": 50.0, "bd": 300.0, "cd": 310.0, "abd": third})
    _at_once(monkeypatch, promised, both)
    assert chosen() == names


def test_names_are_mended_before_two_are_tried_at_once(monkeypatch):
    played(monkeypatch, {"d": 500.0, "ad": 50.0, "bd": 300.0, "cd": 310.0, "abd": 30.0})
    against = _at_once(monkeypatch, True, 1.0)

    def mend(choice):
        return replace(choice, state=Played(choice.state.names, 1.0))

    found = select.choose(Played((), 1000.0), None, Evidence(), None, mend=mend)  # type: ignore[arg-type]
    assert {*found.state.names} == {"a", "b", "d"}
    assert against == []


def test_a_second_way_is_not_gone_where_it_is_part_of_what_explains_all(monkeypatch):
    for left, gone in ((1.0, False), (1.2, True)):
        asked = played(monkeypatch, {"a": 500.0, "b": 505.0, "ab": left, "bc": 300.0})
        chosen()
        assert (("b",) in asked) is gone
    asked = played(monkeypatch, {"a": 500.0, "b": 505.0, "ac": 1.0, "bc": 300.0})
    chosen()
    assert ("b",) in asked


def test_two_at_once_are_tried_on_every_way(monkeypatch):
    """What imitates both may have been ahead in the first round already: then they are beside what the other way has
    named. None is tried beside what led the leader's own ways; beside another, anything.
    """
    played(monkeypatch, {"a": 500.0, "b": 505.0, "ab": 200.0, "bc": 300.0})
    put(monkeypatch, "one_promises_the_rest", lambda search, state: False)
    tried = []
    put(monkeypatch, "leap", lambda search, found, leader, *_: tried.append((found.way.state.names, leader.names)))
    chosen()
    assert tried == [(("a",), ("a", "b")), (("b",), ("a", "b"))]
    played(monkeypatch, {"a": 500.0, "b": 505.0, "ac": 200.0, "bd": 300.0})
    put(monkeypatch, "one_promises_the_rest", lambda search, state: False)
    tried.clear()
    put(monkeypatch, "leap", lambda search, found, leader, *_: tried.append((found.way.state.names, leader.names)))
    chosen()
    assert tried == [(("a",), ("a", "c")), (("b",), ("b",))]


def test_the_report_tells_of_two_at_once(monkeypatch):
    """By the table of rounds what imitates them leads, and neither."""
    played(monkeypatch, {"d": 500.0, "ad": 50.0, "bd": 300.0, "cd": 310.0})
    put(monkeypatch, "one_promises_the_rest", lambda search, state: False)
    both = Played(("d", "b", "c"), 1.0)
    way = lambda found: replace(found.way, state=both, own=dict.fromkeys("dbc", 1.0), together=("b", "c"))  # noqa: E731
    put(monkeypatch, "leap", lambda search, found, *_: way(found))
    found = select.choose(Played((), 1000.0), None, Evidence(), None)  # type: ignore[arg-type]
    assert found.together == ("b", "c")
    (note,) = naming._together(found)
    assert "b and c were then tried together" in note
    assert naming._together(replace(found, together=())) == ()


def test_the_selection_goes_on_where_no_two_do(monkeypatch):
    played(monkeypatch, {"a": 500.0, "ab": 300.0, "abc": 1.0})
    put(monkeypatch, "one_promises_the_rest", lambda search, state: False)
    put(monkeypatch, "leap", lambda *_: None)
    assert select.choose(Played((), 1000.0), None, Evidence(), None).state.names == ("a", "b", "c")  # type: ignore[arg-type]
