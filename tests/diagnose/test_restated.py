"""A parameter restated for other references, by the powers that a fleet is compared with, says the same physics."""

import jax.numpy as jnp
import numpy as np
import pytest

from scpjax.diagnose.restated import POWERS
from scpjax.physics.catalogue import catalogue
from scpjax.physics.mechanism import Mechanism, Values, View

OLD = {"K": 50.0, "m": 0.01, "s": 100.0, "V": 3.7}
NEW = {"K": 57.0, "m": 0.012, "s": 130.0, "V": 4.3}
VALUE = {
    **{"drift": 0.2, "growth": 0.4, "quadrature": 0.1, "cubic": 0.3, "quadratic": 0.2, "steepness": 0.6, "excess": 0.3},
    **{"engaged": 0.5, "threshold": 0.5, "time_constant": 15.0, "begin": 20.0, "end": 50.0},
}
"""Of what is nothing, or too quick to show, at its typical value."""
ABSORBED = {("nonlinear_thermal_force", 3)}  # the base's coefficient, too, is stated for the reference

ROUNDED = {("antagonist_load", 0), ("antagonist_load", 5), ("nonlinear_stiffness", 2), ("nonlinear_thermal_force", 2)}
"""Laws with a corner as wide as a share of the reference."""


def powers(m: Mechanism, law: int) -> dict[str, dict[str, int] | None]:
    name = lambda p: f"{m.name}.{p.name}"  # noqa: E731
    return {p.name: POWERS.get(f"{name(p)} ({m.laws[law]})", POWERS.get(name(p))) for p in m.free_parameters(law)}


def whole() -> list[tuple[str, int]]:
    """Mechanisms and laws all of whose parameters can be restated."""
    known = {key.split(".")[0] for key in POWERS}
    laws = [(m, i) for m in catalogue().values() if m.name in known for i in range(len(m.laws))]
    return [(m.name, i) for m, i in laws if None not in powers(m, i).values() and (m.name, i) not in ABSORBED]


def test_every_name_is_one_of_the_catalogue():
    for key in POWERS:
        name, _, rest = key.partition(".")
        parameter, _, law = rest.partition(" (")
        m = catalogue()[name]
        p = next(p for p in m.parameters if p.name == parameter)
        told = {q.name for q in m.parameters if q.fixed}
        assert not p.fixed
        assert set(POWERS[key]) <= told
        assert not law or m.serves(p, m.laws.index(law[:-1])), key


def said(m: Mechanism, law: int, values: dict[str, float], size: float) -> np.ndarray:
    """All that a mechanism says of a joint, a few steps after its states were 0."""
    p = Values({k: jnp.asarray(v) for k, v in {**values, "law": law}.items()})
    side = jnp.array([1.0, 0.6])
    view = View(
        293.0, 9.0 * size * side, 40.0 * size * side, 0.009 * size * side, 0.003 * side,
        power=2.0 * side, warming=2.0 * side, felt=35.0 * size * side, actuating=40.0 * size * side,
        deflection=0.009 * size * side, pull=1.5 * size * side, restoring=0.8 * size * side, time=60.0 * size,
        mass=0.1, radius=0.015, asked=9.0 * size * side,
        shared=dict.fromkeys(("stiffness", "damping", "coefficient", "conductance", "thermal_mass"), side),
    )  # fmt: skip
    view.own = tuple(jnp.zeros(2) for _ in m.states)
    for _ in range(3 if m.states else 0):
        view.own = tuple(o + 0.5 * r for o, r in zip(view.own, m.rates(p, view), strict=True))
    flows = (m.heat(p, view), m.pull(p, view), m.pull_factor(p, view), m.restoring(p, view), m.force(p, view))
    readings = [m.reading(p, view, q, 40.0 * side) for q in ("displacement", "temperature")]
    more = (m.restoring_factor(p, view), m.resistance(p, view, side), m.deflection(p, view, view.deflection))
    every = (*flows, *readings, *more, m.effort(p, view, view.effort))
    return np.concatenate([np.ravel(jnp.asarray(a) * jnp.ones(2)) for a in every])


@pytest.mark.parametrize(("name", "law"), whole())
def test_restated_it_says_the_same(name, law):
    m = catalogue()[name]
    old = {p.name: OLD[p.unit] if p.fixed else VALUE.get(p.name, p.typical) for p in m.parameters}
    restated = {p.name: NEW[p.unit] if p.fixed else old[p.name] for p in m.parameters}
    for key, by in powers(m, law).items():
        for reference, n in (by or {}).items():
            restated[key] *= (old[reference] / restated[reference]) ** n
    unchanged = {p.name: NEW[p.unit] if p.fixed else old[p.name] for p in m.parameters}
    first, same, other = (np.stack([said(m, law, v, size) for size in (0.5, 1.0)]) for v in (old, restated, unchanged))
    off, wrong = np.abs(same - first).max(), np.abs(other - first).max()
    assert off <= max((0.15 if (name, law) in ROUNDED else 1e-3) * wrong, 1e-9)
    assert wrong > 1e-9 or not any(by for by in powers(m, law).values())
