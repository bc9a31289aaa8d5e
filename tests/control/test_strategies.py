"""Other controllers: what the thesis says of them, and what their theory promises."""

import control
import jax.numpy as jnp
import numpy as np
import pytest
from loop_cases import DEG, PLANT, run_jit, signal, thesis_loop

from scpjax.control.analysis import open_loop, side_systems
from scpjax.control.block import sampled
from scpjax.control.errors import ControlError
from scpjax.control.loop import Disturbance, Loop
from scpjax.control.metrics import measure
from scpjax.control.model_based import design_imc, design_lqi
from scpjax.control.pid import PID, Pair, thesis_pair
from scpjax.control.plant import Difference
from scpjax.control.strategies import (
    CompensatedPair,
    FeedforwardPair,
    ScheduledPair,
    SwitchedPair,
    compensator_system,
    inverse_plant,
    plant_polynomials,
    series_compensator,
)

DT = 0.02
SINE = signal("sine")


def with_controller(controller) -> Loop:
    return Loop(thesis_loop().plant, controller)


def test_switching_drives_one_actuator_at_a_time_and_saves_effort():
    """Section 3.4.2."""
    adopted = measure(run_jit(thesis_loop(), SINE, DT))
    response = run_jit(with_controller(SwitchedPair(thesis_pair())), SINE, DT)
    both = np.asarray(response.effort)
    assert np.all(both.min(axis=1) == 0)
    rising = np.diff(np.asarray(SINE)) > 0
    assert np.all(both[1:][rising, 1] == 0)
    assert np.all(both[1:][~rising, 0] == 0)
    assert measure(response).effort < adopted.effort


def test_scheduling_holds_the_last_voltage():
    adopted = measure(run_jit(thesis_loop(), SINE, DT))
    response = run_jit(with_controller(ScheduledPair(thesis_pair())), SINE, DT)
    assert measure(response).rmse > adopted.rmse
    falling = (response.time > 7.5) & (response.time < 14.5)  # of the sine, after the derivative's filter has run out
    held = np.asarray(response.effort)[np.asarray(falling), 0]
    assert np.ptp(held) < 1e-3
    assert held.mean() > 0.1


def test_feedforward_of_the_inverse_undoes_the_plant():
    """Without feedback the angle is the low-passed reference, which is what remains of an inverse behind one."""
    corner = 3.0
    block = inverse_plant(thesis_loop().plant, corner=corner, dt=DT)
    response = run_jit(with_controller(FeedforwardPair(Pair(PID(0.0, high=1e9)), block)), SINE, DT)
    low_pass = control.TransferFunction([corner**3], np.poly([-corner] * 3))
    wanted = control.forced_response(low_pass, np.asarray(response.time), SINE).outputs
    np.testing.assert_allclose(response.angle, wanted, atol=0.006)
    assert np.abs(wanted).max() > 0.4


def test_feedforward_helps_the_lag_of_the_sine():
    block = inverse_plant(thesis_loop().plant, corner=5.0, dt=DT)
    found = measure(run_jit(with_controller(FeedforwardPair(thesis_pair(), block)), SINE, DT))
    assert found.rmse < measure(run_jit(thesis_loop(), SINE, DT)).rmse


def test_series_compensator_has_the_bandwidth_asked_for():
    """Section 4.4.2: 5 Hz, about 30 rad/s; without limits a sine of 1 Hz is followed."""
    loop = thesis_loop()
    system = compensator_system(loop, loop.controller.agonist, 30.0)
    assert len(system.den[0][0]) == len(system.num[0][0]) == 5
    closed = control.feedback(control.series(control.ss(system), open_loop(loop)), 1)
    assert control.bandwidth(closed) == pytest.approx(30.0, rel=1e-3)
    dt = 0.002
    free = Pair(PID.per_degree(0.5, 0.12, 0.47, 5.84, low=-1e9, high=1e9))
    compensated = CompensatedPair(free, series_compensator(loop, bandwidth=30.0, dt=dt))
    fast = signal("sine", 5.0, frequency=1.0, duration=6.0, dt=dt)
    before = measure(run_jit(Loop(loop.plant, free), fast, dt))
    after = run_jit(Loop(loop.plant, compensated), fast, dt)
    assert measure(after).rmse < 0.4 * before.rmse
    assert float(jnp.abs(after.effort).max()) > 5 * 3.7**2  # at the expense of extreme commands


def test_lqi_settles_without_error_and_rejects_loads():
    plant = thesis_loop().plant
    controller = design_lqi(plant, dt=DT)
    step = np.full(3000, 15.0 * DEG)
    push = jnp.asarray(np.where(np.arange(3000) > 1500, 1e-4, 0.0))  # N; this plant's stiffness is that of (4.4)
    found = run_jit(Loop(plant, controller), step, DT, Disturbance(load=push))
    assert float(found.angle[1499]) == pytest.approx(15 * DEG, rel=1e-3)
    assert float(found.angle[-1]) == pytest.approx(15 * DEG, rel=1e-3)
    assert np.abs(np.asarray(found.angle[1501:1800]) - 15 * DEG).max() > 0.01 * DEG
    assert measure(run_jit(Loop(plant, controller), SINE, DT)).rmse < 5.77 * DEG


def test_lqi_observer_is_that_of_the_closed_loop_theory():
    """Separation: the closed loop's poles are those of the feedback and of the observer."""
    plant = thesis_loop().plant
    k = design_lqi(plant, dt=DT)
    a, b, c = (np.asarray(m) for m in (k.block.a, k.block.b, k.block.c))
    n, feedback, integral, observer = len(b), np.asarray(k.feedback), float(k.integral), np.asarray(k.observer)
    whole = np.block([
        [a, -np.outer(b, feedback), -integral * b[:, None]],
        [np.outer(observer, c), a - np.outer(b, feedback) - np.outer(observer, c), -integral * b[:, None]],
        [-DT * c[None], np.zeros((1, n)), np.ones((1, 1))],
    ])  # fmt: skip
    regulator = np.block([[a - np.outer(b, feedback), -integral * b[:, None]], [-DT * c[None], np.ones((1, 1))]])
    wanted = np.concatenate([np.linalg.eigvals(regulator), np.linalg.eigvals(a - np.outer(observer, c))])
    found = np.linalg.eigvals(whole)
    assert np.abs(found).max() < 1
    np.testing.assert_allclose(np.sort(np.abs(found)), np.sort(np.abs(wanted)), atol=1e-6)


def test_imc_is_its_low_pass_and_removes_what_the_model_does_not_know():
    plant = thesis_loop().plant
    controller = design_imc(plant, dt=DT, corner=0.8, high=1e9)
    found = run_jit(Loop(plant, controller), SINE, DT)
    wanted = control.forced_response(
        control.TransferFunction([0.8**3], np.poly([-0.8] * 3)), np.asarray(found.time), SINE
    )
    np.testing.assert_allclose(found.angle, wanted.outputs, atol=0.006)
    weaker = PLANT.replace({"thermal_actuation.coefficient": 0.8 * PLANT.value("thermal_actuation.coefficient")})
    other = run_jit(Loop(Difference(weaker, weaker), controller), np.full(3000, 10 * DEG), DT)
    assert float(other.angle[-1]) == pytest.approx(10 * DEG, rel=1e-3)


def test_blocks_are_their_systems():
    system = control.TransferFunction([2.0, 1.0], [1.0, 3.0, 2.0])
    values = np.random.default_rng(1).standard_normal(50)
    for method, theirs in (("tustin", "bilinear"), ("zoh", "zoh")):
        block = sampled(system, 0.1, method)
        state, found = block.initial(), []
        for u in values:
            state, y = block.step(state, jnp.asarray(u))
            found.append(float(y))
        wanted = control.forced_response(control.sample_system(control.ss(system), 0.1, theirs), U=values).outputs
        np.testing.assert_allclose(found, wanted, atol=1e-12)


def test_designs_refuse_what_they_cannot_do():
    plant = thesis_loop().plant
    numerator, denominator = plant_polynomials(plant)
    np.testing.assert_allclose(denominator, [1, 1.5053, 1.2661, 0.1909], rtol=1e-9)
    assert numerator == pytest.approx([0.03e-2 / 0.015])
    assert len(side_systems(plant)) == 2
    for make, said in (
        (lambda: inverse_plant(plant, corner=-1.0, dt=DT), "corner is -1"),
        (lambda: design_lqi(plant, dt=DT, effort=0.0), "effort is 0"),
        (lambda: sampled(control.TransferFunction([1, 0], [1]), DT), "more zeros than poles"),
        (lambda: sampled(control.TransferFunction([1], [1, -1]), DT), "unstable"),
        (lambda: series_compensator(Loop(Difference(PLANT), PID(1.0)), dt=DT), "made for a pair"),
        (lambda: series_compensator(thesis_loop(), bandwidth=0.0, dt=DT), "bandwidth is 0"),
    ):
        with pytest.raises(ControlError, match=said):
            make()
