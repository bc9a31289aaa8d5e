"""Two names, each under the law that is best beside the other's wrong one, are asked for both at once."""

from types import SimpleNamespace

import numpy as np
from diagnose.heated import LOSS, base_of, recorded

from scpjax.diagnose import exchange
from scpjax.diagnose.evidence import Evidence
from scpjax.diagnose.hypothesis import State, from_their_starts, grown, trial_at
from scpjax.diagnose.patience import Patience
from scpjax.diagnose.remainder import at_noise
from scpjax.diagnose.trials import at_rest, under_both_their_laws
from scpjax.physics.catalogue import mechanism

PAIR = ("nonlinear_heat_loss", "thermal_softening")


def under(base: State, split, *laws: str) -> State:
    ms = [mechanism(name) for name in PAIR]
    problem = grown(base.setup, *ms)
    vector = np.zeros(len(problem.structure.mechanisms))
    for m, law in zip(ms, laws, strict=True):
        vector[problem.structure.mechanisms.index(m)] = m.laws.index(law)
    return at_rest(problem, split, [trial_at(problem, v, vector) for v in from_their_starts(problem, vector)])


def test_both_laws_are_found_where_both_are_wrong():
    """Of a recording by scipy: a loss that grows with the square of the temperature, a spring that softens as e^-T."""
    base, split = base_of(recorded(lambda _t, T, _x: 0.8 * LOSS * T * (T / 60.0), stiff=lambda T: np.exp(-T / 60.0)))
    wrong = under(base, split, "radiation", "linear")
    assert not at_noise(wrong, split)
    found = min(under_both_their_laws(wrong, PAIR, split), key=lambda s: s.cost)
    assert (found.laws[PAIR[0]], found.laws[PAIR[1]]) == ("power", "exponential")
    assert at_noise(found, split)


def played(monkeypatch, costs):
    asked = []

    def both(state, pair, _split):
        asked.append("".join(pair))
        return [SimpleNamespace(names=state.names, cost=cost) for cost in (1e9, costs.get("".join(pair), 1e9), 90.0)]

    monkeypatch.setattr(exchange, "under_both_their_laws", both)
    monkeypatch.setattr(exchange, "at_noise", lambda s, *_: s.cost < 10.0)
    monkeypatch.setattr(exchange, "is_better", lambda a, b, *_: a.cost < b.cost)
    monkeypatch.setattr(exchange, "_laws_again", lambda s, *_: SimpleNamespace(names=s.names, cost=s.cost - 1.0))
    return asked


def test_two_at_a_time_until_the_noise_is_reached(monkeypatch):
    asked = played(monkeypatch, {"ab": 80.0, "ac": 5.0})
    three = SimpleNamespace(names=("a", "b", "c"), cost=50.0)
    found = exchange.laws_of_two(three, None, Evidence(), Patience())  # type: ignore[arg-type]
    assert asked == ["ab", "ac"]
    assert found.cost == 4.0, "and each law once more beside what has changed"


def test_not_at_the_noise_nor_out_of_patience(monkeypatch):
    asked = played(monkeypatch, {"ab": 5.0})
    near, far = (SimpleNamespace(names=("a", "b"), cost=cost) for cost in (9.0, 50.0))
    assert exchange.laws_of_two(near, None, Evidence(), Patience()) is near  # type: ignore[arg-type]
    assert exchange.laws_of_two(far, None, Evidence(), Patience(0.0)) is far  # type: ignore[arg-type]
    assert asked == []
