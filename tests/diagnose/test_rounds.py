"""A round of the selection: what is fitted, from where, and which law speaks for a name. The fits are played."""

from types import SimpleNamespace

import numpy as np
import pytest

from scpjax.diagnose import candidates, promising
from scpjax.diagnose.evidence import Comparison, Evidence
from scpjax.diagnose.patience import Patience


@pytest.mark.parametrize(("second", "asked"), [(105.0, {100.0, 105.0}), (115.0, set())])
def test_fits_that_are_close_are_fitted_afresh(monkeypatch, second, asked):
    """Not where one mechanism alone is close, under however many laws; a fit that gets no better stays."""

    def fit(cost):
        return SimpleNamespace(cost=cost)

    def afresh(state, split, own):
        assert own == (second == 115.0)
        begun.append(state.cost)
        return SimpleNamespace(cost=90.0 if state.cost == 105.0 else 101.0)

    begun: list[float] = []
    monkeypatch.setattr(candidates, "afresh", afresh)
    monkeypatch.setattr(candidates, "at_noise", lambda state, *_: second == 105.0)
    fitted = {"a": {0: fit(100.0), 1: fit(300.0)}, "b": {0: fit(second)}}
    found = candidates.contested(fit(110.0), fitted, None, Patience())  # type: ignore[arg-type]
    assert set(begun) == asked
    assert found["a"][0].cost == 100.0
    assert found["a"][1].cost == 300.0
    assert found["b"][0].cost == (90.0 if asked else second)
    assert candidates.contested(fit(110.0), {}, None, Patience()) == {}  # type: ignore[arg-type]


def test_the_closest_law_of_what_gains_much_is_fitted_afresh(monkeypatch):
    """A few times the noise off may be a valley it is stuck in, where another mechanism is close; not if it gains
    less, and not its other laws."""

    def fit(cost):
        return SimpleNamespace(cost=cost)

    monkeypatch.setattr(candidates, "at_noise", lambda *_: False)
    monkeypatch.setattr(
        candidates, "afresh", lambda state, split, own: fit(80.0 if state.cost == 300.0 else state.cost)
    )
    fitted = {"a": {0: fit(100.0)}, "b": {0: fit(700.0), 1: fit(300.0)}, "c": {0: fit(700.0)}}
    assert candidates.contested(fit(1000.0), fitted, None, Patience(0.0)) == fitted  # type: ignore[arg-type]
    found = candidates.contested(fit(1000.0), fitted, None, Patience())  # type: ignore[arg-type]
    assert found["b"][1].cost == 80.0
    assert (found["a"][0].cost, found["b"][0].cost, found["c"][0].cost) == (100.0, 700.0, 700.0)
    asked: list[float] = []
    monkeypatch.setattr(candidates, "afresh", lambda state, split, own: asked.append(state.cost))
    alone = {"a": {0: fit(100.0), 1: fit(300.0)}, "c": {0: fit(700.0)}}
    assert candidates.contested(fit(1000.0), alone, None, Patience()) == alone  # type: ignore[arg-type]
    assert asked == []


@pytest.mark.parametrize(("better", "law"), [(True, "wide"), (False, "narrow")])
def test_a_wider_law_of_a_name_has_to_be_better_no_more(monkeypatch, better, law):
    """The name has its evidence by any law; one without it never speaks for it."""
    m = SimpleNamespace(laws=("wide", "narrow", "other"), free_parameters=lambda law: range((3, 1, 1)[law]))

    def by(law, cost, accepted):
        return Comparison(SimpleNamespace(cost=cost), "m", law, 1e3 - cost, 0.5, 0.0, 0.5, accepted)  # type: ignore[arg-type]

    found = [by("wide", 90.0, True), by("narrow", 100.0, True), by("other", 10.0, False)]
    monkeypatch.setattr(candidates, "is_better", lambda a, b, *_: better and a.cost < b.cost)
    assert candidates._best_law(m, found, None, Evidence()).law == law  # type: ignore[arg-type]
    assert candidates._best_law(m, found[2:], None, Evidence()).law == "other"  # type: ignore[arg-type]


def fitted(monkeypatch, taken, abreast, *, near, names=(), contenders=(), explains="", begun=None, patience=None):
    """Which of 14 mechanisms are fitted, each taking a share away; ``abreast`` of those behind the first promise nearly
    what it does, the rest half of it. ``near``: whether the hypothesis is near the noise; ``explains``: what reaches
    it; ``begun``: what promises most beside the base first suggested."""
    tried = []
    state = SimpleNamespace(names=names, cost=10_100.0, setup=None)
    split = SimpleNamespace(is_train=np.ones(100, bool), train=None)
    promises = [
        SimpleNamespace(mechanism=SimpleNamespace(name=f"m{i}"), gain=100.0 - i if i <= abreast else 50.0 - i)
        for i in range(14)
    ]
    problem = SimpleNamespace(space=None)
    monkeypatch.setattr(promising, "at_noise", lambda s, *_: near if s is state else tried[-1] == explains)
    monkeypatch.setattr(promising, "grown", lambda setup, m: tried.append(m.name) or problem)
    start = SimpleNamespace(law=0, laws=None)
    monkeypatch.setattr(promising, "starts_with", lambda *_: [start])
    monkeypatch.setattr(promising, "_best_starts", lambda promise: [start])
    monkeypatch.setattr(promising, "_compiled", lambda *_: None)
    for name in ("_transfer", "from_their_starts", "trial_at"):
        monkeypatch.setattr(promising, name, lambda *_: [None])
    monkeypatch.setattr(promising, "solve_all", lambda *_, **__: ([], np.array([10_100.0 - taken * 10_000.0]), None))
    monkeypatch.setattr(promising, "_as_close_as_others", lambda *_: None)
    monkeypatch.setattr(promising, "go_on", lambda problem, split, solved, cost, *_: (solved, cost))
    monkeypatch.setattr(promising, "_by_law", lambda *_: {0: None})
    found = promising.fit_promising(state, split, promises, begun, 40, lambda _: None, contenders, patience)  # type: ignore[arg-type]
    assert all(found[name] for name in tried)
    return tried


def first(count):
    """Those that promise most."""
    return [f"m{i}" for i in range(count)]


@pytest.mark.parametrize(("taken", "abreast", "count"), [(0.9, 0, 5), (0.3, 0, 10), (0.9, 6, 7), (0.9, 14, 10)])
def test_twice_as_many_are_fitted_where_none_explains_much_or_others_promise_as_much(
    monkeypatch, taken, abreast, count
):
    assert fitted(monkeypatch, taken, abreast, near=True) == first(count)


def test_where_no_first_name_comes_near_the_noise_what_is_likeliest_at_first_is_fitted(monkeypatch):
    """All where there is no saying what is: the base first suggested blows up."""
    assert fitted(monkeypatch, 0.9, 0, near=False) == first(14)
    assert fitted(monkeypatch, 0.9, 0, near=False, names=("a",)) == first(6)
    likeliest = SimpleNamespace(best=None, likeliest=("m12", "m3", "m9"))
    assert fitted(monkeypatch, 0.9, 0, near=False, begun=likeliest) == [*first(5), "m12", "m9"]
    assert fitted(monkeypatch, 0.9, 0, near=False, begun=likeliest, explains="m12") == [*first(5), "m12"]
    assert fitted(monkeypatch, 0.9, 0, near=True, begun=likeliest) == first(5)


def test_out_of_patience_only_what_promises_most_is_fitted(monkeypatch):
    """Fewer than the round would ask for, and the user is told."""
    for names, count in (((), 2), (("a",), 3)):
        impatient = Patience(0.0)
        beside = {"near": False, "names": names, "contenders": ("m13",), "patience": impatient}
        assert fitted(monkeypatch, 0.3, 0, **beside) == first(count)
        assert "--minutes" in impatient.notes()[0]


def test_the_programs_of_what_is_asked_for_next_are_compiled_beside_a_fit(monkeypatch):
    """As it stands then: of one that reached the noise far ones are not asked for any more."""
    ready, fits = [], promising._Fits(None, None, None, 40, print)  # type: ignore[arg-type]
    monkeypatch.setattr(promising, "_compiled", lambda mechanisms, *_: ready.append([m.name for m in mechanisms]))
    monkeypatch.setattr(fits, "add", lambda promise, bent: fits.found.setdefault(promise.mechanism.name, {}))
    promises = [SimpleNamespace(mechanism=SimpleNamespace(name=f"m{i}")) for i in range(5)]
    fits.add_all(promises, lambda i: i != 1 and len(fits.found) < 3)  # type: ignore[arg-type]
    assert list(fits.found) == ["m0", "m2", "m3"]
    assert ready == [["m2", "m3"], ["m3", "m4"], ["m4"]]


@pytest.mark.parametrize(("seconds", "fitted"), [(np.inf, [5, 2]), (0.0, [2])])
def test_out_of_patience_a_mechanism_is_fitted_from_its_best_starts_only(monkeypatch, seconds, fitted):
    """Not from all of them, and not with everything at its start."""
    starts = [SimpleNamespace(law=i % 2, laws=None, value=None) for i in range(5)]
    for name, value in (("grown", None), ("starts_with", starts), ("_best_starts", starts), ("_transfer", None)):
        monkeypatch.setattr(promising, name, lambda *_, value=value: value)
    monkeypatch.setattr(promising, "trial_at", lambda *_: None)
    monkeypatch.setattr(promising, "from_their_starts", lambda *_: [None])
    monkeypatch.setattr(promising, "at_noise", lambda *_: False)
    promise, state = SimpleNamespace(mechanism=SimpleNamespace(name="m")), SimpleNamespace(setup=None)
    fits = promising._Fits(state, None, None, 40, lambda _: None, Patience(seconds))  # type: ignore[arg-type]
    asked = []
    monkeypatch.setattr(fits, "_closest", lambda m, problem, trials, *_: (asked.append(len(trials)), ({}, [], []))[1])
    fits.add(promise)  # type: ignore[arg-type]
    assert asked == fitted


def test_of_trials_that_came_to_the_same_place_one_goes_on():
    """By the same laws: others that are as close may end elsewhere."""
    laws = ([1.0, 0.0], [1.0, 0.0], [1.0, 1.0], *([[1.0, 0.0]] * 6))
    trials = [SimpleNamespace(laws=np.array(law)) for law in laws]
    cost = np.array([100.9, 100.0, 100.0, 101.8, 102.7, 900.0, 900.1, np.inf, np.inf])
    found = promising._as_close_as_others(trials, cost, 1.0, 900.0)  # type: ignore[arg-type]
    assert found.tolist() == [True, False, False, False, True, False, False, False, False]


def test_near_the_noise_one_trial_by_each_other_law_goes_on_unless_it_is_hopeless():
    laws = [1.0, 1.0, 0.0, 0.0, 2.0]
    trials = [SimpleNamespace(laws=np.array([law, 0.0])) for law in laws]
    found = promising._behind_under_their_laws(trials, np.array([100.0, 900.0, 399.0, 398.0, 401.0]))  # type: ignore[arg-type]
    assert found.tolist() == [False, False, True, False, True]


@pytest.mark.parametrize(
    ("least", "nearly", "one_by_law"),
    [
        (500.0, promising.NEARLY, False),
        (133.0, promising.NEARLY, False),
        (131.0, promising.NEARLY, True),
        (100.0, promising._RIVAL, True),
    ],
)
def test_once_one_has_reached_the_noise_only_rivals_of_it_go_on(monkeypatch, least, nearly, one_by_law):
    state = SimpleNamespace(names=(), cost=1000.0)
    split = SimpleNamespace(is_train=np.ones(100, bool), train=None)
    told = []
    trials = [SimpleNamespace(laws=np.array([law])) for law in (0.0, 1.0)]
    monkeypatch.setattr(promising, "solve_all", lambda *_, **__: (trials, np.array([least, 700.0]), None))
    monkeypatch.setattr(promising, "_as_close_as_others", lambda *_: np.array([False, False]))
    monkeypatch.setattr(promising, "go_on", lambda *args: (told.append((args[-1], *args[4])), ([], args[3]))[1])
    monkeypatch.setattr(promising, "_by_law", lambda *_: {})
    fits = promising._Fits(state, split, None, 40, print)  # type: ignore[arg-type]
    fits._closest(None, SimpleNamespace(space=None), [None], promising.NEARLY)  # type: ignore[arg-type,list-item]
    assert told == [(nearly, False, one_by_law)]  # the second is five times as far


def test_what_contended_with_the_first_name_is_fitted_beside_it_whatever_it_promises(monkeypatch):
    """Not once something explains everything, and not twice; nor near the noise."""
    beside = {"names": ("a",), "contenders": ("m13", "m0")}
    assert fitted(monkeypatch, 0.9, 0, near=False, **beside) == [*first(6), "m13"]
    assert fitted(monkeypatch, 0.9, 0, near=False, **beside, explains="m5") == first(6)
    assert fitted(monkeypatch, 0.9, 0, near=True, **beside) == first(6)


@pytest.mark.parametrize(("abreast", "count"), [(0, 1), (2, 3), (3, 4), (4, 5), (9, 5)])
def test_beside_names_what_promises_as_much_as_what_explains_everything_is_fitted_too(monkeypatch, abreast, count):
    """These may be told apart by nothing, and the user has to be told of them."""
    beside = {"near": False, "names": ("a",), "explains": "m0"}
    assert fitted(monkeypatch, 0.9, abreast, **beside) == first(count)


@pytest.mark.parametrize(("square", "looked"), [(1.0, False), (1.2, False), (4.0, True)])
def test_a_base_that_leaves_little_has_not_been_bent(monkeypatch, square, looked):
    """Mechanisms are tried from the parameters first suggested only where much is left that a bent base could hide."""
    asked = []
    nothing = SimpleNamespace(structure=SimpleNamespace(mechanisms=[]))
    monkeypatch.setattr(candidates, "misfit", lambda *_: np.array([1.0, square]))
    monkeypatch.setattr(candidates, "screen", lambda *_: [])
    monkeypatch.setattr(candidates, "fresh", lambda *_: asked.append(True))
    monkeypatch.setattr(candidates, "fit_promising", lambda *_: {})
    assert candidates.try_all(None, None, Evidence(), nothing, max_steps=1, tell=print) == []  # type: ignore[arg-type]
    assert bool(asked) == looked
