"""Sets of mechanisms beside a base of one's own: what was concealed together is named together, and nothing else."""

import os

import numpy as np
import pytest
from scipy.integrate import solve_ivp

from scpjax.diagnose.diagnose import diagnose
from scpjax.fit.predict import predict
from scpjax.physics.catalogue import forget
from scpjax.recordings.recording import Metadata, Recording
from scpjax.simulate.trial import use_base

pytestmark = pytest.mark.skipif(
    os.environ.get("SCPJAX_ACCEPTANCE") != "1", reason="skipped: set SCPJAX_ACCEPTANCE=1 to run every acceptance case"
)

BASE = """
import jax.numpy as jnp
from scpjax.parameter import Parameter
from scpjax.physics.mechanism import Mechanism
from scpjax.physics.system import System


def free(name, low, high, null=None, typical=0.5):
    return Parameter(name=name, symbol=name, unit="1", description=name, typical=typical, bounds=(low, high), null=null,
                     scale="linear", spread=1.0 if null is not None else float("inf"))


class Vessel(System):
    name, title, equation, source, says = "vessel", "Vessel", "dh/dt = g u - k h", "mass", "It fills and drains."
    states, outputs, substeps = ("level",), ("level_V",), 4
    parameters = (free("gain", 0.0, 5.0), free("rate", 0.0, 5.0))

    def rates(self, p, view):
        return (p.gain * view.effort - p.rate * view.own[0],)

    def observe(self, p, view):
        return view.own


class Leak(Mechanism):
    name, title, subsystem, equation, source, says = "leak", "Leak", "balance", "-c h^2", "loss", "It leaks the more."
    needs, starts = ("vessel",), ((0.2,),)
    parameters = (free("size", -1.0, 1.0, 0.0, 0.1),)

    def flows(self, p, view):
        return {"level": -p.size * view.states["level"] ** 2}


class Bend(Mechanism):
    name, title, subsystem, equation, source, says = "bend", "Bend", "sensor", "y + b y^2", "sensor", "It bends."
    needs, starts = ("vessel",), ((0.1,),)
    parameters = (free("size", -1.0, 1.0, 0.0, 0.1),)

    def reading(self, p, view, quantity, value):
        return value + p.size * value**2


class Threshold(Mechanism):
    name, title, subsystem, equation, source, says = "start", "Start", "drive", "u - u0", "pump", "It starts late."
    needs, starts = ("vessel",), ((0.1,),)
    parameters = (free("size", -1.0, 1.0, 0.0, 0.1),)

    def effort(self, p, view, effort):
        return effort - p.size
"""
GAIN, RATE, LEAK, BEND = 0.6, 0.4, 0.25, -0.12


def made(seed: int, leak: float, bend: float) -> Recording:
    rng = np.random.default_rng(seed)
    u = np.repeat(rng.uniform(0.2, 2.5, 20), 12)
    time = 0.5 * np.arange(len(u))

    def rates(t, h):
        return GAIN * u[min(int(t / 0.5 + 1e-9), len(u) - 1)] - RATE * h - leak * h**2

    h = solve_ivp(rates, (0, time[-1]), [0.5], t_eval=time, max_step=0.1, rtol=1e-9).y[0]
    y = h + bend * h**2 + 2e-3 * rng.standard_normal(len(u))
    return Recording.from_arrays(time, {"drive_V": u}, {"level_V": y}, metadata=Metadata(name=f"made {seed}"))


@pytest.fixture
def vessel(tmp_path):
    file = tmp_path / "vessel.py"
    file.write_text(BASE)
    yield use_base(file).name
    forget(file)


def test_two_at_once_are_named_and_predict(vessel):
    found = diagnose([made(0, LEAK, BEND)], model=vessel)
    assert {m.name for m in found.mechanisms} == {"leak", "bend"}
    assert found.verdict == "explained"
    for m, truth in zip(sorted(found.mechanisms, key=lambda m: m.name), (BEND, LEAK), strict=True):
        assert m.parameters["size"].value == pytest.approx(truth, abs=4 * m.parameters["size"].std)
    unseen = made(1, LEAK, BEND)
    said = predict(found.model, unseen)[1]["level_V"]
    assert np.sqrt(np.mean((said - unseen.outputs[:, 0]) ** 2)) < 3e-3
    assert {m.place for m in found.missing} == {"rate of level", "level reading"}
    assert found.location.column == "level_V"


def test_nothing_is_named_where_nothing_is_missing(vessel):
    found = diagnose([made(2, 0.0, 0.0)], model=vessel)
    assert found.verdict == "adequate"
    assert not found.mechanisms
    assert {r.name for r in found.ranking} == {"leak", "bend", "start", "input_delay"}
