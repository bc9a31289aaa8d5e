"""How a prediction begins, and what it may look at."""

from __future__ import annotations

import numpy as np
import pytest

from scpjax.fit.predict import period_of, predict
from scpjax.physics import presets
from scpjax.physics.catalogue import mechanism
from scpjax.physics.model import Model
from scpjax.physics.presets import tm
from scpjax.recordings.recording import Recording
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
