"""What steady displacements at several voltages can tell: Table 4.4 of the thesis, and tables like it.

In steady state the plant (3.6) says x = c V^2 with c = C / (R lambda k). Every other law here is one way to
leave it. Each is fitted to all actuators at once, with a scale of its own for each and a shape that they
share; the noise is what is left over.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np
from jaxtyping import Float
from scipy.optimize import least_squares

from scpjax.errors import FitError
from scpjax.recordings.thesis import TABLE_3_4, TABLE_4_14, TABLE_B_3, SteadyState

COPPER = 0.00404
"""1/K, by which copper's resistance grows, at 20 degC, as thesis (3.13) has it."""
_DECISIVE = 10.0  # difference in BIC
_USUAL_R_LAMBDA = 0.33  # V^2/K
_CONVECTION = 0.25  # exponent of natural convection: Incropera, Fundamentals of Heat and Mass Transfer, ch. 9
Shape = Callable[[np.ndarray, float, float], np.ndarray]


def _copper(v: np.ndarray, r: float) -> np.ndarray:
    """Excess temperature T that solves r T (1 + alpha T) = V^2."""
    return 2 * v**2 / r / (1 + np.sqrt(1 + 4 * COPPER * v**2 / r))


def _stiffer(x: np.ndarray, q: float) -> np.ndarray:
    """Displacement y that solves y + q y^2 = x, for the q where it does."""
    return 2 * x / (1 + np.sqrt(np.maximum(1 + 4 * q * x, 1e-9)))


@dataclass(frozen=True)
class SteadyLaw:
    """``x = after(c shape(V, p, r), p)``: a scale c [m] per actuator, one shape p, and r = R lambda [V^2/K].

    ``zeros``: "" none, "shared" one displacement [m] added for all, "each" one for each actuator.
    """

    name: str
    title: str
    equation: str
    shape: Shape
    unit: str = ""  # of the shape; empty where it has none to estimate
    after: Callable[[np.ndarray, float], np.ndarray] | None = None
    zeros: str = ""


LAWS: tuple[SteadyLaw, ...] = (
    SteadyLaw("linear", "linear plant", "x = c V²", lambda v, p, r: v**2),
    SteadyLaw("copper", "resistance rises as copper's", "x = c T, RλT(1 + αT) = V²", lambda v, p, r: _copper(v, r)),
    SteadyLaw("loss", "heat loss grows faster than T", "x = c V^(2/(1+n))", lambda v, p, r: v ** (2 / (1 + p)), "1"),
    SteadyLaw(
        "copper_loss",
        "copper's resistance and such a loss",
        "x = c T^(1/(1+n)), RλT(1 + αT) = V²",
        lambda v, p, r: _copper(v, r) ** (1 / (1 + p)),
        "1",
    ),
    SteadyLaw(
        "saturation",
        "force saturates, or the supply sags",
        "x = c V² / (1 + d V²)",
        lambda v, p, r: v**2 / (1 + p * v**2),
        "1/V^2",
    ),
    SteadyLaw("stiffening", "stiffness grows with x", "x + q x² = c V²", lambda v, p, r: v**2, "1/m", _stiffer),
    SteadyLaw("zero", "one zero for all", "x = c V² + x₀", lambda v, p, r: v**2, zeros="shared"),
    SteadyLaw("zero_each", "a zero for each", "x = c V² + x₀ᵢ", lambda v, p, r: v**2, zeros="each"),
    SteadyLaw("duty", "power goes with the duty cycle", "x = c V", lambda v, p, r: v),
    SteadyLaw(
        "duty_zero",
        "power goes with the duty cycle, one zero",
        "x = c V + x₀",
        lambda v, p, r: v,
        zeros="shared",
    ),
)


@dataclass(frozen=True)
class LawScore:
    """A law fitted: ``rmse_m``, the same at levels left out, and the shape or (mean) zero ± ``std``, SI."""

    law: SteadyLaw
    rmse_m: float
    cv_rmse_m: float
    parameters: int
    bic: float
    shape: float
    std: float
    weight: float = 0.0


@dataclass(frozen=True)
class SteadyDiagnosis:
    """Laws, best first; ``noise_m`` is what the best leaves per degree of freedom; ``says`` in sentences."""

    scores: tuple[LawScore, ...]
    noise_m: float
    n: int
    says: tuple[str, ...]


def resistance_times_conductance() -> dict[int, float]:
    """R lambda [V^2/K] by actuator: Tables 3.4 and B.3 times Table 4.14 (its median where it has none)."""
    rows = [(a.code, a.conductance_W_per_K) for a in TABLE_4_14 if a.conductance_W_per_K is not None]
    known = {int(code): value for code, value in rows if code.isdigit()}
    usual = float(np.median(list(known.values())))
    return {t.code: t.wire_resistance_ohm * known.get(t.code, usual) for t in (*TABLE_3_4, *TABLE_B_3)}


def diagnose_steady(table: Sequence[SteadyState], *, r_lambda: Mapping[int, float] | None = None) -> SteadyDiagnosis:
    """Compare the laws on a table of steady displacements, by BIC = n ln(RSS/n) + k ln n and left-out levels.

    ``r_lambda`` [V^2/K] by actuator code sets how hot the copper gets; 0.33 where it has none.

    **Raises** `FitError` for fewer than two actuators or fewer than four voltages each.
    """
    if len(table) < 2 or min(len(s.voltage_V) for s in table) < 4:
        raise FitError("too few steady states", mend="give two actuators or more, four voltages or more each")
    volts, moved = [s.voltage_V for s in table], [s.displacement_m for s in table]
    r = [(r_lambda or {}).get(s.code, _USUAL_R_LAMBDA) for s in table]
    fits = sorted((_score(law, volts, moved, r) for law in LAWS), key=lambda f: f.bic)
    likelihood = np.exp([-(f.bic - fits[0].bic) / 2 for f in fits])
    scores = tuple(replace(f, weight=float(w / likelihood.sum())) for f, w in zip(fits, likelihood, strict=True))
    n = sum(len(v) for v in volts)
    noise = scores[0].rmse_m * float(np.sqrt(n / max(n - scores[0].parameters, 1)))
    return SteadyDiagnosis(scores, noise, n, _says(scores, noise))


Arrays = list[np.ndarray]


def _predict(law: SteadyLaw, theta: np.ndarray, v: Arrays, r: list[float]) -> np.ndarray:
    """Displacements [m] of all actuators in a row; ``theta`` is scales, then the shape, then zeros."""
    m = len(v)
    p = theta[m] if law.unit else 0.0
    zeros = theta[m + bool(law.unit) :] if law.zeros else np.zeros(1)
    out = []
    for i, volts in enumerate(v):
        x = theta[i] * law.shape(volts, p, r[i])
        out.append((law.after(x, p) if law.after else x) + zeros[i % len(zeros)])
    return np.concatenate(out)


def _fit(law: SteadyLaw, v: Arrays, x: Arrays, r: list[float]):
    """(``least_squares`` result, unit of each of its unknowns, unit of its residuals: the most travel)."""
    top = max(float(np.max(m)) for m in x)
    shapes = [law.shape(a, 0.0, k) for a, k in zip(v, r, strict=True)]
    scales = [float(s @ b / (s @ s)) for s, b in zip(shapes, x, strict=True)]
    unit = {"1/m": 1 / top, "1/V^2": 0.1}.get(law.unit, 1.0)
    zeros = {"": 0, "shared": 1, "each": len(v)}[law.zeros]
    size = np.array([*scales, *[unit] * bool(law.unit), *[top] * zeros])
    start = np.concatenate([np.ones(len(v)), np.full(len(size) - len(v), 1e-2)])
    low = np.concatenate([np.full(len(v), -np.inf), np.full(int(bool(law.unit)), -0.5), np.full(zeros, -np.inf)])
    target = np.concatenate(x)
    found = least_squares(
        lambda q: (_predict(law, q * size, v, r) - target) / top, start, bounds=(low, np.inf), x_scale="jac"
    )
    return found, size, top


def _score(law: SteadyLaw, v: Arrays, x: Arrays, r: list[float]) -> LawScore:
    found, size, top = _fit(law, v, x, r)
    n, k, m = len(found.fun), len(size), len(v)
    rss = float(np.sum((found.fun * top) ** 2))
    shape = std = 0.0
    if k > m:
        covariance = np.linalg.pinv(found.jac.T @ found.jac) * np.sum(found.fun**2) / max(n - k, 1)
        values = (found.x * size)[m:]
        shape = float(np.mean(values))
        std = float(np.std(values) if k > m + 1 else np.sqrt(covariance[m, m]) * size[m])
    bic = n * np.log(rss / n) + (k + 1) * np.log(n)
    return LawScore(law, float(np.sqrt(rss / n)), _cross_validated(law, v, x, r), k, float(bic), shape, std)


def _cross_validated(law: SteadyLaw, v: Arrays, x: Arrays, r: list[float]) -> float:
    """RMS error [m] at each voltage level, fitted without that level on every actuator."""
    errors: list[Float[np.ndarray, " left"]] = []
    for level in range(max(len(a) for a in v)):
        keep = [np.arange(len(a)) != level for a in v]
        kept_v = [a[k] for a, k in zip(v, keep, strict=True)]
        found, size, _ = _fit(law, kept_v, [b[k] for b, k in zip(x, keep, strict=True)], r)
        wrong = _predict(law, found.x * size, v, r) - np.concatenate(x)
        errors.append(wrong[~np.concatenate(keep)])
    return float(np.sqrt(np.mean(np.concatenate(errors) ** 2)))


def _says(scores: Sequence[LawScore], noise: float) -> tuple[str, ...]:
    """Whether the linear law stands, what is supported, and what cannot be separated."""
    by_name, best = {s.law.name: s for s in scores}, scores[0]
    linear, copper = by_name["linear"], by_name["copper"]
    if linear.bic - best.bic < _DECISIVE:
        return ("The steady states do not contradict the linear plant, x = c V²: no law is clearly better.",)
    out = [
        f"The displacement does not grow as V²: the linear plant misses by {1e3 * linear.rmse_m:.2f} mm rms, "
        f"the best law by {1e3 * best.rmse_m:.2f} mm (noise about {1e3 * noise:.2f} mm; BIC better by "
        f"{linear.bic - best.bic:.0f})."
    ]
    close = [s for s in scores if s.bic - best.bic < _DECISIVE]
    names = "; ".join(f"{s.law.title} ({s.law.equation})" for s in close)
    out.append(
        f"Supported: {names}."
        if len(close) == 1
        else f"Supported, and not to be told apart by steady states alone: {names}."
    )
    if copper.bic - best.bic >= _DECISIVE:
        out.append(f"Copper's resistance alone bends too little: it misses by {1e3 * copper.rmse_m:.2f} mm rms.")
    loss = next((s for s in close if s.law.name in ("loss", "copper_loss")), None)
    if loss and loss.shape - 2 * loss.std > _CONVECTION:
        out.append(
            f"The loss would have to grow with n = {loss.shape:.2f} ± {loss.std:.2f}, more than natural "
            "convection's 1/4, so more than one of these is likely at work. Recorded steps would tell."
        )
    return tuple(out)
