"""A recording that begins in the middle: what held the actuator beside its equilibrium then, holds it in the model."""

from __future__ import annotations

import jax.numpy as jnp
import numpy as np
import pytest

from scpjax.diagnose.holdout import split
from scpjax.diagnose.hypothesis import State, residual_on
from scpjax.diagnose.remainder import misfit
from scpjax.diagnose.rivals import added
from scpjax.fit.fit import best_start
from scpjax.fit.predict import first_state, predict
from scpjax.fit.setup import prepare
from scpjax.physics.catalogue import mechanism
from scpjax.physics.model import Model
from scpjax.physics.presets import aaa, plant, tm
from scpjax.recordings.recording import Metadata, Recording
from scpjax.simulate.simulate import simulate

PLANT = plant(
    resistance=1.2, conductance=0.14, thermal_mass=1.1, coefficient=0.022, stiffness=200.0, damping=5.0, mass=0.1
)
NOISE = {"temperature_degC": 0.02, "displacement_mm": 0.002}
ADDED = np.array([0.02, 2e-5])  # K, m; the second well above what a step of 0.1 s errs at a reversal
HELD = [
    ("friction", 0, {"strength": 0.15, "velocity_time": 300.0}),
    ("friction", 2, {"strength": 0.15, "presliding": 0.02}),
    ("hysteresis", 0, {"strength": 0.5, "width": 0.2}),
    ("hysteresis", 3, {"strength": 0.5, "width": 0.2, "reference_temperature": 60.0}),
    ("friction", 3, {"strength": 0.15, "presliding": 0.02, "static": 0.3, "velocity_time": 300.0}),
    ("creep", 0, {"compliance": 0.3, "time_constant": 12.0, "reference": 0.04}),
    ("creep", 4, {"compliance": 0.3, "time_constant": 12.0, "activation": 0.1, "reference": 0.04}),
]


def holding(name: str, law: int, values: dict[str, float]) -> Model:
    structure = PLANT.structure.with_mechanisms(mechanism(name))
    laws = [float(law) if m.name == name else 0.0 for m in structure.mechanisms]
    own = {f"{name}.{k}": v for k, v in ({"reference": 0.006} | values).items()}
    return Model(structure, laws=laws).replace(PLANT.values() | own)


STEPS = (7.0, 0.0, 5.0, 2.0, 6.5, 0.0, 4.0, 6.0, 1.0)  # V, each for 10 s


def recorded(model: Model, begins: float, *, noise: float = 0.0, steps: tuple[float, ...] = STEPS) -> Recording:
    """A recording of a model that has been heated for ``begins`` seconds before."""
    n = 100 * len(steps)
    time, volts = 0.1 * np.arange(n), np.repeat(steps, 100)
    channels = {"temperature_degC": np.zeros(n), "displacement_mm": np.zeros(n)}
    room = Metadata(ambient_K=float(model.ambient))
    blank = Recording.from_arrays(time, {"voltage_V": volts}, channels, metadata=room)
    y = np.asarray(simulate(model, blank).outputs)
    y = y + noise * ADDED * np.random.default_rng(int(begins)).standard_normal(y.shape)
    return blank.with_outputs(y).slice(begins)


@pytest.mark.parametrize("held", HELD, ids=lambda h: f"{h[0]}-{h[1]}")
def test_what_can_hold_it_there_does(held):
    model = holding(*held)
    mine = model.structure.state_names.index("displacement")
    still = model.initial(temperature=20.0)
    beside = 0.5 * float(still[mine]) * (0.1 if held[0] == "friction" else 0.05)
    for displaced in (beside, -beside):
        z = model.initial(temperature=20.0, displaced=displaced)
        assert float(z[mine] - still[mine]) == pytest.approx(displaced)
        push = float(model.value("elastic_spring.stiffness")) * abs(displaced) / 0.1  # m/s^2, of the spring alone
        if (held[0], held[1]) != ("friction", 0):  # dry friction is no force at rest, but what an integrator finds
            effort = model.balances().holding([z[i] for i in range(len(z))], jnp.zeros(1))
            assert abs(float(model.rates(z, effort)[mine + 1])) < 0.02 * push


@pytest.mark.parametrize("held", HELD, ids=lambda h: f"{h[0]}-{h[1]}")
@pytest.mark.parametrize("begins", [8.0, 19.0])
def test_prediction_of_one_that_begins_in_the_middle(held, begins):
    model = holding(*held)
    recording = recorded(model, begins)
    x = 1e3 * recording.output("displacement")
    _, said = predict(model, recording, noise=NOISE)
    off = np.sqrt(np.mean((said["displacement_mm"] - x)[:60] ** 2))
    forgetful = model.initial(temperature=recording.output("temperature")[0] - float(model.ambient))
    at_rest = 1e3 * np.asarray(simulate(model, recording, initial=forgetful).outputs)[:, 1]
    assert off < 0.1 * np.sqrt(np.mean((at_rest - x)[:60] ** 2))


@pytest.mark.parametrize("held", HELD[1:], ids=lambda h: f"{h[0]}-{h[1]}")
def test_what_holds_a_joint_pushes_on_both_sides(held):
    joint = aaa(PLANT, pulley_radius=0.015)
    structure = joint.structure.with_mechanisms(mechanism(held[0]))
    laws = [float(held[1]) if m.name == held[0] else 0.0 for m in structure.mechanisms]
    own = {f"{held[0]}.{k}": v for k, v in ({"reference": 0.006} | held[2]).items()}
    model = Model(structure, laws=laws).replace(joint.values() | own)
    z = model.initial(temperature=jnp.array([30.0, 10.0]), displaced=2e-4)
    effort = model.balances().holding([z[i] for i in range(len(z))], jnp.zeros(2))
    assert abs(float(model.rates(z, effort)[3])) < 0.02 * 2 * 200.0 * 2e-4 / 0.2  # m/s^2, of the springs alone


def test_what_the_noise_of_either_sensor_may_make_holds_nothing():
    """The equilibrium is known by the first temperature: 1 K off, and it stands elsewhere."""
    model = holding(*HELD[2])
    recording = recorded(PLANT, 8.0)
    y = np.stack([recording.output("temperature"), recording.output("displacement")], axis=1)
    y[0, 0] += 1.0
    begun = lambda kelvin: first_state(model, recording.with_outputs(y), NOISE | {"temperature_degC": kelvin})  # noqa: E731
    at = model.structure.state_names.index("hysteresis.internal_stretch")
    assert float(begun(1.0)[at]) == 0.0
    assert abs(float(begun(0.02)[at])) > 0.1


def test_what_holds_it_is_asked_before_what_creeps():
    """One of them answers for where it begins, else the load would be out of balance."""
    structure = PLANT.structure.with_mechanisms(mechanism("friction"), mechanism("creep"))
    laws = [2.0 if m.name == "friction" else 0.0 for m in structure.mechanisms]
    own = {f"friction.{k}": v for k, v in ({"reference": 0.006} | HELD[1][2]).items()}
    own |= {f"creep.{k}": v for k, v in HELD[5][2].items()}
    names = presliding, crept = "friction.presliding_stretch", "creep.creep_displacement"
    for strength, creeps in ((0.15, False), (0.0, True)):
        model = Model(structure, laws=laws).replace(PLANT.values() | own | {"friction.strength": strength})
        still, z = model.initial(temperature=20.0), model.initial(temperature=20.0, displaced=1e-5)
        at = {n: model.structure.state_names.index(n) for n in names}
        assert (abs(float(z[at[crept]] - still[at[crept]])) > 5e-6) == creeps
        if not creeps:
            assert abs(float(z[at[presliding]])) > 0.01


def test_a_weight_that_is_let_go_has_not_crept_farther():
    """Driven directly, what begins beside rest was held there: it is let go, and the spring pulls at once."""
    weight = tm(coefficient=0.02, stiffness=200.0, damping=5.0, mass=0.1).structure
    structure = weight.with_mechanisms(mechanism("creep"))
    model = Model(structure).replace({"creep.compliance": 0.3, "creep.time_constant": 12.0, "creep.reference": 0.04})
    z = model.initial(displaced=0.01)
    assert float(z[structure.state_names.index("creep.creep_displacement")]) == pytest.approx(0.01 * 0.3 / 1.3)


def friction_leaves(*recordings: Recording) -> float:
    """Mean square, in units of the noise's, that friction added to the base model leaves, in the worse column."""
    setup = prepare(recordings)
    parts = split(setup.data)
    trial, _, _ = best_start(setup, parts.train)
    residual = residual_on(trial, parts.whole, setup)
    base = State(setup, trial, residual, float(np.sum(residual[parts.is_train] ** 2)))
    found = added(base, "friction", parts)
    return float(np.max(misfit(found, parts) * (setup.data.sigma / ADDED) ** 2))


def test_friction_is_found_in_recordings_that_began_in_it(monkeypatch):
    recordings = [recorded(holding(*HELD[0]), t, noise=1.0) for t in (8.0, 19.0)]
    left = friction_leaves(*recordings)
    monkeypatch.setattr("scpjax.fit.setup.driven_before", lambda *_: False)
    assert left < 1.15
    assert friction_leaves(*recordings) > 2 * left


def test_where_it_began_is_estimated_for_a_recording_that_began_warm():
    warm, cold = (recorded(holding(*HELD[0]), t, noise=1.0) for t in (8.0, 0.0))
    names = lambda *r: prepare(r).space.locals.names(PLANT.structure)  # noqa: E731
    assert names(warm) == ("initial_temperature", "initial_displacement")
    assert names(cold, warm) == ("initial_temperature", "initial_displacement")
    assert names(cold) == ("initial_temperature",)


COOLED = (7.0, *[0.0] * 8, *STEPS)  # V, each for 10 s; cold again from 90 s on


def test_one_that_has_cooled_but_is_held_away_from_rest_begins_there(monkeypatch):
    """At the room's temperature friction still holds the load where the last stroke has left it."""
    recording = recorded(holding(*HELD[1]), 85.0, noise=1.0, steps=COOLED)
    assert abs(recording.output("temperature")[0] - float(PLANT.ambient)) < 0.3
    assert recording.output("displacement")[0] > 5e-4
    assert prepare([recording]).space.locals.names(PLANT.structure) == ("initial_temperature", "initial_displacement")
    left = friction_leaves(recording)
    _, said = predict(holding(*HELD[1]), recording, noise=NOISE)
    off = 1e-3 * said["displacement_mm"] - recording.output("displacement")
    assert np.sqrt(np.mean(off[:60] ** 2)) < 1.5 * ADDED[1]
    monkeypatch.setattr("scpjax.fit.setup.driven_before", lambda *_: False)
    assert friction_leaves(recording) > 2 * left


def test_what_the_drive_has_moved_by_the_second_sample_was_not_there_before():
    recording = recorded(PLANT, 0.0)
    y = np.stack([recording.output("temperature"), recording.output("displacement")], axis=1)
    quiet = recording.with_outputs(y + 0.02 * ADDED * np.random.default_rng(0).standard_normal(y.shape))
    assert np.median(quiet.output("displacement")[:3]) > 0.01 * np.ptp(quiet.output("displacement"))
    assert prepare([quiet]).space.locals.names(PLANT.structure) == ("initial_temperature",)
