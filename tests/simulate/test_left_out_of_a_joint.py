"""Left-out mechanisms in a joint, against their equations at rest and scipy: one supply for two, and what loads it."""

import jax.numpy as jnp
import numpy as np
import pytest
import scipy.integrate
import scipy.optimize
from sim_cases import PLANT, extended, multilevel, recorded, worst
from written_out import C_TH, LAM, R

from scpjax.physics import presets
from scpjax.physics.catalogue import catalogue, left_out
from scpjax.physics.model import Model
from scpjax.simulate.simulate import Adaptive, Exponential, simulate


def on_one_supply(law, **own):
    base = presets.aaa(PLANT, pulley_radius=0.015)
    structure = extended(base.structure, "supply_sag")
    laws = [float(law) * (m.name == "supply_sag") for m in structure.mechanisms]
    own = {"sag": 0.4, "reference": 10.0, "time_constant": 2.0, "reference_time": 6.0} | own
    return Model(structure, laws=laws).replace(base.values() | {f"supply_sag.{k}": v for k, v in own.items()})


def test_both_actuators_of_a_joint_draw_on_one_supply():
    model = on_one_supply(3)
    volts = np.array([8.0, 3.0])
    z = model.initial()
    found = model.rates(z, jnp.asarray(volts**2))[:2]
    np.testing.assert_allclose(found, (volts * (1 - 0.4 * 11.0 / 10)) ** 2 / R / C_TH, rtol=1e-6)
    warm = model.initial(temperature=jnp.array([4.0, 1.0]))
    asked = model.balances().holding([warm[i] for i in range(len(warm))], jnp.zeros(2))
    np.testing.assert_allclose(model.rates(warm, asked)[:2], 0.0, atol=1e-9)


@pytest.mark.parametrize("law", [5, 6, 7, 9, 11, 13, 17], ids=lambda law: catalogue()["supply_sag"].laws[law])
def test_both_actuators_of_a_joint_tire_one_supply(law):
    model = on_one_supply(law, sag=0.15, capacity=4.0, at_once=0.4)
    names = model.structure.state_names
    drawn = [i for i, name in enumerate(names) if ".drawn" in name]
    volts = np.array([8.0, 3.0])

    def given(q):
        q = q / (1 - q / 4.0) if law == 9 else q
        if law in (13, 17):  # 0.4 of what is lost at once, by what both together draw
            return volts * (1 - 0.09 * q) / (1 + 0.06 * volts.sum() / 10)
        return np.maximum(volts - 1.5 * q, 0.0) if law == 7 else volts * (1 - 0.15 * q)

    def rates(_t, z):
        total = (volts if law == 11 else given(z[2])).sum() / 10
        heat = (given(z[2]) ** 2 / R - LAM * z[:2]) / C_TH
        return [*heat, total / 6.0 if law in (5, 9, 17) else (total - z[2]) / 2.0]

    time = np.arange(0, 10, 0.01)
    exact = scipy.integrate.solve_ivp(rates, (0, time[-1]), [0.0] * 3, t_eval=time, rtol=1e-9, atol=1e-12)
    held = {f"voltage_{side}_V": np.full(1000, v) for side, v in zip(("agonist", "antagonist"), volts, strict=True)}
    found = simulate(model, recorded(time, held), method=Adaptive(rtol=1e-8, atol=1e-10)).states
    np.testing.assert_allclose(found[:, :2].T, exact.y[:2], atol=1e-7)
    for i in drawn:
        np.testing.assert_allclose(found[:, i], exact.y[2], atol=1e-8)


def loaded_joint(law, **numbers):
    """A joint with an antagonist load under one of its laws."""
    base = presets.aaa(PLANT, pulley_radius=0.015)
    structure = extended(base.structure, "antagonist_load")
    laws = [float(law) * (m.name == "antagonist_load") for m in structure.mechanisms]
    return Model(structure, laws=laws).replace(base.values() | {f"antagonist_load.{k}": v for k, v in numbers.items()})


def test_a_link_pulls_its_joint_back_as_a_pendulum():
    """At rest: 2 k x + a k x_ref (sin(phi_0 + x/r) - sin(phi_0)) = C (T_1 - T_2), so it turns further up than down."""
    model = loaded_joint(3, strength=6.0, angle=0.6, reference=0.004)
    k, c = (float(PLANT.value(key)) for key in ("elastic_spring.stiffness", "thermal_actuation.coefficient"))
    angles = []
    for warm in (90.0, -90.0):  # of the agonist beyond the antagonist, or the other way

        def pulled(x, warm=warm):
            return 2 * k * x + 6.0 * k * 0.004 * (np.sin(0.6 + x / 0.015) - np.sin(0.6)) - c * warm

        x = scipy.optimize.brentq(pulled, -0.02, 0.02)
        z = model.initial(temperature=jnp.array([max(warm, 0.0), max(-warm, 0.0)])).at[2].set(x)
        effort = model.balances().holding([z[i] for i in range(len(z))], jnp.zeros(2))
        np.testing.assert_allclose(model.rates(z, effort), 0.0, atol=1e-9)
        angles.append(x / 0.015)
    assert angles[0] > 1.05 * abs(angles[1]) > 0.2  # the higher it is, the shorter the lever that is left to raise


def test_a_weight_hangs_from_its_joint_only_once_it_is_lifted():
    """At rest: 2 k x + a k x_ref (1 - exp(-x/x_0)) = C (T_1 - T_2) where x > 0, and nothing more where it is not."""
    model = loaded_joint(6, strength=2.0, onset=0.1, reference=0.004)
    k, mass = float(PLANT.value("elastic_spring.stiffness")), float(model.balances().moving_mass)
    for x in (-0.004, -0.0001, 0.0, 0.0001, 0.0004, 0.004):
        z = model.initial().at[2].set(x)
        force = float(model.rates(z, jnp.zeros(2))[3]) * mass
        hangs = 2.0 * k * 0.004 * (1 - np.exp(-x / 0.0004)) if x > 0 else 0.0
        np.testing.assert_allclose(-force, 2 * k * x + hangs, atol=0.03 * k * 0.004, rtol=1e-9)
        assert hangs > 0 or abs(-force - 2 * k * x) < 1e-12


@pytest.mark.parametrize("law", [4, 5])
def test_muscles_of_a_joint_need_not_pull_alike(law):
    """At rest: 2 k x + a k (x - x_0) = C (T_1 - (1 + g) T_2), the spring that the antagonist is beyond x_0 alone."""
    model = loaded_joint(law, strength=1.5, onset=0.3, excess=0.4, reference=0.004)
    k, c = (float(PLANT.value(key)) for key in ("elastic_spring.stiffness", "thermal_actuation.coefficient"))
    for first, second in ((90.0, 10.0), (10.0, 90.0)):
        pull = c * (first - 1.4 * second)
        x = pull / (2 * k)
        if law == 5 and x > 0.0012:
            x = (pull + 1.5 * k * 0.0012) / (3.5 * k)
        z = model.initial(temperature=jnp.array([first, second])).at[2].set(x)
        effort = model.balances().holding([z[i] for i in range(len(z))], jnp.zeros(2))
        force = np.asarray(model.rates(z, effort))[3] * float(model.balances().moving_mass)
        np.testing.assert_allclose(force / (c * 90.0), 0.0, atol=1e-2)  # the spring's corner is rounded


def test_every_mechanism_vanishes_in_a_joint():
    base = presets.aaa(PLANT, pulley_radius=0.015)
    model = Model(extended(base.structure, *(m.name for m in left_out()))).replace(base.values())
    recording = multilevel(duration=2.0)
    volts = recording.inputs[:, 0]
    recording = recorded(recording.time, {"voltage_agonist_V": volts, "voltage_antagonist_V": volts[::-1].copy()})
    found = simulate(model, recording, method=Exponential(order=2)).states[:, :4]
    assert worst(found, simulate(base, recording).states) < 1e-9
