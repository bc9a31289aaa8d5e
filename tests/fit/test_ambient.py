"""The ambient where none is told: from where the thermometer began, and one for all where they began alike."""

import numpy as np
import pytest

from scpjax.fit.ambient import ambients
from scpjax.physics import presets
from scpjax.recordings.recording import Metadata, Recording

STRUCTURE = presets.structure("te")
TIME = 0.1 * np.arange(200)
SIGMA = 0.15


def recorded(
    begin: float,
    *,
    driven: bool,
    seed: int = 0,
    told: float | None = None,
    tau: float = 9.0,
    sigma: float = SIGMA,
) -> Recording:
    """A first-order wire that warms by 60 K in the end, within ``tau`` [s], from ``begin`` [degC]."""
    drive = np.full(len(TIME), 3.0)
    drive[: 0 if driven else 40] = 0.0
    warm = np.zeros(len(TIME))
    for i in range(1, len(TIME)):
        warm[i] = warm[i - 1] + 0.1 * (60.0 * drive[i - 1] / 3.0 - warm[i - 1]) / tau
    noise = sigma * np.random.default_rng(seed).standard_normal(len(TIME))
    meta = Metadata(name=f"made {seed}", ambient_K=told)
    outputs = {"temperature_degC": begin + warm + noise}
    return Recording.from_arrays(TIME, {"voltage_V": drive}, outputs, metadata=meta)


@pytest.mark.parametrize("driven", [False, True])
def test_it_is_where_the_thermometer_began_within_the_error_it_is_taken_to_have(driven):
    found = [ambients([recorded(22.0, driven=driven, seed=k)], STRUCTURE, SIGMA)[0][0] - 295.15 for k in range(200)]
    assert abs(np.mean(found)) < 0.1  # 0.67 K a sample, where it is driven
    assert np.std(found) < (0.2 if driven else 0.1)


def test_a_wild_first_reading_is_none_of_it():
    """85 degC is what a DS18B20 says until it has measured."""
    warm = recorded(22.0, driven=True)
    read = np.array(warm.outputs)
    for wild in (358.15, 273.15):
        read[0] = wild
        assert ambients([warm.with_outputs(read)], STRUCTURE, SIGMA)[0][0] == pytest.approx(295.15, abs=0.8)


@pytest.mark.parametrize(("tau", "off"), [(0.6, 0.9), (1.0, 0.25), (2.0, 0.05)])
def test_a_first_reading_before_a_quick_warming_is_none_that_is_wild(tau, off):
    """A parabola through nine readings errs by so much there; without the first, by three times that."""
    quick = recorded(22.0, driven=True, tau=tau, sigma=0.005)
    assert abs(ambients([quick], STRUCTURE, 0.005)[0][0] - 295.15) < off


@pytest.mark.parametrize("late", [3, 80])
def test_a_thermometer_that_begins_late_is_led_back_or_told_of(late):
    """80 samples, 8 s, after the drive came on, half of what it warms by has gone by: the others' room is taken."""
    driven = recorded(22.0, driven=True)
    weights = np.ones((len(TIME), 1))
    weights[:late] = 0.0
    found, notes = ambients([driven.with_weights(weights), recorded(35.0, driven=False)], STRUCTURE, SIGMA)
    assert any("too late" in n for n in notes) == (late == 80)
    if late == 3:
        assert found[0] == pytest.approx(295.15, abs=1.5)  # 2 K have gone by; 0.5 K is what leading back may err
    else:
        assert found[0] == found[1]


def test_beginnings_alike_are_one_ambient_and_others_are_their_own():
    alike = [recorded(22.0, driven=k % 2 == 1, seed=k) for k in range(4)]
    found, notes = ambients(alike, STRUCTURE, SIGMA)
    assert len(set(found)) == 1
    assert found[0] == pytest.approx(295.15, abs=0.12)
    assert all("of all recordings" in n for n in notes)
    found, notes = ambients([*alike, recorded(24.0, driven=False, seed=9)], STRUCTURE, SIGMA)
    assert found[-1] == pytest.approx(297.15, abs=0.2)
    assert len(set(found)) == 5
    assert not any("of all recordings" in n for n in notes)


def test_beginnings_that_differ_by_noise_are_seldom_taken_for_different():
    rng = np.random.default_rng(3)
    apart = 0
    for k in range(300):
        several = [recorded(22.0, driven=bool(rng.integers(2)), seed=1000 * k + j) for j in range(3)]
        apart += len(set(ambients(several, STRUCTURE, SIGMA)[0])) > 1
    assert apart <= 6


def test_what_is_told_is_believed():
    found, notes = ambients([recorded(22.0, driven=True, told=290.0), recorded(22.0, driven=False)], STRUCTURE, SIGMA)
    assert found[0] == 290.0
    assert found[1] == pytest.approx(295.15, abs=0.2)
    assert len(notes) == 1
