"""How a prediction begins, and what it may look at."""

from __future__ import annotations

import numpy as np
import pytest

from scpjax.cli.inputs import output_columns
from scpjax.fit.ambient import rooms
from scpjax.fit.predict import first_state, period_of, predict
from scpjax.physics import presets
from scpjax.physics.catalogue import mechanism
from scpjax.physics.model import Model
from scpjax.physics.presets import tm
from scpjax.recordings.recording import Metadata, Recording
from scpjax.simulate.simulate import Exponential, simulate

# a weight that rings at 31 rad/s and forgets within half a second
MODEL = tm(coefficient=2.0, stiffness=1000.0, damping=8.0, mass=1.0, drive="gain")


def multisine(n: int, period: int, seed: int = 0) -> np.ndarray:
    rng = np.random.default_rng(seed)
    t = np.arange(n) / period
    return sum(np.cos(2 * np.pi * (k * t + rng.uniform())) for k in range(3, 40))


def test_a_drive_that_repeats_itself_is_recognised():
    assert period_of(multisine(2300, 2048)) == 2048
    noise = np.random.default_rng(1).standard_normal(2300)
    assert period_of(multisine(2300, 2048) + 0.02 * noise) == 2048


@pytest.mark.parametrize(
    "drive",
    [
        multisine(2300, 5000),  # never repeats
        np.random.default_rng(2).standard_normal(3000),
        np.concatenate([np.zeros(400), np.ones(2000), np.zeros(400)]),  # the same rest at both ends is no repetition
        np.linspace(0, 1, 2000),
    ],
)
def test_one_that_does_not_is_not(drive):
    assert period_of(drive) is None


def recorded(lead: int, n: int) -> tuple[Recording, np.ndarray]:
    """A recording that begins in the middle of the motion, and the truth."""
    time, drive = 0.005 * np.arange(lead + n), {"drive_V": multisine(lead + n, 2048)}
    blank = Recording.from_arrays(time, drive, {"displacement_m": np.zeros(lead + n)}, hold="linear")
    x = np.asarray(simulate(MODEL, blank).outputs)[lead:, 0]
    return blank.slice(time[lead]).with_outputs(x[:, None]), x


def test_begun_in_motion_under_a_repeating_drive():
    recording, x = recorded(1000, 2300)
    _, said = predict(MODEL, recording, noise={"displacement_m": 1e-6})
    wrong = np.abs(said["displacement_m"] - x)[:20]
    assert wrong.max() < 0.02 * np.std(x)


def test_no_later_output_is_looked_at():
    recording, _ = recorded(1000, 2300)
    blind = recording.with_weights(np.concatenate([[[1.0]], np.zeros((recording.n - 1, 1))]))
    for a, b in zip(predict(MODEL, recording)[1].values(), predict(MODEL, blind)[1].values(), strict=True):
        np.testing.assert_array_equal(a, b)


@pytest.mark.parametrize(("off", "begins"), [(5.0, 5.0), (-5.0, 0.0), (-7.0, -7.0), (3.0, 0.0)])
def test_a_heated_actuator_is_seldom_colder_than_its_room(off, begins):
    """A first sample ``off`` standard deviations from the room: what it says of where the actuator began."""
    model = presets.te(resistance=1.2, conductance=0.14, thermal_mass=1.2)
    read = np.full(200, float(model.ambient) - 273.15)
    read[0] += 0.1 * off
    recording = Recording.from_arrays(0.1 * np.arange(200), {"voltage_V": np.zeros(200)}, {"temperature_degC": read})
    _, said = predict(model, recording, noise={"temperature_degC": 0.1})
    assert said["temperature_degC"][0] - read[1] == pytest.approx(0.1 * begins, abs=1e-6)


@pytest.mark.parametrize(
    ("left_out", "value"),
    [
        (None, {}),
        ("slack", {"gap": 0.2, "corner": 0.02, "reference": 0.01}),
        ("nonlinear_stiffness", {"quadratic": 0.0, "cubic": 2.0, "reference": 0.01}),
    ],
)
@pytest.mark.parametrize("warm", [25.0, 60.0])
def test_where_only_the_displacement_is_read_it_begins_as_warm_as_that_takes(left_out, value, warm):
    """It stood still there for long, by all of its balances."""
    model = presets.plant(
        resistance=1.2, conductance=0.14, thermal_mass=1.1, coefficient=0.024, stiffness=150.0, damping=8.0, mass=0.25
    )
    if left_out:
        model = Model(model.structure.with_mechanisms(mechanism(left_out)), ambient=model.ambient).replace(
            model.values() | {f"{left_out}.{k}": v for k, v in value.items()}
        )
    moved = float(model.observe(model.initial(warm), np.zeros(1))[1])
    assert moved > 1e-3
    read = np.full(50, 1e3 * moved)
    recording = Recording.from_arrays(0.1 * np.arange(50), {"voltage_V": np.zeros(50)}, {"displacement_mm": read})
    _, said = predict(model, recording, noise={"displacement_mm": 0.01}, response_columns=("temperature_degC",))
    assert said["displacement_mm"][0] == pytest.approx(1e3 * moved, abs=1e-3)
    assert said["temperature_degC"][0] + 273.15 - float(model.ambient) == pytest.approx(warm, abs=0.05)


def test_where_a_step_goes_astray_it_is_halved():
    """An element thirty times as stiff as the spring, which slips by 0.07 mm: four steps a sample ring with it."""
    base = presets.plant(
        resistance=1.2,
        conductance=0.14,
        thermal_mass=1.2,
        coefficient=0.0277,
        stiffness=165.6,
        damping=0.69,
        mass=0.154,
    )
    structure = base.structure.with_mechanisms(mechanism("hysteresis"))
    laws = [float(m.laws.index("Duhem")) if m.name == "hysteresis" else 0.0 for m in structure.mechanisms]
    own = {"hysteresis.strength": 29.2, "hysteresis.width": 0.0279, "hysteresis.reference": 0.00246}
    model = Model(structure, laws=laws).replace(base.values() | own)
    time = 0.05 * np.arange(1200)
    volts = np.random.default_rng(0).uniform(0.0, 3.5, 12)[np.arange(1200) // 100]
    recording = Recording.from_arrays(time, {"voltage_V": volts}, {"displacement_m": np.zeros(1200)})
    wanted, ringing = (
        np.asarray(simulate(model, recording, method=Exponential(order=2, substeps=k)).outputs)[:, 1] for k in (64, 4)
    )
    _, said = predict(model, recording)
    error = np.std(said["displacement_m"] - wanted)
    assert error < 0.01 * np.std(wanted)
    assert error < 0.1 * np.std(ringing - wanted)


PLANT = presets.plant(
    resistance=1.2, conductance=0.1, thermal_mass=1.0, coefficient=0.02, stiffness=180.0, damping=8.0, mass=0.25
)


def heated(columns: dict[str, float], *, first: float = 0.0, ambient: float | None = 293.15) -> Recording:
    """A step after 5 s, with a reading of each column at every stamp."""
    time = 0.1 * np.arange(200)
    drive = np.where(time < 5.0, first, 3.0)
    outputs = {c: np.full(time.size, y) for c, y in columns.items()}
    return Recording.from_arrays(time, {"voltage_V": drive}, outputs, metadata=Metadata(ambient_K=ambient))


@pytest.mark.parametrize(
    "fitted", [("temperature_degC", "displacement_mm", "force_N"), ("force_N", "temperature_degC")]
)
def test_a_column_that_the_model_does_not_give_is_not_made_up(fitted):
    said = predict(PLANT, heated({"temperature_degC": 20.0, "force_N": 1.0}), response_columns=fitted)[1]
    assert set(said) == {c for c in fitted if c != "force_N"} | {"temperature_degC"}
    alone = predict(PLANT, heated({"temperature_degC": 20.0, "displacement_mm": 0.0}))[1]
    for column in said:
        np.testing.assert_array_equal(said[column], alone[column])


@pytest.mark.parametrize("fitted", [("level_V", "displacement_mm"), ("displacement_mm", "level_V")])
def test_a_column_with_a_name_of_its_own_stands_for_an_output_only_where_none_is_one(fitted):
    said = predict(PLANT, heated({"displacement_mm": 0.0}), response_columns=fitted)[1]
    assert list(said) == ["displacement_mm"]
    assert output_columns(PLANT, heated({"displacement_mm": 0.0}), {"response": fitted})["displacement_mm"][0] == 1
    said = predict(PLANT, heated({"level_V": 0.0}), response_columns=("level_V",))[1]
    assert list(said) == ["level_V"]


def test_a_file_that_measures_other_things_alone_is_predicted_all_the_same():
    _, said = predict(PLANT, heated({"force_N": 1.0}), response_columns=("displacement_mm", "force_N"))
    assert list(said) == ["displacement_mm"]
    assert list(predict(PLANT, heated({"force_N": 1.0}))[1]) == ["temperature_degC", "displacement_mm"]


def test_of_two_units_of_one_output_the_first_is_taken():
    told = ("displacement_mm", "displacement_m", "level_V")
    _, said = predict(PLANT, heated({"displacement_m": 0.0}), response_columns=told)
    assert list(said) == ["displacement_mm"]


@pytest.mark.parametrize("column", ["displacement_mm", "displacement_m"])
def test_noise_is_that_of_the_sensor_in_whatever_unit_a_file_has(column):
    """A first reading within the noise is no start away from rest."""
    off = 0.03 if column == "displacement_mm" else 3e-5
    noise = {"displacement_mm": 0.02, "temperature_degC": 0.1}
    begun = first_state(PLANT, heated({column: off}), noise)
    np.testing.assert_array_equal(begun, PLANT.initial())
    assert float(np.max(np.abs(first_state(PLANT, heated({column: 10 * off}), noise)))) > 0


@pytest.mark.parametrize(
    ("others", "first", "begins", "room"),
    [
        ((295.0, 297.0), 0.0, 296.0, 296.0),  # as those it was fitted to, it began in its own room
        ((295.0, 297.0), 0.0, 298.5, 298.5),
        ((295.0, 297.0), 0.0, 310.0, 295.0),  # that is no room like these: it began warm
        ((295.0, 297.0), 3.0, 296.0, 295.0),  # driven from the start
        ((295.0, 295.0), 0.0, 296.0, 295.0),  # they were of one room
        ((), 0.0, 296.0, 295.0),
    ],
)
def test_a_recording_that_tells_no_room_began_in_its_own_as_others_did(others, first, begins, room):
    model = Model(PLANT.structure, PLANT.theta, PLANT.laws, 295.0)
    recording = heated({"temperature_degC": begins - 273.15}, first=first, ambient=None)
    noise = {"temperature_degC": 0.1}
    _, said = predict(model, recording, noise=noise, rooms=others)
    inside = Model(PLANT.structure, PLANT.theta, PLANT.laws, room)
    _, wanted = predict(inside, recording.with_metadata(Metadata(ambient_K=room)), noise=noise)
    np.testing.assert_allclose(said["temperature_degC"], wanted["temperature_degC"], atol=1e-6)
    told = recording.with_metadata(Metadata(ambient_K=290.0))
    alone, among = (predict(model, told, noise=noise, rooms=r)[1]["temperature_degC"] for r in ((), others))
    np.testing.assert_array_equal(alone, among)  # what it tells goes before
    assert abs(alone[-1] - said["temperature_degC"][-1]) > 1.0


def test_a_temperature_that_drives_counts_from_its_first_where_no_room_was_told():
    time = 0.1 * np.arange(100)
    warm = 310.0 - 273.15 + 20.0 * np.minimum(time / 5.0, 1.0)
    model = tm(coefficient=0.02, stiffness=180.0, damping=8.0, mass=0.25)
    model = Model(model.structure, model.theta, model.laws, 295.0)
    recording = Recording.from_arrays(time, {"temperature_degC": warm}, {}, hold="linear", require_outputs=False)
    moved = [predict(model, recording, rooms=r)[1]["displacement_mm"] for r in ((), (295.0,))]
    assert moved[0][0] > 1.0  # 15 K above the model's room
    assert moved[1][0] == pytest.approx(0.0, abs=1e-9)
    for rest in (0.0, moved[0][0]):  # where the displacement is read, by whichever it began at rest
        read = np.full(time.size, rest)
        begun = Recording.from_arrays(time, {"temperature_degC": warm}, {"displacement_mm": read}, hold="linear")
        _, said = predict(model, begun, rooms=(295.0,), noise={"displacement_mm": 0.01})
        np.testing.assert_allclose(said["displacement_mm"], moved[0] if rest else moved[1], atol=1e-6)


def test_rooms_are_those_that_thermometers_showed():
    cold, warm, none = (
        heated(c, ambient=None)
        for c in ({"temperature_degC": 22.0}, {"temperature_degC": 24.0}, {"displacement_mm": 0.0})
    )
    hot = heated({"temperature_degC": 45.0}, ambient=None)
    found = rooms([cold, warm, none, hot], PLANT.structure, 0.05)
    np.testing.assert_allclose(found, [295.15, 297.15], atol=1e-6)
    assert rooms([cold, heated({"temperature_degC": 22.0})], PLANT.structure, 0.05) == []
