"""The ways of simulating against each other, against scipy and against equations written out here."""

import equinox as eqx
import jax
import numpy as np
import pytest
import scipy.fft
import scipy.integrate
import scipy.linalg
import scipy.signal
from sim_cases import (
    CASES,
    KINKED,
    PARAMETERS,
    PLANT,
    at_null,
    case_id,
    case_of,
    driven_by_power,
    extended,
    multilevel,
    recorded,
    smooth,
    with_active,
    worst,
)
from written_out import PULL, WARM, A, M, R, integrate

from scpjax.errors import ModelError
from scpjax.physics import presets
from scpjax.physics.catalogue import left_out
from scpjax.simulate import exponential
from scpjax.simulate.drive import make_grid
from scpjax.simulate.simulate import Adaptive, Exact, Exponential, node_states, simulate

P = PARAMETERS
TIGHT = Adaptive(rtol=3e-12, atol=3e-14)

# -- reductions ------------------------------------------------------------------------------------


@pytest.mark.parametrize("order", [2, 4])
@pytest.mark.parametrize("names", [None, *((k,) for k in KINKED if k in {m.name for m in left_out()})])
def test_every_left_out_mechanism_vanishes_at_its_null(names, order):
    structure = smooth() if names is None else extended(PLANT.structure, *names)
    recording = multilevel()
    found = simulate(at_null(structure), recording, method=Exponential(order=order)).states[:, :3]
    assert worst(found, simulate(PLANT, recording, method=Exact()).states) < 1e-9


@pytest.mark.parametrize("hold", ["zero_order", "linear"])
@pytest.mark.parametrize("column", ["voltage_V", "power_W"])
def test_fixed_steps_are_exact_where_nothing_is_nonlinear(hold, column):
    model = PLANT if column == "voltage_V" else driven_by_power()
    recording = multilevel(hold=hold, column=column)
    exact = simulate(model, recording, method=Exact()).states
    assert worst(simulate(model, recording, method=Exponential(order=4)).states, exact) < 1e-12


def test_exact_refuses_a_nonlinear_model():
    with pytest.raises(ModelError, match="not linear"):
        simulate(at_null(extended(PLANT.structure, "creep")), multilevel(), method=Exact())


# -- mechanisms ------------------------------------------------------------------------------------

# of the states and of the outputs: |v| has a kink at every reversal; friction and springs are felt a step ahead
ROUGH = {
    "fatigue": (2e-4, 1e-5),
    "hysteresis-Duhem": (2e-5, 1e-6),
    "friction": (5e-2, 5e-3),
    "antagonist_load": (3e-2, 3e-3),
}


@pytest.mark.parametrize("case", CASES, ids=case_id)
def test_fixed_steps_agree_with_adaptive_ones(case):
    """Eight steps to a sample of 0.05 s: the hardening spring rings at 30 rad/s, hysteresis has kinks."""
    states, outputs = ROUGH.get(case_id(case), ROUGH.get(case[0], (1e-6, 1e-7)))
    model, z0 = case_of(*case)
    recording = multilevel()
    wanted = simulate(model, recording, initial=z0, method=TIGHT)
    found = simulate(model, recording, initial=z0, method=Exponential(substeps=8))
    assert worst(found.states, wanted.states) < states
    assert worst(found.outputs, wanted.outputs) < outputs
    without = simulate(at_null(model.structure), recording, initial=z0, method=Exponential(substeps=8)).outputs
    assert worst(found.outputs, without) > 1e-3  # it does something to agree on


def _adaptive_and_stepped(name, values, method_of, factors):
    """Adaptive states, and the errors of a way of stepping with each number of substeps."""
    model, z0 = case_of(name, 0)
    recording = multilevel()
    wanted = simulate(model.replace(values), recording, initial=z0, method=TIGHT).states[:, :2]
    small = with_active(extended(PLANT.structure, name), name).replace(values)
    begun = small.initial(temperature=10.0)
    return [
        worst(simulate(small, recording, initial=begun, method=method_of(k)).states[:, :2], wanted) for k in factors
    ]


@pytest.mark.parametrize("order", [2, 4])
def test_order_of_convergence(order):
    errors = _adaptive_and_stepped("nonlinear_stiffness", {}, lambda k: Exponential(order=order, substeps=k), (2, 4, 8))
    orders = np.log2(np.array(errors[:-1]) / errors[1:])
    np.testing.assert_allclose(orders, order, atol=0.25)


@pytest.mark.parametrize("sides", [1, 2])
def test_creep_that_saturates_within_a_step_is_second_order_from_long_steps_on(sides):
    """At 30 rad/s its stress passes the activation many times over in a sample of 0.05 s."""
    base = PLANT if sides == 1 else presets.aaa(PLANT, pulley_radius=0.015)
    sharp = {"creep.activation": 0.0125, "creep.compliance": 0.33, "creep.time_constant": 38.0}
    model = with_active(extended(base.structure, "creep"), "creep", 4).replace(sharp)
    recording = multilevel(hold_s=1.0, duration=20.0)
    if sides == 2:
        first = recording.inputs[:, 0]
        drives = {"voltage_agonist_V": first, "voltage_antagonist_V": first[::-1].copy()}
        recording = recorded(recording.time, drives)
    z0 = model.initial(temperature=10.0)
    moving = slice(0, sides + 1)
    wanted = simulate(model, recording, initial=z0, method=Adaptive()).states[:, moving]
    errors = [
        worst(simulate(model, recording, initial=z0, method=Exponential(order=2, substeps=k)).states[:, moving], wanted)
        for k in (1, 2, 4, 8)
    ]
    assert errors[0] < 5e-3
    np.testing.assert_allclose(np.log2(np.array(errors[1:-1]) / errors[2:]), 2.0, atol=0.3)


def test_delay_that_is_no_multiple_of_the_step_converges():
    errors = _adaptive_and_stepped(
        "input_delay", {"input_delay.time": 0.1234}, lambda k: Exponential(order=2, substeps=k), (1, 8)
    )
    assert errors[1] < errors[0] / 20
    assert errors[1] < 1e-4


# -- stiffness -------------------------------------------------------------------------------------


def _ringing():
    stiff = {**P, "stiffness": P["mass"] * 34.0**2, "damping": 0.05, "thermal_mass": 12.0}
    return stiff, presets.plant(**stiff)


def test_ringing_weight_with_slow_heat_is_exact_at_long_steps():
    """34 rad/s and 0.1 s steps, heat that takes a minute."""
    stiff, model = _ringing()
    recording = multilevel(duration=100.0, period=0.1, hold_s=20.0)
    a = A.copy()
    a[0, 0] = -stiff["conductance"] / stiff["thermal_mass"]
    a[2, 1:] = -stiff["stiffness"] / stiff["mass"], -stiff["damping"] / stiff["mass"]
    b = np.array([[1 / (stiff["resistance"] * stiff["thermal_mass"])], [0.0], [0.0]])
    system = (a, b, np.eye(3), np.zeros((3, 1)))
    z0 = np.array([0.0, 0.01, 0.0])
    wanted = scipy.signal.lsim(system, recording.inputs[:, 0] ** 2, recording.time, X0=z0, interp=False)[1]
    for method in (Exact(), Exponential(order=2), Exponential(order=4)):
        assert worst(simulate(model, recording, initial=z0, method=method).states, wanted) < 1e-9


def test_ringing_weight_with_nonlinear_heat_loss_at_long_steps():
    stiff, model = _ringing()
    recording = multilevel(duration=100.0, period=0.1, hold_s=20.0)
    c, lam = stiff["thermal_mass"], stiff["conductance"]
    structure = extended(model.structure, "nonlinear_heat_loss")
    extra = {"nonlinear_heat_loss.strength": 0.8, "nonlinear_heat_loss.exponent": 0.6}
    z0 = (WARM, 0.01, 0.0)

    def rates(_t, z, u):
        t, x, v = z
        heat = (u / R - lam * t * (1 + 0.8 * (abs(t) / 50.0) ** 0.6)) / c
        return [heat, v, (PULL * t - stiff["damping"] * v - stiff["stiffness"] * x) / M]

    wanted = integrate(rates, z0, recording)
    nonlinear = type(model)(structure).replace(model.values() | extra)
    found = simulate(nonlinear, recording, initial=np.array(z0)).states
    assert worst(found, wanted) < 1e-6


# -- matrices of a step ----------------------------------------------------------------------------


@pytest.mark.parametrize("order", [2, 4])
def test_a_matrix_by_columns_or_taken_apart_gives_the_same_states_and_gradients(monkeypatch, order):
    structure = extended(PLANT.structure, "hysteresis")
    model = with_active(structure, "hysteresis")
    grid = make_grid(structure, multilevel(), ambient=model.ambient)

    def end(theta: jax.Array) -> tuple[jax.Array, jax.Array]:
        moved = eqx.tree_at(lambda m: m.theta, model, theta)
        states = node_states(moved, grid, moved.initial(), order=order)[0]
        return states[-1, 2], states

    found = []
    for few in (0, 10_000):
        monkeypatch.setattr(exponential, "_FEW", few)
        forward, states = jax.jit(jax.jacfwd(lambda theta: end(theta), has_aux=True))(model.theta)
        found.append((np.asarray(states), np.asarray(forward)))
    for by_columns, apart in zip(*found, strict=True):
        scale = np.maximum(np.max(np.abs(apart), axis=0), 1e-300)
        np.testing.assert_allclose(by_columns / scale, apart / scale, atol=1e-9)
    monkeypatch.setattr(exponential, "_FEW", 0)
    reverse = jax.jit(jax.grad(lambda theta: end(theta)[0]))(model.theta)
    np.testing.assert_allclose(reverse, forward, rtol=1e-6, atol=1e-9 * np.max(np.abs(forward)))
