"""An actuator that creeps, recorded so slowly and noisily that a second thermal node would do as well."""

from dataclasses import replace

import equinox as eqx
import jax.numpy as jnp
import numpy as np

from scpjax.diagnose.holdout import Split, split
from scpjax.diagnose.hypothesis import State, moving_parameters, residual_on
from scpjax.diagnose.rivals import by_law
from scpjax.fit.data import pack
from scpjax.fit.fit import best_start, refine
from scpjax.fit.setup import prepare, restructured
from scpjax.physics.catalogue import mechanism
from scpjax.physics.model import Model
from scpjax.physics.presets import structure
from scpjax.recordings import excitation
from scpjax.recordings.recording import Metadata, Recording
from scpjax.simulate.simulate import Adaptive, simulate

AMBIENT = 295.15
LAWS = {"creep": "one branch", "two_node_thermal": "store"}
NOISE = {"temperature_degC": 1.0, "displacement_mm": 0.4}
BASE = {
    "joule_heating.gain": 1 / 1.2,
    "newton_cooling.conductance": 0.14,
    "newton_cooling.thermal_mass": 1.1,
    "thermal_actuation.coefficient": 0.024,
    "elastic_spring.stiffness": 180.0,
    "viscous_damping.damping": 8.0,
    "inertia.mass": 0.25,
}


def truth() -> Model:
    """The plant with creep: a quarter more, 6 s late."""
    model = Model(structure("plant").with_mechanisms(mechanism("creep")), ambient=AMBIENT)
    return model.replace({**BASE, "creep.compliance": 0.25, "creep.time_constant": 6.0})


def played(model: Model, time: np.ndarray, drive: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Outputs in file units (n, 2) and the heated node [K] (n,), by adaptive steps: not what the search uses."""
    recording = Recording.from_arrays(time, {"voltage_V": drive}, {}, require_outputs=False)
    path = simulate(model, recording, method=Adaptive(rtol=1e-7, atol=1e-9))
    out = np.asarray(path.outputs)
    return np.stack([out[:, 0] - 273.15, 1e3 * out[:, 1]], axis=1), np.asarray(path.states)[:, 0] + AMBIENT


def noisy(time: np.ndarray, drive: np.ndarray, clean: np.ndarray, seed: int, name: str) -> Recording:
    """A recording of clean outputs (n, 2) in file units."""
    rng = np.random.default_rng(seed)
    outputs = {c: clean[:, i] + s * rng.standard_normal(len(time)) for i, (c, s) in enumerate(NOISE.items())}
    known = (("resistance_ohm", 1.2), ("moving_mass_kg", 0.25))
    meta = Metadata(name=name, known=known, ambient_K=AMBIENT, model="plant")
    return Recording.from_arrays(time, {"voltage_V": drive}, outputs, metadata=meta)


def slow(seed: int = 0) -> Recording:
    """Two slow triangles."""
    time, drive = excitation.triangle(duration_s=240, period_s=0.4, low=0.5, high=4, frequency_hz=1 / 120)
    return noisy(time, drive, played(truth(), time, drive)[0], seed, "slow")


def fitted(recordings: list[Recording], names: tuple[str, ...]) -> tuple[dict[str, State], Split]:
    """Base and hypotheses with one mechanism each, fitted to the training part."""
    setup = prepare(recordings)
    parts = split(setup.data)
    trial, _, cost = best_start(setup, parts.train)
    base = State(setup, trial, residual_on(trial, parts.whole, setup), cost)
    return {"base model": base} | {n: _under(LAWS[n], n, by_law(base, n, parts, close=np.inf)) for n in names}, parts


def _under(law: str, name: str, found: dict[str, State]) -> State:
    """That of the fits of a mechanism that is under a law: noise may favour another."""
    index = mechanism(name).laws.index(law)
    at = [m.name for m in next(iter(found.values())).setup.structure.mechanisms].index(name)
    return next(s for s in found.values() if s.trial.laws[at] == index)


def again(state: State, recordings: list[Recording]) -> State:
    """A hypothesis fitted to more recordings from where it stands, with noise and priors as they were."""
    old = state.setup
    new = restructured(prepare(recordings), old.structure)
    n = len(old.structure.slots)
    data = pack(old.structure, recordings, np.asarray(old.data.sigma), ambient=[AMBIENT] * len(recordings))
    begun = np.zeros(new.space.size - n)
    priors = [
        np.concatenate([np.asarray(was)[:n], np.asarray(now)[n:]])
        for was, now in (
            (old.space.prior_mean, new.space.prior_mean),
            (old.space.prior_spread, new.space.prior_spread),
        )
    ]
    space = eqx.tree_at(lambda s: (s.prior_mean, s.prior_spread), new.space, tuple(map(jnp.asarray, priors)))
    setup = replace(new, data=data, space=space, fixed=np.concatenate([old.fixed[:n], begun]))
    laws = np.asarray(state.trial.laws)
    active = np.concatenate([moving_parameters(old, laws)[:n], np.ones(len(begun), bool)])
    start = setup.trial(np.concatenate([state.values[:n], begun]), active, laws, 16)
    trial, _, cost = refine(setup, data, start, max_steps=30)
    return State(setup, trial, residual_on(trial, data, setup), cost)
