"""Left-out mechanisms against their equations, written out here and integrated by scipy, and against limits."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
import scipy.integrate
from sim_cases import KINKED, PARAMETERS, PLANT, case_id, extended, multilevel, recorded, smooth, with_active, worst
from test_methods import BETA, C_TH, LAM, PULL, START, WARM, K, M, R, integrate

from scpjax.fit.guess import Scales
from scpjax.fit.space import null_values
from scpjax.physics import presets
from scpjax.physics.catalogue import NEEDS, applicable, catalogue, left_out
from scpjax.physics.model import Model
from scpjax.simulate.simulate import Adaptive, Exponential, energy_balance, simulate

# a rounded corner as the equations state it: |x| with the corner of a hyperbola
HOOK = lambda x, w: np.sqrt(x * x + w * w)  # noqa: E731


def plant(*, power=None, loss=0.0, force=None, own=()):
    """Rates of the plant with a term changed: own states follow the three of the plant."""

    def rates(t, z, u):
        warm, x, v = z[:3]
        into = u / R if power is None else power(t, z, u)
        back = -K * x - BETA * v + (PULL * warm if force is None else force(t, z, u))
        gone = LAM * warm + (loss(t, z) if callable(loss) else loss)
        return [(into - gone) / C_TH, v, back / M, *[rate(t, z, u) for rate in own]]

    return rates, (*START, *[0.0] * len(own))


def sagging(law):
    drawn = lambda z, u: np.sqrt(u) / 10 if law == 0 else z[3]  # noqa: E731
    left = lambda z, u: u * (1 - 0.4 * drawn(z, u)) ** 2  # noqa: E731
    fill = {
        0: lambda t, z, u: (np.sqrt(left(z, u)) / 10 - z[3]) / 2.0,
        1: lambda t, z, u: np.sqrt(left(z, u)) / 10 / 6.0,
        2: lambda t, z, u: (np.sqrt(left(z, u)) / 10 - z[3]) / 2.0,
    }[law]
    return plant(power=lambda t, z, u: left(z, u) / R, own=(fill,))


def dead_zone(law):
    def reaching(t, z, u):
        v = np.sqrt(u)
        if law == 1:
            return u / (1 + (3.0 / v) ** 16) / R if v > 0 else 0.0
        return (v - (HOOK(v + 3, 0.3) - HOOK(v - 3, 0.3)) / 2) ** 2 / R

    return plant(power=reaching)


def drifting_room(law):
    shape = {0: lambda t: t / 6, 1: lambda t: 1 - np.exp(-t / 1.5), 2: lambda t: np.sin(t / 1.5)}[law]
    return plant(loss=lambda t, z: -LAM * 0.4 * 20 * shape(t))


def bent_force(law):
    def force(t, z, u):
        r = z[0] / 20
        if law == 0:
            return PULL * z[0] * (1 + 0.6 * r)
        if law == 1:
            return PULL * z[0] / np.sqrt(1 + 0.6 * r * r)
        if law == 3:
            return PULL * z[0] * np.hypot(r, 0.02) ** 0.6
        beyond = (r + HOOK(r - 0.5, 0.1) - HOOK(0.5, 0.1)) / 2
        return PULL * (z[0] + 0.6 * 20 * beyond)

    return plant(force=force)


def softening(law):
    def force(t, z, u):
        r = z[0] / 20
        share = r if law == 0 else ((r - 0.5) / HOOK(r - 0.5, 0.2) + 0.5 / HOOK(0.5, 0.2)) / 2
        return PULL * z[0] + K * z[1] * 0.4 * share

    return plant(force=force)


def slack(law):
    def force(t, z, u):
        pull, idle = PULL * z[0], K * 0.2 * 0.0025
        taken = (HOOK(pull + idle, 0.1 * idle) - HOOK(pull - idle, 0.1 * idle)) / 2
        return pull - (taken if law == 1 else 0.0)

    return plant(force=force)


def tiring(law):
    wear = {
        0: lambda t, z, u: abs(z[2]) / 10 / 0.0005,
        1: lambda t, z, u: max(z[0], 0) / 20 / 6,
        2: lambda t, z, u: max(z[0], 0) / 20 / 6,
    }[law]
    worn = lambda t, z: t / 6 if law == 2 else z[3]  # noqa: E731
    return plant(force=lambda t, z, u: PULL * z[0] * (1 - 0.6 * (1 - np.exp(-0.8 / 0.6 * worn(t, z)))), own=(wear,))


def pulled_back(law):
    def force(t, z, u):
        x = z[1] / 0.0025
        beyond = (x - 0.4 + HOOK(x - 0.4, 0.02) + 0.4 - HOOK(0.4, 0.02)) / 2
        f = lambda s: s + 1 - s**-2 - s**-3  # noqa: E731
        slope = 1 + 2 * 1.1**-3 + 3 * 1.1**-4
        rubber = 0.5 * (f(1.1 + x / 0.5) - f(1.1)) / slope
        return PULL * z[0] - 0.7 * K * 0.0025 * (beyond, beyond**2, rubber)[law]

    return plant(force=force)


def drifting_sensor(_law):
    return plant()


EQUATIONS = {
    "supply_sag": (sagging, 3),
    "drive_dead_zone": (dead_zone, 2),
    "ambient_drift": (drifting_room, 3),
    "nonlinear_thermal_force": (bent_force, 4),
    "thermal_softening": (softening, 2),
    "slack": (slack, 2),
    "fatigue": (tiring, 3),
    "antagonist_load": (pulled_back, 3),
    "sensor_drift": (drifting_sensor, 6),
}


@pytest.mark.parametrize("case", [(n, law) for n, (_, laws) in EQUATIONS.items() for law in range(laws)], ids=case_id)
def test_mechanism_is_its_equation(case):
    name, law = case
    rates, z0 = EQUATIONS[name][0](law)
    recording = multilevel(hold_s=1.0)
    wanted = integrate(rates, z0, recording)
    model = with_active(extended(PLANT.structure, name) if name in KINKED else smooth(), name, law)
    names = model.structure.state_names
    mine = np.array([i for i, s in enumerate(names) if s.startswith(name) or ("." not in s and s != "time")])
    start = model.initial(WARM).at[mine].set(np.array(z0))
    found = simulate(model, recording, initial=start, method=Exponential(substeps=8))
    # |v| has a corner at every reversal; springs that engage are felt a step ahead
    near, near_outputs = (5e-2, 3e-3) if name == "antagonist_load" and law < 2 else (2e-6, 3e-6)
    near = 2e-4 if name == "fatigue" else near
    assert worst(found.states[:, mine], wanted) < near
    warm, moved = wanted[:, 0] + float(model.ambient), wanted[:, 1].copy()
    if name == "slack" and law == 0:
        moved -= (HOOK(moved + 5e-4, 5e-5) - HOOK(moved - 5e-4, 5e-5)) / 2
    if name == "sensor_drift":
        shape = 1 - np.exp(-recording.time / 2) if law in (2, 3) else recording.time / 6
        far, hot = (moved, wanted[:, 0]) if law > 3 else (0.0025, 20)
        moved, warm = (moved + 0.5 * far * shape, warm) if law % 2 == 0 else (moved, warm + 0.5 * hot * shape)
    np.testing.assert_allclose(found.outputs[:, 0], warm, rtol=1e-6)
    assert worst(found.outputs[:, 1], moved) < near_outputs


# -- friction: the integrator looks a step ahead --------------------------------------------------------------

ACTUATOR = {**PARAMETERS, "resistance": 1.2, "conductance": 0.14, "thermal_mass": 1.2, "coefficient": 0.022}
ACTUATOR |= {"damping": 8.0, "mass": 0.3}
TRAVEL = 0.0095
SLOW = {"friction.velocity_time": 300.0, "friction.reference": TRAVEL, "friction.static": 0.3}


def rubbing(recording, strength, law=0, order=2, **others):
    base = presets.plant(**ACTUATOR)
    structure = extended(base.structure, "friction")
    laws = [float(law) * (m.name == "friction") for m in structure.mechanisms]
    model = Model(structure, laws=laws).replace(base.values() | SLOW | {"friction.strength": strength} | others)
    return np.asarray(simulate(model, recording, method=Exponential(order=order)).states)


def rubbed(recording, strength, law=0):
    """By scipy's implicit integrator, for friction as tanh would have it within 0.05."""
    dry, slow = strength * K * TRAVEL, TRAVEL / 300.0
    z, out = np.zeros(3), [np.zeros(3)]
    for gap, volts in zip(np.diff(recording.time), recording.inputs[:-1, 0], strict=True):

        def rates(_t, z, volts=volts):
            t, x, v = z
            u = abs(v) / slow
            sliding = 2 * u / (1 + u + np.sqrt((1 - u) ** 2 + 0.4 * u)) * np.sign(v)
            most = dry * (1 + law * 0.3 / (1 + (u / 10) ** 2))
            force = 0.022 * t - K * x - 8 * v - most * sliding
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


# -- a joint ---------------------------------------------------------------------------------------------------


def test_crosstalk_is_its_equation_and_conserves_heat():
    base = presets.aaa(PLANT, pulley_radius=0.015)
    model = Model(extended(base.structure, "thermal_crosstalk")).replace(
        base.values() | {"thermal_crosstalk.exchange": 0.4}
    )
    time = np.arange(0, 20, 0.05)
    volts = np.where(time < 12, 8.0, 0.0)
    recording = recorded(time, {"voltage_agonist_V": volts, "voltage_antagonist_V": 0.3 * volts})
    found = np.asarray(simulate(model, recording).states[:, :2])
    a = np.array([[-1.4, 0.4], [0.4, -1.4]]) * LAM / C_TH
    z, wanted = np.zeros(2), [np.zeros(2)]
    for v in volts[:-1]:
        rest = np.linalg.solve(a, -np.array([v**2, 0.09 * v**2]) / R / C_TH)
        z = rest + scipy.linalg.expm(a * 0.05) @ (z - rest)
        wanted.append(z)
    np.testing.assert_allclose(found, wanted, rtol=1e-9, atol=1e-12)
    balance = energy_balance(model, recording)
    np.testing.assert_allclose(balance["lost"] + balance["stored"], balance["supplied"], rtol=1e-9)
    np.testing.assert_allclose(balance["stored"], C_TH * found[-1].sum(), rtol=1e-2)


def test_every_mechanism_vanishes_in_a_joint():
    base = presets.aaa(PLANT, pulley_radius=0.015)
    model = Model(extended(base.structure, *(m.name for m in left_out()))).replace(base.values())
    recording = multilevel(duration=2.0)
    volts = recording.inputs[:, 0]
    recording = recorded(recording.time, {"voltage_agonist_V": volts, "voltage_antagonist_V": volts[::-1].copy()})
    found = simulate(model, recording, method=Exponential(order=2)).states[:, :4]
    assert worst(found, simulate(base, recording).states) < 1e-9


# -- limits and edges ------------------------------------------------------------------------------------------


@pytest.mark.parametrize("law", [0, 1, 2])
def test_what_a_dead_time_brings_over_is_what_the_supply_must_be_asked_for(law):
    model = with_active(extended(PLANT.structure, "supply_sag"), "supply_sag", law)
    z = list(model.initial(WARM))
    asked = model.balances().holding(z, jnp.zeros(1))
    np.testing.assert_allclose(model.rates(jnp.stack(z), asked)[0], 0.0, atol=1e-12)
    plain = float(np.sqrt(LAM * WARM * R))
    assert float(asked[0]) ** 0.5 >= plain * (1 - 1e-12)
    if law == 0:
        v = np.roots([-0.04, 1.0, -plain]).min()
        np.testing.assert_allclose(asked[0], v**2, rtol=1e-5)


@pytest.mark.parametrize("law", [0, 1])
def test_what_a_dead_time_brings_over_is_above_the_dead_zone(law):
    model = with_active(extended(PLANT.structure, "drive_dead_zone"), "drive_dead_zone", law)
    z = list(model.initial(WARM))
    asked = model.balances().holding(z, jnp.zeros(1))
    plain = np.sqrt(LAM * WARM * R)
    np.testing.assert_allclose(np.sqrt(asked), plain + 3.0 * (law == 0), rtol=1e-12)
    assert abs(float(model.rates(jnp.stack(z), asked)[0])) < 0.02 * LAM * WARM / C_TH


def test_small_drives_do_not_pass_a_dead_zone():
    for law in (0, 1):
        model = with_active(extended(PLANT.structure, "drive_dead_zone"), "drive_dead_zone", law)
        passed = [float(model.rates(model.initial(), jnp.array([v**2]))[0]) * C_TH * R for v in (0.0, 1.5, 2.2, 9.0)]
        np.testing.assert_allclose(passed[:3], 0.0, atol=5e-2)
        np.testing.assert_allclose(passed[3], (36.0, 81.0)[law], rtol=5e-3)


@pytest.mark.parametrize("period", [0.05, 0.25])
@pytest.mark.parametrize("strength", [0.7, 30.0])
def test_a_second_spring_however_stiff_and_long_the_steps(period, strength):
    """Heated slowly: x = (C T + a k x_0)/((1 + a) k) beyond x_0."""
    base = presets.plant(**ACTUATOR)
    model = Model(extended(base.structure, "antagonist_load")).replace(
        base.values()
        | {f"antagonist_load.{k}": v for k, v in (("strength", strength), ("onset", 0.4), ("reference", 0.005))}
    )
    time = np.arange(0, 60, period)
    recording = recorded(time, {"voltage_V": np.sqrt(1.2 * 0.14 * time)})
    z = np.asarray(simulate(model, recording, method=Exponential(order=2)).states)
    free = 0.022 * z[:, 0] / K
    wanted = np.where(free < 0.002, free, (free + strength * 0.002) / (1 + strength))
    np.testing.assert_allclose(z[:, 1], wanted, atol=1.2e-4)
    assert np.ptp(free) > 0.004


@pytest.mark.parametrize("m", left_out(), ids=lambda m: m.name)
def test_derivatives_are_finite_at_null_and_at_the_starts(m):
    """Of rates and readings, with respect to states, parameters and effort: at rest, warm and moving."""
    base = presets.aaa(PLANT, pulley_radius=0.015) if "joint" in m.needs else PLANT
    structure = extended(base.structure, m.name)

    def all_of(theta, z, effort, laws):
        model = Model(structure, theta=theta, laws=laws)
        return model.rates(z, effort), model.observe(z, effort), model.core()

    derivative = jax.jit(jax.jacfwd(all_of, argnums=(0, 1, 2)))
    scales = Scales(response=7.0, duration=60.0, temperature=30.0, displacement=3e-3, drive=10.0)
    null = null_values(structure, scales)
    null = np.where(np.isnan(null), 0.0, null)
    for slot in base.structure.slots:
        null[structure.index[slot.key]] = base.theta[slot.index]
    points = [null]
    for start in m.starts:
        theta = null.copy()
        for p, value in zip(m.parameters, start, strict=True):
            if not p.fixed:
                theta[structure.index[f"{m.name}.{p.name}"]] = value * {"response": 7.0, "duration": 60.0}.get(
                    p.time, 1
                )
        points.append(theta)
    sides = len(structure.sides)
    for theta in points:
        for law in range(len(m.laws)):
            laws = jnp.asarray([float(law) * (other.name == m.name) for other in structure.mechanisms])
            model = Model(structure, theta=theta, laws=laws)
            for z in (model.initial(), model.initial(5.0), model.initial(20.0, 1e-3, 0.01)):
                for effort in (0.0, 50.0):
                    found = derivative(jnp.asarray(theta), z, jnp.full(sides, effort), laws)
                    assert all(np.isfinite(leaf).all() for leaf in jax.tree.leaves(found)), (law, effort)


def test_needs_are_respected():
    volts = {"electric", "voltage", "thermal", "mechanical", "temperature_output", "displacement_output"}
    able = {m.name for m in left_out() if applicable(m, volts)}
    assert {"supply_sag", "drive_dead_zone", "friction", "sensor_drift"} <= able
    assert "thermal_crosstalk" not in able
    assert applicable(catalogue()["thermal_crosstalk"], NEEDS)
    assert not applicable(catalogue()["supply_sag"], volts - {"voltage"} | {"current"})
    force_only = {"mechanical", "displacement_output"}
    assert not any(
        applicable(catalogue()[n], force_only) for n in ("supply_sag", "drive_dead_zone", "ambient_drift", "sensor_lag")
    )
    drift = catalogue()["sensor_drift"]
    assert [applicable(drift, force_only, law) for law in range(4)] == [True, False, True, False]


def test_references_are_the_scales_of_the_data():
    structure = extended(PLANT.structure, "supply_sag", "sensor_drift")
    scales = Scales(response=7.0, duration=60.0, temperature=30.0, displacement=3e-3, drive=9.0)
    values = dict(zip(structure.index, null_values(structure, scales), strict=True))
    assert values["supply_sag.reference"] == 9.0
    assert values["supply_sag.reference_time"] == values["sensor_drift.reference_time"] == 60.0
    assert values["sensor_drift.reference"] == 3e-3
    assert values["sensor_drift.reference_temperature"] == 30.0


def test_time_is_a_state_only_where_it_is_looked_at():
    assert "time" not in extended(PLANT.structure, "friction").state_names
    model = with_active(extended(PLANT.structure, "ambient_drift", "sensor_lag"), "ambient_drift")
    assert model.structure.state_names[-1] == "time"
    recording = recorded(5.0 + np.arange(0, 3, 0.05), {"voltage_V": np.ones(60)})
    for method in (Exponential(order=2), Exponential(order=4), Adaptive()):
        found = simulate(model, recording, method=method).states[:, -1]
        np.testing.assert_allclose(found, recording.time - 5.0, rtol=1e-9, atol=1e-12)
