"""Left-out mechanisms against their equations, written out here, and against limits."""

import itertools

import jax
import jax.numpy as jnp
import numpy as np
import pytest
import scipy.linalg
from sim_cases import ACTUATOR, PLANT, extended, recorded, with_active
from written_out import C_TH, LAM, WARM, K, R

from scpjax.fit.guess import Scales
from scpjax.fit.space import null_values
from scpjax.physics import presets
from scpjax.physics.catalogue import NEEDS, applicable, catalogue, left_out
from scpjax.physics.mechanism import Values, View
from scpjax.physics.model import Model
from scpjax.simulate.simulate import Adaptive, Exponential, simulate


@pytest.mark.parametrize(
    ("name", "law", "own", "rtol"),
    [
        ("supply_sag", 2, {"sag": 0.3, "time_constant": 2.0, "reference": 5.0}, 0.03),
        ("supply_sag", 4, {"sag": 0.3, "time_constant": 2.0, "reference": 5.0}, 0.03),
        ("supply_sag", 6, {"sag": 0.2, "time_constant": 2.0, "reference": 5.0}, 0.03),
        ("supply_sag", 10, {"sag": 0.2, "time_constant": 2.0, "reference": 5.0}, 0.03),
        ("supply_sag", 14, {"sag": 0.3, "time_constant": 2.0, "slow_ratio": 4.0, "reference": 5.0}, 0.03),
        ("input_delay", 1, {"time": 1.5, "share": 0.8}, 1e-4),
    ],
)
@pytest.mark.parametrize("sides", [1, 2])
def test_what_remembers_the_drive_begins_as_what_has_kept_it_warm_left_it(name, law, own, rtol, sides):
    base = PLANT if sides == 1 else presets.aaa(PLANT, pulley_radius=0.015)
    structure = extended(base.structure, name)
    laws = [float(law) * (m.name == name) for m in structure.mechanisms]
    model = Model(structure, laws=laws).replace(base.values() | {f"{name}.{k}": v for k, v in own.items()})
    volts = (4.0, 3.0)[:sides]
    drives = ("voltage_V",) if sides == 1 else ("voltage_agonist_V", "voltage_antagonist_V")
    time = np.arange(0, 120, 0.05)
    long = recorded(time, {d: np.full(len(time), v) for d, v in zip(drives, volts, strict=True)})
    ended = np.asarray(simulate(model, long).states)[-1]
    found = np.asarray(model.initial(temperature=jnp.asarray(ended[:sides])))
    its_own = ("drawn", "lagged", *(("slow_drawn",) if law == 14 else ()))
    mine = [
        i
        for i, state in enumerate(structure.state_names)
        if state.partition(".")[2].split("_a")[0].rstrip("_123") in its_own
    ]
    assert mine
    assert np.all(ended[mine] > 0.3)
    np.testing.assert_allclose(found[mine], ended[mine], rtol=rtol)
    np.testing.assert_array_less(np.asarray(model.initial())[mine], 1e-5)


@pytest.mark.parametrize("law", [0, 1, 2, 4, 8, 10, 12, 14, 16])
def test_what_a_dead_time_brings_over_is_what_the_supply_must_be_asked_for(law):
    model = with_active(extended(PLANT.structure, "supply_sag"), "supply_sag", law)
    z = list(model.initial(WARM))
    if law in (1, 8, 16):  # by which something has been drawn
        z[model.structure.state_names.index("supply_sag.drawn")] = jnp.asarray(0.8)
    asked = model.balances().holding(z, jnp.zeros(1))
    np.testing.assert_allclose(model.rates(jnp.stack(z), asked)[0], 0.0, atol=1e-12)
    plain = float(np.sqrt(LAM * WARM * R))
    assert float(asked[0]) ** 0.5 >= plain * (1 - 1e-12)
    if law == 0:
        v = np.roots([-0.04, 1.0, -plain]).min()
        np.testing.assert_allclose(asked[0], v**2, rtol=1e-5)


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
    joint = "joint" in {*m.needs, *itertools.chain(*m.law_needs.values())}
    base = presets.aaa(PLANT, pulley_radius=0.015) if joint else PLANT
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


def test_plays_of_temperature_are_moved_by_the_heated_node_beside_a_second_one():
    """The second node leaves the heated one less thermal mass: it warms faster, and the plays with it."""
    structure = extended(PLANT.structure, "hysteresis", "two_node_thermal")
    laws = [3.0 * (m.name == "hysteresis") for m in structure.mechanisms]
    own = {"hysteresis.strength": 0.4, "hysteresis.width": 0.2, "hysteresis.reference_temperature": 30.0}
    own |= {"two_node_thermal.share": 0.4, "two_node_thermal.time_constant": 2.0}
    model = Model(structure, laws=laws).replace(PLANT.values() | own)
    at = {name: i for i, name in enumerate(structure.state_names)}
    z = jnp.zeros(len(at)).at[at["temperature"]].set(20.0)
    rates = np.asarray(model.rates(z, jnp.asarray([4.0])))
    assert rates[at["temperature"]] != 0
    np.testing.assert_allclose(rates[at["hysteresis.internal_stretch"]] * 0.2 * 30.0, rates[at["temperature"]])


def test_two_layers_are_nearer_to_a_slab_than_one_core():
    """Behind a skin warmed at once, but for the first instants; the slab by Fourier's series. All are as far behind one
    that warms steadily, which is how their time constant is defined."""
    m = catalogue()["two_node_thermal"]
    share, tau = 0.4, 0.3
    behind = tau / (1 - share)  # s, L^2 / (3 diffusivity): how far the mean of a slab is behind a steady rise

    def matrix(law):
        values = {"share": share, "time_constant": tau, "slow_part": 0.5, "slow_ratio": 6.0, "law": float(law)}
        shared = {"conductance": jnp.asarray(LAM), "thermal_mass": jnp.asarray(C_TH)}
        view = lambda skin, own: View(skin, skin, skin, skin, skin, own=tuple(own), shared=shared)  # noqa: E731
        rates = lambda skin, own: jnp.stack(m.rates(Values(values), view(skin, own)))  # noqa: E731
        at = jnp.zeros(()), jnp.zeros(2)
        return np.asarray(jax.jacobian(rates, 1)(*at)), np.asarray(jax.jacobian(rates, 0)(*at))

    time = np.linspace(0.0, 10 * behind, 2000)
    n = 2 * np.arange(200)[:, None] + 1
    slab = 1 - np.sum(8 / (np.pi * n) ** 2 * np.exp(-((n * np.pi / 2) ** 2) * time / (3 * behind)), axis=0)

    def warmed(law, weights):
        a, b = matrix(law)
        rest = -np.linalg.solve(a, b)
        return np.array([weights @ (rest - scipy.linalg.expm(a * t) @ rest) for t in time]), rest

    core, _ = warmed(0, np.array([1.0, 0.0]))
    layers, rest = warmed(4, np.array([0.5, 0.5]))
    np.testing.assert_allclose(rest, 1.0, rtol=1e-12)
    off = [float(np.sqrt(np.mean((y - slab)[time > behind / 4] ** 2))) for y in (layers, core)]
    assert off[0] < 0.4 * off[1]
    late = [np.trapezoid(1 - y, time) for y in (core, layers, slab)]
    np.testing.assert_allclose(late, behind, rtol=5e-3)
