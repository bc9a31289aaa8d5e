"""Curves of a closure: a smooth function of one variable, times at most one other, as a cubic spline.

``s(w) = sum_k c_k (B(n z - k) - B(n z_0 - k))`` with z from 0 to 1 over the range that was seen, z_0 where w is 0, B
the cardinal cubic B-spline and n the number of pieces (de Boor, A Practical Guide to Splines, 2001, ch. IX); s is 0 at
rest, and beyond the range goes on straight for `BEYOND` of it, then stays as it is. Of the time z is a logarithm, as
what drifts or wears does so the most at first: z = ln(1 + a t/t_high)/ln(1 + a). Of the velocity it is one too, to both
sides of rest, near which an actuator mostly is: z goes with asinh(b v/max |v|).
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any, ClassVar

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, ArrayLike, Float

from scpjax.parameter import Parameter, weight
from scpjax.physics.mechanism import Mechanism, Side, Values, View

PIECES = (3, 6, 12)
"""Numbers of pieces between which the recordings choose; each of them splits those of the one before in two."""
_MOST = max(PIECES) + 2
_EARLY = 20.0  # a, in the z of the time
_SLOW = 20.0  # b, in the z of the velocity
BEYOND = 0.5
"""Of the range, for which a curve goes on beyond its ends."""
WEIGHTS = tuple(f"c{k + 1}" for k in range(_MOST))

VARIABLES = ("temperature", "displacement", "velocity", "effort", "time")
SYMBOLS = {"temperature": "T", "displacement": "x", "velocity": "v", "effort": "u", "time": "t", "": ""}
UNITS = {"temperature": "K", "displacement": "m", "velocity": "m/s", "effort": "drive", "time": "s"}


@dataclass(frozen=True)
class Form:
    """``factor`` s(``variable``), by their names in `VARIABLES`; a factor of "" is 1.

    ``of``: of what, where a mechanism has curves of several: which sensor, or the store. ``names``: mechanisms of the
    catalogue that such a term is, whatever its curve; more than one where no curve tells them apart.
    """

    factor: str
    variable: str
    of: str = ""
    names: tuple[str, ...] = ()

    @property
    def name(self) -> str:
        """Such as "T s(x)"."""
        return f"{SYMBOLS[self.factor]} s({SYMBOLS[self.variable]})".strip()


def laws(forms: tuple[Form, ...]) -> tuple[str, ...]:
    """Each form with each number of pieces."""
    return tuple(f"{'of ' + f.of + ': ' if f.of else ''}{f.name}, {n} pieces" for f in forms for n in PIECES)


def form_of(forms: tuple[Form, ...], law: int) -> tuple[Form, int]:
    """A law's form and number of pieces."""
    return forms[law // len(PIECES)], PIECES[law % len(PIECES)]


def only_under(forms: tuple[Form, ...]) -> dict[str, tuple[int, ...]]:
    """Laws that have each weight: a spline of n pieces that is 0 at rest has n + 2."""
    count = len(forms) * len(PIECES)
    return {
        w: tuple(law for law in range(count) if k < form_of(forms, law)[1] + 2)
        for k, w in enumerate(WEIGHTS)
        if k >= min(PIECES) + 2
    }


def parameters() -> tuple[Parameter, ...]:
    """The weights (null 0), then the ranges and references of the variables (fixed)."""
    free = tuple(weight(w, w, "weight of a piece of the spline") for w in WEIGHTS)
    fixed = tuple(
        Parameter(
            name=f"{v}_{end}",
            symbol=f"{SYMBOLS[v]}_{end}",
            unit=UNITS[v],
            description=f"{words} {v} of the range",
            typical=value,
            bounds=(-1e300, 1e300),
            null=value,
            scale="linear",
            fixed=True,
        )
        for v in VARIABLES
        for end, words, value in (("low", "lowest", 0.0), ("high", "highest", 1.0))
    )
    return free + fixed


def share_of(variable: str, value: ArrayLike, low: ArrayLike, high: ArrayLike) -> Array:
    """z: where a value lies in the range, from 0 to 1."""
    if variable == "time":
        return jnp.log1p(_EARLY * jnp.asarray(value) / high) / math.log1p(_EARLY)
    value, low, high = (jnp.asarray(x) for x in (value, low, high))
    if variable == "velocity":
        value, low, high = (jnp.arcsinh(_SLOW * x / jnp.maximum(-low, high)) for x in (value, low, high))
    return (value - low) / (high - low)


def value_at(variable: str, z: np.ndarray, low: float, high: float) -> np.ndarray:
    """The value at a place in the range: the inverse of `share_of`."""
    if variable == "time":
        return high * np.expm1(z * math.log1p(_EARLY)) / _EARLY
    if variable == "velocity":
        most = max(-low, high)
        first, last = (math.asinh(_SLOW * x / most) for x in (low, high))
        return most * np.sinh(first + z * (last - first)) / _SLOW
    return low + z * (high - low)


def basis(z: np.ndarray, zero: float, pieces: int) -> np.ndarray:
    """(n, pieces + 2) of the places z in the range, as `product` has them."""
    k = np.arange(pieces + 2)
    return np.asarray(_bell(pieces * z[:, None] - k) - _bell(pieces * zero - k))


def _bell(t: ArrayLike) -> Array:
    a = jnp.abs(t)
    return (jnp.maximum(2.0 - a, 0.0) ** 3 - 4.0 * jnp.maximum(1.0 - a, 0.0) ** 3) / 6.0


def _slope(t: ArrayLike) -> Array:
    a = jnp.abs(t)
    return jnp.sign(t) * (2.0 * jnp.maximum(1.0 - a, 0.0) ** 2 - 0.5 * jnp.maximum(2.0 - a, 0.0) ** 2)


def product(forms: tuple[Form, ...], p: Values, view: View, of: str = "") -> Side:
    """Dimensionless ``factor s(variable)`` of the law in force; 0 where its form is of something else."""
    law = jnp.asarray(p.law, int)
    form, fine = jnp.floor_divide(law, len(PIECES)), jnp.mod(law, len(PIECES))
    still = jnp.ones_like(view.temperature)  # the time is the same for both sides

    def of_the_law(names: Sequence[str], values: Callable[[str], Sequence[ArrayLike]]) -> list[Array]:
        """Some values of what the law in force has, given those of all that a law may have."""
        found = [jnp.zeros(())] * len(values(names[0]))
        for name in dict.fromkeys(names):
            mine = jnp.any(form == jnp.asarray([i for i, other in enumerate(names) if other == name]))
            found = [jnp.where(mine, new, old) for new, old in zip(values(name), found, strict=True)]
        return found

    def of_variable(name: str) -> tuple[Array, Array]:
        low, high = getattr(p, f"{name}_low"), getattr(p, f"{name}_high")
        return share_of(name, getattr(view, name) * still, low, high), share_of(name, 0.0, low, high)

    def of_factor(name: str) -> tuple[Array]:
        return (getattr(view, name) / getattr(p, f"{name}_high") * still if name else still,)

    z, zero = of_the_law([f.variable for f in forms], of_variable)
    (factor,) = of_the_law([f.factor for f in forms], of_factor)
    (here,) = of_the_law([f.of for f in forms], lambda name: (1.0 if name == of else 0.0,))
    pieces = jnp.asarray(PIECES, z.dtype)[fine]
    weights = tuple(getattr(p, w) * still for w in WEIGHTS)
    z, zero = jnp.clip(z, -BEYOND, 1.0 + BEYOND), jnp.clip(zero, 0.0, 1.0) * still
    return here * factor * _spline(weights, z, zero, pieces)


@jax.custom_jvp
def _spline(weights: tuple[Side, ...], z: Side, zero: Side, pieces: Array) -> Side:
    """s at z, straight on beyond the range. A tangent goes by the slope, which is one number for all sensitivities, and
    by each weight in turn: XLA computes those of many side by side, but not a sum along an axis of each.
    """
    return jnp.sum(jnp.stack(weights, axis=-1) * _pieces(z, zero, pieces), axis=-1)


def _pieces(z: Side, zero: Side, pieces: Array) -> Float[Array, "*sides k"]:
    """What every weight is multiplied by."""
    inside, k = jnp.clip(z, 0.0, 1.0), jnp.arange(len(WEIGHTS), dtype=jnp.result_type(z))
    at = (pieces * inside)[..., None] - k
    return _bell(at) + (pieces * (z - inside))[..., None] * _slope(at) - _bell((pieces * zero)[..., None] - k)


@_spline.defjvp
def _spline_along(primals: tuple[Any, ...], tangents: tuple[Any, ...]) -> tuple[Array, Array]:
    weights, z, zero, pieces = primals
    by_weight, by_z, by_zero, _ = tangents
    every, shape = jnp.stack(weights, axis=-1), _pieces(z, zero, pieces)
    k = jnp.arange(len(weights), dtype=z.dtype)

    def steep(at: Array) -> Array:
        return pieces * jnp.sum(every * _slope((pieces * jnp.clip(at, 0.0, 1.0))[..., None] - k), axis=-1)

    along = sum(dw * shape[..., i] for i, dw in enumerate(by_weight)) + steep(z) * by_z - steep(zero) * by_zero
    return jnp.sum(every * shape, axis=-1), along


class LearnedCurve(Mechanism):
    """What the closures by a curve share; one of them says its `forms` and the balance in which its curve stands."""

    source = "closure by a cubic spline, fitted through the simulation: de Boor, A Practical Guide to Splines (2001)"
    excited_by = "whatever excited it in the recordings"
    learned = True
    timed = True
    parameters = parameters()
    starts = ((0.0,) * len(parameters),)
    forms: ClassVar[tuple[Form, ...]] = ()

    def __init_subclass__(cls, **options: object):
        super().__init_subclass__(**options)
        cls.laws, cls.only_under = laws(cls.forms), only_under(cls.forms)
