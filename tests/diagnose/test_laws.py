"""Under which of its laws a mechanism is told that was just named. The fits are played."""

from types import SimpleNamespace

from scpjax.diagnose import laws
from scpjax.diagnose.evidence import Evidence


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
