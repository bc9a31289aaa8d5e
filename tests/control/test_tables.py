"""The loop against what the thesis printed: Tables 4.15 and 4.16, section 4.4.2 and (4.5)."""

import numpy as np
import pytest
from loop_cases import DEG, run_jit, signal, thesis_loop

from scpjax.control.analysis import closed_loop, figures, side_systems
from scpjax.control.metrics import measure
from scpjax.control.operating import reach
from scpjax.control.reference import sections
from scpjax.recordings.thesis import TABLE_4_15, TABLE_4_16


@pytest.mark.parametrize("row", TABLE_4_15.rows, ids=lambda r: f"{r.amplitude_rad / DEG:.0f}deg")
def test_table_4_15(row):
    loop = thesis_loop()
    reference = signal("sine", row.amplitude_rad / DEG, frequency=0.1, duration=60.0)
    found = measure(run_jit(loop, reference, 0.02), section=5.0)
    assert found.rmse == pytest.approx(row.rmse_rad, rel=0.005)
    assert found.peak_error == pytest.approx(row.peak_error_rad, abs=0.06 * DEG)
    assert found.delay == pytest.approx(row.delay_s, abs=0.0201)
    assert found.phase == pytest.approx(row.phase_rad, abs=0.0201 * 36 * DEG)


@pytest.mark.parametrize("row", TABLE_4_16.rows, ids=lambda r: r.reference)
def test_table_4_16(row):
    skip = 0.0 if row.reference in ("sine", "square") else 5.0
    response = run_jit(thesis_loop(), signal(row.reference), 0.02)
    found = measure(response, section=sections(row.reference), skip=skip)
    assert found.rmse == pytest.approx(row.rmse_rad, rel=0.003)
    assert found.mae == pytest.approx(row.mae_rad, rel=0.003)
    assert found.section_error == pytest.approx(row.max_error_rad, rel=0.02 if row.reference == "square" else 0.003)


def test_slower_square_of_section_4_4_3():
    found = measure(run_jit(thesis_loop(), signal("square", frequency=0.025, duration=60.0), 0.02))
    assert found.rmse == pytest.approx(14.51 * DEG, rel=0.01)
    assert found.mae == pytest.approx(6.53 * DEG, rel=0.01)


def test_stability_figures_of_section_4_4_2():
    found = figures(thesis_loop())
    assert found.stable
    assert found.step is not None
    assert found.step.rise == pytest.approx(1.17, rel=0.02)
    assert found.step.settling == pytest.approx(13.0, rel=0.02)
    assert found.step.overshoot == pytest.approx(0.315, rel=0.02)
    assert found.gain_margin_dB == pytest.approx(10.6, rel=0.02)
    assert found.phase_margin == pytest.approx(35.6 * DEG, rel=0.02)
    assert found.bandwidth == pytest.approx(1.76, rel=0.02)
    assert len(closed_loop(thesis_loop()).poles()) == 10


def test_poles_are_4_5():
    found = sorted(side_systems(thesis_loop().plant)[0].poles(), key=lambda p: (p.real, p.imag))
    np.testing.assert_allclose(found, [-0.6590 - 0.7649j, -0.6590 + 0.7649j, -0.1873], rtol=1e-3)


def test_reach_is_the_gain_times_the_greatest_effort():
    far = 0.0300e-2 / 0.1909 * 3.7**2 / 0.015
    np.testing.assert_allclose(reach(thesis_loop().plant, 3.7**2), (-far, far), rtol=1e-9)
