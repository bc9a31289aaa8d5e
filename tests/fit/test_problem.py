"""Residuals and their Jacobian, which the solvers take abreast, against plain derivatives and plain simulations."""

from importlib import resources

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from scpjax.diagnose.holdout import split
from scpjax.diagnose.hypothesis import grown, trial_at
from scpjax.diagnose.own import with_own
from scpjax.fit.problem import CEILING, residuals, residuals_of, sensitivities, soften
from scpjax.fit.setup import prepare
from scpjax.physics.catalogue import mechanism
from scpjax.recordings import read_recording


def problem_and_trial(name, order=2):
    with resources.as_file(resources.files("scpjax") / "examples" / "demo") as folder:
        setup = prepare([read_recording(f) for f in sorted(folder.glob("*.csv"))], order=order)
    problem = grown(setup, mechanism(name)) if name else setup
    start = np.asarray(problem.starts[0]) * 1.03
    trial = trial_at(problem, start, np.zeros(len(problem.structure.mechanisms)))
    return problem, jax.tree.map(jnp.asarray, trial)


@pytest.mark.parametrize(("name", "order"), [(None, 2), ("hysteresis", 2), ("hysteresis", 4)])
@pytest.mark.parametrize("robust", [0.0, 1.5])
def test_the_jacobian_is_the_derivative_of_the_residuals(name, order, robust):
    problem, trial = problem_and_trial(name, order)
    moving = jnp.asarray(trial.free[trial.index])
    value, jacobian = sensitivities(moving, trial, problem.data, problem.space, robust=robust)

    def plain(x):
        return residuals(x, trial, problem.data, problem.space, robust=robust)

    np.testing.assert_allclose(value, plain(moving), rtol=1e-9, atol=1e-9)
    direction = np.random.default_rng(0).normal(size=moving.shape) * 1e-6
    expected = (plain(moving + direction) - plain(moving - direction)) / 2
    size = np.linalg.norm(expected)
    assert size > 0
    assert np.linalg.norm(jacobian @ direction - expected) < 1e-5 * size
    forward = jax.jvp(plain, (moving,), (jnp.asarray(direction),))[1]
    np.testing.assert_allclose(jacobian @ direction, forward, rtol=1e-6, atol=1e-9 * size)


@pytest.mark.parametrize("own", [False, True])
def test_a_recording_has_lanes_for_what_it_depends_on_and_no_more(own):
    """Values and initial states of other recordings have none; the Jacobian is the whole one all the same."""
    with resources.as_file(resources.files("scpjax") / "examples" / "demo") as folder:
        setup = prepare([read_recording(f) for f in sorted(folder.glob("*.csv"))])
    setup = with_own(setup, "newton_cooling.conductance") if own else setup
    trial = trial_at(setup, np.asarray(setup.starts[0]) * 1.03, np.zeros(len(setup.structure.mechanisms)))
    trial = jax.tree.map(jnp.asarray, trial)
    keys = [setup.space.keys[i] for i in trial.index]
    names = [r.metadata.name for r in setup.recordings]
    for i, lanes in enumerate(trial.lanes):
        mine = [keys[place] for place in lanes if place < len(keys)]
        others = [key for key in keys if key not in mine]
        assert len(lanes) % 4 == 0
        assert all(f"recording_{i}." not in key and f"@{names[i]}" not in key for key in others)
        assert all(("recording_" in key) or ("@" in key) for key in others)
        assert len(others) >= (2 if own else 1)
    moving, data, space = jnp.asarray(trial.free[trial.index]), setup.data, setup.space
    _, jacobian = sensitivities(moving, trial, data, space)
    whole = jax.jacfwd(lambda x: residuals(x, trial, data, space))(moving)
    np.testing.assert_allclose(jacobian, whole, rtol=1e-6, atol=1e-9 * float(np.max(np.abs(whole))))


def test_padding_is_not_simulated():
    """A drive that is no number there changes nothing; in the held-out end, which a solver should be turned back by, it
    does."""
    problem, trial = problem_and_trial("hysteresis")
    data = split(problem.data).train
    last = data.bin * (int(np.max(data.grids.at)) // data.bin + 1)
    effort = np.array(data.grids.effort)
    assert last < effort.shape[1]
    moving = jnp.asarray(trial.free[trial.index])
    values = np.asarray(problem.space.values(trial.free, trial.fixed, trial.active))[None]

    def of(driven):
        value, jacobian = sensitivities(moving, trial, driven, problem.space)
        return value, jacobian, residuals_of(values, np.asarray(trial.laws)[None], driven, problem.space)

    padded = lambda x: residuals(x, trial, data, problem.space)  # noqa: E731
    plain = padded(moving), jax.jacfwd(padded)(moving)
    for mine, theirs in zip(of(data), plain, strict=False):
        np.testing.assert_allclose(mine, theirs, rtol=1e-9, atol=1e-9)
    broken = effort.copy()
    broken[:, last:] = np.nan
    for a, b in zip(of(data), of(data.with_effort(broken)), strict=True):
        np.testing.assert_array_equal(a, b)
    ends = np.flatnonzero(np.isfinite(np.asarray(data.norm)).any(axis=(0, 2))).max()
    assert data.bin * (ends + 1) < last
    broken[:, data.bin * (ends + 1) :] = np.nan
    assert np.any(np.abs(of(data.with_effort(broken))[0]) >= CEILING)


def test_models_abreast_have_the_residuals_of_each():
    problem, trial = problem_and_trial("hysteresis")
    values = np.asarray(problem.space.values(trial.free, trial.fixed, trial.active))
    both, laws = np.stack([values, 1.1 * values]), np.stack([trial.laws, np.asarray(trial.laws)])
    found = residuals_of(jnp.asarray(both), jnp.asarray(laws), problem.data, problem.space)
    moving = jnp.asarray(trial.free[trial.index])
    one = residuals(moving, trial, problem.data, problem.space)[: problem.data.target.size]
    np.testing.assert_allclose(found[0].ravel(), one, rtol=1e-9, atol=1e-9)
    assert float(jnp.max(jnp.abs(found[1] - found[0]))) > 1e-3


def test_softened_residuals_square_to_the_pseudo_huber_loss():
    r, d = np.linspace(-30.0, 30.0, 61), 2.0
    np.testing.assert_allclose(soften(jnp.asarray(r), d) ** 2, 2 * d**2 * (np.sqrt(1 + (r / d) ** 2) - 1), atol=1e-12)
