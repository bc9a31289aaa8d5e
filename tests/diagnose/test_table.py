"""Steady states made by a known law, with numpy alone, are given back to that law."""

import numpy as np
import pytest

from scpjax.diagnose.table import diagnose_steady, resistance_times_conductance
from scpjax.errors import FitError
from scpjax.recordings.thesis import SteadyState, table_4_4_recordings

VOLTS = 3.7 * np.array([100, 125, 150, 175, 200, 225, 245]) / 255


def copper(v: np.ndarray, r: float) -> np.ndarray:
    """Excess temperature by bisection of r T (1 + alpha T) = V^2."""
    low, high = np.zeros_like(v), np.full_like(v, 1e4)
    for _ in range(80):
        middle = (low + high) / 2
        above = r * middle * (1 + 0.00404 * middle) > v**2
        low, high = np.where(above, low, middle), np.where(above, middle, high)
    return low


def stiffer(x: np.ndarray, q: float) -> np.ndarray:
    """Positive root of q y^2 + y - x."""
    return np.array([max(np.roots([q, 1.0, -a]).real) for a in x])


LAWS = {
    "linear": (lambda v, r: 1e-3 * v**2, None),
    "copper": (lambda v, r: 1.2e-4 * copper(v, r), None),
    "loss": (lambda v, r: 1.5e-3 * v ** (2 / 1.4), 0.4),
    "saturation": (lambda v, r: 2e-3 * v**2 / (1 + 0.12 * v**2), 0.12),
    "zero": (lambda v, r: 1e-3 * v**2 + 2e-3, 2e-3),
    "duty": (lambda v, r: 3e-3 * v, None),
    "duty_zero": (lambda v, r: 4e-3 * v - 2.5e-3, -2.5e-3),
}


def made(law: str, noise_m: float, seed: int = 0, r: float = 0.1) -> tuple[SteadyState, ...]:
    rng = np.random.default_rng(seed)
    truth, _ = LAWS[law]
    scales = np.ones(9) if law.endswith("zero") else 0.5 + 0.2 * np.arange(9)  # a shared zero has no scale
    return tuple(
        SteadyState(i, 0.1, VOLTS, scale * truth(VOLTS, r) + noise_m * rng.normal(size=7))
        for i, scale in enumerate(scales)
    )


@pytest.mark.parametrize("law", LAWS)
def test_the_law_that_made_the_table_is_found(law):
    noise = 2e-5
    found = diagnose_steady(made(law, noise), r_lambda=dict.fromkeys(range(9), 0.1))
    if law == "linear":  # nested in others: none of them may be much better
        assert "do not contradict" in found.says[0]
        mine = next(s for s in found.scores if s.law.name == law)
        assert mine.bic - found.scores[0].bic < 10
    else:
        mine = found.scores[0]
        assert mine.law.name == law
    assert found.noise_m == pytest.approx(noise, rel=0.3)
    assert mine.cv_rmse_m == pytest.approx(noise, rel=0.8)
    value = LAWS[law][1]
    if value is not None:
        assert abs(mine.shape - value) < 4 * mine.std
        assert mine.std < 0.2 * abs(value)


def test_stiffness_is_recovered():
    """Each actuator is scaled before the spring, which they share."""
    pulls = [(1 + 0.1 * i) * 2e-3 * VOLTS**2 for i in range(9)]
    table = tuple(SteadyState(i, 0.1, VOLTS, stiffer(pull, 200.0)) for i, pull in enumerate(pulls))
    found = diagnose_steady(table)
    assert found.scores[0].law.name == "stiffening"
    assert found.scores[0].shape == pytest.approx(200.0, rel=1e-6)


def test_coarse_readings_do_not_make_a_discovery():
    for seed in range(10):
        assert "do not contradict" in diagnose_steady(made("linear", 5e-4, seed)).says[0]


def test_table_4_4_is_not_linear_and_copper_is_not_enough():
    found = diagnose_steady(table_4_4_recordings(), r_lambda=resistance_times_conductance())
    by_name = {s.law.name: s for s in found.scores}
    assert found.n == 60
    assert sum(s.weight for s in found.scores) == pytest.approx(1.0)
    assert by_name["linear"].bic - found.scores[0].bic > 50
    assert by_name["copper"].bic - found.scores[0].bic > 50
    assert by_name["copper"].bic < by_name["linear"].bic
    assert 2e-4 < found.noise_m < 7e-4  # sonar
    said = " ".join(found.says)
    assert "does not grow as V²" in said
    assert "not to be told apart" in said


def test_linear_law_by_hand():
    """Least squares of one scale each, in closed form."""
    table = table_4_4_recordings()
    squares = 0.0
    for s in table:
        u = s.voltage_V**2
        squares += np.sum((s.displacement_m - u * (u @ s.displacement_m) / (u @ u)) ** 2)
    linear = next(s for s in diagnose_steady(table).scores if s.law.name == "linear")
    assert linear.rmse_m == pytest.approx(np.sqrt(squares / 60), rel=1e-6)
    assert linear.bic == pytest.approx(60 * np.log(squares / 60) + 10 * np.log(60), rel=1e-9)


def test_too_few():
    table = table_4_4_recordings()
    with pytest.raises(FitError, match="too few"):
        diagnose_steady(table[:1])
    with pytest.raises(FitError, match="too few"):
        diagnose_steady([SteadyState(s.code, 0.1, s.voltage_V[:3], s.displacement_m[:3]) for s in table])
