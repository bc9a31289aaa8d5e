"""Excitations against scipy, spectra and the definitions."""

import numpy as np
import pytest
from scipy import signal

from scpjax.errors import RecordingError
from scpjax.recordings import excitation as ex

GRID = {"duration_s": 20.0, "period_s": 0.05}
BAND = {"low": 0.5, "high": 3.0}


def test_time_axis():
    time, value = ex.step(**GRID, amplitude=3.0, start_s=2.0)
    np.testing.assert_allclose(time, 0.05 * np.arange(400))
    assert value.sum() == 3.0 * 360
    assert value[39] == 0
    assert value[40] == 3.0


def test_step_difference_and_stair():
    time, value = ex.step_difference(**GRID, amplitude=2.0, up_s=5.0, down_s=15.0, offset=0.5)
    np.testing.assert_array_equal(value, np.where((time >= 5 - 1e-9) & (time < 15 - 1e-9), 2.5, 0.5))
    _, value = ex.stair(duration_s=9.0, period_s=0.1, low=0.0, high=2.0, steps=4)
    np.testing.assert_allclose(value.reshape(9, 10).mean(axis=1), [0, 0.5, 1, 1.5, 2, 1.5, 1, 0.5, 0])


def test_against_scipy():
    time, value = ex.sawtooth(**GRID, **BAND, frequency_hz=0.13)
    np.testing.assert_allclose(value, 1.75 + 1.25 * signal.sawtooth(2 * np.pi * 0.13 * time), atol=1e-6)
    time, value = ex.triangle(**GRID, **BAND, frequency_hz=0.13)
    np.testing.assert_allclose(value, 1.75 + 1.25 * signal.sawtooth(2 * np.pi * 0.13 * time, 0.5), atol=1e-6)
    time, value = ex.square(**GRID, **BAND, frequency_hz=0.13, duty=0.3)
    np.testing.assert_array_equal(value, 1.75 + 1.25 * signal.square(2 * np.pi * 0.13 * time, 0.3))
    time, value = ex.chirp(**GRID, amplitude=1.0, start_hz=0.1, stop_hz=4.0)
    np.testing.assert_allclose(value, signal.chirp(time, 0.1, 20.0, 4.0, phi=-90), atol=1e-9)
    time, value = ex.chirp(**GRID, amplitude=1.0, start_hz=0.1, stop_hz=4.0, sweep="logarithmic")
    np.testing.assert_allclose(value, signal.chirp(time, 0.1, 20.0, 4.0, "logarithmic", phi=-90), atol=1e-9)


def test_sine():
    _, value = ex.sine(**GRID, amplitude=2.0, frequency_hz=0.25, offset=1.0)
    assert np.mean(value) == pytest.approx(1.0)
    assert np.std(value) == pytest.approx(2.0 / np.sqrt(2))


def test_multilevel_random():
    _, value = ex.multilevel_random(**GRID, **BAND, hold_s=2.0, seed=3)
    assert np.all(value.reshape(10, 40) == value.reshape(10, 40)[:, :1])
    assert value.min() >= 0.5
    assert value.max() <= 3.0
    _, again = ex.multilevel_random(**GRID, **BAND, hold_s=2.0, seed=3)
    np.testing.assert_array_equal(value, again)
    _, few = ex.multilevel_random(duration_s=200, period_s=1, **BAND, hold_s=1, seed=0, levels=3)
    assert set(few) == {0.5, 1.75, 3.0}


@pytest.mark.parametrize("order", [3, 4, 5, 6, 7, 9, 10, 11])
def test_prbs_is_maximal(order):
    n = 2**order - 1
    _, value = ex.prbs(duration_s=n, period_s=1.0, low=-1.0, high=1.0, hold_s=1.0, order=order, seed=1)
    assert abs(value.sum()) == 1.0  # one more of one kind
    spectrum = np.abs(np.fft.fft(value)) ** 2
    np.testing.assert_allclose(spectrum[1:], n + 1, rtol=1e-6)  # two-valued autocorrelation


@pytest.mark.parametrize("phases", ["schroeder", "random"])
def test_multisine_is_flat_in_its_band_and_empty_outside(phases):
    _, value = ex.multisine(**GRID, rms=0.7, low_hz=0.5, high_hz=2.0, offset=1.5, phases=phases, seed=2)
    spectrum = np.abs(np.fft.rfft(value - 1.5)) / value.size
    frequency = np.fft.rfftfreq(value.size, 0.05)
    inside = (frequency > 0.49) & (frequency < 2.01)
    assert inside.sum() == 31
    np.testing.assert_allclose(spectrum[inside], spectrum[inside][0], rtol=1e-9)
    assert spectrum[~inside].max() < 1e-12
    assert np.std(value) == pytest.approx(0.7)


def test_schroeder_crest_is_low():
    _, value = ex.multisine(**GRID, rms=1.0, low_hz=0.05, high_hz=5.0)
    assert np.abs(value).max() < 2.1


@pytest.mark.parametrize(
    ("make", "word"),
    [
        (lambda: ex.step(duration_s=-1, period_s=0.1, amplitude=1), "positive"),
        (lambda: ex.step(duration_s=1, period_s=0, amplitude=1), "positive"),
        (lambda: ex.sine(**GRID, amplitude=1, frequency_hz=11), "Nyquist"),
        (lambda: ex.chirp(**GRID, amplitude=1, start_hz=0.1, stop_hz=50), "Nyquist"),
        (lambda: ex.chirp(**GRID, amplitude=1, start_hz=0, stop_hz=5, sweep="logarithmic"), "start"),
        (lambda: ex.square(**GRID, low=2, high=1, frequency_hz=1), "swap"),
        (lambda: ex.square(**GRID, low=0, high=1, frequency_hz=1, duty=1.5), "between"),
        (lambda: ex.prbs(**GRID, low=0, high=1, hold_s=1, order=8), "use one of"),
        (lambda: ex.prbs(**GRID, low=0, high=1, hold_s=0.01), "hold"),
        (lambda: ex.multilevel_random(**GRID, low=0, high=1, hold_s=0.01), "hold"),
        (lambda: ex.step_difference(**GRID, amplitude=1, up_s=5, down_s=2), "up"),
        (lambda: ex.multisine(**GRID, rms=1, low_hz=0.101, high_hz=0.102), "wider"),
    ],
)
def test_bad_options(make, word):
    with pytest.raises(RecordingError, match=word):
        make()
