"""What is worth fitting: also what a base is bent so far to imitate that it promises nothing."""

import jax.numpy as jnp
import numpy as np
from diagnose.creeping import AMBIENT, BASE

from scpjax.diagnose import screen as screening
from scpjax.diagnose.holdout import Split, split
from scpjax.diagnose.hypothesis import State, from_their_starts, grown, residual_on
from scpjax.diagnose.rivals import added
from scpjax.diagnose.screen import fresh, ready, ready_beside_names, screen
from scpjax.fit import solve
from scpjax.fit.fit import best_start, refine
from scpjax.fit.setup import Setup, prepare
from scpjax.kept import key_of
from scpjax.physics.catalogue import mechanism
from scpjax.physics.model import Model
from scpjax.physics.presets import structure
from scpjax.recordings import excitation
from scpjax.recordings.recording import Metadata, Recording
from scpjax.simulate.simulate import Exponential, simulate

TRIED = [mechanism(n) for n in ("friction", "nonlinear_stiffness", "nonlinear_heat_loss", "sensor_drift")]


def hypothesis(strength: float) -> tuple[State, Split, Setup]:
    """A plant that sticks, recorded, and the base model fitted to it."""
    time, volts = excitation.multilevel_random(duration_s=120, period_s=0.1, hold_s=6, low=0, high=4, seed=3)
    meta = Metadata(name="made", known=(("resistance_ohm", 1.2), ("moving_mass_kg", 0.25)), ambient_K=AMBIENT)
    driven = Recording.from_arrays(time, {"voltage_V": volts}, {}, metadata=meta, require_outputs=False)
    sticks = Model(structure("plant").with_mechanisms(mechanism("friction")), ambient=jnp.asarray(AMBIENT))
    sticks = sticks.replace({**BASE, "friction.strength": strength, "friction.reference": 5e-3})
    out = np.asarray(simulate(sticks, driven, method=Exponential(substeps=8)).outputs)
    noise = np.random.default_rng(0).standard_normal(out.shape)
    outputs = {
        "temperature_degC": out[:, 0] - 273.15 + 0.1 * noise[:, 0],
        "displacement_mm": 1e3 * out[:, 1] + 0.03 * noise[:, 1],
    }
    setup = prepare([Recording.from_arrays(time, {"voltage_V": volts}, outputs, metadata=meta)], model="plant")
    parts = split(setup.data)
    trial, _, _ = best_start(setup, parts.train)
    trial, _, cost = refine(setup, parts.train, trial)
    return State(setup, trial, residual_on(trial, parts.whole, setup), float(cost)), parts, grown(setup, *TRIED)


def test_friction_is_tried_from_the_parameters_first_suggested():
    state, parts, catalogue = hypothesis(0.4)
    found = fresh(state, parts, catalogue, TRIED)
    assert found is not None
    assert found.best is not None
    assert found.best.name == found.likeliest[0] == found.promises[0].mechanism.name == "friction"
    assert [p.gain for p in found.promises] == sorted((p.gain for p in found.promises), reverse=True)
    # and it would begin there: not where the fit without it has ended
    begun, bent = found.state.values, state.values
    at = state.setup.structure.index["viscous_damping.damping"]
    assert begun[at] == state.setup.starts[0][at]
    assert bent[at] != begun[at]


def test_nothing_is_begun_anew_where_nothing_sticks():
    state, parts, catalogue = hypothesis(0.001)
    found = fresh(state, parts, catalogue, TRIED)
    assert found is not None
    assert found.best is None or found.best.name != "friction"


def test_the_programs_made_ready_are_those_that_screen(monkeypatch):
    """A program of other shapes would be compiled in vain."""
    state, parts, catalogue = hypothesis(0.4)
    asked, forward = [], solve._forward
    monkeypatch.setattr(solve, "_forward", lambda *args: (asked.append(key_of(forward, args)), forward(*args))[1])
    ready(state.setup, catalogue)
    halves = {*asked}
    assert len(asked) == len(halves) == 2
    promises = screen(state, parts, catalogue, TRIED)
    assert {*asked} == halves
    assert len(asked) > 2
    assert None not in asked
    asked.clear()
    ready_beside_names(catalogue)
    (whole,) = asked
    screen(added(state, "friction", parts), parts, catalogue, TRIED[1:])
    assert len(asked) > 1
    assert {*asked} == {whole}
    assert whole not in halves
    # what a half simulates is what all of the catalogue does
    monkeypatch.setattr(screening, "_simulators", lambda *_: [catalogue])
    together = {p.mechanism.name: p for p in screen(state, parts, catalogue, TRIED)}
    for p in promises:
        np.testing.assert_allclose(p.each, together[p.mechanism.name].each, rtol=1e-6, atol=1e-6)


def test_a_fit_may_begin_with_the_base_and_every_mechanism_at_their_starts():
    state, _, _ = hypothesis(0.001)
    friction, spring = mechanism("friction"), mechanism("nonlinear_stiffness")
    problem = grown(state.setup, friction, spring)
    first, *last = from_their_starts(problem, np.zeros(len(problem.structure.mechanisms), int))
    assert len(last) == 1
    at = problem.structure.index
    for value, start in ((first, 0), (last[0], -1)):
        assert value[at["friction.strength"]] == friction.starts[start][0]
        assert value[at["nonlinear_stiffness.quadratic"]] == spring.starts[start][0]
        # what the first law does not use stays as it is without the mechanism, and the base where the data put it first
        assert value[at["nonlinear_stiffness.strength"]] == 0.0
        for name, i in state.setup.structure.index.items():
            assert value[at[name]] == state.setup.starts[0][i]
