"""What the drive does between its samples: zero-order, linear and band-limited holds against scipy."""

import numpy as np
import pytest
import scipy.fft
import scipy.integrate
import scipy.linalg
import scipy.signal
from sim_cases import PLANT, driven_by_power, multilevel, recorded, worst
from written_out import A, B, P, lsim

from scpjax.errors import ModelError
from scpjax.simulate.simulate import Adaptive, Exact, Exponential, simulate

TIGHT = Adaptive(rtol=1e-11, atol=1e-13)


def test_zero_order_hold_is_scipys_on_a_fine_grid():
    recording = multilevel()
    fine = np.repeat(recording.inputs[:, 0], 64)[: 64 * (recording.n - 1) + 1]
    time = np.arange(fine.size) * (0.05 / 64)
    wanted = lsim(fine**2, time, linear=False)[::64]
    assert worst(simulate(PLANT, recording).states, wanted) < 1e-10


def refined(effort_at, recording, z0=(0.0, 0.0, 0.0)):
    """scipy's piecewise linear response on grids 64 and 128 times finer, extrapolated to none."""
    coarse, fine = (
        lsim(effort_at(k), recording.time[0] + np.arange(k * (recording.n - 1) + 1) * (0.05 / k), z0)[::k]
        for k in (64, 128)
    )
    return fine + (fine - coarse) / 3


def test_linear_hold_of_volts_is_a_parabola_of_power():
    recording = multilevel(hold="linear")

    def effort_at(k):
        fine = np.interp(np.arange(k * (recording.n - 1) + 1) / k, np.arange(recording.n), recording.inputs[:, 0])
        return fine**2

    assert worst(simulate(PLANT, recording).states, refined(effort_at, recording)) < 1e-8


def test_linear_hold_of_power_is_scipys_first_order_hold():
    recording = multilevel(hold="linear", column="power_W")
    wanted = lsim(recording.inputs[:, 0] * P["resistance"], recording.time)
    assert worst(simulate(driven_by_power(), recording).states, wanted) < 1e-10


@pytest.mark.parametrize("column", ["voltage_V", "power_W"])
def test_band_limited_hold_is_the_cosine_series_of_the_samples(column):
    recording = multilevel(hold="band_limited", column=column)
    n, z0 = recording.n, (4.0, 0.001, -0.02)
    series = scipy.fft.dct(recording.inputs[:, 0], type=1) / (n - 1)
    series[[0, -1]] /= 2

    def effort_at(k):
        phase = np.pi * np.arange(k * (n - 1) + 1) / (k * (n - 1))
        column_at = np.cos(np.outer(phase, np.arange(n))) @ series
        return column_at**2 if column == "voltage_V" else column_at * P["resistance"]

    model = PLANT if column == "voltage_V" else driven_by_power()
    found = simulate(model, recording, initial=np.array(z0)).states
    assert worst(found, refined(effort_at, recording, z0)) < 1e-7


def test_band_limited_fixed_steps_converge_to_the_exact_ones():
    recording = multilevel(hold="band_limited")
    exact = simulate(PLANT, recording).states
    errors = [worst(simulate(PLANT, recording, method=Exponential(substeps=k)).states, exact) for k in (4, 8)]
    assert errors[1] < 1e-5
    assert errors[0] / errors[1] > 8  # the parabola through three points of the effort: third order and more


def _uneven(n=60):
    return 1.3 + np.cumsum(np.random.default_rng(1).choice([0.02, 0.05, 0.0713, 0.4], n))


def test_uneven_stamps_zero_order_is_the_augmented_exponential():
    time = _uneven()
    recording = recorded(time, {"voltage_V": multilevel().inputs[: time.size, 0]})
    z = np.array([2.0, 0.001, 0.01, 0.0])
    wanted = [z[:3]]
    for gap, volts in zip(np.diff(time), recording.inputs[:-1, 0], strict=True):
        whole = np.block([[A, B * volts**2], [np.zeros((1, 4))]])
        z = scipy.linalg.expm(whole * gap) @ np.r_[z[:3], 1.0]
        wanted.append(z[:3])
    found = simulate(PLANT, recording, initial=np.array([2.0, 0.001, 0.01])).states
    assert worst(found, np.array(wanted)) < 1e-12


def test_uneven_stamps_linear_hold_is_the_integrated_equation():
    time = _uneven(30)
    volts = multilevel(hold_s=0.1).inputs[: time.size, 0]
    recording = recorded(time, {"voltage_V": volts}, hold="linear")
    z, wanted = np.zeros(3), [np.zeros(3)]
    for i, gap in enumerate(np.diff(time)):

        def rates(t, z, i=i, gap=gap):
            return A @ z + B[:, 0] * (volts[i] + (volts[i + 1] - volts[i]) * t / gap) ** 2

        z = scipy.integrate.solve_ivp(rates, (0, gap), z, method="DOP853", rtol=1e-12, atol=1e-15).y[:, -1]
        wanted.append(z)
    assert worst(simulate(PLANT, recording).states, np.array(wanted)) < 1e-10


def test_band_limited_hold_of_uneven_stamps_is_refused():
    time = _uneven()
    recording = recorded(time, {"voltage_V": np.ones(time.size)}, hold="band_limited")
    for method in (Exact(), Exponential(), Adaptive()):
        with pytest.raises(ModelError, match="uniform time stamps"):
            simulate(PLANT, recording, method=method)


@pytest.mark.parametrize("hold", ["linear", "band_limited"])
def test_adaptive_follows_the_same_holds(hold):
    recording = multilevel(hold=hold)
    exact = simulate(PLANT, recording).states
    assert worst(simulate(PLANT, recording, method=TIGHT).states, exact) < 1e-6


def test_adaptive_says_when_it_gives_up():
    with pytest.raises(ModelError, match="raise max_steps"):
        simulate(PLANT, multilevel(), method=Adaptive(max_steps=50))
