"""A fit that was made before is not made again, and is the same to the bit."""

from dataclasses import replace

import jax
import numpy as np
import pytest

from scpjax.diagnose.holdout import split
from scpjax.fit import solve as room
from scpjax.fit.ends import _KEPT, End, Ends, key_of
from scpjax.fit.setup import prepare
from scpjax.fit.solve import solve, solve_all
from scpjax.recordings.recording import Metadata, Recording


@pytest.fixture
def problem():
    time = 0.1 * np.arange(400)
    drive = np.where(time % 20 < 10, 3.0, 1.0)
    warm, x = [], 0.0
    for u in drive:
        x += 0.1 * (u**2 / 1.2 - 0.1 * x) / 1.0
        warm.append(20.0 + x)
    noise = 0.05 * np.random.default_rng(0).standard_normal(time.size)
    known = (("resistance_ohm", 1.2),)
    meta = Metadata(ambient_K=293.15, known=known)
    setup = prepare(
        [Recording.from_arrays(time, {"voltage_V": drive}, {"temperature_degC": warm + noise}, metadata=meta)]
    )
    value = np.asarray(setup.starts[0])
    active, laws = np.asarray(setup.base_active), np.zeros(len(setup.structure.mechanisms))
    off = value.copy()
    off[active] *= 1.5
    return setup, [setup.trial(v, active, laws, int(active.sum())) for v in (value, off)]


@pytest.fixture
def made(monkeypatch):
    """How many trials were really fitted, call by call."""
    counts: list[int] = []

    def counting(trials, *args, **options):
        counts.append(int(trials.free.shape[0]))
        return solve(trials, *args, **options)

    monkeypatch.setattr(room, "solve", counting)
    monkeypatch.setattr(room, "_ENDS", Ends())
    return counts


def same(a, b):
    for x, y in zip(jax.tree.leaves(a), jax.tree.leaves(b), strict=True):
        np.testing.assert_array_equal(x, y)


def test_the_same_fit_is_made_once(problem, made):
    setup, (one, two) = problem
    once = solve_all([one, two, one], setup.data, setup.space, max_steps=40)
    again = solve_all([two, one], setup.data, setup.space, max_steps=40)
    assert made == [2]
    same([once[0][i] for i in (1, 0)], again[0])
    np.testing.assert_array_equal(once[1][[1, 0]], again[1])
    same(once[0][0], once[0][2])
    straight = solve(room.stack([one, two]), setup.data, setup.space, max_steps=40)
    np.testing.assert_array_equal(straight.free, [t.free for t in once[0][:2]])
    np.testing.assert_array_equal(straight.cost, once[1][:2])


def test_what_was_told_may_be_changed_by_who_asked(problem, made):
    setup, (one, _) = problem
    first = solve_all([one], setup.data, setup.space, max_steps=40)[0][0]
    kept = np.array(first.free)
    first.free[:] = 0.0
    np.testing.assert_array_equal(solve_all([one], setup.data, setup.space, max_steps=40)[0][0].free, kept)


def test_one_at_rest_is_there_by_any_longer_way_and_by_no_other_tolerance(problem, made):
    setup, (_, off) = problem
    _, cost, rested = solve_all([off], setup.data, setup.space, max_steps=40, tolerance=0.02)
    assert rested.all()
    longer = solve_all([off], setup.data, setup.space, max_steps=60, tolerance=0.02)
    assert (made, longer[1][0]) == ([1], cost[0])
    solve_all([off], setup.data, setup.space, max_steps=40, tolerance=1e-6)
    solve_all([off], setup.data, setup.space, max_steps=1, tolerance=0.02)
    assert made == [1, 1, 1]


def test_one_on_its_way_is_there_by_any_finer_tolerance_and_no_other_limit(problem, made):
    setup, (_, off) = problem
    _, cost, rested = solve_all([off], setup.data, setup.space, max_steps=2, tolerance=0.02)
    assert not rested.any()
    finer = solve_all([off], setup.data, setup.space, max_steps=2, tolerance=1e-3)
    assert (made, finer[1][0], finer[2][0]) == ([1], cost[0], False)
    straight = solve(room.stack([off]), setup.data, setup.space, max_steps=2, tolerance=1e-3)
    assert straight.cost[0] == cost[0]
    solve_all([off], setup.data, setup.space, max_steps=3, tolerance=0.02)
    solve_all([off], setup.data, setup.space, max_steps=2, tolerance=100.0)
    assert made == [1, 1, 1]


def test_other_data_priors_or_starts_are_other_fits(problem, made):
    setup, (one, two) = problem
    solve_all([one], setup.data, setup.space, max_steps=40)
    solve_all([two], setup.data, setup.space, max_steps=40)
    solve_all([one], split(setup.data).train, setup.space, max_steps=40)
    other = replace(setup.space, prior_mean=setup.space.prior_mean + 0.1)
    solve_all([one], setup.data, other, max_steps=40)
    assert made == [1, 1, 1, 1]
    assert key_of(one, other) != key_of(one, setup.space)


def test_only_the_last_few_data_are_held(problem, made):
    setup, _ = problem
    ends, end = Ends(), End(np.zeros(3), 1.0, True, 3, 40, 1e-3)
    several = [split(setup.data).train for _ in range(_KEPT + 1)]
    for data in several[:-1]:
        ends.keep(data, "fit", end)
    assert ends.find(several[0], "fit", 40, 1e-3) is end  # asked for again, it is none of the oldest
    ends.keep(several[-1], "fit", end)
    assert [ends.find(data, "fit", 40, 1e-3) is end for data in several] == [i != 1 for i in range(len(several))]
