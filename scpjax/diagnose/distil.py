"""A learned curve in words: what it is in units, with its band, and the readable expression that comes close to it."""

from __future__ import annotations

import itertools
import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from scipy.optimize import least_squares

from scpjax.diagnose.curve import Curve
from scpjax.diagnose.expression import in_words, scale_of, shown, stands_for, variables_of
from scpjax.diagnose.result import Closure, Drawn
from scpjax.fit.identifiability import Uncertainty
from scpjax.fit.result import Estimate
from scpjax.physics.curves import SYMBOLS, basis, value_at

_POINTS = 61
_CLOSE = 0.995  # share of a curve's variation with which one function is enough
_FAIR = 0.9  # with less, no expression is given
_SUPER = str.maketrans("0123456789", "⁰¹²³⁴⁵⁶⁷⁸⁹")
_INTERCHANGEABLE = {
    ("learned_heat", "", "effort"),
    ("learned_force", "", "temperature"),
    ("learned_force", "", "displacement"),
    ("learned_reading temperature", "", "temperature"),
    ("learned_reading displacement", "", "displacement"),
}
"""(place, factor, variable) of curves of which a straight part, and so the scale of the rest, is interchangeable with
the gain, the pull, the spring or the scale of all: their bands are beside those as they are told, for no recording
tells how much of it is whose."""


@dataclass(frozen=True)
class _Function:
    """A physical function of the variable, as a share of its farthest value; ``says`` writes it."""

    value: Callable[[np.ndarray], np.ndarray]
    says: Callable[[str, str, float], str]
    power: int = 0


def _power(n: int) -> _Function:
    return _Function(lambda y: y**n, lambda v, unit, far: v + (str(n).translate(_SUPER) if n > 1 else ""), n)


def _either_way(n: int) -> _Function:
    """|v| v^(n - 1), of what goes both ways."""
    return _Function(lambda y: np.abs(y) * y ** (n - 1), lambda v, unit, far: f"|{v}|" + f" {v}" * (n - 1), n)


def _beyond(a: float) -> _Function:
    return _Function(lambda y: np.maximum(y - a, 0.0), lambda v, unit, far: f"max({v} - {a * far:.3g} {unit}, 0)", 1)


def _levels(a: float) -> _Function:
    return _Function(lambda y: np.tanh(y / a), lambda v, unit, far: f"tanh({v} / {a * far:.3g} {unit})")


def _grows(a: float) -> _Function:
    return _Function(lambda y: np.expm1(y / a), lambda v, unit, far: f"(exp({v} / {a * far:.3g} {unit}) - 1)")


def _bump(a: float, width: float) -> _Function:
    return _Function(
        lambda y: np.exp(-(((y - a) / width) ** 2)),
        lambda v, unit, far: f"exp(-(({v} - {a * far:.3g} {unit})/({width * far:.3g} {unit}))²)",
    )


_LIBRARY = (
    *(_power(n) for n in (1, 2, 3, 4)),
    *(_beyond(round(a, 2)) for a in np.arange(0.1, 0.95, 0.1)),
    *(_levels(a) for a in np.geomspace(0.1, 1.0, 12)),
    *(_grows(a) for a in np.geomspace(0.15, 1.0, 8)),
)


def _peaks(y: np.ndarray, curve: np.ndarray) -> list[_Function]:
    """The peak, rising from nearly 0 at rest and falling again, that comes closest; none where it would not fall."""
    top = int(np.argmax(np.abs(curve)))
    best = least_squares(
        lambda q: q[0] * np.exp(-(((y - q[1]) / q[2]) ** 2)) - curve,
        (curve[top], y[top], 0.2),
        bounds=((-np.inf, 0.0, 0.05), (np.inf, 1.0, 1.0)),
        x_scale=(abs(curve[top]), 0.1, 0.1),
    )
    _, a, width = best.x
    return [_bump(float(a), float(width))] if 1.5 * width < a < 1.0 - 0.5 * width else []


def draw(found: Curve, every: Mapping[str, Estimate], values: Mapping[str, float], doubt: Uncertainty) -> Closure:
    """The closure with its curve in units, its 95 % band, and an expression distilled from it (sparse regression over
    physical functions: Brunton, Proctor, Kutz, PNAS 113 (2016) 3932); ``every``, ``values`` (as of `describe`) and
    ``doubt`` are of its final fit.
    """
    form, units = found.form, {**shown(found.state.setup.structure.drive), "time": ("s", 1.0)}
    alike = tuple(in_words(c) for c in found.alike)
    own, own_size = units[form.variable]
    place = found.place
    variables = variables_of(found)
    what, unit, subsystem = stands_for(place, variables)
    scale = scale_of(place, values, found.reference("temperature_high"), found.reference("displacement_high"))
    if form.factor:
        scale /= found.reference(f"{form.factor}_high") * units[form.factor][1]
    z = np.linspace(0.0, 1.0, _POINTS)
    matrix = scale * basis(z, found.zero, found.pieces)
    weights = np.array([every[k].value for k in found.keys])
    index = [doubt.keys.index(k) for k in found.keys]
    at = value_at(form.variable, z, *found.ends) * own_size
    covariance = doubt.covariance[np.ix_(index, index)]
    interchangeable = (place, form.factor, form.variable) in _INTERCHANGEABLE
    if interchangeable:
        base = found.state.setup.structure.base
        covariance = given(doubt.covariance, index, [i for i, k in enumerate(doubt.keys) if k.split(".")[0] in base])
    spread = np.sqrt(np.maximum(np.einsum("ij,jk,ik->i", matrix, covariance, matrix), 0.0))
    curve = matrix @ weights
    factor = units[form.factor][0] if form.factor else ""
    per = f"{unit}/({factor})" if "/" in factor else f"{unit}/{factor}".removesuffix("/")
    expression, near, share = distilled(at, curve, SYMBOLS[form.variable], own, per)
    says = f"{what} = {form.name}, s from 0 to {curve[np.argmax(np.abs(curve))]:.3g} {per}"
    if expression:
        says += f", s ≈ {expression}"
    if interchangeable:
        says += " (beside the base model's parameters as they are told, which can take up a straight part of it)"
    return Closure(
        subsystem,
        place,
        tuple(variables),
        says,
        {k: every[k] for k in found.keys},
        found.evidence.held_out_gain,
        found.evidence.delta_bic,
        Drawn(form.variable, own, form.name, per, at, curve, spread, expression, near, share),
        alike,
    )


def given(covariance: np.ndarray, these: Sequence[int], held: Sequence[int]) -> np.ndarray:
    """Covariance of some of several normal variables where others are known: Schur's complement."""
    size = np.sqrt(np.maximum(np.diag(covariance), 1e-300))
    scaled = covariance / np.outer(size, size)
    across = scaled[np.ix_(these, held)]
    left = scaled[np.ix_(these, these)] - across @ np.linalg.pinv(scaled[np.ix_(held, held)], hermitian=True) @ across.T
    return left * np.outer(size[these], size[these])


def distilled(at: np.ndarray, curve: np.ndarray, symbol: str, own: str, unit: str) -> tuple[str, np.ndarray, float]:
    """(expression, its values, share of the curve's variation that it has): one function of the library, or a peak, or
    two functions where one is not close; no expression where two are not either. ``symbol`` and ``own`` are the
    variable's symbol and unit.
    """
    far = float(np.max(np.abs(at)))
    y, total = at / far, float(np.sum(curve**2))
    if total == 0.0:
        return "", curve, 0.0
    usable = [*_LIBRARY] if at.min() >= 0 else [*(f for f in _LIBRARY if f.power), _either_way(1), _either_way(2)]
    peaks = _peaks(y, curve) if at.min() >= 0 else []
    best: tuple[float, tuple[_Function, ...], np.ndarray] = (-math.inf, (), np.zeros(0))
    for functions, size in ((usable, 1), (peaks, 1), (usable, 2)):
        for chosen in itertools.combinations(functions, size):
            design = np.stack([f.value(y) for f in chosen], axis=1)
            weights = np.linalg.lstsq(design, curve, rcond=None)[0]
            share = 1.0 - float(np.sum((design @ weights - curve) ** 2)) / total
            if share > best[0] and np.all(np.abs(weights) < 20 * np.max(np.abs(curve))):
                best = (share, chosen, weights)
        if best[0] >= _CLOSE:
            break
    share, chosen, weights = best
    if share < _FAIR:
        return "", curve, share
    near = np.stack([f.value(y) for f in chosen], axis=1) @ weights
    return _written(chosen, weights, symbol, own, unit, far), near, share


def _written(functions: Sequence[_Function], weights: np.ndarray, symbol: str, own: str, unit: str, far: float) -> str:
    pieces = []
    for f, w in zip(functions, weights, strict=True):
        size = abs(w) / far**f.power
        raised = str(f.power).translate(_SUPER) if f.power > 1 else ""
        own_unit = f"({own})" if raised and not own.isalpha() else own
        units = unit if not f.power else f"{unit}{'/' if '/' not in unit else ' '}{own_unit}{raised}"
        if f.power and "/" in unit:
            head, tail = unit.split("/", 1)
            units = f"{head}/({tail} {own_unit}{raised})"
        sign = ("" if w >= 0 else "-") if not pieces else ("+ " if w >= 0 else "- ")
        pieces.append(f"{sign}{size:.3g} {units} {f.says(symbol, own, far)}")
    return " ".join(pieces)
