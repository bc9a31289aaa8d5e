"""Starts from the data alone, against systems simulated by scipy."""

import numpy as np
import pytest
from scipy import signal

from scpjax.errors import FitError
from scpjax.fit.metrics import mae, nrmse, rmse
from scpjax.fit.noise import noise_floor
from scpjax.fit.start import (
    best_linear,
    conductance_from_steady_states,
    stiffness_from_loads,
    thermal_mass_from_energy,
)

PERIOD = 0.05


def drive(n=3000, seed=0):
    return np.repeat(np.random.default_rng(seed).uniform(0, 13, n // 60), 60)


def test_srivc_is_not_biased_by_output_noise():
    """Plain least squares on filtered noisy data underestimates the pole; the instrumental variables do not."""
    u = drive()
    _, clean, _ = signal.lsim(([0.7], [1.0, 0.125]), u, np.arange(len(u)) * PERIOD, interp=False)
    found = []
    for seed in range(10):
        noisy = clean + 0.05 * clean.std() * np.random.default_rng(seed).standard_normal(len(u))
        found.append(best_linear(u, noisy, PERIOD, 1)[0])
    poles, gains = [m.a[0] for m in found], [m.b0 for m in found]
    assert np.mean(poles) == pytest.approx(0.125, rel=0.01)
    assert np.mean(gains) == pytest.approx(0.7, rel=0.01)


def test_srivc_finds_a_resonance():
    rng = np.random.default_rng(1)
    u = np.repeat(rng.standard_normal(600), 10)
    t = np.arange(len(u)) * 0.005
    _, y, _ = signal.lsim(([400.0], [1.0, 6.0, 900.0]), u, t, interp=False)
    m = best_linear(u, y + 0.02 * y.std() * rng.standard_normal(len(u)), 0.005, 2)[0]
    np.testing.assert_allclose(m.a, [6.0, 900.0], rtol=0.05)
    assert m.nrmse > 95


def test_energy_and_steady_states_give_the_thermal_parameters():
    power = drive(seed=3)
    time = np.arange(len(power)) * PERIOD
    _, excess, _ = signal.lsim(([1 / 2.25], [1.0, 0.29 / 2.25]), power, time, interp=False)
    lam, mass = thermal_mass_from_energy(power, excess, PERIOD)
    assert lam == pytest.approx(0.29, rel=0.01)
    assert mass == pytest.approx(2.25, rel=0.01)
    assert conductance_from_steady_states([1.0, 2.9], [1 / 0.29, 10.0]) == pytest.approx(0.29)


def test_temperature_that_does_not_follow_the_power_is_an_error():
    with pytest.raises(FitError, match="does not follow"):
        thermal_mass_from_energy(drive(), -np.abs(np.sin(np.arange(3000) / 50.0)) * 20, PERIOD)


def test_stiffness_is_the_slope_of_load_against_displacement():
    x = np.array([0.0, 1e-3, 2e-3, 4e-3])
    assert stiffness_from_loads(5.0 + 102.84 * x, x) == pytest.approx(102.84)


@pytest.mark.parametrize("sigma", [0.02, 0.3])
def test_noise_floor_of_a_slow_signal(sigma):
    rng = np.random.default_rng(0)
    slow = 40 * np.sin(np.arange(4000) / 300)
    assert noise_floor(slow + sigma * rng.standard_normal(4000)) == pytest.approx(sigma, rel=0.1)


def test_noise_floor_of_a_quick_signal_is_not_the_signal():
    """A resonance at a fifth of the Nyquist frequency: third differences take it for noise, the spectrum does not."""
    rng = np.random.default_rng(0)
    quick = np.sin(np.arange(8000) * 0.6) * (1 + 0.3 * np.sin(np.arange(8000) * 0.01))
    assert noise_floor(quick + 0.005 * rng.standard_normal(8000)) == pytest.approx(0.005, rel=0.15)


def test_noise_floor_is_hardly_ever_a_tenth_low():
    """Too low, a right model is called unexplained; believing the spectrum at two standard deviations was so in one or
    two of a hundred columns."""
    rng = np.random.default_rng(5)
    slow = 5.0 * np.sin(np.arange(1400) / 100.0)
    found = np.array([noise_floor(slow + 0.15 * rng.standard_normal(1400)) for _ in range(1000)])
    assert np.mean(found < 0.9 * 0.15) < 0.005


def test_noise_floor_of_white_noise_is_not_low():
    """Of two estimates the lesser would be, by 2 to 5 % on the average."""
    rng = np.random.default_rng(1)
    found = [noise_floor(rng.standard_normal(1200)) for _ in range(200)]
    assert np.mean(found) == pytest.approx(1.0, abs=0.01)
    assert np.quantile(found, 0.02) > 0.9


def test_metrics_by_hand():
    predicted, actual = [1.0, 2.0, 4.0], [1.0, 2.0, 3.0]
    assert rmse(predicted, actual) == pytest.approx(np.sqrt(1 / 3))
    assert mae(predicted, actual) == pytest.approx(1 / 3)
    assert nrmse(predicted, actual) == pytest.approx(100 * (1 - np.sqrt(1 / 3) / np.sqrt(2 / 3)))
    assert rmse(predicted, actual, [1, 1, 0]) == 0.0
    assert nrmse(np.full(3, 2.0), actual) == pytest.approx(0.0)
