"""Stretches held out in turn: nine tenths, none twice, and the second half; each set judges a fit without it."""

from dataclasses import replace
from functools import cache
from types import SimpleNamespace

import numpy as np
import pytest
from diagnose.heated import recorded as heated
from diagnose.heated import rubbed_by_air
from diagnose.test_holdout import recorded

from scpjax.diagnose import evidence, folds, remainder
from scpjax.diagnose.diagnose import _base
from scpjax.diagnose.evidence import Evidence, compare
from scpjax.diagnose.folds import held_in_turn, squares_in_turn, untold
from scpjax.diagnose.holdout import Split, split
from scpjax.diagnose.hypothesis import State, grown, residual_on, trial_at
from scpjax.diagnose.remainder import leaves_much
from scpjax.fit.fit import best_start, refine
from scpjax.fit.setup import prepare
from scpjax.physics.catalogue import mechanism

_N = 1000
_OFF = slice(int(0.82 * _N), int(0.88 * _N))  # held out by the second set of stretches, and in the second half


@cache
def fitted() -> tuple[State, Split]:
    """A heater of which one stretch was read 3 degrees too high, 60 times the noise."""
    recording = recorded(_N)
    read = np.array(recording.outputs)
    read[_OFF] += 3.0
    setup = prepare([recording.with_outputs(read)])
    parts = split(setup.data)
    trial, _, _ = best_start(setup, parts.train)
    trial, _, cost = refine(setup, parts.train, trial)
    return State(setup, trial, residual_on(trial, parts.whole, setup), cost), parts


def test_nine_tenths_are_held_out_and_none_of_it_twice_and_the_second_half():
    _, parts = fitted()
    *sets, half = masks = np.stack([parts.mask, *(other.mask for other in parts.others)])
    assert np.sum(sets, axis=0).max() == 1
    there = np.asarray(parts.whole.weights) > 0
    assert [np.mean(m[there]) for m in masks] == pytest.approx([0.3, 0.3, 0.3, 0.48], abs=0.02)
    assert half[0, : _N // 2].sum() == 0
    assert parts.others is parts.others
    finer = replace(parts, train=parts.train.finer(2), whole=parts.whole.finer(2))
    assert all(np.array_equal(a.is_held, b.is_held) for a, b in zip(parts.others, finer.others, strict=True))


@pytest.mark.parametrize("away", [(0.1, 0.2), (0.2, 0.6), (0.7, 0.9), (0.0, 0.0)])
def test_the_second_half_is_held_out_of_recordings_with_gaps_too(away):
    recording = recorded(_N)
    read = np.array(recording.outputs)
    read[int(away[0] * _N) : int(away[1] * _N)] = np.nan
    parts = split(prepare([recording.with_outputs(read)]).data)
    half = parts.others[-1].mask[0, :, 0]
    there = np.asarray(parts.whole.weights)[0, :, 0] > 0
    first = int(np.argmax(half))
    assert first >= 0.5 * _N
    assert half[first : np.flatnonzero(there)[-1] + 1].all()
    assert 0.2 < np.mean(half[there]) <= 0.5


def test_what_only_the_stretches_held_out_say_is_not_remembered():
    """A room that grows warmer in the second half alone, fitted to all of it."""
    recording = recorded(_N)
    read = np.array(recording.outputs)
    since = 0.05 * np.arange(_N)[:, None] - 35.0
    read += np.where(since > 0, 3.0 * -np.expm1(-since / 5.0), 0.0)
    base = prepare([recording.with_outputs(read)])
    parts = split(base.data)
    m = mechanism("ambient_drift")
    setup, law = grown(base, m), m.laws.index("excursion")
    known = {"begin": 35.0, "end": 140.0, "time_constant": 5.0, "drift": 3.0 / base.scales.temperature}
    start = np.array(setup.starts[0])
    for key, value in known.items():
        start[setup.structure.index[f"ambient_drift.{key}"]] = value
    laws = np.array([law if each.name == m.name else 0 for each in setup.structure.mechanisms])
    trial, _, cost = refine(setup, parts.train, trial_at(setup, start, laws))
    state = State(setup, trial, residual_on(trial, parts.whole, setup), cost)
    half = parts.others[-1]
    drift = setup.structure.index["ambient_drift.drift"]
    assert [bool(np.asarray(untold(trial, setup, by).active)[drift]) for by in (half, parts)] == [False, True]
    assert np.asarray(untold(trial, setup, half).fixed)[drift] == 0.0
    assert untold(fitted()[0].trial, fitted()[0].setup, half) is fitted()[0].trial  # nothing beyond the base model
    *_, (residual, held) = held_in_turn([state], parts)[0]
    assert float(np.sqrt(np.mean(residual[held] ** 2))) > 20
    assert float(np.sqrt(np.mean(residual[half.is_train] ** 2))) < 1.5


def test_each_set_judges_a_fit_that_has_not_seen_it():
    state, parts = fitted()
    ((own, second, third, half),) = held_in_turn([state], parts)
    assert np.array_equal(own[0], state.residual)
    rms = lambda residual, there: float(np.sqrt(np.mean(residual[there] ** 2)))  # noqa: E731
    there = parts.is_train | parts.is_held
    for residual, held in (second, half):  # what was read wrong is held out
        assert rms(residual, there & ~held) == pytest.approx(1.0, abs=0.2)
        assert rms(residual, held) > 20
    assert rms(third[0], there & ~third[1]) > 5  # and seen by the others
    assert rms(third[0], third[1]) < rms(own[0], parts.is_train)
    squares = [float(np.sum(residual[held] ** 2)) for residual, held in (own, second, third, half)]
    assert squares_in_turn(state, parts) == pytest.approx(sum(squares))


def test_a_hypothesis_is_fitted_anew_once(monkeypatch):
    state, parts = fitted()
    known = held_in_turn([state], parts)
    monkeypatch.setattr(folds, "solve_all", None)
    assert held_in_turn([state, state], parts) == [*known, *known]
    with pytest.raises(TypeError):  # of other data nothing is known
        held_in_turn([state], replace(parts))


@pytest.mark.parametrize("far", [False, True])
def test_they_judge_where_the_noise_is_no_scale(monkeypatch, far):
    """A law that does better in the one set and worse in the others."""
    state, parts = fitted()
    worse = replace(state, residual=1.5 * state.residual)
    monkeypatch.setattr(evidence, "no_scale", lambda before, split: far)
    turned = lambda size: [(size * state.residual, h) for h in (parts.is_held, parts.is_train, parts.is_train)]  # noqa: E731
    monkeypatch.setattr(evidence, "held_in_turn", lambda states, split: [turned(1.0), turned(3.0)])
    found = compare(worse, state, "", "", parts, Evidence(), 1)
    assert found.delta_bic > 0
    assert found.held_out_gain == pytest.approx(1 - 3.0 if far else 1 - 1 / 1.5)
    assert (found.held_out_excess > 0) is not far
    assert evidence.is_better(state, worse, parts, Evidence()) is not far


def test_what_fits_worse_is_not_fitted_anew(monkeypatch):
    state, parts = fitted()
    monkeypatch.setattr(evidence, "no_scale", lambda before, split: True)
    monkeypatch.setattr(evidence, "held_in_turn", None)
    assert compare(state, replace(state, residual=1.5 * state.residual), "", "", parts, Evidence(), 1).delta_bic < 0


@pytest.mark.parametrize(("left", "much"), [(0.7, False), (1.1, True)])
def test_how_much_is_left_is_of_all_sets_where_the_noise_is_no_scale(monkeypatch, left, much):
    """Of the one set three times what the base model leaves there is left; of all sets less, or more."""
    there = np.zeros((1, 100, 1), bool)
    there[:, 30:] = True
    parts = SimpleNamespace(is_train=there, is_held=~there)
    base, state = (SimpleNamespace(residual=np.full((1, 100, 1), size), names=("a",)) for size in (400.0, 150.0))
    state.residual = np.where(parts.is_held, 700.0, state.residual)
    of_all = {id(base): 1.0, id(state): left}
    monkeypatch.setattr(remainder, "squares_in_turn", lambda s, _: of_all[id(s)])
    assert leaves_much(base, state, parts) is much  # type: ignore[arg-type]
    for s in (base, state):  # nearer the noise the one set decides
        s.residual = s.residual / 20
    assert leaves_much(base, state, parts)  # type: ignore[arg-type]
    monkeypatch.setattr(remainder, "squares_in_turn", None)
    assert leaves_much(base, state, parts)  # type: ignore[arg-type]


@pytest.mark.parametrize(("quiet", "told"), [(1.0, False), (1e-3, True)])
def test_that_they_judge_is_told(quiet, told):
    _, base, notes = _base(prepare([heated(rubbed_by_air, quiet=quiet)]))
    assert any("second half" in n for n in notes) is told
    assert base.names == ()
