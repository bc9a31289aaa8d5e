"""Derivatives, both modes, against differences of the function itself; single against double precision."""

import equinox as eqx
import jax
import jax.flatten_util
import jax.numpy as jnp
import numpy as np
import pytest
from sim_cases import (
    CASES,
    KINKED,
    PLANT,
    case_id,
    extended,
    multilevel,
    recorded,
    smooth,
    with_active,
    worst,
)

from scpjax.physics import presets
from scpjax.physics.model import Model
from scpjax.simulate.simulate import Adaptive, Exact, Exponential, simulate

DURATION = 1.5
STEP = 1e-3  # of each quantity's scale; the differences are of fourth order
KINK_STEP = 1e-5  # where a kink may lie within the greater one
FAST_COMPILE = {"xla_backend_optimization_level": 0, "xla_llvm_disable_expensive_passes": True}
# at the representative dead time the held drive's edges meet the steps', and its derivative differs by side
ELSEWHERE = {
    "input_delay": {"input_delay.time": 0.1234},
    "ambient_drift": {"ambient_drift.begin": 0.2137, "ambient_drift.end": 0.9643},  # within the recording and a step
}


def loss_of(structure, recording, method):
    """A scalar in which every reading has a weight of its own, as a function of all that it depends on."""
    rng = np.random.default_rng(5)
    weight = rng.uniform(0.5, 1.5, (recording.n, 2)) / np.array([10.0, 1e-3])

    def loss(point, laws):
        theta, z0, inputs, ambient = point
        model = Model(structure, theta=theta, laws=laws, ambient=ambient)
        driven = eqx.tree_at(lambda r: r.inputs, recording, inputs)
        outputs = simulate(model, driven, initial=z0, method=method).outputs
        return jnp.sum(weight * (outputs - jnp.array([ambient, 0.0]))) / recording.n + 1e-3 * outputs[-1, 0]

    return loss


_compiled = {}


def derivatives(key, structure, recording, method, point, laws, step=STEP):
    """(reverse, forward, differences), each flat and in units of the loss for a change by one scale."""
    flat, unravel = jax.flatten_util.ravel_pytree(point)
    scale = _scales(point)
    if key not in _compiled:
        loss = loss_of(structure, recording, method)

        def scaled(x, laws, flat):
            return loss(unravel(flat + x * scale), laws)

        _compiled[key] = (
            jax.jit(
                lambda laws, f: (jax.grad(scaled)(0 * f, laws, f), jax.jacfwd(scaled)(0 * f, laws, f)),
                compiler_options=FAST_COMPILE,
            ),
            jax.jit(jax.vmap(scaled, in_axes=(0, None, None)), compiler_options=FAST_COMPILE),
        )
    both, values = _compiled[key]
    reverse, forward = both(laws, flat)
    eye = step * np.eye(flat.size)
    far, near, nearer, farther = np.split(np.asarray(values(np.vstack([-2 * eye, -eye, eye, 2 * eye]), laws, flat)), 4)
    return np.asarray(reverse), np.asarray(forward), (far - farther + 8 * (nearer - near)) / (12 * step)


def _scales(point):
    """The size of each quantity, or of its kind where it is zero."""
    sizes = [np.abs(np.asarray(leaf)) for leaf in point]
    floors = [1e-3, 1e-3, 1.0, 1.0]
    return np.concatenate([np.where(s > 0, s, f).ravel() for s, f in zip(sizes, floors, strict=True)])


def assert_agree(found, keep=slice(None), served=slice(None)):
    """Those kept agree; most of what the laws serve of them is no zero."""
    some = np.asarray(found[2])[served]
    reverse, forward, differences = (np.asarray(f)[keep] for f in found)
    floor = 1e-9 * np.max(np.abs(differences))
    np.testing.assert_allclose(reverse, differences, rtol=1e-6, atol=floor)
    np.testing.assert_allclose(forward, differences, rtol=1e-6, atol=floor)
    assert np.count_nonzero(some) > 0.75 * some.size  # but for states that another mechanism or law uses


def point_of(model, recording):
    z0 = model.initial(temperature=10.0, displaced=1e-3, velocity=0.01)
    return (model.theta, z0, jnp.asarray(recording.inputs), model.ambient)


@pytest.mark.parametrize("hold", ["zero_order", "linear", "band_limited", "uneven linear"])
def test_linear_models_exactly(hold):
    recording = multilevel(duration=DURATION, hold_s=0.1, hold=hold.split()[-1])
    if hold.startswith("uneven"):
        time = np.cumsum(np.random.default_rng(2).choice([0.03, 0.05, 0.11], recording.n))
        recording = recorded(time, {"voltage_V": recording.inputs[:, 0]}, hold="linear")
    found = derivatives(hold, PLANT.structure, recording, Exact(), point_of(PLANT, recording), PLANT.laws)
    assert_agree(found)


@pytest.mark.parametrize("case", CASES, ids=case_id)
def test_mechanisms_by_fixed_steps(case):
    """Base parameters, those of the mechanism, the initial state and every input."""
    name, law = case
    structure = extended(PLANT.structure, name) if name in KINKED else smooth()
    model = with_active(structure, name, law).replace(ELSEWHERE.get(name, {}))
    recording = multilevel(duration=DURATION, hold_s=0.1)
    key = name if name in KINKED else "smooth"
    point, step = point_of(model, recording), KINK_STEP if name in KINKED else STEP
    if case == ("creep", 3):  # away from rest, where the way there and the way back meet
        at = structure.state_names.index("creep.creep_displacement")
        point = (point[0], point[1].at[at].multiply(0.9), *point[2:])
    found = derivatives(key, structure, recording, Exponential(order=2), point, model.laws, step)
    base = {m.name for m in structure.mechanisms if m.is_base}
    keep = np.ones(found[0].size, bool)  # without the other mechanisms, which sit on their null's edge
    keep[: model.theta.size] = [s.mechanism in base | {name} for s in structure.slots]  # others sit on a null's edge
    served = keep.copy()
    laws = dict(zip((m.name for m in structure.mechanisms), np.asarray(model.laws), strict=True))
    used = [structure.mechanism(s.mechanism).serves(s.parameter, int(laws[s.mechanism])) for s in structure.slots]
    served[: model.theta.size] &= used
    assert_agree(found, keep, served)


def test_fourth_order():
    """On one that bends the force balance; the balances themselves are those of the second order."""
    structure = extended(PLANT.structure, "nonlinear_stiffness", "resistance_temperature")
    model = with_active(structure, "nonlinear_stiffness").replace({"resistance_temperature.coefficient": 0.004})
    recording = multilevel(duration=DURATION, hold_s=0.1, hold="linear")
    point = point_of(model, recording)
    assert_agree(derivatives("fourth", structure, recording, Exponential(order=4), point, model.laws))


def test_adaptive_both_ways():
    base = presets.te(resistance=10.0, conductance=0.2, thermal_mass=1.5)
    model = Model(extended(base.structure, "nonlinear_heat_loss")).replace(
        base.values() | {"nonlinear_heat_loss.strength": 0.8}
    )
    recording = multilevel(duration=0.5, hold_s=0.1)
    z0 = model.initial(temperature=10.0)

    def end(theta, method):
        return simulate(Model(model.structure, theta=theta), recording, initial=z0, method=method).outputs[-1, 0]

    adaptive = Adaptive(rtol=1e-10, atol=1e-12, max_steps=4096)
    wanted = jax.grad(end)(model.theta, Exponential(substeps=4)) * model.theta
    for derivative in (jax.jacfwd, jax.grad):
        found = derivative(end)(model.theta, adaptive) * model.theta
        np.testing.assert_allclose(found, wanted, rtol=1e-6, atol=1e-9)
    assert np.count_nonzero(wanted) >= 4


def _run(method, structure, name=None, law=0):
    recording = multilevel(duration=3.0)
    model = Model(structure).replace(PLANT.values()) if name is None else with_active(structure, name, law)
    found = simulate(model, recording, initial=model.initial(temperature=10.0), method=method)
    return np.asarray(found.states), np.asarray(found.outputs) - np.array([float(model.ambient), 0.0])


def assert_single_precision(method, structure, name=None, law=0):
    wanted = _run(method, structure, name, law)
    with jax.enable_x64(False):
        found = _run(method, structure, name, law)
    assert found[0].dtype == np.float32
    for f, w in zip(found, wanted, strict=True):
        assert worst(f, w) < 1e-4


@pytest.mark.parametrize("method", [Exact(), Exponential(order=2), Exponential(order=4)], ids=["exact", "2", "4"])
def test_single_precision_of_linear_models(method):
    assert_single_precision(method, PLANT.structure)


@pytest.mark.parametrize("case", CASES, ids=case_id)
def test_single_precision_of_mechanisms(case):
    name, law = case
    assert_single_precision(
        Exponential(order=2), extended(PLANT.structure, name) if name in KINKED else smooth(), name, law
    )
