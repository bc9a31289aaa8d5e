"""Every law of a mechanism has room for what it moves, and none for what only other laws do; what is at the noise."""

from types import SimpleNamespace

import numpy as np
import pytest
from creeping import slow

from scpjax.diagnose import trials
from scpjax.diagnose.hypothesis import State, grown, moving_parameters, trial_at, width
from scpjax.diagnose.remainder import at_noise
from scpjax.fit.setup import prepare
from scpjax.physics.catalogue import mechanism


@pytest.mark.parametrize("names", [("creep",), ("nonlinear_stiffness",), ("creep", "nonlinear_stiffness")])
def test_as_many_places_as_the_widest_law_needs(names):
    problem = grown(prepare([slow()]), *(mechanism(n) for n in names))
    idle, places, widest = problem.space.size, width(problem), 0
    for law in range(max(len(mechanism(n).laws) for n in names)):
        laws = np.zeros(len(problem.structure.mechanisms))
        for i, m in enumerate(problem.structure.mechanisms):
            laws[i] = min(law, len(m.laws) - 1)
        moves = np.flatnonzero(moving_parameters(problem, laws))
        index = np.asarray(trial_at(problem, np.asarray(problem.starts[0]), laws).index)
        assert len(index) == places
        np.testing.assert_array_equal(index[: len(moves)], moves)
        assert np.all(index[len(moves) :] == idle)
        widest = max(widest, len(moves))
    if len(names) == 1:
        assert widest == places


@pytest.mark.parametrize("n", [300, 1000, 20_000])
def test_white_noise_is_at_the_noise_however_few_samples(n):
    """All but a few in a hundred, of two columns. Half as much again of a mean square is not; nor is a wave as small as
    chance, which is like its neighbours.
    """
    rng, here = np.random.default_rng(n), np.ones((1, n, 2), bool)
    split = SimpleNamespace(is_train=here, is_held=~here)

    def share(noise, slow=0.0):
        wave = slow * np.sin(np.linspace(0.0, 20.0, n))[None, :, None]
        drawn = (SimpleNamespace(residual=noise * rng.standard_normal((1, n, 2)) + wave) for _ in range(500))
        return np.mean([at_noise(state, split) for state in drawn])  # type: ignore[arg-type]

    assert share(1.0) > 0.96
    assert share(1.25) < 0.01
    assert share(1.0, slow=0.55) < 0.1


@pytest.mark.parametrize("noise", [True, False])
def test_what_was_fitted_afresh_is_not_again_unless_its_mechanisms_have_starts_of_their_own(monkeypatch, noise):
    problem = grown(prepare([slow()]), mechanism("creep"))
    trial = trial_at(problem, np.asarray(problem.starts[0]), np.zeros(len(problem.structure.mechanisms)))
    asked = []

    def at_rest(setup, split, begun):
        asked.append(len(begun))
        return State(setup, begun[0], np.zeros(()), 1.0)

    monkeypatch.setattr(trials, "_leading_at_rest", at_rest)
    monkeypatch.setattr(trials, "at_noise", lambda *_: noise)
    first = State(problem, trial, np.zeros(()), 2.0)
    found = trials.afresh(first, None, own=False)  # type: ignore[arg-type]
    assert found.anew
    assert trials.afresh(found, None, own=False) is found  # type: ignore[arg-type]
    assert (trials.afresh(found, None) is found) == noise  # type: ignore[arg-type]
    few = 1 + len(problem.starts[:3])
    assert asked == ([few] if noise else [few, few + 2])
