"""What is held out of every recording: three tenths, in three stretches; nothing of one that is too short for that."""

import numpy as np
import pytest

from scpjax.diagnose.holdout import split
from scpjax.fit.noise import noise_of
from scpjax.fit.setup import prepare
from scpjax.physics.presets import te
from scpjax.recordings.recording import Metadata, Recording
from scpjax.simulate.simulate import simulate

HEATER = te(resistance=3.2, conductance=0.06, thermal_mass=0.26)


def recorded(n: int, noise: float = 0.05) -> Recording:
    meta = Metadata(ambient_K=float(HEATER.ambient), known=(("resistance_ohm", 3.2),), model="te")
    volts = np.where(np.arange(n) // 25 % 2, 2.5, 0.0)
    blank = Recording.from_arrays(
        0.05 * np.arange(n), {"voltage_V": volts}, {"temperature_degC": np.zeros(n)}, metadata=meta
    )
    exact = np.asarray(simulate(HEATER, blank).outputs)
    return blank.with_outputs(exact + noise * np.random.default_rng(n).standard_normal(exact.shape))


@pytest.mark.parametrize("n", [60, 112, 120, 300])
def test_a_short_recording_beside_a_long_one_keeps_something_to_fit(n):
    """Bins of 75 samples, as for the long one: those of the short one are one to four."""
    data = prepare([recorded(6000), recorded(n)], bin=75).data
    parts = split(data)
    assert parts.is_train.any(axis=(1, 2)).all()
    shares = [np.mean(parts.mask[i][np.asarray(data.weights)[i] > 0]) for i in (0, 1)]
    assert shares[0] == pytest.approx(0.3, abs=0.02)
    assert shares[1] <= 0.5


def test_readings_without_noise_are_off_by_a_little():
    """However wild one of them is."""
    exact = recorded(2000, noise=0.0)
    structure = prepare([exact]).structure
    low, high = np.quantile(exact.outputs, [0.01, 0.99])
    assert noise_of([exact], structure)[0] >= 1e-5 * (high - low)
    noisy = recorded(2000)
    read = np.array(noisy.outputs)
    read[700] += 1e6
    assert noise_of([noisy.with_outputs(read)], structure)[0] < 1.2 * 0.05
