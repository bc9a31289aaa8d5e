"""Where a fit starts: from the data alone.

Linear parts by SRIVC (Young, Jakeman 1980: refined instrumental variables for continuous-time transfer functions),
with the thesis's own rules (section 4.3.2) where that is not to be had: the thermal mass from the energy supplied,
the conductance from steady states, the stiffness from the slope of load against displacement.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy import signal

from scpjax.errors import FitError


@dataclass(frozen=True)
class Linear:
    """Y/U = b0 / (s^n + a_{n-1} s^{n-1} + ... + a0): ``a`` is (a_{n-1}, ..., a0); ``nrmse`` in percent."""

    a: np.ndarray
    b0: float
    offset: float
    nrmse: float

    @property
    def poles(self) -> np.ndarray:
        """Roots of the denominator [1/s]."""
        return np.roots(np.concatenate([[1.0], self.a]))


def srivc(
    u: np.ndarray,
    y: np.ndarray,
    period: float,
    order: int,
    *,
    cutoff: float,
    held: bool = True,
    iterations: int = 15,
) -> Linear | None:
    """All-pole continuous-time model of ``y`` (n,) driven by ``u`` (n,), by refined instrumental variables.

    The signals are filtered by 1/A(s); instruments come from the noise-free response of the last model, so noise on
    ``y`` does not bias it. An offset and the free response of the filter's start are estimated beside.
    ``cutoff`` [rad/s] is where the first filter stands; ``held`` says that ``u`` is constant between samples (else it
    runs straight). Returns None where no stable model is found.
    """
    one = np.ones_like(y)
    den = np.real(np.poly(np.full(order, -cutoff)))
    here = _Filtered(den, period, u, one, held)
    best: Linear | None = None
    x = y
    for i in range(iterations):
        ly, lx = here.bank(y), here.bank(x)
        # y^(n) = -a_{n-1} y^(n-1) ... - a0 y + b0 u + c + (free responses), all filtered by 1/A
        regress = np.column_stack([-ly[:, 1:], here.drive[:, -1:], here.one])
        instrument = np.column_stack([-(lx if i else ly)[:, 1:], here.drive[:, -1:], here.one])
        scale = np.sqrt(np.mean(regress**2, axis=0)) + 1e-300
        g = (instrument / scale).T @ (regress / scale)
        if not np.all(np.isfinite(g)):
            break
        p = np.linalg.lstsq(g, (instrument / scale).T @ ly[:, 0], rcond=1e-13)[0] / scale
        new = np.concatenate([[1.0], p[:order]])
        roots = np.roots(new)
        # unstable or implausibly fast roots are reflected so that the iteration can go on
        roots = np.where(roots.real > -1e-6 * cutoff, -np.abs(roots.real) - 1e-3 * cutoff + 1j * roots.imag, roots)
        roots = np.where(np.abs(roots) > 3.0 / period, roots * 3.0 / period / np.abs(roots), roots)
        new = np.real(np.poly(roots))
        here = _Filtered(new, period, u, one, held)
        model, x = _score(here, float(p[order]), y)
        if best is None or model.nrmse > best.nrmse:
            best = model
        if np.max(np.abs(new - den) / (np.abs(new) + 1e-12)) < 1e-6:
            break
        den = new
        if not np.all(np.isfinite(den)) or np.max(np.roots(den).real) > -1e-9:
            break
    return best


class _Filtered:
    """What does not change while 1/A(s) does not: its filter, and by it the drive and an offset."""

    def __init__(self, den: np.ndarray, period: float, u: np.ndarray, one: np.ndarray, held: bool):
        self.bank = _Filters(den, period)
        self.drive = (_Filters(den, period, held=True) if held else self.bank)(u)
        self.one = self.bank(one)


class _Filters:
    """s -> columns s^(n), ..., s', s, each filtered by 1/A(s); s runs straight between samples, or is held."""

    def __init__(self, den: np.ndarray, period: float, *, held: bool = False):
        order = len(den) - 1
        a, b = np.zeros((order, order)), np.zeros(order)
        a[0], a[np.arange(1, order), np.arange(order - 1)], b[0] = -den[1:], 1.0, 1.0
        # powers of a small matrix by numpy alone: scipy's expm wakes all BLAS threads for a 3 x 3
        whole = _exponential(
            np.block([[a, b[:, None], np.zeros((order, 1))], [np.zeros((2, order)), np.eye(2, k=1)]]) * period
        )
        ad, g1, g2 = whole[:order, :order], whole[:order, order], whole[:order, order + 1]
        now, later = (g1, 0 * g1) if held else (g1 - g2 / period, g2 / period)
        self.den = den
        self.denominator, self.numerators = _transfer(ad, now + ad @ later, later)

    def __call__(self, s: np.ndarray) -> np.ndarray:
        states = np.column_stack([signal.lfilter(num, self.denominator, s) for num in self.numerators])
        return np.column_stack([s - states @ self.den[1:], states])


def _exponential(m: np.ndarray) -> np.ndarray:
    """Matrix exponential of a small matrix by scaling and squaring of its Taylor series."""
    count = max(int(np.ceil(np.log2(max(np.abs(m).sum(axis=1).max(), 1e-300)))) + 2, 0)
    x = m / 2.0**count
    term = total = np.eye(len(m))
    for k in range(1, 14):
        term = term @ x / k
        total = total + term
    for _ in range(count):
        total = total @ total
    return total


def _transfer(a: np.ndarray, b: np.ndarray, d: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Denominator (n + 1,) and numerators (n, n + 1) of all states of z x = a x + b u, ``d`` u beside, by Leverrier's
    recursion, which of so small a matrix takes less time than eigenvalues for every state.
    """
    n = len(b)
    den, num = np.ones(n + 1), np.zeros((n, n + 1))
    turned = np.eye(n)
    for k in range(1, n + 1):
        num[:, k] = turned @ b
        turned = a @ turned
        den[k] = -np.trace(turned) / k
        turned = turned + den[k] * np.eye(n)
    return den, num + np.outer(d, den)


def _score(at: _Filtered, b0: float, y: np.ndarray) -> tuple[Linear, np.ndarray]:
    x = b0 * at.drive[:, -1]
    basis = np.column_stack([np.ones_like(y), at.one[:, 1:]])
    extra = basis @ np.linalg.lstsq(basis, y - x, rcond=None)[0]
    error = y - x - extra
    score = 100 * (1 - np.sqrt(np.mean(error**2)) / (np.std(y) + 1e-300))
    return Linear(at.bank.den[1:], b0, float(np.mean(extra)), float(score)), x


def best_linear(u: np.ndarray, y: np.ndarray, period: float, order: int, *, held: bool = True) -> list[Linear]:
    """SRIVC from several first filters; the distinct results, best first (may be empty)."""
    span = len(u) * period
    low, high = 2 * np.pi / span, 0.5 * np.pi / period
    found: list[Linear] = []
    for cutoff in np.geomspace(2 * low, high, 6):
        try:
            model = srivc(u, y, period, order, cutoff=float(cutoff), held=held)
        except np.linalg.LinAlgError:
            continue  # this filter leaves nothing to regress on; the next one may
        if model is not None and np.isfinite(model.nrmse):
            found.append(model)
    found.sort(key=lambda m: -m.nrmse)
    distinct: list[Linear] = []
    for m in found:
        if all(np.max(np.abs(np.log(np.abs(m.a / d.a)))) > 0.05 for d in distinct if np.all(d.a != 0)):
            distinct.append(m)
    return distinct


def thermal_mass_from_energy(
    power: np.ndarray, excess: np.ndarray, period: float, conductance: float | None = None
) -> tuple[float, float]:
    """(conductance [W/K], thermal mass [J/K]) by least squares on the heat supplied so far.

    integral(P) = conductance integral(T) + thermal_mass (T - T(0)), after thesis section 4.3.2. ``excess`` [K above
    ambient] and ``power`` [W] are (n,).

    **Raises** `FitError` when the record cannot tell the two apart (no power, or a temperature that never moves).
    """
    supplied = np.concatenate([[0.0], np.cumsum(power[:-1])]) * period
    kept = np.concatenate([[0.0], np.cumsum((excess[1:] + excess[:-1]) / 2)]) * period
    basis = np.column_stack([kept, excess - excess[: max(len(excess) // 200, 1)].mean(), np.ones_like(kept)])
    if conductance is not None:
        supplied, basis = supplied - conductance * kept, basis[:, 1:]
    scale = np.sqrt(np.mean(basis**2, axis=0)) + 1e-300
    p = np.linalg.lstsq(basis / scale, supplied, rcond=1e-10)[0] / scale
    lam, mass = (float(p[0]), float(p[1])) if conductance is None else (conductance, float(p[0]))
    if not (lam > 0 and mass > 0):
        raise FitError(
            "temperature does not follow the power supplied",
            mend="check the columns and their units; the drive must change and the temperature respond",
        )
    return lam, mass


def conductance_from_steady_states(power: np.ndarray, excess: np.ndarray) -> float:
    """Conductance [W/K] as the slope of power against temperature excess in steady states, thesis 4.3.2, figure 4.6."""
    power, excess = np.asarray(power, float), np.asarray(excess, float)
    return float(np.sum(power * excess) / np.sum(excess**2))


def stiffness_from_loads(force: np.ndarray, displacement: np.ndarray) -> float:
    """Stiffness [N/m] as the slope of load against displacement, thesis 4.3.2, figure 4.8."""
    slope = np.polyfit(np.asarray(displacement, float), np.asarray(force, float), 1)[0]
    return float(slope)
