"""The solver of every fit, on functions whose minimum is known."""

import re

import jax
import jax.numpy as jnp
import numpy as np
import optimistix as optx
import pytest
from scipy.optimize import least_squares

from scpjax.fit.marquardt import Marquardt
from scpjax.fit.problem import known

TIME = np.linspace(0.0, 4.0, 40)


def fitted(residual, start, *, tolerance=1e-12, limit=100):
    """(where it ended, steps, half the sum of squares there)."""

    def both(x, args):
        return residual(x), jax.jacfwd(residual)(x)

    found = optx.least_squares(
        both,
        Marquardt(tolerance=tolerance, limit=limit),
        jnp.asarray(start, float),
        has_aux=True,
        max_steps=400,
        throw=False,
    )
    np.testing.assert_allclose(found.state.residual, residual(found.value), atol=1e-12)
    np.testing.assert_allclose(found.aux, jax.jacfwd(residual)(found.value), atol=1e-12)
    return np.asarray(found.value), int(found.stats["num_steps"]), 0.5 * float(jnp.sum(found.state.residual**2))


def rosenbrock(x):
    return jnp.array([10.0 * (x[1] - x[0] ** 2), 1.0 - x[0]])


def powell(x):  # singular at its minimum
    return jnp.array(
        [
            x[0] + 10 * x[1],
            jnp.sqrt(5.0) * (x[2] - x[3]),
            (x[1] - 2 * x[2]) ** 2,
            jnp.sqrt(10.0) * (x[0] - x[3]) ** 2,
        ]
    )


def two_decays(x, data=None):
    said = x[0] * jnp.exp(-x[1] * TIME) + x[2] * jnp.exp(-x[3] * TIME)
    return said - (1.0 * np.exp(-0.5 * TIME) + 0.6 * np.exp(-3.0 * TIME) if data is None else data)


@pytest.mark.parametrize(
    ("residual", "start", "minimum", "within"),
    [
        (rosenbrock, [-1.2, 1.0], [1.0, 1.0], 1e-6),
        (powell, [3.0, -1.0, 0.0, 1.0], [0.0, 0.0, 0.0, 0.0], 2e-3),
        (two_decays, [0.7, 0.2, 0.7, 5.0], [1.0, 0.5, 0.6, 3.0], 1e-5),
    ],
)
def test_it_ends_at_the_minimum(residual, start, minimum, within):
    value, steps, _ = fitted(residual, start)
    np.testing.assert_allclose(value, minimum, atol=within)
    assert steps < 60


def test_noise_ends_where_scipy_ends():
    data = two_decays(jnp.zeros(4), 0.0) + 0.02 * np.random.default_rng(3).standard_normal(len(TIME))
    data = np.asarray(data) + np.exp(-0.5 * TIME) + 0.6 * np.exp(-3.0 * TIME)
    value, _, half = fitted(lambda x: two_decays(x, data), [0.7, 0.2, 0.7, 5.0])
    peer = least_squares(lambda x: np.asarray(two_decays(x, data)), [0.7, 0.2, 0.7, 5.0], xtol=1e-12, ftol=1e-12)
    assert half == pytest.approx(peer.cost, rel=1e-6)
    np.testing.assert_allclose(value, peer.x, rtol=1e-3)


def test_units_of_the_parameters_do_not_matter():
    units = np.array([1.5, 0.7, 1.2, 0.8])
    plain = fitted(two_decays, [0.7, 0.2, 0.7, 5.0])
    other = fitted(lambda x: two_decays(x * units), np.array([0.7, 0.2, 0.7, 5.0]) / units)
    assert plain[1] == other[1]  # as long as no column is less than a hundredth of the longest
    np.testing.assert_allclose(other[0] * units, plain[0], rtol=1e-9)


def test_it_takes_fewer_steps_than_undamped_scales_do():
    """The same problem in units a thousandfold apart, by `optimistix.LevenbergMarquardt` and by this."""
    units = jnp.array([1.0, 1e-3])
    scaled = lambda x: rosenbrock(x * units)  # noqa: E731
    start = jnp.array([-1.2, 1e3])
    _, steps, _ = fitted(scaled, start)
    peer = optx.least_squares(
        lambda x, _: scaled(x), optx.LevenbergMarquardt(1e-12, 1e-12), start, max_steps=2000, throw=False
    )
    assert 2 * steps < int(peer.stats["num_steps"])


def test_a_parameter_that_nothing_depends_on_stays():
    value, steps, half = fitted(lambda x: rosenbrock(x[:2]), [-1.2, 1.0, 7.0])
    np.testing.assert_allclose(value, [1.0, 1.0, 7.0], atol=1e-6)
    assert steps < 60
    assert half < 1e-12


def test_it_stops_at_the_limit_and_with_the_cost():
    assert fitted(rosenbrock, [-1.2, 1.0], limit=4)[1] == 4
    rough = fitted(rosenbrock, [-1.2, 1.0], tolerance=1.0)
    assert rough[1] < fitted(rosenbrock, [-1.2, 1.0])[1]


def test_no_better_place_ends_it():
    """Where every step is refused it gives up, and stays where it was."""
    value, steps, _ = fitted(lambda x: jnp.where(jnp.all(x == 1.0), x - 0.5, jnp.full(2, 1e7)), [1.0, 1.0])
    np.testing.assert_array_equal(value, [1.0, 1.0])
    assert steps < 20


def test_what_is_not_finite_is_refused():
    """A logarithm that the first bold step would leave the domain of."""
    value, _, half = fitted(lambda x: jnp.where(x > 0, jnp.log(x), 1e7), [30.0])
    np.testing.assert_allclose(value, [1.0], atol=1e-6)
    assert half < 1e-10


def test_a_residual_without_a_finite_derivative_does_not_end_the_fit():
    """sqrt has none at 0, where it begins, nor then by any other parameter; there the Jacobian is 0."""

    def residual(x):
        return jnp.array([x[0] - 3.0, x[1] + 2.0, 1.0 + jnp.sqrt(jnp.abs(x[2]))])

    def both(x, args):
        return residual(x), known(jax.jacfwd(residual)(x))

    solver = Marquardt(tolerance=1e-12, limit=100)
    found = optx.least_squares(both, solver, jnp.array([0.0, 0.0, 0.0]), has_aux=True, max_steps=400, throw=False)
    np.testing.assert_allclose(found.value, [3.0, -2.0, 0.0], atol=1e-6)
    np.testing.assert_array_equal(found.aux, [[1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [0.0, 0.0, 0.0]])


@pytest.mark.parametrize("of", ["all", "one", "none"])
def test_jacobians_side_by_side_are_0_where_they_are_not_finite(of):
    jacobians = np.random.default_rng(1).normal(size=(5, 7, 3))
    there = {"all": slice(None), "one": 2, "none": slice(0)}[of]
    jacobians[there, 3, 1] = np.nan
    np.testing.assert_array_equal(jax.jit(jax.vmap(known))(jacobians), np.nan_to_num(jacobians))


def test_side_by_side_a_batch_of_matrices_waits_for_the_one_before():
    """Of two batches at once, each holds one of XLA's threads until the others have done its part: two cores never come
    back (jaxlib 0.10.2). Triangles alone, each of the one before, are never two at once; Q beside them would be.
    """

    def one(target):
        both = lambda x, _: (rosenbrock(x) - target, jax.jacfwd(rosenbrock)(x))  # noqa: E731
        solver = Marquardt(tolerance=1e-12, limit=100)
        start = jnp.array([-1.2, 1.0])
        return optx.least_squares(both, solver, start, has_aux=True, max_steps=400, throw=False).value

    many = jax.jit(jax.vmap(one))
    targets = jnp.stack([jnp.zeros(70), jnp.linspace(-0.5, 0.5, 70)], axis=1)
    found = many(targets)
    np.testing.assert_allclose(found[:, 0], 1.0 - targets[:, 1], atol=1e-6)
    np.testing.assert_allclose(found[:, 1], found[:, 0] ** 2, atol=1e-6)
    calls = set(re.findall(r"lapack_\w+", many.lower(targets).compile().as_text()))
    assert calls == {"lapack_dgeqrf_ffi", "lapack_dtrsm_ffi"}
