"""The thesis's models against closed forms and scipy."""

import numpy as np
import pytest
import scipy.signal
from sim_cases import PARAMETERS, PLANT, multilevel, recorded, worst

from scpjax.errors import ModelError
from scpjax.physics import presets
from scpjax.simulate.simulate import simulate

TIME = np.arange(400) * 0.05


def held(system: tuple, effort: np.ndarray, time: np.ndarray) -> np.ndarray:
    """scipy's response to an effort held from stamp to stamp."""
    return scipy.signal.lsim(system, effort, time, interp=False)[1]


def plant_tf(p: dict) -> tuple[list[float], list[float]]:
    """Transfer function (3.6), by hand."""
    decay = p["conductance"] / p["thermal_mass"]
    return (
        [p["coefficient"] / (p["thermal_mass"] * p["mass"] * p["resistance"])],
        [
            1.0,
            p["damping"] / p["mass"] + decay,
            p["stiffness"] / p["mass"] + decay * p["damping"] / p["mass"],
            decay * p["stiffness"] / p["mass"],
        ],
    )


def test_te_step_is_the_exponential_of_3_3():
    model = presets.te(resistance=10.0, conductance=0.2, thermal_mass=1.5, ambient=295.0)
    found = simulate(model, recorded(TIME, {"voltage_V": np.full(TIME.size, 6.0)})).outputs[:, 0]
    wanted = 295.0 + 36.0 / 10.0 / 0.2 * (1 - np.exp(-TIME * 0.2 / 1.5))
    np.testing.assert_allclose(found, wanted, rtol=1e-13)


@pytest.mark.parametrize("damping", [1.0, 2 * np.sqrt(180.0 * 0.2), 40.0], ids=["under", "critical", "over"])
def test_tm_free_response_is_the_closed_form_of_3_4(damping):
    m, k = 0.2, 180.0
    model = presets.tm(coefficient=0.02, stiffness=k, damping=damping, mass=m)
    z0 = np.array([0.004, -0.03])
    rest = np.full(TIME.size, float(model.ambient) - 273.15)
    found = simulate(model, recorded(TIME / 10, {"temperature_degC": rest}), initial=z0).states
    t, s, w2 = TIME / 10, damping / (2 * m), k / m
    r = np.sqrt(complex(s**2 - w2))  # x = e^(-st) (x0 cosh rt + (v0 + s x0) sinh(rt)/r)
    shape = t if abs(r) < 1e-6 else np.sinh(r * t) / r
    x = (np.exp(-s * t) * (z0[0] * np.cosh(r * t) + (z0[1] + s * z0[0]) * shape)).real
    assert worst(found[:, :1], x[:, None]) < 1e-11


def test_tm_settles_where_the_spring_balances_the_pull():
    model = presets.tm(coefficient=0.02, stiffness=180.0, damping=5.0, mass=0.2)
    warm = np.full(TIME.size, float(model.ambient) - 273.15 + 30.0)
    found = simulate(model, recorded(TIME, {"temperature_degC": warm})).outputs[-1, 0]
    np.testing.assert_allclose(found, 0.02 * 30.0 / 180.0, rtol=1e-10)


def test_plant_step_is_the_partial_fractions_of_3_6():
    found = simulate(PLANT, recorded(TIME, {"voltage_V": np.full(TIME.size, 8.0)})).outputs[:, 1]
    numerator, denominator = plant_tf(PARAMETERS)
    residues, poles, _ = scipy.signal.residue(numerator, np.polymul(denominator, [1.0, 0.0]))
    wanted = 64.0 * (residues * np.exp(np.outer(TIME, poles))).sum(axis=1).real
    assert worst(found[:, None], wanted[:, None]) < 1e-11


def test_plant_under_levels_is_scipys():
    recording = multilevel(duration=30.0)
    found = simulate(PLANT, recording).outputs[:, 1]
    wanted = held(plant_tf(PARAMETERS), recording.inputs[:, 0] ** 2, recording.time)
    assert worst(found[:, None], wanted[:, None]) < 1e-11


def test_joint_is_the_third_order_system_of_3_11():
    first = {**PARAMETERS, "coefficient": 0.03, "mass": 0.05}
    second = {
        **PARAMETERS,
        "coefficient": 0.017,
        "stiffness": 120.0,
        "damping": 3.0,
        "mass": 0.08,
        "thermal_mass": 2.2,
    }
    radius, pulley = 0.015, 0.006
    model = presets.aaa(presets.plant(**first), presets.plant(**second), pulley_radius=radius, pulley_mass=pulley)
    recording = multilevel(duration=30.0, column="voltage_agonist_V")
    volts, passive = recording.inputs[:, 0], np.zeros(recording.n)
    driven = recorded(recording.time, {"voltage_agonist_V": volts, "voltage_antagonist_V": passive})
    outputs = simulate(model, driven).outputs

    inertia = 0.5 * pulley + first["mass"] + second["mass"]  # (3.10), (3.12)
    a = inertia * radius / first["coefficient"]
    b = (first["damping"] + second["damping"]) * radius / first["coefficient"]
    c = (first["stiffness"] + second["stiffness"]) * radius / first["coefficient"]
    heat, mass = first["conductance"], first["thermal_mass"]
    system = (
        [1 / (first["resistance"] * mass * a)],
        [1, b / a + heat / mass, c / a + heat * b / (mass * a), heat * c / (mass * a)],
    )
    wanted = held(system, volts**2, recording.time)
    assert worst(outputs[:, 2:], wanted[:, None]) < 1e-11
    np.testing.assert_allclose(outputs[:, 1], float(model.ambient), rtol=1e-15)  # the passive one stays cold
    assert np.max(np.abs(wanted)) > 0.05  # rad, or nothing was tested

    pulled_back = recorded(recording.time, {"voltage_agonist_V": passive, "voltage_antagonist_V": volts})
    twin = {"coefficient": second["coefficient"], "conductance": second["conductance"]}
    a, b, c = (q * first["coefficient"] / twin["coefficient"] for q in (a, b, c))
    heat, mass = twin["conductance"], second["thermal_mass"]
    system = (
        [-1 / (second["resistance"] * mass * a)],
        [1, b / a + heat / mass, c / a + heat * b / (mass * a), heat * c / (mass * a)],
    )
    wanted = held(system, volts**2, recording.time)
    assert worst(simulate(model, pulled_back).outputs[:, 2:], wanted[:, None]) < 1e-11


def test_joint_of_equals_does_not_turn_when_both_pull():
    model = presets.aaa(PLANT, pulley_radius=0.015)
    volts = multilevel().inputs[:, 0]
    both = recorded(np.arange(volts.size) * 0.05, {"voltage_agonist_V": volts, "voltage_antagonist_V": volts})
    outputs = simulate(model, both).outputs
    assert np.max(np.abs(outputs[:, 2])) < 1e-15
    assert np.max(outputs[:, 0]) > float(model.ambient) + 5


def test_compact_form_both_ways():
    compact = presets.to_compact(PLANT)
    numerator, denominator = plant_tf(PARAMETERS)
    np.testing.assert_allclose(
        [compact.b0, compact.a2, compact.a1, compact.a0], numerator + denominator[1:], rtol=1e-14
    )
    back = presets.from_compact(compact, mass=0.2, resistance=10.0, thermal_mass=1.5)
    for key, value in PLANT.values().items():
        np.testing.assert_allclose(back.values()[key], value, rtol=1e-9, err_msg=key)


def test_compact_form_of_table_3_5_has_the_eigenvalues_4_5():
    model = presets.from_compact(
        presets.Compact(b0=0.0300, a2=1.5053, a1=1.2661, a0=0.1909),
        mass=0.05,
        resistance=4.0,
        thermal_mass=1.3,
    )
    a, _ = model.linearise()
    found = np.linalg.eigvals(np.asarray(a))
    wanted = [-0.6590 + 0.7649j, -0.6590 - 0.7649j, -0.1873]
    for w in wanted:
        assert np.min(np.abs(found - w)) < 1e-4
    again = presets.to_compact(model)
    np.testing.assert_allclose([again.b0, again.a2, again.a1, again.a0], [0.03, 1.5053, 1.2661, 0.1909], rtol=1e-12)


def test_compact_form_without_a_real_stable_pole_is_refused():
    with pytest.raises(ModelError, match="real pole"):
        presets.from_compact(
            presets.Compact(b0=1.0, a2=1.0, a1=1.0, a0=-1.0), mass=1.0, resistance=1.0, thermal_mass=1.0
        )
