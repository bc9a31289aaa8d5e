"""Fleets, seeds, and linearisation about an operating point."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from loop_cases import DEG, PLANT, run_jit, signal, thesis_loop

from scpjax.control.analysis import (
    UNSTABLE,
    closed_loop,
    figures,
    loop_response,
    open_loop,
    sensitivity_peak,
    side_systems,
)
from scpjax.control.errors import ControlError
from scpjax.control.fleet import covariance_plants, fleet_of, spread_plants, varied
from scpjax.control.loop import Loop, play, run
from scpjax.control.operating import operating_point, reach
from scpjax.control.pid import PID, Pair, thesis_pair
from scpjax.control.plant import Difference, Joint
from scpjax.control.problem import Problem
from scpjax.control.search import SearchOptions
from scpjax.control.sensor import Sensor
from scpjax.control.strategies import FeedforwardPair, SwitchedPair, inverse_plant
from scpjax.control.tune import TuneOptions, tune
from scpjax.physics.catalogue import mechanism
from scpjax.physics.known import known_model
from scpjax.physics.model import Model
from scpjax.physics.presets import aaa


def test_spread_is_what_was_asked_for():
    plants = spread_plants(thesis_loop().plant, 0.2, 400, seed=3)
    assert isinstance(plants, Difference)
    for key in varied(PLANT):
        index = PLANT.structure.index[key]
        ratios = np.log(np.asarray(plants.agonist.theta[:, index]) / float(PLANT.value(key)))
        assert ratios.std() == pytest.approx(0.2, rel=0.15)
        assert abs(ratios.mean()) < 0.04
    mass = PLANT.structure.index["inertia.mass"]
    assert np.ptp(np.asarray(plants.agonist.theta[:, mass])) == 0
    assert np.any(plants.agonist.theta != plants.antagonist.theta)


def test_covariance_is_that_of_the_draws():
    keys = ("thermal_actuation.coefficient", "elastic_spring.stiffness")
    wanted = np.array([[0.04, 0.03], [0.03, 0.04]])
    plants = covariance_plants(thesis_loop().plant, wanted, keys, 2000)
    index = [PLANT.structure.index[k] for k in keys]
    draws = np.log(np.asarray(plants.agonist.theta[:, np.array(index)]) / [float(PLANT.value(k)) for k in keys])
    np.testing.assert_allclose(np.cov(draws.T), wanted, atol=0.004)


def test_fleets_of_joints_and_of_single_plants():
    joint = Joint(aaa(known_model("plant"), pulley_radius=0.015))
    single = Difference(PLANT)
    for plant, controller in ((joint, thesis_pair()), (single, thesis_pair().agonist)):
        plants = spread_plants(plant, 0.1, 3)
        angles = jax.vmap(lambda p, c=controller: run(Loop(p, c), signal("sine", 2.0, duration=1.0)).angle)(plants)
        assert angles.shape == (3, 51)
        assert float(jnp.std(angles[:, -1])) > 0
        one = fleet_of([jax.tree.map(lambda x, i=i: x[i], plants) for i in range(3)])
        assert all(jnp.array_equal(a, b) for a, b in zip(jax.tree.leaves(one), jax.tree.leaves(plants), strict=True))


def test_seeds_are_batched():
    loop = Loop(thesis_loop().plant, thesis_pair(), Sensor(noise=1.0 * DEG))
    reference = signal("sine", duration=4.0)
    keys = jax.random.split(jax.random.key(0), 5)
    many = jax.jit(jax.vmap(lambda k: run(loop, reference, key=k).angle))(keys)
    for key, row in zip(keys, many, strict=True):
        np.testing.assert_allclose(run_jit(loop, reference, 0.02, key=key).angle, row, atol=1e-12)


def lossy() -> Model:
    base = known_model("plant")
    model = Model(base.structure.with_mechanisms(mechanism("nonlinear_heat_loss")), ambient=base.ambient)
    return model.replace(base.values() | {"nonlinear_heat_loss.strength": 0.5})


def test_operating_point_is_at_rest_and_its_system_has_the_local_gain():
    model = lossy()
    plant = Difference(model, model)
    effort = jnp.array([8.0])
    z = operating_point(model, effort)
    np.testing.assert_allclose(model.rates(z, effort), 0.0, atol=1e-9)

    def rest(u):
        return float(model.observe(operating_point(model, jnp.array([u])), jnp.array([u]))[-1])

    slope = (rest(8.01) - rest(7.99)) / 0.02 / 0.015
    gains = [float(np.real(s.dcgain())) for s in side_systems(plant, jnp.array([8.0, 8.0]))]
    assert gains[0] == pytest.approx(slope, rel=1e-5)
    assert gains[1] == pytest.approx(-slope, rel=1e-5)
    assert gains[0] < 0.9 * float(np.real(side_systems(plant)[0].dcgain()))  # a hot actuator loses more
    long = play(plant, np.tile([3.7**2, 0.0], (20_000, 1)), dt=0.02)[0]
    assert float(long[-1]) == pytest.approx(reach(plant, 3.7**2)[1], rel=1e-6)


def test_frequency_response_is_that_of_python_control():
    loop = thesis_loop()
    omega = np.geomspace(0.01, 50.0, 40)
    wanted = np.asarray(open_loop(loop)(1j * omega))
    np.testing.assert_allclose(loop_response(loop, jnp.asarray(omega)), wanted, rtol=1e-8)
    found = figures(loop)
    dense = np.geomspace(0.05, 20, 20_000)
    peak = np.max(1 / np.abs(1 + np.asarray(open_loop(loop)(1j * dense))))
    assert float(sensitivity_peak(loop)) == pytest.approx(peak, rel=1e-3)
    assert found.sensitivity == pytest.approx(peak, rel=1e-3)


def test_an_unstable_linear_loop_has_no_step_figures():
    found = figures(Loop(thesis_loop().plant, Pair(PID.per_degree(20.0, 5.0, 0.01, 2.0))))
    assert not found.stable
    assert found.step is None
    assert np.isnan(found.bandwidth)
    with pytest.raises(ControlError, match="is no PID or Pair"):
        figures(Loop(thesis_loop().plant, SwitchedPair(thesis_pair())))


def test_sensitivity_knows_unstable_loops():
    """Of random gains: by encirclements as by the poles of the closed loop."""
    rng = np.random.default_rng(5)
    gains = np.exp(np.log([0.5, 0.12, 0.47, 5.84]) + 1.5 * rng.standard_normal((60, 4)))
    plant = thesis_loop().plant
    peaks = jax.jit(jax.vmap(lambda g: sensitivity_peak(Loop(plant, Pair(PID.per_degree(*g))))))(jnp.asarray(gains))
    stable = []
    for g in gains:
        poles = np.asarray(closed_loop(Loop(plant, Pair(PID.per_degree(*g)))).poles())
        stable.append(bool(np.all(poles.real[np.abs(poles) > 1e-8] < 0)))  # the branches share an integrator, at 0
        assert figures(Loop(plant, Pair(PID.per_degree(*g)))).stable == stable[-1]
    assert 5 < sum(stable) < 55
    np.testing.assert_array_equal(np.asarray(peaks) < UNSTABLE, stable)


def test_feedforward_share_can_be_tuned():
    loop = thesis_loop()
    controller = FeedforwardPair(thesis_pair(), inverse_plant(loop.plant, corner=5.0, dt=0.02), share=0.1)
    problem = Problem(Loop(loop.plant, controller), signal("sine", duration=10.0))
    options = TuneOptions(free=("feedforward",), search=SearchOptions(screened=16, rounds=()), walk=None, refined=0)
    found = tune(problem, options)
    assert found.improved
    assert found.gains["feedforward"] > 0.3
    assert found.gains["Kp"] == pytest.approx(0.5)
    with pytest.raises(ControlError, match="has no feedforward"):
        tune(Problem(loop, signal("sine", duration=10.0)), options)


def test_what_makes_no_fleet_is_refused():
    plant = thesis_loop().plant
    for make, said in (
        (lambda: spread_plants(plant, 0.0, 3), "spread of 0"),
        (lambda: spread_plants(plant, 0.2, 0), "0 plants"),
        (lambda: covariance_plants(plant, np.eye(3), ("elastic_spring.stiffness",), 3), "for 1 parameters"),
        (lambda: covariance_plants(plant, -np.eye(1), ("elastic_spring.stiffness",), 3), "no covariance"),
        (lambda: fleet_of([]), "no plants"),
        (lambda: fleet_of([plant, Difference(PLANT)]), "not of one structure"),
    ):
        with pytest.raises(ControlError, match=said):
            make()
