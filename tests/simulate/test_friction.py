"""Dry friction: the integrator looks a step ahead."""

import jax.numpy as jnp
import numpy as np
import pytest
import scipy.integrate
from sim_cases import ACTUATOR, PLANT, extended, multilevel, recorded, with_active
from written_out import BETA, PULL, K, M

from scpjax.physics import presets
from scpjax.physics.model import Model
from scpjax.simulate.simulate import Exponential, simulate

TRAVEL = 0.0095
SLOW = {"friction.velocity_time": 300.0, "friction.reference": TRAVEL, "friction.static": 0.3}


def rubbing(recording, strength, law=0, order=2, **others):
    base = presets.plant(**ACTUATOR)
    structure = extended(base.structure, "friction")
    laws = [float(law) * (m.name == "friction") for m in structure.mechanisms]
    model = Model(structure, laws=laws).replace(base.values() | SLOW | {"friction.strength": strength} | others)
    return np.asarray(simulate(model, recording, method=Exponential(order=order)).states)


def rubbed(recording, strength, law=0, spring=0.0):
    """By scipy's implicit integrator, for friction as tanh would have it within 0.05; and with a ``spring`` [N/m] that
    engages at a fifth of the travel.
    """
    dry, slow = strength * K * TRAVEL, TRAVEL / 300.0
    z, out = np.zeros(3), [np.zeros(3)]
    for gap, volts in zip(np.diff(recording.time), recording.inputs[:-1, 0], strict=True):

        def rates(_t, z, volts=volts):
            t, x, v = z
            u = abs(v) / slow
            sliding = 2 * u / (1 + u + np.sqrt((1 - u) ** 2 + 0.4 * u)) * np.sign(v)
            most = dry * (1 + law * 0.3 * np.exp(-((u / 10) ** 2)))
            force = 0.022 * t - K * x - 8 * v - most * sliding - spring * max(x - 0.2 * TRAVEL, 0.0)
            return [(volts**2 / 1.2 - 0.14 * t) / 1.2, v, force / 0.3]

        z = scipy.integrate.solve_ivp(rates, (0, gap), z, method="Radau", rtol=1e-8, atol=1e-11).y[:, -1]
        out.append(z)
    return np.array(out)


@pytest.mark.parametrize("law", [0, 1])
@pytest.mark.parametrize("period", [0.05, 0.25])
def test_friction_of_long_steps_is_that_of_short_ones(period, law):
    recording = multilevel(duration=40.0, period=period, hold_s=6.0, high=3.5)
    wanted = rubbed(recording, 0.2, law)[:, 1]
    free = rubbing(recording, 1e-9)[:, 1]
    effect = np.sqrt(np.mean((wanted - free) ** 2))
    assert effect > 0.05 * np.max(wanted)
    for order, most in ((2, 0.05), (4, 0.03)):
        error = np.sqrt(np.mean((rubbing(recording, 0.2, law, order=order)[:, 1] - wanted) ** 2))
        assert error < (most + 0.1 * law) * effect, (order, error / effect)


@pytest.mark.parametrize("period", [0.05, 0.1])
def test_friction_beside_a_spring_that_engages_holds_what_that_leaves(period):
    """Both look a step ahead: each given what the other does."""
    recording = multilevel(duration=40.0, period=period, hold_s=6.0, high=4.5)
    wanted = rubbed(recording, 0.1, spring=0.9 * K)[:, 1]
    effect = np.sqrt(np.mean((wanted - rubbed(recording, 0.1)[:, 1]) ** 2))
    assert effect > 0.05 * np.max(wanted)

    structure = extended(presets.plant(**ACTUATOR).structure, "friction", "antagonist_load")
    own = {"antagonist_load.strength": 0.9, "antagonist_load.onset": 0.2, "antagonist_load.reference": TRAVEL}
    values = presets.plant(**ACTUATOR).values() | SLOW | {"friction.strength": 0.1} | own
    for order, most in ((2, 0.05), (4, 0.03)):
        found = simulate(Model(structure).replace(values), recording, method=Exponential(order=order)).states[:, 1]
        error = np.sqrt(np.mean((np.asarray(found) - wanted) ** 2))
        assert error < most * effect, (order, error / effect)


def held_and_slipped(recording):
    """LuGre's friction by scipy's implicit integrator: 0.2 of the spring's force, half as much again at rest."""
    dry, fast = 0.2 * K * TRAVEL, 10 * TRAVEL / 30.0
    z, out = np.zeros(4), [np.zeros(4)]
    for gap, volts in zip(np.diff(recording.time), recording.inputs[:-1, 0], strict=True):

        def rates(_t, z, volts=volts):
            t, x, v, held = z
            most = 1 + 0.5 * np.exp(-((v / fast) ** 2))
            force = 0.022 * t - K * x - 8 * v - dry * held
            return [(volts**2 / 1.2 - 0.14 * t) / 1.2, v, force / 0.3, (v - abs(v) * held / most) / (0.05 * TRAVEL)]

        z = scipy.integrate.solve_ivp(rates, (0, gap), z, method="Radau", rtol=1e-8, atol=1e-11).y[:, -1]
        out.append(z)
    return np.array(out)


@pytest.mark.parametrize("order", [2, 4])
def test_lugres_contact_holds_faster_at_rest(order):
    recording = multilevel(duration=40.0, period=0.05, hold_s=6.0, high=3.5)
    wanted = held_and_slipped(recording)
    own = {"friction.static": 0.5, "friction.presliding": 0.05, "friction.velocity_time": 30.0}
    found = rubbing(recording, 0.2, 3, order, **own)
    dahl = rubbing(recording, 0.2, 2, order, **own)
    effect = np.sqrt(np.mean((wanted[:, 1] - dahl[:, 1]) ** 2))
    assert effect > 0.01 * np.max(wanted[:, 1])
    assert np.sqrt(np.mean((wanted[:, 1] - found[:, 1]) ** 2)) < 0.05 * effect
    assert np.max(wanted[:, 3]) > 1.05  # than it ever is under Dahl's law


def test_friction_without_steps_is_the_law_itself():
    model = with_active(extended(PLANT.structure, "friction"), "friction").replace({"friction.velocity_time": 2.0})
    z = np.array([5.0, 1e-3, 0.002])
    u = 0.002 / (0.0025 / 2.0)
    s = 2 * u / (1 + u + np.sqrt((1 - u) ** 2 + 0.4 * u))
    wanted = (PULL * 5.0 - K * 1e-3 - BETA * 0.002 - 0.2 * K * 0.0025 * s) / M
    np.testing.assert_allclose(model.rates(jnp.asarray(z), jnp.zeros(1))[2], wanted, rtol=1e-12)


@pytest.mark.parametrize("period", [0.05, 0.25])
def test_load_sticks_until_the_pull_exceeds_friction(period):
    """Slow heating: nothing moves below F_c, then x = (C T - F_c)/k but for the drag of the motion."""
    time = np.arange(0, 60, period)
    recording = recorded(time, {"voltage_V": np.sqrt(1.2 * 0.14 * time)})  # about 1 K/s
    z = rubbing(recording, 0.3, **{"friction.velocity_time": 3e4})
    pull, dry = 0.022 * z[:, 0], 0.3 * K * TRAVEL
    stuck, slides = pull < 0.9 * dry, pull > 1.15 * dry
    assert np.max(np.abs(z[stuck, 1])) < 0.02 * TRAVEL
    rate = np.gradient(z[:, 1], time)
    np.testing.assert_allclose(z[slides, 1], (pull - dry - 8 * rate)[slides] / K, atol=0.04 * TRAVEL)


def test_strong_friction_does_not_blow_up():
    recording = multilevel(duration=40.0, period=0.25, hold_s=3.0, high=4.0)
    for strength in (0.5, 3.0, 50.0):
        z = rubbing(recording, strength)
        assert np.all(np.isfinite(z))
        assert np.max(np.abs(z[:, 1])) < 1.5 * np.max(0.022 * z[:, 0]) / K


def test_a_contact_that_gives_before_it_slips_is_duhems_hysteresis():
    """The same equation under two names; hysteresis is held against scipy elsewhere."""
    recording = multilevel(hold_s=1.0)
    found = []
    for name, law, own in (
        ("friction", 2, {"strength": 0.2, "presliding": 0.1, "reference": 0.0025}),
        ("hysteresis", 1, {"strength": 2.0, "width": 0.1, "reference": 0.0025}),
    ):
        model = with_active(extended(PLANT.structure, name), name, law)
        model = model.replace({f"{name}.{k}": v for k, v in own.items()})
        found.append(simulate(model, recording, method=Exponential(substeps=4)))
    np.testing.assert_allclose(found[0].states[:, :4], found[1].states[:, :4], rtol=1e-9, atol=1e-12)
    free = simulate(PLANT, recording).outputs[:, 1]
    assert np.max(np.abs(found[0].outputs[:, 1] - free)) > 0.05 * np.ptp(free)
