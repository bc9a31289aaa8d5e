"""(b) Table 4.4: displacement does not grow as V^2. Which of copper, loss, saturation and an offset does it support?

    x = c T(V)^(1/(1+n)) / (1 + d V^2) + x0,    q R lambda T (1 + alpha T) = V^2

with c for each actuator and n, d, x0 and q shared. Copper's alpha is known, R lambda stands in Tables 3.4, B.3 and
4.14; q below 1 says that the wire is hotter than the thermistor said. All combinations are fitted, compared by BIC and
at voltages and at actuators left out, and on actuators drawn anew with replacement.
"""

from __future__ import annotations

import itertools
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy.optimize import least_squares

from scpjax.diagnose.table import COPPER, resistance_times_conductance
from scpjax.recordings.thesis import SteadyState, table_4_4_recordings

FACTORS = ("copper", "hotter", "loss", "saturation", "offset")
_SHAPES = {"hotter": (-1.0, (-5.0, 1.0)), "loss": (0.3, (-0.9, 5.0)), "saturation": (0.05, (-0.5, 5.0))}
_SHAPES["offset"] = (0.5, (-20.0, 20.0))  # ln q; n; d in 1/V^2; x0 in mm
Table = Sequence[SteadyState]


@dataclass(frozen=True)
class Law:
    """A combination fitted. ``values`` with ``std``: ln q, n, d [1/V^2], x0 [mm]; errors in mm."""

    factors: tuple[str, ...]
    rmse: float
    bic: float
    values: dict[str, float]
    std: dict[str, float]
    voltage_left_out: float = np.nan
    actuator_left_out: float = np.nan

    @property
    def name(self) -> str:
        """The factors in words."""
        return " + ".join(self.factors) or "none (x = c V²)"


def combinations() -> list[tuple[str, ...]]:
    """All sets of factors; a wire hotter than measured means something only with copper's resistance."""
    sets = [s for n in range(len(FACTORS) + 1) for s in itertools.combinations(FACTORS, n)]
    return [s for s in sets if "hotter" not in s or "copper" in s]


def temperature(volts: np.ndarray, r_lambda: float, q: float) -> np.ndarray:
    """Excess temperature [K] of copper at a voltage: the positive root of q R lambda T (1 + alpha T) = V^2."""
    power = volts**2 / (q * r_lambda)
    return 2 * power / (1 + np.sqrt(1 + 4 * COPPER * power))


def _shape(volts: np.ndarray, r_lambda: float, p: dict[str, float], copper: bool) -> np.ndarray:
    warm = temperature(volts, r_lambda, np.exp(p.get("hotter", 0.0))) if copper else volts**2
    return warm ** (1 / (1 + p.get("loss", 0.0))) / (1 + p.get("saturation", 0.0) * volts**2)


_R_LAMBDA = resistance_times_conductance()


def _residuals(x: np.ndarray, names: Sequence[str], copper: bool, table: Table, keep: Sequence[np.ndarray]) -> list:
    """(measured - said) [mm] of every actuator at all its voltages, its scale fitted to those kept."""
    p = dict(zip(names, x, strict=True))
    out = []
    for row, use in zip(table, keep, strict=True):
        shape = _shape(row.voltage_V, _R_LAMBDA[row.code], p, copper)
        moved = 1e3 * row.displacement_m - p.get("offset", 0.0)
        scale = float(shape[use] @ moved[use] / (shape[use] @ shape[use]))
        out.append(moved - scale * shape)
    return out


def fit_law(factors: tuple[str, ...], table: Table, keep: Sequence[np.ndarray] | None = None) -> tuple[Law, np.ndarray]:
    """A combination fitted to the voltages kept (all of them when not given), and its shared parameters."""
    keep = keep or [np.ones(len(row.voltage_V), bool) for row in table]
    names, copper = [f for f in factors if f != "copper"], "copper" in factors

    def kept(x: np.ndarray) -> np.ndarray:
        parts = _residuals(x, names, copper, table, keep)
        return np.concatenate([r[use] for r, use in zip(parts, keep, strict=True)])

    x, jacobian = np.zeros(0), np.zeros((0, 0))
    if names:
        start, bounds = zip(*[_SHAPES[n] for n in names], strict=True)
        found = least_squares(kept, np.array(start), bounds=tuple(zip(*bounds, strict=True)), x_scale="jac")
        x, jacobian = found.x, found.jac
    left = kept(x)
    n, k = len(left), len(x) + len(table)
    rss = float(left @ left)
    spread = np.sqrt(np.diag(np.linalg.pinv(jacobian.T @ jacobian)) * rss / max(n - k, 1)) if names else x
    values, std = (dict(zip(names, map(float, v), strict=True)) for v in (x, spread))
    return Law(factors, float(np.sqrt(rss / n)), float(n * np.log(rss / n) + (k + 1) * np.log(n)), values, std), x


def left_out(factors: tuple[str, ...], table: Table) -> tuple[float, float]:
    """RMS errors [mm] at every voltage level left out of the fit, and of every actuator left out of the shape.

    An actuator left out has its scale from its first, third, ... voltage and is judged on the others.
    """
    names, copper = [f for f in factors if f != "copper"], "copper" in factors
    levels: list[np.ndarray] = []
    for level in range(max(len(row.voltage_V) for row in table)):
        keep = [np.arange(len(row.voltage_V)) != level for row in table]
        x = fit_law(factors, table, keep)[1]
        parts = _residuals(x, names, copper, table, keep)
        levels += [r[~use] for r, use in zip(parts, keep, strict=True)]
    others: list[np.ndarray] = []
    for i, row in enumerate(table):
        x = fit_law(factors, [*table[:i], *table[i + 1 :]])[1]
        odd = np.arange(len(row.voltage_V)) % 2 == 0
        others.append(_residuals(x, names, copper, [row], [odd])[0][~odd])
    return tuple(float(np.sqrt(np.mean(np.concatenate(e) ** 2))) for e in (levels, others))  # type: ignore[return-value]


def compare() -> list[Law]:
    """All combinations on Table 4.4, best BIC first."""
    table = table_4_4_recordings()
    found = []
    for factors in combinations():
        law = fit_law(factors, table)[0]
        voltage, actuator = left_out(factors, table)
        found.append(Law(law.factors, law.rmse, law.bic, law.values, law.std, voltage, actuator))
    return sorted(found, key=lambda law: law.bic)


def resampled(
    laws: Sequence[Law], draws: int = 200, seed: int = 0
) -> dict[tuple[str, ...], tuple[float, float, float]]:
    """Of each law: mean and standard deviation of its BIC less the best law's, and how often it is best, over tables of
    nine actuators drawn with replacement.
    """
    table, rng = table_4_4_recordings(), np.random.default_rng(seed)
    bic = np.empty((draws, len(laws)))
    for i in range(draws):
        drawn = [table[j] for j in rng.integers(0, len(table), len(table))]
        bic[i] = [fit_law(law.factors, drawn)[0].bic for law in laws]
    best = np.bincount(np.argmin(bic, axis=1), minlength=len(laws)) / draws
    above = bic - bic[:, :1]
    return {
        law.factors: (float(above[:, j].mean()), float(above[:, j].std()), float(best[j])) for j, law in enumerate(laws)
    }


def share_of(factor: str, laws: Sequence[Law]) -> tuple[float, float]:
    """Probability of a factor before the data, every combination as likely as any other, and after, by BIC weights."""
    weight = np.exp([-(law.bic - laws[0].bic) / 2 for law in laws])
    there = np.array([factor in law.factors for law in laws])
    return float(there.mean()), float(weight[there].sum() / weight.sum())


def power(draws: int = 400, seed: int = 0) -> tuple[float, float, tuple[float, float]]:
    """(p, its standard deviation, the least and the greatest of a single actuator) of x = c V^p.

    The deviation is over tables of nine actuators drawn with replacement: readings of one actuator are not independent.
    """
    table, rng = table_4_4_recordings(), np.random.default_rng(seed)

    def of(rows: Table) -> float:
        return 2 / (1 + fit_law(("loss",), rows)[0].values["loss"])

    drawn = [of([table[j] for j in rng.integers(0, len(table), len(table))]) for _ in range(draws)]
    alone = [of([row]) for row in table]
    return of(table), float(np.std(drawn)), (min(alone), max(alone))


def hottest(law: Law) -> float:
    """Greatest excess temperature [K] that a law with copper in it gives a wire of Table 4.4."""
    q = float(np.exp(law.values.get("hotter", 0.0)))
    return max(float(temperature(row.voltage_V, _R_LAMBDA[row.code], q).max()) for row in table_4_4_recordings())


def copper_at(excess: float) -> float:
    """BIC of copper's resistance alone when its hottest wire is ``excess`` [K] above ambient."""
    table = table_4_4_recordings()
    low, high = -8.0, 4.0  # ln q; the hotter, the smaller
    for _ in range(60):
        middle = (low + high) / 2
        hot = max(float(temperature(row.voltage_V, _R_LAMBDA[row.code], np.exp(middle)).max()) for row in table)
        low, high = (middle, high) if hot > excess else (low, middle)
    keep = [np.ones(len(row.voltage_V), bool) for row in table]
    left = np.concatenate(_residuals(np.array([low]), ["hotter"], True, table, keep))
    n = len(left)
    return float(n * np.log(left @ left / n) + (1 + len(table)) * np.log(n))
