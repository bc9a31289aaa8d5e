"""Walks along the floor of a valley: a cliff whose bottom slopes, and what a line search must not do."""

import numpy as np
import pytest

from scpjax.control.search import SearchOptions, search
from scpjax.control.valley import WalkOptions, across, walk

LOW, HIGH = np.full(4, -4.0), np.full(4, 4.0)
FLOOR = np.array([-3.0, 1.5, -2.0])


class Cliff:
    """Falls steeply towards a bent surface and jumps behind it; along it the bottom slopes to 1 at ``FLOOR``."""

    def __init__(self):
        self.count = 0

    def __call__(self, points):
        self.count += len(points)
        off = points[:, 1] - (-0.8 + 0.1 * points[:, 0] + 0.03 * points[:, 2] ** 2)
        bottom = 1 + 0.03 * np.sum((points[:, [0, 2, 3]] - FLOOR) ** 2, axis=1)
        return bottom + np.where(off <= 0, 2 * np.sqrt(-np.minimum(off, 0.0) + 1e-6), 1.0 + off)


def test_walk_goes_down_along_a_cliff():
    at_start = np.array([[1.0, -0.9, 1.0, 1.0]])
    for seed in range(5):
        cliff = Cliff()
        points, values, path = walk(cliff, at_start, cliff(at_start), LOW, HIGH, WalkOptions(several=1), seed=seed)
        assert cliff.count <= 601
        assert np.all(np.diff(path) <= 0)
        assert np.all((points >= LOW) & (points <= HIGH))
        assert values[0] == pytest.approx(cliff(points)[0])
        assert values[0] < 1.2
    # the same number of points at random around the best does not get there
    given = at_start[0]
    found = min(search(Cliff(), given, LOW, HIGH, SearchOptions(screened=0))[0], key=lambda n: n.best)
    assert found.best > values[0]


def test_lines_find_the_least_and_keep_bounds():
    points = np.array([[0.0, 0.0], [3.9, 0.0]])
    ways = np.array([[1.0, 0.0], [1.0, 0.0]])
    bowl = lambda x: (x[:, 0] - np.array([0.123, 9.0])[: len(x)]) ** 2  # noqa: E731
    at, least = across(bowl, points, bowl(points), ways, LOW[:2], HIGH[:2], 0.2, 1e-4)
    assert at[0, 0] == pytest.approx(0.123, abs=2e-4)
    assert at[1, 0] == pytest.approx(4.0)
    np.testing.assert_allclose(least, bowl(at))


def test_never_worse_and_never_more_than_allowed():
    rough = lambda x: np.where(np.sin(1e4 * x).sum(axis=1) > 0, np.inf, 1 + np.abs(x).sum(axis=1))  # noqa: E731
    starts = np.array([[0.3, 0.2, 0.1, 0.5], [1.0, 1.0, 1.0, 1.0], [0.1, 0.1, 0.2, 0.1]])
    values = rough(starts)
    values[np.isinf(values)] = 2.0
    for evaluations in (0, 30, 200):
        points, found, _ = walk(rough, starts, values, LOW, HIGH, WalkOptions(evaluations=evaluations))
        assert found[0] <= values[:2].min()
        assert points.shape == (2, 4)
    one = lambda x: (x[:, 0] - 0.3) ** 2  # noqa: E731
    at, least, _ = walk(one, np.array([[0.25]]), one(np.array([[0.25]])), LOW[:1], HIGH[:1], WalkOptions())
    assert at[0, 0] == pytest.approx(0.3, abs=2e-3)
    assert least[0] < 1e-5
