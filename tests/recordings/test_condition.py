"""Conditioning against scipy, conservation and known noise."""

import numpy as np
import pytest
from scipy import signal

from scpjax.errors import RecordingError
from scpjax.recordings import Recording
from scpjax.recordings.condition import (
    decimate,
    estimate_noise,
    estimate_noises,
    hampel,
    lowpass,
    remove_offset,
    replace_jumps,
    resample,
)

PERIOD = 0.05
TIME = PERIOD * np.arange(600)


def make(output=None, drive=None, *, time=TIME, hold="zero_order", column="displacement_m"):
    output = np.sin(0.5 * time) if output is None else output
    drive = np.floor(time / 3.0) % 4 if drive is None else drive
    return Recording.from_arrays(time, {"voltage_V": drive}, {column: output}, hold=hold)


def test_lowpass_has_no_lag_and_halves_at_the_cutoff():
    slow, edge = np.sin(2 * np.pi * 0.1 * TIME), np.sin(2 * np.pi * 2.0 * TIME)
    inner = slice(100, 500)
    out = lowpass(make(slow), 2.0).outputs[:, 0]
    np.testing.assert_allclose(out[inner], slow[inner], atol=1e-4)
    out = lowpass(make(edge), 2.0).outputs[:, 0]
    assert np.std(out[inner]) / np.std(edge[inner]) == pytest.approx(0.5, abs=0.01)
    sections = signal.butter(2, 3.0, fs=1 / PERIOD, output="sos")
    np.testing.assert_allclose(
        lowpass(make(edge), 3.0, order=2).outputs[inner, 0],
        signal.sosfiltfilt(sections, edge)[inner],
        atol=1e-6,
    )


def test_remove_offset():
    values = 5.0 + np.sin(TIME)
    values[10] = np.nan
    recording = remove_offset(make(values))
    assert (recording.weights * recording.outputs).sum() == pytest.approx(0.0, abs=1e-9)
    np.testing.assert_array_equal(recording.inputs, make().inputs)
    assert remove_offset(make(values), inputs=True).inputs.mean() == pytest.approx(0.0, abs=1e-12)
    step = np.where(TIME < 2.0, 3.0, 7.0)
    started = remove_offset(make(step), mode="initial", initial_s=1.0)
    np.testing.assert_allclose(started.outputs[:, 0], step - 3.0)


def test_resample_keeps_a_held_input_and_a_linear_output():
    rng = np.random.default_rng(0)
    keep = np.sort(rng.choice(np.arange(1, 599), 500, replace=False))
    keep = np.concatenate([[0], keep, [599]])
    drive = np.floor(TIME / 3.0) % 4
    recording = resample(make((2 * TIME)[keep], drive[keep], time=TIME[keep]), PERIOD)
    assert recording.is_uniform
    assert recording.n == 600
    np.testing.assert_allclose(recording.outputs[:, 0], 2 * TIME, atol=1e-9)
    np.testing.assert_array_equal(recording.inputs[keep, 0], drive[keep])
    last = keep[np.searchsorted(keep, np.arange(600), side="right") - 1]
    np.testing.assert_array_equal(recording.inputs[:, 0], drive[last])
    straight = resample(make(drive=TIME.copy(), hold="linear"), 0.02)
    np.testing.assert_allclose(straight.inputs[:, 0], straight.time, atol=1e-9)


def test_resample_of_an_even_recording_changes_nothing():
    recording = make()
    again = resample(recording)
    np.testing.assert_allclose(again.time, recording.time, atol=1e-12)
    np.testing.assert_allclose(again.outputs, recording.outputs, atol=1e-12)
    np.testing.assert_array_equal(again.inputs, recording.inputs)
    np.testing.assert_array_equal(again.weights, recording.weights)


def test_resample_does_not_bridge_gaps():
    gap = (TIME > 10.02) & (TIME < 11.98)
    recording = resample(make(np.sin(TIME)[~gap], TIME[~gap], time=TIME[~gap]), PERIOD)
    np.testing.assert_array_equal(recording.weights[:, 0] == 0, gap)
    missing = np.where(gap, np.nan, np.sin(TIME))
    np.testing.assert_array_equal(resample(make(missing)).weights[:, 0] == 0, gap)


@pytest.mark.parametrize("factor", [2, 3, 5])
def test_decimation_keeps_means_and_times(factor):
    rng = np.random.default_rng(1)
    recording = make(rng.normal(size=600))
    small = decimate(recording, factor)
    assert small.n == 600 // factor
    assert small.outputs.mean() == pytest.approx(recording.outputs.mean())
    assert small.time.mean() == pytest.approx(recording.time.mean())
    assert small.period == pytest.approx(factor * PERIOD)
    straight = decimate(make(3 * TIME, 2 * TIME, hold="linear"), factor)
    np.testing.assert_allclose(straight.outputs[:, 0], 3 * straight.time)
    np.testing.assert_allclose(straight.inputs[:, 0], 2 * straight.time)


@pytest.mark.parametrize("factor", [2, 3, 4, 5])
def test_decimated_held_input_has_the_same_integral(factor):
    drive = np.random.default_rng(2).uniform(0, 3, 600)
    small = decimate(make(drive=drive), factor)
    fine = np.arange(600 * 100) * PERIOD / 100 + PERIOD / 200  # midpoints of a fine grid
    held = drive[(fine / PERIOD).astype(int)]
    inside = (fine >= small.time[0]) & (fine < small.time[-1])
    integral = held[inside].sum() * PERIOD / 100
    assert small.inputs[:-1].sum() * small.period == pytest.approx(integral, rel=1e-6)


def test_decimation_leaves_missing_samples_out():
    values = TIME * 0 + 4.0
    values[[0, 6, 7, 8]] = np.nan
    small = decimate(make(values), 3)
    np.testing.assert_allclose(small.outputs[:, 0], 4.0)
    assert small.weights[0, 0] == pytest.approx(2 / 3)
    assert small.weights[2, 0] == 0
    assert small.weights[3, 0] == 1


def test_hampel_finds_spikes_and_keeps_values():
    rng = np.random.default_rng(3)
    values = np.sin(0.5 * TIME) + rng.normal(0, 0.01, 600)
    spikes = rng.choice(600, 12, replace=False)
    values[spikes] += 0.3 * rng.choice([-1, 1], 12)
    recording = hampel(make(values))
    flagged = np.flatnonzero(recording.weights[:, 0] == 0)
    assert set(spikes) <= set(flagged)
    assert flagged.size <= 14
    np.testing.assert_array_equal(recording.outputs[:, 0], values)


def test_hampel_leaves_a_step_alone():
    values = np.where(TIME < 10, 0.0, 1.0) + np.random.default_rng(4).normal(0, 0.01, 600)
    assert (hampel(make(values)).weights == 0).sum() <= 2


def test_replace_jumps():
    values = np.sin(0.5 * TIME)
    values[[100, 101, 300]] += 0.5
    recording = replace_jumps(make(values), 0.2)
    np.testing.assert_array_equal(np.flatnonzero(recording.weights[:, 0] == 0), [100, 101, 300])
    assert recording.outputs[101, 0] == recording.outputs[99, 0]
    step = np.where(TIME < 10, 0.0, 1.0)
    settled = replace_jumps(make(step), 0.2, run=3)
    assert (settled.weights == 0).sum() == 3  # then the new level is believed
    assert settled.outputs[-1, 0] == 1.0


def test_noise_of_white_noise_is_unbiased():
    estimates = [estimate_noise(0.7 * np.random.default_rng(seed).normal(size=1000)) for seed in range(200)]
    assert np.mean(estimates) == pytest.approx(0.7, rel=0.01)
    assert np.std(estimates) < 0.7 * 0.05


def test_noise_sees_past_trend_jumps_and_gaps():
    rng = np.random.default_rng(5)
    time = np.arange(1000) * 0.05
    trend = 40 * np.exp(-time / 8) + np.where(time > 25, 10.0, 0.0) + 3 * np.sin(time)
    estimates = []
    for _ in range(40):
        values = trend + rng.normal(0, 0.2, 1000)
        weights = rng.uniform(size=1000) > 0.05
        values[~weights] = 1e6
        estimates.append(estimate_noise(values, weights))
    assert np.mean(estimates) == pytest.approx(0.2, rel=0.03)


@pytest.mark.parametrize(("noise", "step"), [(0.15, 0.05), (0.15, 0.15), (0.05, 0.1)])
def test_noise_of_a_quantised_signal(noise, step):
    rng = np.random.default_rng(6)
    slope = np.linspace(20, 60, 1000)
    estimates = [estimate_noise(np.round((slope + rng.normal(0, noise, 1000)) / step) * step) for _ in range(40)]
    assert np.mean(estimates) == pytest.approx(np.sqrt(noise**2 + step**2 / 12), rel=0.05)


def test_noise_of_a_sensor_logged_more_rarely_than_the_clock():
    rng = np.random.default_rng(8)
    values = 5 * np.sin(np.linspace(0, 6, 1200)) + rng.normal(0, 0.1, 1200)
    assert estimate_noise(values, np.arange(1200) % 3 == 0) == pytest.approx(0.1, rel=0.15)
    with pytest.raises(RecordingError, match="too few"):
        estimate_noise(values, np.arange(1200) % 240 == 0)


def test_noise_of_nothing():
    assert estimate_noise(np.full(50, 3.0)) == 0.0
    assert estimate_noise(np.linspace(0, 1, 50)) < 1e-12
    with pytest.raises(RecordingError, match="too few"):
        estimate_noise(np.zeros(5))


def test_noises_of_a_recording_skip_gaps_of_the_clock():
    rng = np.random.default_rng(7)
    keep = rng.uniform(size=6000) > 0.1
    time = PERIOD * np.arange(6000)
    values = 30 * np.sin(0.8 * time) + rng.normal(0, 0.1, 6000)
    recording = make(values[keep], time=time[keep])
    assert estimate_noises(recording)[0] == pytest.approx(0.1, rel=0.06)


def test_noise_of_practice(practice_dir):
    from scpjax.recordings import read_recording

    recording = read_recording(practice_dir / "p00" / "given" / "0_step.csv")
    rest = recording.input("voltage")[:40]
    assert np.all(rest == 0)
    noise = estimate_noises(recording)
    still = recording.outputs[:40].std(axis=0)
    np.testing.assert_allclose(noise, still, rtol=0.35)


def test_uneven_recordings_are_refused_with_a_mend():
    uneven = make(time=TIME + 0.02 * (np.arange(600) % 2))
    for action in (lambda r: lowpass(r, 1.0), lambda r: decimate(r, 2)):
        with pytest.raises(RecordingError, match="resample"):
            action(uneven)


@pytest.mark.parametrize(
    ("action", "word"),
    [
        (lambda r: lowpass(r, 20.0), "half the sample rate"),
        (lambda r: lowpass(r, -1.0), "half the sample rate"),
        (lambda r: decimate(r, 0), "use 2"),
        (lambda r: decimate(r, 200), "at least 8"),
        (lambda r: resample(r, -1.0), "seconds"),
        (lambda r: hampel(r, window=4), "use 5"),
        (lambda r: replace_jumps(r, 0.0), "largest step"),
        (lambda r: remove_offset(r, mode="median"), "mean"),
    ],
)
def test_bad_options(action, word):
    with pytest.raises(RecordingError, match=word):
        action(make())
