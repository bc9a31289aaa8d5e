"""Curves of a closure: what the simulation computes is the spline of `basis`, and its tangents are its derivatives."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from scpjax.physics.catalogue import catalogue
from scpjax.physics.curves import BEYOND, PIECES, WEIGHTS, basis, form_of, product, value_at
from scpjax.physics.mechanism import Values, View

RANGES = {
    "temperature": (-2.0, 60.0),
    "displacement": (-0.001, 0.02),
    "velocity": (-0.004, 0.01),
    "effort": (0.0, 30.0),
    "time": (0.0, 300.0),
}
NAMES = ("learned_heat_curve", "learned_force_curve", "learned_reading_curve")


def values(m, law, weights):
    own = dict(zip(WEIGHTS, weights, strict=True))
    ends = {f"{v}_{end}": at for v, (low, high) in RANGES.items() for end, at in (("low", low), ("high", high))}
    return Values({**own, **ends, "law": jnp.asarray(float(law))})


def seen(now):
    view = View(0.0, now["effort"], now["temperature"], now["displacement"], now["velocity"], shared={}, mass=1.0)
    view.time = now["time"]
    return view


def at(share):
    """All variables at this share of their ranges, beyond them as far."""
    return {
        v: low + share * (high - low) if not 0 <= share <= 1 else float(value_at(v, np.array(share), low, high))
        for v, (low, high) in RANGES.items()
    }


CASES = [(name, law) for name in NAMES for law in range(0, len(catalogue()[name].laws), 4)]


@pytest.mark.parametrize(("name", "law"), CASES)
def test_it_is_the_spline_of_its_basis_and_has_its_derivatives(name, law):
    m = catalogue()[name]
    form, pieces = form_of(m.forms, law)
    rng = np.random.default_rng(law)
    weights = jnp.asarray(rng.normal(size=len(WEIGHTS)))

    def along(now, weights):
        return product(m.forms, values(m, law, weights), seen(now), form.of)

    @jax.jit
    def value_and_slopes(now, weights, step, push):
        value, slope = jax.jvp(along, (now, weights), (step, push))
        return value, slope, jax.vjp(along, now, weights)[1](jnp.ones(()))

    for share in (0.03, 0.4, 0.77, 1.2, 1.0 + BEYOND + 0.3):
        now = at(share)
        step = {v: 1e-6 * (high - low) * rng.normal() for v, (low, high) in RANGES.items()}
        push = jnp.asarray(1e-6 * rng.normal(size=len(WEIGHTS)))
        _, slope, (by_now, by_weight) = value_and_slopes(now, weights, step, push)
        if share <= 1:
            place = _share(form.variable, now[form.variable])
            used = np.asarray(weights)[: pieces + 2] @ basis(np.array([place]), _share(form.variable, 0.0), pieces)[0]
            factor = now[form.factor] / RANGES[form.factor][1] if form.factor else 1.0
            few = weights.at[pieces + 2 :].set(0.0)
            np.testing.assert_allclose(value_and_slopes(now, few, step, push)[0], factor * used, rtol=1e-9, atol=1e-12)
        ahead, behind = ({v: now[v] + sign * step[v] for v in now} for sign in (1, -1))
        value_ahead, value_behind = (
            value_and_slopes(place, w, step, push)[0]
            for place, w in ((ahead, weights + push), (behind, weights - push))
        )
        np.testing.assert_allclose(slope, (value_ahead - value_behind) / 2, rtol=1e-5, atol=1e-12)
        total = sum(float(by_now[v]) * step[v] for v in now) + float(by_weight @ push)
        np.testing.assert_allclose(total, slope, rtol=1e-9, atol=1e-15)
    elsewhere = product(m.forms, values(m, law, weights), seen(at(0.4)), "nothing")
    assert float(elsewhere) == 0.0


def _share(variable, value):
    """The inverse of `value_at`, by bisection."""
    low, high = -0.5, 1.0
    for _ in range(80):
        middle = 0.5 * (low + high)
        if float(value_at(variable, np.array(middle), *RANGES[variable])) < value:
            low = middle
        else:
            high = middle
    return low


def test_both_sides_of_a_joint_have_their_own_place_on_it():
    m = catalogue()["learned_heat_curve"]
    law = PIECES.index(6)  # T s(x)
    weights = jnp.asarray(np.random.default_rng(1).normal(size=len(WEIGHTS)))
    now = {v: np.array([at(0.3)[v], at(0.8)[v]]) for v in RANGES} | {"time": 10.0}
    both = product(m.forms, values(m, law, weights), seen({v: jnp.asarray(x) for v, x in now.items()}))
    one = [
        product(m.forms, values(m, law, weights), seen({v: x[i] if np.ndim(x) else x for v, x in now.items()}))
        for i in (0, 1)
    ]
    np.testing.assert_allclose(both, one, rtol=1e-12)
    assert both.shape == (2,)
