"""Long signals are drawn with their peaks and holes, numbers with the digits that they have."""

import math

import numpy as np
import pytest
from matplotlib.backends.backend_agg import FigureCanvasAgg

from scpjax.diagnose.result import Latent
from scpjax.fit.result import Trace
from scpjax.report import missing
from scpjax.report.numbers import estimate, interval, number, percent, plus_minus
from scpjax.report.plot import envelope, overlay, png


@pytest.mark.parametrize("n", [50, 200_000])
def test_a_long_signal_is_thinned_and_keeps_its_peaks(n):
    rng = np.random.default_rng(0)
    y = rng.normal(size=n)
    y[n // 3], y[n // 2] = 50.0, -70.0
    y[5:10] = np.nan
    t, thin = envelope(np.arange(n), y)
    assert len(thin) <= max(1500, min(n, 50))
    assert np.nanmax(thin) == 50.0
    assert np.nanmin(thin) == -70.0
    assert np.all(np.diff(t) >= 0)


def test_a_hole_in_a_long_signal_stays_a_hole():
    y = np.ones(100_000)
    y[40_000:60_000] = np.nan
    t, thin = envelope(np.arange(100_000), y)
    assert np.isnan(thin[(t > 40_500) & (t < 59_500)]).all()


def test_the_names_of_two_voltages_stand_above_their_curves():
    t = np.linspace(0.0, 60.0, 600)
    volts = np.stack([4 + 3 * np.sin(t), 4 - 3 * np.sin(t)], axis=1)
    columns = ("v_agonist_v", "v_antagonist_v")
    trace = Trace("r", "angle_deg", t, volts, columns, volts[:, 0], np.ones(600), volts[:, 1], volts[:, 0], t < 9)
    figure = overlay([trace], noise={}, labels=("base", "found"))
    assert png(figure)
    axis = figure.axes[-1]
    legend = axis.get_legend()
    assert legend is not None
    top = axis.transData.transform((0.0, float(np.max(volts))))[1]
    assert legend.get_window_extent().y0 > top


@pytest.mark.parametrize(
    ("said", "words"),
    [
        (number(0.0), "0"),
        (number(0.012345), "0.0123"),
        (number(-12.345), "−12.3"),
        (number(999.9), "1000"),
        (number(4.5e-7), "4.50 × 10⁻⁷"),
        (number(math.nan), "–"),
        (plus_minus(4.2123, 0.1312), "4.21 ± 0.13"),
        (plus_minus(4.2e-7, 1.3e-8), "(4.20 ± 0.13) × 10⁻⁷"),
        (plus_minus(129.3, 48.2), "129 ± 48"),
        (plus_minus(2.0, math.nan), "2.000"),
        (estimate(289.0, 1148.0, 0.119, 7e5), "about 290"),
        (estimate(30.0, 2.0, 26.0, 34.0, True), "30.00, at its limit"),
        (estimate(-0.1, 0.2, -0.5, 0.3), "−0.10 ± 0.20"),
        (interval(3.85e-3, 4.01e-3), "0.00385 to 0.00401"),
        (interval(1.00001, 1.00002), "1.000010 to 1.000020"),
        (interval(0.8999989, 0.9000007, True), "–"),
        (percent(1.0), "> 99 %"),
        (percent(0.001), "< 1 %"),
        (percent(0.0), "0 %"),
        (percent(0.5), "50 %"),
    ],
)
def test_numbers(said, words):
    assert said == words


@pytest.mark.parametrize(("size", "unit"), [(0.006, "mN"), (0.3, "N"), (40.0, "N")])
def test_what_is_missing_is_labelled_within_its_figure(size, unit):
    """Ticks of a force of thousandths of a newton have many zeros, and push their label to the left."""
    time = np.linspace(0.0, 60.0, 50)
    swing = size * np.sin(time)
    estimate = ("thermomechanical", "force", "N", 10.0, 0.9, 1.0, (time,), (swing,), (0.05 * np.abs(swing),), ())
    drawn = missing.figure(Latent(*estimate), ["pulses"])
    FigureCanvasAgg(drawn).draw()
    axis = drawn.axes[0]
    assert axis.get_ylabel().endswith(f"({unit})")
    assert axis.yaxis.label.get_window_extent().x0 > 0.0
