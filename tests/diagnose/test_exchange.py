"""A name chosen before the rest was known gives way to one that does better beside it."""

from types import SimpleNamespace

import pytest

from scpjax.diagnose import exchange
from scpjax.diagnose.exchange import accepted_beside, exchanged
from scpjax.diagnose.result import Ranked
from scpjax.diagnose.select import Choice, Evidence

RANKING = (
    Ranked("a", 100.0, 0.5, 0.9, "", 1),
    Ranked("b", 90.0, 0.4, 0.1, "", 1),
    Ranked("c", 50.0, -0.1, 0.0, "", 1),
    Ranked("d", 5.0, 0.1, 0.0, "", 1),
    Ranked("e", 80.0, 0.3, 1.0, "", 2),
)


def state(names, cost):
    return SimpleNamespace(names=tuple(names), cost=cost)


def chosen(names, cost):
    return Choice(state(names, cost), RANKING, dict.fromkeys(names, 0.9), {"a": ("z",)})  # type: ignore[arg-type]


@pytest.fixture
def swaps(monkeypatch):
    """Costs of what stands in a name's place; what was tried."""
    costs, tried = {}, []

    def swapped(before, out, name, split):
        tried.append((out, name))
        return {name: state([*(n for n in before.names if n != out), name], costs.get(name, 1e9))}

    monkeypatch.setattr(exchange, "swapped", swapped)
    monkeypatch.setattr(exchange, "prune", lambda s, *_: s)
    monkeypatch.setattr(exchange, "is_better", lambda a, b, *_: a.cost < b.cost)
    monkeypatch.setattr(exchange, "at_noise", lambda s, *_: s.cost < 10.0)
    return costs, tried


def test_what_had_evidence_in_the_round_of_a_name_stands_beside_it():
    assert accepted_beside(RANKING, "a", Evidence()) == ["b"]
    assert accepted_beside(RANKING, "e", Evidence()) == []
    assert accepted_beside(RANKING, "b", Evidence()) == []


def test_a_better_one_takes_its_place_and_its_chance(swaps):
    costs, tried = swaps
    costs["b"] = 50.0
    found = exchanged(chosen(("a", "e"), 100.0), None, Evidence())  # type: ignore[arg-type]
    assert found.state.names == ("e", "b")
    assert found.probability == {"e": 0.9, "b": 0.9}
    assert found.equivalents == {"e": (), "b": ()}
    assert tried == [("a", "b")]


@pytest.mark.parametrize(
    ("names", "cost", "other"), [(("a", "e"), 100.0, 150.0), (("a", "e"), 5.0, 1.0), (("a",), 100.0, 1.0)]
)
def test_nothing_is_exchanged_for_a_worse_one_or_at_the_noise_or_alone(swaps, names, cost, other):
    costs, _ = swaps
    costs["b"] = other
    before = chosen(names, cost)
    assert exchanged(before, None, Evidence()) is before  # type: ignore[arg-type]
