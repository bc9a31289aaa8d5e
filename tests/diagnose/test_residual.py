"""Residual tests reject when they should, and at the rate that they say when they should not."""

import numpy as np
from scipy import signal, stats

from scpjax.diagnose.residual import independence, whiteness
from scpjax.fit.colour import Whitener

THERE = np.ones((2, 400), bool)


def test_whiteness_false_alarm_rate_is_what_it_says():
    rng = np.random.default_rng(0)
    p = [whiteness(rng.standard_normal((2, 400)), THERE) for _ in range(400)]
    assert 0.02 <= np.mean(np.array(p) < 0.05) <= 0.09
    assert stats.kstest(p, "uniform").statistic < 0.1


def test_whiteness_sees_a_slow_misfit():
    rng = np.random.default_rng(1)
    slow = signal.lfilter([1], [1, -0.9], rng.standard_normal((2, 400)), axis=1)
    assert whiteness(slow, THERE) < 1e-6


def test_independence_false_alarm_rate_is_what_it_says():
    rng = np.random.default_rng(2)
    p = []
    for _ in range(300):
        drive = np.repeat(rng.uniform(0, 10, (2, 40)), 10, axis=1)
        p.append(independence(rng.standard_normal((2, 400)), drive, THERE))
    assert np.mean(np.array(p) < 0.05) <= 0.09


def test_independence_sees_what_the_drive_still_explains():
    rng = np.random.default_rng(3)
    drive = np.repeat(rng.uniform(0, 10, (2, 40)), 10, axis=1)
    late = np.pad(drive, ((0, 0), (3, 0)))[:, :400]
    assert independence(0.3 * (late - late.mean()) + rng.standard_normal((2, 400)), drive, THERE) < 1e-4


def test_whitener_leaves_white_residuals_alone_and_whitens_coloured_ones():
    rng = np.random.default_rng(4)
    there = np.ones((2, 2000, 1), bool)
    white = rng.standard_normal((2, 2000, 1))
    assert Whitener.learn(white, there).is_white
    coloured = signal.lfilter([1], [1, -0.8], white, axis=1)
    w = Whitener.learn(coloured, there)
    np.testing.assert_allclose(w.colour[0], [0.8, 0.0, 0.0], atol=0.06)
    total, n = w(coloured, there)
    assert abs(total / n - 1.0) < 0.06
