"""Under which of its laws a mechanism is told that was just named. The fits are played."""

from types import SimpleNamespace

import numpy as np
import pytest

from scpjax.diagnose import laws
from scpjax.diagnose.evidence import Evidence
from scpjax.diagnose.patience import Patience


def test_away_from_the_noise_every_law_that_comes_near_is_fitted_afresh(monkeypatch):
    """A quick fit of another law may be behind only by where it began; one that is far behind is left."""
    m = SimpleNamespace(laws=("a", "b", "c", "d"), free_parameters=lambda law: ("J", "tau", "n")[: 2 + (law == 3)])
    setup = SimpleNamespace(structure=SimpleNamespace(mechanism=lambda _: m))
    quick = {0: 120.0, 2: 260.0, 3: 130.0}
    better = {120.0: 105.0, 130.0: 60.0}
    asked: list[float] = []

    def fit(law, cost):
        return SimpleNamespace(setup=setup, laws={"m": m.laws[law]}, cost=cost, law=law)

    def under(state, _m, law, _split, added):
        assert added == (["n"] if law == 3 else [])
        return fit(law, quick[law])

    def afresh(state, _split):
        asked.append(state.cost)
        return fit(state.law, better[state.cost])

    monkeypatch.setattr(laws, "laws_that_can_act", lambda *_: range(4))
    monkeypatch.setattr(laws, "_under", under)
    monkeypatch.setattr(laws, "afresh", afresh)
    monkeypatch.setattr(laws, "is_better", lambda a, b, *_: a.cost < b.cost)
    found = laws._every_law(fit(1, 100.0), "m", None, Evidence())  # type: ignore[arg-type]
    assert (found.law, found.cost) == (3, 60.0)
    assert set(asked) == {120.0, 130.0}
    better[130.0] = 101.0
    assert laws._every_law(fit(1, 100.0), "m", None, Evidence()).law == 1  # type: ignore[arg-type]


@pytest.mark.parametrize(
    ("left", "several"),
    [((1.0, 200.0), True), ((150.0, 1.0), True), ((1.0, 50.0), False), ((8.0, 8.0), False), ((1.0, 1.0), False)],
)
def test_where_another_name_is_missing_laws_are_not_asked_for_at_length(monkeypatch, left, several):
    """It is where one leaves a tenth of some column's misfit and more, and that is thrice the noise."""
    m = SimpleNamespace(laws=("narrow", "now", "wide"), free_parameters=lambda law: ("J", "tau", "n")[: 1 + law])
    setup = SimpleNamespace(structure=SimpleNamespace(mechanism=lambda _: m))

    def fit(law, misfit, names=("m",)):
        return SimpleNamespace(setup=setup, names=names, laws={"m": m.laws[law]}, misfit=np.array(misfit), cost=1.0)

    asked: list[str] = []
    monkeypatch.setattr(laws, "laws_that_can_act", lambda *_: range(3))
    monkeypatch.setattr(laws, "misfit", lambda state, _split: state.misfit)
    monkeypatch.setattr(laws, "excess", lambda state, _split: state.misfit - 1.0)
    monkeypatch.setattr(laws, "_under", lambda state, _m, law, *_: asked.append(m.laws[law]) or fit(law, left))
    monkeypatch.setattr(laws, "afresh", lambda state, *_: asked.append("afresh") or state)
    monkeypatch.setattr(laws, "_every_law", lambda state, *_: asked.append("every") or state)
    monkeypatch.setattr(laws, "at_noise", lambda state, _split: bool(np.all(state.misfit <= 1.0)))
    monkeypatch.setattr(laws, "is_better", lambda *_: False)
    laws.other_laws(fit(1, left), "m", None, Evidence(), fit(1, (1001.0, 1001.0)), Patience())  # type: ignore[arg-type]
    every = [] if max(left) == 1.0 else ["every"]
    assert sorted(asked) == sorted(["narrow", "wide"] if several else ["narrow", "afresh", "wide", *every])
    asked.clear()
    beside = fit(1, left, names=("a", "m"))  # out of patience it is left for all names together, but at the noise
    laws.other_laws(beside, "m", None, Evidence(), fit(1, (1001.0, 1001.0)), Patience(0.0))  # type: ignore[arg-type]
    assert bool(asked) == (max(left) == 1.0)


@pytest.mark.parametrize(("behind", "afresh"), [(3.9, True), (4.1, False)])
@pytest.mark.parametrize("noise", [True, False])
def test_at_the_noise_a_narrower_law_that_is_hopeless_is_not_fitted_afresh(monkeypatch, behind, afresh, noise):
    m = SimpleNamespace(laws=("narrow", "now"), free_parameters=lambda law: ("J", "tau")[: 1 + law])
    setup = SimpleNamespace(structure=SimpleNamespace(mechanism=lambda _: m))

    def fit(law, cost):
        return SimpleNamespace(setup=setup, names=("m",), laws={"m": m.laws[law]}, cost=cost)

    asked: list[float] = []
    monkeypatch.setattr(laws, "laws_that_can_act", lambda *_: range(2))
    monkeypatch.setattr(laws, "_is_one_of_several", lambda *_: False)
    monkeypatch.setattr(laws, "_under", lambda state, _m, law, *_: fit(law, behind * state.cost))
    monkeypatch.setattr(laws, "afresh", lambda state, *_: asked.append(state.cost) or state)
    monkeypatch.setattr(laws, "_every_law", lambda state, *_: state)
    monkeypatch.setattr(laws, "at_noise", lambda *_: noise)
    monkeypatch.setattr(laws, "is_better", lambda *_: True)
    laws.other_laws(fit(1, 100.0), "m", None, Evidence(), None, Patience())  # type: ignore[arg-type]
    assert asked == ([100.0 * behind] if afresh or not noise else [])
