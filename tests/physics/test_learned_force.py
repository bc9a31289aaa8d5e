"""The dampers of a learned force, that would stop an actuator within a thousandth of a step, against scipy."""

import numpy as np
import pytest
import scipy.integrate
from loaded import COEFFICIENT, CONDUCTANCE, DAMPING, GAIN, MASS, PLANT, STIFFNESS, THERMAL_MASS

from scpjax.physics import presets
from scpjax.physics.catalogue import catalogue
from scpjax.physics.model import Model
from scpjax.recordings.recording import Recording
from scpjax.simulate.simulate import Adaptive, Exponential, simulate

REFERENCES = {"reference": 0.008, "reference_temperature": 60.0, "velocity_scale": 0.001, "effort_scale": 10.0}
TIME = np.arange(0.0, 30.0, 0.05)
VOLTS = np.where(TIME < 9.0, 3.2, np.where(TIME < 17.0, 0.0, 2.0))
DAMPERS = {
    "v_speed": lambda temperature, x, v: v * abs(v) / 0.001**2,
    "xv": lambda temperature, x, v: x / 0.008 * v / 0.001,
    "Tv": lambda temperature, x, v: temperature / 60.0 * v / 0.001,
}


def model(base: Model = PLANT, **weights: float) -> Model:
    structure = base.structure.with_mechanisms(catalogue()["learned_force"])
    own = {f"learned_force.{k}": v for k, v in {**REFERENCES, **weights}.items()}
    return Model(structure, ambient=base.ambient).replace(base.values() | own)


def rates_with(term: str, weight: float, effort: float):
    def rates(_t, z):
        temperature, x, v = z
        damper = weight * STIFFNESS * 0.008 * DAMPERS[term](temperature, x, v)
        force = COEFFICIENT * temperature - STIFFNESS * x - DAMPING * v - damper
        return [(GAIN * effort - CONDUCTANCE * temperature) / THERMAL_MASS, v, force / MASS]

    return rates


def by_scipy(term: str, weight: float) -> np.ndarray:
    z, there = np.zeros(3), [np.zeros(3)]
    for volts in VOLTS[:-1]:
        of = rates_with(term, weight, volts**2)
        z = scipy.integrate.solve_ivp(of, (0.0, 0.05), z, "Radau", rtol=1e-9, atol=1e-13).y[:, -1]
        there.append(z)
    return np.array(there)


def moved(model: Model, **method: int) -> np.ndarray:
    still = Recording.from_arrays(TIME, {"voltage_V": VOLTS}, {"displacement_mm": np.zeros_like(TIME)})
    return np.asarray(simulate(model, still, method=Exponential(**method)).states)[:, 1]


@pytest.mark.parametrize(("order", "near"), [(2, 0.04), (4, 0.01)])
@pytest.mark.parametrize(("term", "weight"), [("v_speed", 0.3), ("xv", 0.6), ("Tv", 0.6)])
def test_what_dampens_is_followed_by_steps_of_a_sample(term, weight, order, near):
    """0.3 k x_ref at 1 mm/s is 380 N s/m: m/c is 0.6 ms, a step 50 ms."""
    wanted = by_scipy(term, weight)[:, 1]
    assert np.abs(moved(model(**{term: weight}), order=order) - wanted).max() < near * changed(wanted)


def test_what_drives_on_is_followed_as_well():
    """By less than what the damper of the base model takes."""
    wanted = by_scipy("Tv", -0.004)[:, 1]
    assert np.abs(moved(model(Tv=-0.004), order=2) - wanted).max() < 0.1 * changed(wanted)


def changed(wanted: np.ndarray) -> float:
    return float(np.abs(moved(PLANT) - wanted).max())


def test_shorter_steps_come_nearer():
    wanted = by_scipy("v_speed", 0.3)[:, 1]
    long, short = (np.abs(moved(model(v_speed=0.3), substeps=n) - wanted).max() for n in (1, 16))
    assert short < 0.2 * long


def test_an_adaptive_integrator_sees_the_same_force():
    short = Recording.from_arrays(
        TIME[:120], {"voltage_V": VOLTS[:120]}, {"displacement_mm": np.zeros_like(TIME[:120])}
    )
    found = simulate(model(v_speed=0.3), short, method=Adaptive(rtol=1e-8, atol=1e-11)).states
    np.testing.assert_allclose(found, by_scipy("v_speed", 0.3)[:120], atol=1e-7)


@pytest.mark.parametrize("term", DAMPERS)
@pytest.mark.parametrize("weight", [0.3, -0.3])
def test_without_a_step_it_is_its_term(term, weight):
    """Whichever way it pushes, and also where x, and so x v, has the other sign."""
    for z in ([40.0, 3e-3, 2e-3], [40.0, 3e-3, -2e-3], [40.0, -3e-3, 1e-3]):
        wanted = rates_with(term, weight, 20.0)(0.0, z)
        np.testing.assert_allclose(model(**{term: weight}).rates(np.array(z), np.array([20.0])), wanted, rtol=1e-12)


def test_of_a_joint_both_sides_dampen():
    """Each by its own temperature, with the velocity that is one's and the other's alike."""
    base = presets.aaa(PLANT, pulley_radius=0.015)
    z, effort = np.array([40.0, 20.0, 3e-3, 2e-3]), np.array([20.0, 5.0])
    plain, damped = (np.asarray(m.rates(z, effort)) for m in (base, model(base, Tv=0.3)))
    inertia = base.balances().moving_mass
    by_hand = 0.3 * STIFFNESS * 0.008 * (40.0 + 20.0) / 60.0 * 2.0 / inertia
    np.testing.assert_allclose((plain - damped)[-1], by_hand, rtol=1e-10)
    np.testing.assert_allclose(plain[:-1], damped[:-1])
