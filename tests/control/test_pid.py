"""PID controllers against python-control's discretisations, an independent loop in numpy, and their definitions."""

import control
import jax
import jax.numpy as jnp
import numpy as np
import pytest
from loop_cases import DEG, thesis_loop

from scpjax.control.analysis import pid_transfer
from scpjax.control.errors import ControlError
from scpjax.control.pid import PID, Pair, PIDState, thesis_pair

FREE = {"low": -1e6, "high": 1e6}


def commands(pid, errors, dt):
    """Commands before the limits, along errors of a reference at measurement 0."""

    def body(state, e):
        state, command = pid.step(state, jnp.zeros(()), e, dt)
        return state, (command.asked[0], command.effort[0], state.integral)

    return [np.asarray(v) for v in jax.lax.scan(body, pid.initial(), jnp.asarray(errors))[1]]


@pytest.mark.parametrize(("form", "method"), [("forward_euler", "euler"), ("backward_euler", "backward_diff"),
                                              ("tustin", "bilinear")])  # fmt: skip
def test_discrete_forms_are_those_of_python_control(form, method):
    dt, pid = 0.05, PID(0.5, 0.12, 0.47, 5.84, form=form, **FREE)
    errors = np.random.default_rng(0).standard_normal(200)
    # python-control's c2d of a state space: both integrators one by one, so that poles do not interact
    system = control.ss([[0, 0], [0, -5.84]], [[0.12], [5.84 * 0.47]], [[1, -5.84]], [[0.5 + 0.47 * 5.84]])
    wanted = control.forced_response(control.sample_system(system, dt, method), U=errors).outputs
    np.testing.assert_allclose(commands(pid, errors, dt)[0], wanted, atol=1e-9)


def test_continuous_form_has_the_transfer_function_4_13():
    pid = PID(0.5, 0.12, 0.47, 5.84, **FREE)

    def answer(state, e):
        rates, command = pid.rates(PIDState(*state), jnp.zeros(()), e)
        return jnp.stack(rates), command.asked[0]

    (a, c), (b, d) = (jax.jacfwd(answer, argnums=i)(jnp.zeros(2), jnp.zeros(())) for i in (0, 1))
    found = control.ss2tf(control.ss(a, b[:, None], c[None], [[d]]))
    wanted = pid_transfer(pid)
    np.testing.assert_allclose(found.num[0][0], wanted.num[0][0], atol=1e-12)
    np.testing.assert_allclose(found.den[0][0], wanted.den[0][0], atol=1e-12)
    kp, ki, kd, n = 0.5, 0.12, 0.47, 5.84
    np.testing.assert_allclose(wanted.num[0][0], [kp + kd * n, ki + n * kp, n * ki])
    np.testing.assert_allclose(wanted.den[0][0], [1, n, 0])


def test_small_steps_approach_the_continuous_form():
    wanted = control.step_response(pid_transfer(PID(0.5, 0.12, 0.47, 5.84)), np.arange(0, 2, 1e-3)).outputs
    for form in ("forward_euler", "backward_euler", "tustin"):
        found = commands(PID(0.5, 0.12, 0.47, 5.84, form=form, **FREE), np.ones(2000), 1e-3)[0]
        np.testing.assert_allclose(found, wanted, atol=2e-2)


def test_special_cases():
    e = np.linspace(-1, 1, 50)
    np.testing.assert_allclose(commands(PID(2.0, **FREE), e, 0.1)[0], 2 * e, atol=1e-14)
    pi = commands(PID(2.0, 3.0, **FREE), e, 0.1)[0]
    np.testing.assert_allclose(pi, 2 * e + 3 * 0.1 * np.concatenate([[0], np.cumsum(e)[:-1]]), atol=1e-13)
    pd = commands(PID(2.0, 0.0, 1.0, 10.0, **FREE), np.ones(100), 0.05)[0]
    np.testing.assert_allclose(pd - 2.0, 10.0 * 0.5 ** np.arange(100), atol=1e-12)


def test_saturation_is_3_18():
    asked, effort, _ = commands(PID(10.0), np.linspace(-1, 3, 41), 0.1)
    np.testing.assert_array_equal(effort, np.clip(asked, 0.0, 3.7**2))
    assert effort.min() == 0.0
    assert effort.max() == 3.7**2


def test_clamping_is_3_17():
    pid = PID(1.0, 2.0, high=3.0)
    asked, effort, integral = commands(pid, np.concatenate([np.ones(60), -np.ones(10)]), 0.1)
    before = np.concatenate([[0.0], integral[:-1]])
    moved = np.abs(integral - before) > 1e-15
    error = np.concatenate([np.ones(60), -np.ones(10)])
    np.testing.assert_array_equal(moved, ~((asked != effort) & (error * asked > 0)))
    assert integral.max() <= 3.0 - 1.0 + 0.2 + 1e-12
    wound = commands(PID(1.0, 2.0, high=3.0, anti_windup="none"), error, 0.1)[2]
    assert wound.max() > 10.0


def test_antagonist_clamps_like_the_agonist():
    """Mirrored errors give mirrored integrals: with the sign of the error itself in (3.17) they would not."""
    error = np.concatenate([np.ones(60), -np.ones(30)])
    pid = PID(1.0, 2.0, high=3.0)
    _, ua, ia = commands(pid, error, 0.1)
    _, ub, ib = commands(pid.opposite(), -error, 0.1)
    np.testing.assert_array_equal(ua, ub)
    np.testing.assert_array_equal(ia, ib)


def test_back_calculation_leads_the_excess_back():
    pid = PID(1.0, 2.0, high=3.0, anti_windup="back_calculation", tracking=5.0)
    asked, effort, integral = commands(pid, np.ones(200), 0.05)
    # at rest Ki e = tracking (asked - effort)
    assert asked[-1] - effort[-1] == pytest.approx(2.0 / 5.0, rel=1e-3)
    assert integral[-1] == pytest.approx(3.0 + 0.4 - 1.0, rel=1e-3)


def test_weights():
    pid = PID(2.0, 0.0, 1.0, 10.0, reference_weight=0.3, derivative_weight=0.0, **FREE)
    _, command = pid.step(pid.initial(), jnp.asarray(0.1), jnp.asarray(1.0), jnp.asarray(0.02))
    assert float(command.asked[0]) == pytest.approx(2.0 * (0.3 - 0.1) - 10.0 * 0.1)


def test_pair_has_opposite_gains_as_table_3_7():
    pair = thesis_pair()
    for name, value in {"Kp": 0.50, "Ki": 0.12, "Kd": 0.47}.items():
        assert float(pair.agonist.gains[name]) == pytest.approx(value)
        assert float(pair.antagonist.gains[name]) == pytest.approx(-value)
    assert float(pair.antagonist.n) == 5.84
    assert float(pair.agonist.kp) == pytest.approx(0.5 / DEG)


@pytest.mark.parametrize(("make", "said"), [
    (lambda: PID(float("nan")), "Kp is nan"),
    (lambda: PID(1.0, float("inf")), "Ki is inf"),
    (lambda: PID(1.0, 1.0, 1.0, -5.0), "N is -5"),
    (lambda: PID(1.0, n=0.0), "N is 0"),
    (lambda: PID(1.0, low=2.0, high=1.0), "not in order"),
    (lambda: PID(1.0, form="euler"), "no form 'euler'"),
    (lambda: PID(1.0, anti_windup="clamp"), "no anti_windup 'clamp'"),
    (lambda: PID(1.0, form="tustin").rates(PID(1.0).initial(), jnp.zeros(()), jnp.zeros(())), "has no rates"),
])  # fmt: skip
def test_bad_gains_are_refused(make, said):
    with pytest.raises(ControlError, match=said):
        make()


def test_pairs_are_batched_over_gains():
    kp = jnp.linspace(10.0, 60.0, 5)
    pair = jax.vmap(lambda k: Pair(PID(k, 5.0, 20.0, 6.0)))(kp)
    assert pair.antagonist.kp.shape == (5,)
    assert thesis_loop().controller.sides == 2
