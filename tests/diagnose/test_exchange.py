"""A name chosen before the rest was known gives way to one that does better beside it, and is told with its equals."""

import math
from types import SimpleNamespace

import pytest
from diagnose.creeping import AMBIENT
from diagnose.heated import LOSS, base_of, recorded

from scpjax.diagnose import exchange
from scpjax.diagnose.choice import Choice
from scpjax.diagnose.evidence import Evidence
from scpjax.diagnose.exchange import accepted_beside, exchanged, in_its_place
from scpjax.diagnose.hypothesis import starts_with, trial_at
from scpjax.diagnose.patience import Patience
from scpjax.diagnose.result import Ranked
from scpjax.diagnose.rivals import added
from scpjax.diagnose.trials import at_rest, under_every_law

RANKING = (
    Ranked("a", 100.0, 0.5, 0.9, "", 1),
    Ranked("b", 90.0, 0.4, 0.1, "", 1),
    Ranked("c", 50.0, -0.1, 0.0, "", 1),
    Ranked("d", 5.0, 0.1, 0.0, "", 1),
    Ranked("e", 80.0, 0.3, 1.0, "", 2),
)
NAMES = "abcdefg"
CATALOGUE = SimpleNamespace(
    structure=SimpleNamespace(mechanisms=[SimpleNamespace(name=n, is_base=False) for n in NAMES])
)


def state(names, cost, law="", width=2):
    return SimpleNamespace(names=tuple(names), cost=cost, laws=dict.fromkeys(names, law), width=width)


def again(s, cost):
    return SimpleNamespace(names=s.names, cost=cost, laws=s.laws, width=s.width)


def chosen(names, cost):
    return Choice(state(names, cost), RANKING, dict.fromkeys(names, 0.9), {"a": ("z",)})  # type: ignore[arg-type]


def after_exchange(choice):
    return exchanged(choice, None, None, Evidence(), CATALOGUE)  # type: ignore[arg-type]


@pytest.fixture
def swaps(monkeypatch):
    """Costs of what stands in a name's place, what each promises, and what was tried."""
    costs, promise, tried, fresh, width = {}, {"a": 100.0, "e": 90.0}, [], {}, {}
    anew: dict[str, float] = {}  # what each promises beside the base first suggested

    def by_law(bare, name, split, close=0.0):
        tried.append((*bare.names, name))
        return {name: state([*bare.names, name], costs.get(name, 1e9), width=width.get(name, 2))}

    def screen(bare, split, catalogue, candidates, gains=promise):
        promises = [SimpleNamespace(mechanism=m, gain=gains.get(m.name, 0.0)) for m in candidates]
        return sorted(promises, key=lambda p: -p.gain)

    def begun(*asked):
        return SimpleNamespace(promises=screen(*asked, anew)) if anew else None

    monkeypatch.setattr(exchange, "without", lambda s, name, _: state([n for n in s.names if n != name], 1e9))
    monkeypatch.setattr(exchange, "by_law", by_law)
    monkeypatch.setattr(exchange, "screen", screen)
    monkeypatch.setattr(exchange, "fresh", begun)
    monkeypatch.setattr(exchange, "afresh", lambda s, _: again(s, fresh.get(s.names[-1], s.cost)))
    monkeypatch.setattr(exchange, "prune", lambda s, *_: s)
    monkeypatch.setattr(exchange, "at_noise", lambda *_: True)
    monkeypatch.setattr(exchange, "under_every_law", lambda s, *_, **__: s)
    monkeypatch.setattr(exchange, "under_both_their_laws", lambda *_: [])
    monkeypatch.setattr(exchange, "strained", lambda s: ())
    monkeypatch.setattr(exchange, "moving", lambda s: s.width)

    def in_order(s, first, split):
        return state([first, *(n for n in s.names if n != first)], s.cost, width=s.width)

    monkeypatch.setattr(exchange, "in_order", in_order)
    monkeypatch.setattr(exchange, "is_better", lambda a, b, *_: a.cost < b.cost)
    monkeypatch.setattr(exchange, "are_equal", lambda a, b, *_: abs(a.cost - b.cost) < 5.0)
    return SimpleNamespace(costs=costs, promise=promise, tried=tried, fresh=fresh, anew=anew, width=width)


@pytest.mark.parametrize(("square", "much", "tried"), [(1.5, True, True), (1.8, True, False), (1.8, False, True)])
def test_out_of_patience_names_that_will_be_told_are_exchanged(swaps, monkeypatch, square, much, tried):
    """Those near the noise, and those that do not leave so much that they are given up."""
    monkeypatch.setattr(exchange, "leaves_much", lambda *_: much)
    monkeypatch.setattr(exchange, "at_noise", lambda s, split, level=1.05: square < level)
    exchanged(chosen(("a", "e"), 100.0), None, None, Evidence(), CATALOGUE, Patience(0.0, math.inf))  # type: ignore[arg-type]
    assert bool(swaps.tried) == tried


def test_late_no_name_is_exchanged_which_is_told(swaps):
    patience = Patience(0.0, 0.0)
    found = exchanged(chosen(("a", "e"), 100.0), None, None, Evidence(), CATALOGUE, patience)  # type: ignore[arg-type]
    assert found.state.names == ("a", "e")
    assert swaps.tried == []
    assert "names set against what could stand in their place" in patience.notes()[-1]


def test_out_of_patience_names_that_will_be_given_up_are_not_exchanged(swaps, monkeypatch):
    monkeypatch.setattr(exchange, "leaves_much", lambda *_: True)
    choice, patience = chosen(("a", "e"), 100.0), Patience(0.0, math.inf)
    exchanged(choice, None, None, Evidence(), CATALOGUE, patience)  # type: ignore[arg-type]
    assert swaps.tried
    assert not patience.ended
    monkeypatch.setattr(exchange, "at_noise", lambda *_: False)
    swaps.tried.clear()
    found = exchanged(choice, None, None, Evidence(), CATALOGUE, patience)  # type: ignore[arg-type]
    assert swaps.tried == []
    assert found.state is choice.state
    assert patience.ended


def test_a_name_is_not_asked_for_again_where_it_was_left_in_its_place(swaps, monkeypatch):
    """Its place is taken once: what came after that was left beside the very same names."""
    monkeypatch.setattr(exchange, "at_noise", lambda *_: False)
    swaps.costs["b"], asked = 50.0, []
    swaps.promise["b"] = 200.0

    def without(s, name, _):
        asked.append(name)
        return state([n for n in s.names if n != name], 1e9)

    monkeypatch.setattr(exchange, "without", without)
    found = after_exchange(chosen(("a", "e", "f"), 100.0))
    assert found.state.names == ("b", "e", "f")
    assert asked == ["a", "e", "f", "b"]


def test_a_name_is_not_asked_for_its_law_again_where_it_kept_it(swaps, monkeypatch):
    monkeypatch.setattr(exchange, "at_noise", lambda *_: False)
    asked, costs = [], iter([60.0, 60.0, 60.0, 60.0])

    def under_every_law(s, name, *_, **__):
        asked.append(name)
        return again(s, next(costs))

    monkeypatch.setattr(exchange, "under_every_law", under_every_law)
    found = exchange._laws_again(state("aef", 100.0), None, Evidence(), Patience())  # type: ignore[arg-type]
    assert found.cost == 60.0
    assert asked == ["a", "e", "f", "a"]


def test_away_from_the_noise_names_are_asked_for_their_laws_again(swaps, monkeypatch):
    choice = chosen(("a", "e"), 100.0)
    assert after_exchange(choice).state is choice.state
    monkeypatch.setattr(exchange, "at_noise", lambda s, *_: s.cost < 40.0)
    laws = {"a": iter([60.0, 30.0]), "e": iter([200.0, 200.0])}  # what it costs under the best of them, each time

    def by_law(bare, name, split, close=0.0):
        swaps.tried.append((*bare.names, name))
        cost = next(laws[name]) if name in laws else 1e9
        return {name: state([*bare.names, name], cost, f"law {cost}")}

    monkeypatch.setattr(exchange, "by_law", by_law)
    swaps.tried.clear()
    found = after_exchange(choice)
    # e is not asked for again, as it was left beside this very a
    assert [t for t in swaps.tried if t[-1] in laws] == [("e", "a"), ("a", "e"), ("e", "a")]
    assert found.state.cost == 30.0
    assert found.state.names == ("a", "e")
    assert found.probability == choice.probability


def test_at_the_noise_laws_change_where_one_is_stretched(swaps, monkeypatch):
    asked = []
    monkeypatch.setattr(exchange, "under_every_law", lambda s, name, _: (asked.append(name), again(s, 90.0))[1])
    assert after_exchange(chosen(("a", "e"), 100.0)).state.cost == 100.0
    assert asked == []
    monkeypatch.setattr(exchange, "strained", lambda s: ("e",) if s.cost > 95.0 else ())
    assert after_exchange(chosen(("a", "e"), 100.0)).state.cost == 90.0
    assert asked == ["a"], "and no longer than one is"


def test_away_from_the_noise_laws_change_first_where_all_stand(swaps, monkeypatch):
    """One law after the other, until the noise is reached; then no name is asked in another's place."""
    monkeypatch.setattr(exchange, "at_noise", lambda s, *_: s.cost < 40.0)
    costs, asked = {"a": 70.0, "e": 30.0}, []

    def under_every_law(s, name, _):
        asked.append((name, s.cost))
        return state(s.names, min(s.cost, costs[name]), f"law of {name}")

    monkeypatch.setattr(exchange, "under_every_law", under_every_law)
    found = after_exchange(chosen(("a", "e"), 100.0))
    assert asked == [("a", 100.0), ("e", 70.0)]
    assert found.state.cost == 30.0
    costs |= {"e": 70.0}  # it stays away from the noise: all are asked once more beside what has changed
    asked.clear()
    assert after_exchange(chosen(("a", "e"), 100.0)).state.cost == 70.0
    assert asked == [("a", 100.0), ("e", 70.0), ("a", 70.0)]


def test_out_of_patience_every_name_is_still_asked_for_its_law_once(swaps, monkeypatch):
    """A wrong law may be all that is amiss where a search took too long."""
    monkeypatch.setattr(exchange, "at_noise", lambda *_: False)
    monkeypatch.setattr(exchange, "leaves_much", lambda *_: True)
    asked = []

    def under_every_law(s, name, _, *, hurried):
        asked.append(name)
        assert hurried
        return again(s, s.cost - 10.0)

    monkeypatch.setattr(exchange, "under_every_law", under_every_law)
    patience = Patience(0.0, math.inf)
    found = exchanged(chosen(("a", "e"), 100.0), None, None, Evidence(), CATALOGUE, patience)  # type: ignore[arg-type]
    assert asked == ["a", "e"]
    assert found.state.cost == 80.0
    assert swaps.tried == []
    assert patience.ended


@pytest.mark.parametrize(("reached", "asked"), [(1.02, []), (1.2, ["a", "e"])], ids=["at the noise", "near it"])
def test_names_that_do_not_quite_reach_the_noise_are_asked_for_their_laws_once(swaps, monkeypatch, reached, asked):
    """Mean square 1.2 is near the noise (1.15 squared) and not at it: laws chosen beside a missing name may be why."""
    monkeypatch.setattr(exchange, "at_noise", lambda s, split, within=1.05: reached < within)
    found = []

    def under_every_law(s, name, _, *, hurried):
        assert hurried
        found.append(name)
        return again(s, s.cost - 1.0)

    monkeypatch.setattr(exchange, "under_every_law", under_every_law)
    exchanged(chosen(("a", "e"), 100.0), None, None, Evidence(), CATALOGUE)  # type: ignore[arg-type]
    assert found == asked


@pytest.mark.parametrize("hurried", [False, True])
def test_a_wrong_law_beside_a_fitted_rest_is_put_right(hurried):
    """A loss by radiation held under the law of a power, from where that fit came to rest."""

    def radiates(_t, temperature, _x):
        return 1.5 * LOSS * ((temperature + AMBIENT) ** 4 - AMBIENT**4) / (4 * AMBIENT**3) - 1.5 * LOSS * temperature

    base, parts = base_of(recorded(radiates))
    right = added(base, "nonlinear_heat_loss", parts)
    m = right.setup.structure.mechanism("nonlinear_heat_loss")
    wrong = at_rest(
        right.setup, parts, [t for t in _starts(base, m, right.setup) if t.laws[-1] != right.trial.laws[-1]]
    )
    assert wrong.laws != right.laws
    again = under_every_law(wrong, "nonlinear_heat_loss", parts, hurried=hurried)
    assert again.laws == right.laws
    assert again.cost == pytest.approx(right.cost, rel=1e-3)
    assert again.cost < wrong.cost


def _starts(base, m, problem):
    return [trial_at(problem, s.value, s.laws) for s in starts_with(base, m, problem)]


def test_what_did_badly_in_the_place_of_a_name_is_tried_once_and_only_what_contends_is_pruned(swaps, monkeypatch):
    monkeypatch.setattr(exchange, "at_noise", lambda *_: False)
    swaps.promise |= {"f": 95.0, "g": 92.0}
    costs = {"a": iter([60.0, 60.0]), "e": iter([200.0, 200.0])}  # a law is changed once: there are two passes

    def by_law(bare, name, split, close=0.0):
        swaps.tried.append((*bare.names, name))
        cost = next(costs[name]) if name in costs else {"f": 500.0, "g": 150.0}.get(name, 1e9)
        return {name: state([*bare.names, name], cost, f"law {cost}")}

    pruned = []
    monkeypatch.setattr(exchange, "by_law", by_law)
    monkeypatch.setattr(exchange, "prune", lambda s, *_: (pruned.append(s.names), s)[1])
    assert after_exchange(chosen(("a", "e"), 100.0)).state.cost == 60.0
    for name, times in {"f": 1, "g": 2}.items():
        assert swaps.tried.count(("e", name)) == times, name
    assert pruned == [("e", "a")]


def test_what_had_evidence_in_the_round_of_a_name_stands_beside_it():
    assert accepted_beside(RANKING, "a", Evidence()) == ["b"]
    assert accepted_beside(RANKING, "e", Evidence()) == []
    assert accepted_beside(RANKING, "b", Evidence()) == ["a"], "it led no round"
    assert accepted_beside(RANKING, "f", Evidence()) == []


def test_what_promises_most_beside_the_others_is_tried_and_what_had_evidence(swaps):
    swaps.promise |= {"f": 80.0, "g": 60.0, "c": 40.0, "d": 10.0}
    tried = in_its_place("a", state(["e"], 1.0), RANKING, None, Evidence(), CATALOGUE)  # type: ignore[arg-type]
    assert tried == ["f", "g", "b"]
    tried = in_its_place("a", state(["e"], 1.0), RANKING, None, Evidence(), CATALOGUE, far=True)  # type: ignore[arg-type]
    assert tried == ["f", "g", "c", "b"]
    swaps.promise |= {"f": 29.0, "g": 20.0, "c": 0.0}  # of the 100 that the name itself promises
    tried = in_its_place("a", state(["e"], 1.0), RANKING, None, Evidence(), CATALOGUE)  # type: ignore[arg-type]
    assert tried == ["b"]


def test_what_promises_as_much_beside_the_base_first_suggested_is_tried_too(swaps):
    """Where the fit of the others stands, their base may have been bent to imitate it: there it promises nothing."""
    swaps.anew |= {"a": 100.0, "g": 95.0, "b": 60.0, "d": 50.0}
    tried = in_its_place("a", state(["e"], 1.0), [], None, Evidence(), CATALOGUE)  # type: ignore[arg-type]
    assert tried == ["g", "b"]
    swaps.promise |= {"g": 80.0, "f": 60.0}
    tried = in_its_place("a", state(["e"], 1.0), [], None, Evidence(), CATALOGUE)  # type: ignore[arg-type]
    assert tried == ["g", "f", "b"]
    swaps.anew |= {"a": 1000.0}
    tried = in_its_place("a", state(["e"], 1.0), [], None, Evidence(), CATALOGUE)  # type: ignore[arg-type]
    assert tried == ["g", "f"]


@pytest.mark.parametrize(("closest", "told"), [(90.0, "closest"), (110.0, "alike")])
def test_what_is_not_better_under_its_closest_law_may_be_equal_under_another(swaps, monkeypatch, closest, told):
    def by_law(bare, name, split, close):
        costs = {"closest": closest, "far": 400.0, "alike": 102.0}
        return {n: state([*bare.names, name], c, n) for n, c in costs.items()}

    monkeypatch.setattr(exchange, "by_law", by_law)
    now = {"state": state("ea", 100.0), "base": None, "split": None, "rules": Evidence(), "patience": Patience()}
    found = exchange._beside(state("e", 1e3), "b", **now)  # type: ignore[arg-type]
    assert found is not None
    assert found.laws["b"] == told


def test_a_better_one_takes_its_place_and_its_chance(swaps):
    swaps.costs["b"] = 50.0
    found = after_exchange(chosen(("a", "e"), 100.0))
    assert found.state.names == ("b", "e")
    assert found.probability == {"b": 0.9, "e": 0.9}
    assert found.equivalents == {"e": (), "b": ()}
    assert swaps.tried == [("e", "b"), ("b", "a")]  # and what it took the place of, in the place of the other
    behind = chosen(("a", "e"), 100.0)
    behind.probability["b"] = 0.008  # in the round in which the other was the best: it is no longer
    assert after_exchange(behind).probability == {"e": 0.9, "b": 0.9}


def test_one_is_judged_by_where_it_comes_to_rest_with_base_parameters_that_nothing_has_bent(swaps):
    swaps.costs["b"], swaps.fresh["b"] = 150.0, 50.0
    assert after_exchange(chosen(("a", "e"), 100.0)).state.names == ("b", "e")


def test_one_that_nobody_ranked_may_be_better(swaps):
    """Beside a name that came first and was wrong it had no evidence."""
    swaps.promise["g"] = 95.0
    swaps.costs["g"] = 50.0
    assert after_exchange(chosen(("a", "e"), 100.0)).state.names == ("g", "e")


def test_one_that_does_as_well_is_told(swaps):
    swaps.costs |= {"b": 103.0, "f": 97.0}
    swaps.promise["f"] = 95.0
    found = after_exchange(chosen(("a", "e"), 100.0))
    assert found.state.names == ("f", "e")  # better, if by little
    assert found.equivalents == {"e": (), "f": ("a",)}
    swaps.costs["f"] = 104.0
    found = after_exchange(chosen(("a", "e"), 100.0))
    assert found.state.names == ("a", "e")
    assert found.equivalents == {"a": ("f", "b", "z"), "e": ("f",)}


def test_one_that_does_as_well_with_fewer_parameters_takes_its_place(swaps):
    swaps.costs |= {"b": 103.0}
    swaps.width |= {"b": 1}
    found = after_exchange(chosen(("a", "e"), 100.0))
    assert found.state.names == ("b", "e")
    assert found.equivalents["b"] == ("a",)
    swaps.width |= {"b": 3}
    assert after_exchange(chosen(("a", "e"), 100.0)).state.names == ("a", "e")


def test_away_from_the_noise_one_that_does_as_well_may_be_better_beside_other_laws(swaps, monkeypatch):
    """The laws of the others were chosen beside what it stands in the place of."""
    monkeypatch.setattr(exchange, "at_noise", lambda s, *_: False)
    swaps.costs |= {"b": 103.0}

    def under_every_law(s, name, _):
        return again(s, 40.0) if "b" in s.names and name == "e" else s

    monkeypatch.setattr(exchange, "under_every_law", under_every_law)
    found = after_exchange(chosen(("a", "e"), 100.0))
    assert set(found.state.names) == {"b", "e"}
    assert found.state.cost == 40.0


def test_a_worse_one_changes_nothing(swaps):
    swaps.costs["b"] = 150.0
    found = after_exchange(chosen(("a", "e"), 100.0))
    assert found.state.names == ("a", "e")
    assert found.equivalents == {"a": ("z",), "e": ()}


def test_one_whose_every_fit_blew_up_is_passed_over(swaps, monkeypatch):
    monkeypatch.setattr(exchange, "by_law", lambda *_, **__: {})
    found = after_exchange(chosen(("a", "e"), 100.0))
    assert found.state.names == ("a", "e")
    assert found.equivalents == {"a": ("z",), "e": ()}


def test_one_name_alone_was_compared_in_its_round(swaps):
    before = chosen(("a",), 100.0)
    assert after_exchange(before) is before
    assert swaps.tried == []
