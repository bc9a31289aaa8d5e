"""Recordings of one actuator that are not alike: in length, in sensors, in sampling rate, in number."""

import numpy as np
import pytest

from scpjax.diagnose import trials
from scpjax.diagnose.holdout import split
from scpjax.diagnose.hypothesis import residual_on
from scpjax.diagnose.naming import state_at
from scpjax.diagnose.trials import integrable
from scpjax.errors import FitError
from scpjax.fit.fit import FitOptions, fit
from scpjax.fit.fleet import _setups, fit_fleet
from scpjax.fit.identifiability import uncertainty
from scpjax.fit.setup import UNKNOWN_POWER, prepare
from scpjax.fit.solve import evaluate, stack
from scpjax.physics.presets import plant, te
from scpjax.recordings.excitation import multilevel_random
from scpjax.recordings.plausible import LOOK
from scpjax.recordings.recording import Metadata, Recording
from scpjax.simulate.simulate import simulate

HEATER = te(resistance=3.0, conductance=0.06, thermal_mass=0.6)
PULLER = plant(
    resistance=3.0, conductance=0.06, thermal_mass=0.6, coefficient=0.02, stiffness=180.0, damping=5.0, mass=0.2
)
NOISE = {"temperature_degC": 0.05, "displacement_mm": 1e-5}  # K, m
OHMS = (("resistance_ohm", 3.0),)


def made(model, seconds, *, seed, columns, period=0.1, high=4.0, hold="zero_order", known=OHMS):
    """A recording of some columns of a model's outputs, with noise."""
    time, volts = multilevel_random(duration_s=seconds, period_s=period, low=0.0, high=high, hold_s=12.0, seed=seed)
    every = ("temperature_degC", "displacement_mm")[: len(model.structure.outputs)]
    meta = Metadata(name=f"r{seed}", ambient_K=float(model.ambient), known=known)
    empty = {c: np.zeros(len(time)) for c in every}
    blank = Recording.from_arrays(time, {"voltage_V": volts}, empty, metadata=meta, hold=hold)
    exact, rng = np.asarray(simulate(model, blank).outputs), np.random.default_rng(seed)
    noisy = exact + rng.standard_normal(exact.shape) * np.array([NOISE[c] for c in every])
    shown = {"temperature_degC": noisy[:, 0] - 273.15, "displacement_mm": 1e3 * noisy[:, -1]}
    return Recording.from_arrays(time, {"voltage_V": volts}, {c: shown[c] for c in columns}, metadata=meta, hold=hold)


def test_actuators_with_different_numbers_of_recordings_are_fitted_abreast():
    heat = ("temperature_degC",)
    two = [made(HEATER, 60, seed=s, columns=heat) for s in (1, 2)]
    fleet = fit_fleet([two, [made(HEATER, 60, seed=3, columns=heat)]], names=["two", "one"])
    alone = fit(two)
    key = "newton_cooling.conductance"
    for found in fleet.fits:
        assert found.parameters[key].value == pytest.approx(0.06, abs=4 * found.parameters[key].std)
    assert fleet.fits[0].parameters[key].value == pytest.approx(alone.parameters[key].value, rel=1e-3)


def test_an_actuator_of_a_fleet_is_integrated_as_alone():
    bent = [made(HEATER, 60, seed=4, columns=("temperature_degC",), hold="band_limited")]
    setups, failures = _setups([bent], None, None, FitOptions(), None)
    assert not failures
    assert float(setups[0].data.grids.step[0]) == pytest.approx(float(prepare(bent).data.grids.step[0]))
    assert float(setups[0].data.grids.step[0]) == pytest.approx(0.05)


def test_each_balance_is_read_off_a_recording_that_shows_it():
    """The longest has no displacement: its scale is the other's, and the heat is read off the longest."""
    long = made(PULLER, 300, seed=5, columns=("temperature_degC",))
    both = made(PULLER, 60, seed=6, columns=("temperature_degC", "displacement_mm"), high=3.0)
    setup, alone = prepare([long, both]), prepare([both])
    travel = np.ptp(both.output("displacement"))
    assert 0.5 * travel < setup.scales.displacement < 2 * travel
    assert setup.scales.displacement == pytest.approx(alone.scales.displacement)
    assert setup.scales.temperature == pytest.approx(prepare([long]).scales.temperature, rel=0.05)
    assert setup.scales.drive == pytest.approx(4.0, rel=0.01)


def test_bins_are_short_also_where_samples_are_rare():
    quick = made(HEATER, 100, seed=7, columns=("temperature_degC",), period=0.01)
    slow = made(HEATER, 200, seed=8, columns=("temperature_degC",), period=1.0)
    assert prepare([quick, slow]).data.bin * slow.period <= 10.0 / 8 + 1e-9 or prepare([quick, slow]).data.bin == 1
    assert prepare([quick]).data.bin > 1


def test_a_sensor_logged_in_every_other_row_is_fitted():
    r = made(HEATER, 120, seed=9, columns=("temperature_degC",))
    weights = np.array(r.weights)
    weights[1::2] = 0.0
    found = fit([r.with_weights(weights)])
    assert found.parameters["newton_cooling.conductance"].value == pytest.approx(0.06, rel=0.02)
    assert found.noise["temperature_degC"] == pytest.approx(0.05, rel=0.2)


def warmed(n, seed):
    """Warmth that drives a displacement, as a file of ``model = "tm"`` has it."""
    rng, t = np.random.default_rng(seed), 0.1 * np.arange(n)
    warmth = 22.0 + 20.0 * (1 - np.cos(t / 40.0)) + 5.0 * np.sin(t / 7.0)
    moved = 0.1 * (warmth - warmth[0]) + 0.01 * rng.standard_normal(n)
    meta = Metadata(name=f"w{seed}", model="tm")
    drive = {"temperature_degC": warmth}
    return Recording.from_arrays(t, drive, {"displacement_mm": moved}, metadata=meta, hold="linear")


def test_segments_of_a_long_recording_have_its_room():
    long = warmed(20_000, 1)
    setup = prepare([long])
    assert len(setup.recordings) > 1
    np.testing.assert_allclose(np.asarray(setup.data.ambient), long.inputs[0, 0])


def test_steps_of_a_drive_along_lines_are_checked_by_shorter_ones(monkeypatch):
    """The integrator of the other order is the same one there."""
    setup = prepare([warmed(600, 4)])
    parts = split(setup.data)
    state = state_at(setup, parts, setup.trial(setup.starts[0], setup.base_active))
    assert integrable(state, parts)
    asked = []

    def off(trial, data, setup):
        asked.append(float(data.grids.step[0]))
        return residual_on(trial, data, setup) + 1.0

    monkeypatch.setattr(trials, "residual_on", off)
    assert not integrable(state, parts)
    assert asked == [pytest.approx(0.05)]


def test_a_short_recording_beside_a_long_one_keeps_samples():
    setup = prepare([warmed(20_000, 1), warmed(300, 2), warmed(40, 3)])
    for r in setup.recordings:
        assert np.mean(np.asarray(r.weights) > 0) > 0.3, r.metadata.name


def test_full_drive_of_a_pwm_is_that_of_its_supply():
    volts = made(HEATER, 60, seed=1, columns=("temperature_degC",), known=())
    meta = Metadata(name="pwm", ambient_K=float(HEATER.ambient), supply_V=12.0)
    drive = {"pwm": 255.0 * volts.input("voltage") / volts.input("voltage").max()}
    shown = {"temperature_degC": volts.output("temperature") - 273.15}
    setup = prepare([Recording.from_arrays(volts.time, drive, shown, metadata=meta)])
    assert setup.starts[0][setup.structure.index["joule_heating.gain"]] * 12.0**2 == pytest.approx(1.0)


def test_what_has_no_finite_derivative_is_not_seen():
    setup = prepare([made(HEATER, 60, seed=1, columns=("temperature_degC",))])
    trial = setup.trial(setup.starts[0], setup.base_active)
    here = evaluate(stack([trial]), setup.data, setup.space)
    residual, jacobian = np.array(here.residual[0]), np.array(here.jacobian[0])
    which = [setup.space.keys[i] for i in np.asarray(trial.index)].index("newton_cooling.thermal_mass")
    jacobian[100:200, which] = np.nan
    found = uncertainty(trial, setup.data, setup.space, at=(residual, jacobian))
    assert np.all(np.isfinite(found.std_free))
    whole = uncertainty(trial, setup.data, setup.space)
    assert found.std_free[which] > 20 * whole.std_free[which]
    assert any("newton_cooling.thermal_mass is not determined" in s for s in found.open_directions)


def test_limits_that_leave_no_experiment_are_refused_before_anything_is_sought(monkeypatch):
    import scpjax.diagnose.diagnose as room
    from scpjax.diagnose.profiles import Limits

    def seek(*given, **options):
        raise AssertionError("something was sought")

    monkeypatch.setattr(room, "find_names", seek)
    moved = made(PULLER, 60, seed=6, columns=("displacement_mm",))
    for limits, said in (
        (Limits(hottest=330.0), "thermometer"),
        (Limits(lowest=5.0, highest=2.0), "nothing to choose"),
    ):
        with pytest.raises(FitError, match=said):
            room.diagnose([moved], options=room.DiagnoseOptions(next=limits))


def test_identical_actuators_driven_differently_have_the_same_parameters():
    """Though nothing tells the power: full drive of the whole fleet is called 1 W, not of each."""
    actuators = [
        [made(HEATER, 60.0, seed=s, columns=["temperature_degC"], high=v, known=())] for s, v in ((1, 3.0), (2, 5.0))
    ]
    found = fit_fleet(actuators, model="te").fits
    a, b = (f.parameters["newton_cooling.conductance"].value for f in found)
    assert a == pytest.approx(b, rel=0.02)
    top = max(float(np.max(r.input("voltage"))) for (r,) in actuators)
    assert a == pytest.approx(0.06 * 3.0 / top**2, rel=0.02)
    assert found[0].known == ()  # nobody told the gain
    assert any(n.startswith(UNKNOWN_POWER) for n in found[0].notes)
    alone = fit(actuators[0], model="te")
    assert alone.known == ()
    assert fit([made(HEATER, 60.0, seed=1, columns=["temperature_degC"])], model="te").known == ("joule_heating.gain",)


def test_what_one_toml_tells_of_the_actuator_holds_for_its_other_files():
    told = made(HEATER, 40.0, seed=1, columns=["temperature_degC"])
    untold = made(HEATER, 40.0, seed=2, columns=["temperature_degC"], known=())
    other = made(HEATER, 40.0, seed=3, columns=["temperature_degC"], known=(("resistance_ohm", 4.0),))
    for both in ([told, untold], [untold, told]):
        setup = prepare(both, model="te")
        assert setup.known == ("joule_heating.gain",)
        assert f"{LOOK}r2 has no [actuator]; that of r1 is taken for it, too" in setup.notes
    with pytest.raises(FitError, match="differ between recordings"):
        prepare([told, other], model="te")


@pytest.mark.parametrize("ohms", [0.0, -1.0])
def test_a_resistance_that_is_none_is_refused(ohms):
    recording = made(HEATER, 40.0, seed=1, columns=["temperature_degC"], known=(("resistance_ohm", ohms),))
    with pytest.raises(FitError, match=r"resistance_ohm is .*; give a number above 0"):
        prepare([recording], model="te")


def test_the_force_of_a_drive_that_pulls_directly_is_by_its_unit():
    recording = made(PULLER, 60.0, seed=1, columns=["displacement_mm"], known=())
    found = fit([recording], model="tm").parameters
    assert found["thermal_actuation.coefficient"].unit == "N/V²"
    assert found["elastic_spring.stiffness"].unit == "N/m"
    whole = made(PULLER, 60.0, seed=1, columns=["temperature_degC", "displacement_mm"])
    assert fit([whole]).parameters["thermal_actuation.coefficient"].unit == "N/K"
