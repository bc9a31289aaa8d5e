"""Samples that a clock skipped while the drive changed: the change is timed from what the outputs did after it."""

import numpy as np
import pytest

from scpjax.fit.fit import best_start, fit, refine, settle
from scpjax.fit.fleet import fit_fleet
from scpjax.fit.gaps import Gap, bridged, fill, find_gaps, improve, slopes_at
from scpjax.fit.predict import predict
from scpjax.fit.setup import prepare
from scpjax.fit.solve import outputs_of
from scpjax.physics.presets import te
from scpjax.recordings.recording import Metadata, Recording
from scpjax.simulate.simulate import simulate

HEATER = te(resistance=3.2, conductance=0.06, thermal_mass=0.26)
PERIOD, NOISE = 0.05, 0.05  # s, K
TICKS = np.arange(1600)
# jumps of volts by the tick at which they happen, in the middle of which samples are missing: five of six ticks
JUMPS = {201: 3.0, 404: 0.0, 605: 0.0002, 802: 2.0, 1003: 0.0, 1204: 2.5}
MISSING = [t for jump in JUMPS for t in range(jump // 100 * 100 + 1, jump // 100 * 100 + 6)]


def recorded(volts: np.ndarray, missing: list[int], seed: int = 0) -> Recording:
    """A heater's recording from which samples were lost after it was made."""
    meta = Metadata(ambient_K=float(HEATER.ambient), known=(("resistance_ohm", 3.2),), model="te")
    blank = Recording.from_arrays(
        PERIOD * TICKS, {"voltage_V": volts}, {"temperature_degC": np.zeros(len(TICKS))}, metadata=meta
    )
    exact = np.asarray(simulate(HEATER, blank).outputs)
    noisy = exact + NOISE * np.random.default_rng(seed).standard_normal(exact.shape)
    left = np.setdiff1d(TICKS, missing)
    return blank.with_samples(blank.time[left], blank.inputs[left], noisy[left], None)


@pytest.fixture(scope="module")
def jumping():
    volts = np.zeros(len(TICKS))
    for jump, level in JUMPS.items():
        volts[jump:] = level
    return prepare([recorded(volts, MISSING)])


def test_jumps_are_timed_beside_those_that_do_nothing(jumping):
    """Nothing at all is what a jump does below a dead zone: here, one to where it came from."""
    trial, _, _ = best_start(jumping, jumping.data)
    gaps = find_gaps(jumping.data)
    assert [(g.start, g.end) for g in gaps] == [(j // 100 * 100, j // 100 * 100 + 6) for j in JUMPS]
    gaps = (*gaps, Gap(0, 1410, 1416, gaps[-1].after, gaps[-1].after))
    shares, as_recorded = np.full(len(gaps), 0.5), np.asarray(jumping.data.grids.effort)
    for _ in range(3):
        trial, _, _ = refine(jumping, jumping.data.with_effort(fill(as_recorded, gaps, shares)), trial)
        shares = improve(jumping.data, gaps, shares, trial, jumping.space)
    true, told = np.array([*((j % 100) / 6 for j in JUMPS), 0.5]), np.array([*(j != 605 for j in JUMPS), False])
    np.testing.assert_allclose(shares[told], true[told], atol=0.03)
    np.testing.assert_allclose(shares[~told], 0.5, atol=0.01)  # of a fifth of a millivolt nothing is known


def test_settling_times_them_and_finds_what_the_heater_is(jumping):
    trial, _, _ = best_start(jumping, jumping.data)
    _, data, notes = settle(jumping, trial, jumping.data)
    assert "6 gaps" in notes[0]
    assert np.any(np.asarray(data.grids.effort) != np.asarray(jumping.data.grids.effort))
    found = fit(jumping.recordings)
    for key, true in (("newton_cooling.conductance", 0.06), ("newton_cooling.thermal_mass", 0.26)):
        value = float(found.model.value(key))
        assert abs(value - true) < 0.005 * true


def test_an_actuator_of_a_fleet_is_settled_as_one_alone_is(jumping):
    """Jumps in gaps are timed and a wild sample is left out; not for the other one, which has a recording more."""
    (recording,) = jumping.recordings
    read = np.array(recording.outputs)
    read[700] += 40 * NOISE
    steady = recorded(np.where(TICKS // 100 % 2, 2.5, 0.0), [])
    one, two = fit_fleet([[recording.with_outputs(read)], [steady, steady.with_outputs(steady.outputs + 0.0)]]).fits
    assert not isinstance(one, str)
    assert not isinstance(two, str)
    told = [n for n in one.notes if "gaps" in n or "wild" in n]
    assert len(told) == 2
    assert "6 gaps" in told[0]
    assert told[1].startswith("1 isolated")
    assert not [n for n in two.notes if "gaps" in n or "wild" in n]
    alone = fit([recording.with_outputs(read)])
    for key, true in (("newton_cooling.conductance", 0.06), ("newton_cooling.thermal_mass", 0.26)):
        assert abs(float(one.model.value(key)) - true) < 0.005 * true
        np.testing.assert_allclose(float(one.model.value(key)), float(alone.model.value(key)), rtol=1e-3)


@pytest.mark.parametrize("shape", ["sweep", "jumps"])
def test_a_prediction_lets_the_drive_change_within_a_gap(shape):
    lost = sorted(np.random.default_rng(1).choice(np.arange(20, 1590), 120, replace=False))
    missing = [t for start in lost for t in range(start, start + 4)]
    phase = 2 * np.pi * TICKS / 400
    volts = 1.5 - 1.5 * np.cos(phase) if shape == "sweep" else np.where(np.sin(phase * 3) > 0, 3.0, 0.0)
    recording = recorded(volts, missing)
    whole = recorded(volts, [])
    _, said = predict(HEATER, recording)
    kept = np.setdiff1d(TICKS, missing)
    exact = predict(HEATER, whole)[1]["temperature_degC"][kept]
    held = np.asarray(simulate(HEATER, recording).outputs)[:, 0] - 273.15
    error, before = (np.sqrt(np.mean((y - exact) ** 2)) for y in (said["temperature_degC"], held))
    assert error < (0.1 if shape == "sweep" else 0.75) * before


def test_only_what_a_clock_skipped_is_bridged():
    volts = np.linspace(0.0, 3.0, len(TICKS))
    whole = recorded(volts, [])
    assert bridged(whole, "voltage")[0] is whole
    few = recorded(volts, list(np.setdiff1d(TICKS, TICKS[::7] + TICKS[::7] % 5)))  # a list of events, not a clock
    assert bridged(few, "voltage")[0] is few
    skipped = recorded(volts, [100, 101, 500])
    full, there = bridged(skipped, "voltage")
    assert len(full.time) == len(TICKS)
    np.testing.assert_allclose(full.inputs[there], skipped.inputs)
    np.testing.assert_allclose(full.time, PERIOD * TICKS, atol=1e-9)
    np.testing.assert_allclose(full.weights[[100, 101, 500]], 0.0)


def test_a_drive_on_its_way_is_told_from_one_that_jumps():
    values = np.array([0, 0, 0, 1, 2, 3, 9, 9, 9, 3, 2, 1, 1, 1, 5], float)
    nodes = np.delete(np.arange(15), [6, 7])
    assert slopes_at(nodes, values, 5) == (0.0, 0.0)  # up, and then a jump
    values[6:10] = 3.5, 4, 3.5, 3
    assert slopes_at(nodes, values, 5) == (1.0, -0.5)
    values[3:6] = 0.0, 3.0, 3.0
    assert slopes_at(nodes, values, 5) == (0.0, 0.0)  # it jumped just before
    values[:6] = 3.0
    assert slopes_at(nodes, values, 5) == (0.0, -0.5)
    assert slopes_at(nodes, values, 1) == (0.0, 0.0)  # at rest
    assert slopes_at(nodes, values, 12) == (0.0, 0.0)  # nothing after it


@pytest.mark.parametrize("shape", ["triangle", "sine"])
def test_a_drive_that_turned_round_in_a_long_gap_leaves_no_misfit(shape):
    """Three seconds are missing at each crest: between the ends of each the drive was higher than at either."""
    crests = [410, 810, 1210]
    missing = [t for c in crests for t in range(c - 37, c + 24)]
    phase = TICKS / 400
    up = 2 * np.abs(phase - np.round(phase)) if shape == "triangle" else 0.5 - 0.5 * np.cos(2 * np.pi * phase)
    recording = recorded(3.0 * np.roll(up, 210), missing)
    setup = prepare([recording])
    trial, _, _ = best_start(setup, setup.data)
    assert [(g.start, g.end) for g in find_gaps(setup.data)] == [(c - 38, c + 24) for c in crests]
    trial, data, notes = settle(setup, trial, setup.data)
    assert "3 gaps" in notes[0]
    error = np.asarray(outputs_of(trial, data, setup.space) - data.outputs)[0, : recording.n, 0]
    assert np.sqrt(np.mean(error**2)) < 1.1 * NOISE
    after = np.searchsorted(recording.time, PERIOD * np.array([c + 24 for c in crests]))
    for k in after:
        assert abs(np.mean(error[k : k + 10])) < 0.6 * NOISE
    found = fit([recording]).model
    assert float(found.value("newton_cooling.conductance")) == pytest.approx(0.06, rel=0.01)
    _, said = predict(HEATER, recording)  # where nothing is estimated: the crest is about right
    line = np.interp(TICKS, np.setdiff1d(TICKS, missing), 1.0 * recording.inputs[:, 0] ** 2) ** 0.5
    exact, lower = (np.asarray(simulate(HEATER, recorded(v, [])).outputs)[:, 0] for v in (3.0 * np.roll(up, 210), line))
    kept = np.setdiff1d(TICKS, missing)
    off = [np.sqrt(np.mean((y - exact[kept]) ** 2)) for y in (said["temperature_degC"] + 273.15, lower[kept])]
    assert off[0] < 0.5 * off[1]


def jumpy(hold: int, seed: int = 3) -> np.ndarray:
    """Volts that take another level after every ``hold`` ticks."""
    levels = np.random.default_rng(seed).choice([0.0, 1.0, 2.0, 3.0], len(TICKS) // hold + 1)
    return np.repeat(levels, hold)[: len(TICKS)]


def test_a_gap_as_long_as_a_drive_stands_leaves_no_misfit():
    """Three seconds are missing, in which the drive took two levels or three that nobody has seen."""
    volts, starts = jumpy(25), [310, 735, 1160]
    missing = [t for s in starts for t in range(s, s + 60)]
    recording = recorded(volts, missing)
    setup = prepare([recording])
    trial, _, _ = best_start(setup, setup.data)
    gaps = find_gaps(setup.data)
    assert [(g.start, g.end) for g in gaps] == [(s - 1, s + 60) for s in starts]
    assert all(g.spread > 0 and g.slopes is None for g in gaps)
    once, _, _ = refine(setup, setup.data, trial)
    held = np.asarray(outputs_of(once, setup.data, setup.space) - setup.data.outputs)[0, : recording.n, 0]
    trial, data, _ = settle(setup, trial, setup.data)
    error = np.asarray(outputs_of(trial, data, setup.space) - data.outputs)[0, : recording.n, 0]
    assert np.sqrt(np.mean(error**2)) < 1.2 * NOISE < 0.2 * np.sqrt(np.mean(held**2))


def test_the_noise_of_a_measured_drive_is_no_jump():
    """One tick is missing here and there, while the volts stand."""
    volts = jumpy(200) + 1.0
    noisy = volts + 0.004 * np.random.default_rng(0).standard_normal(len(TICKS))
    setup = prepare([recorded(noisy, [150, 350, 551, 952])])
    assert all(g.spread < 0.05 for g in find_gaps(setup.data))
