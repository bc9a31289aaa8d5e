"""Samples that stand out alone are left out, even where they have bent the fit; a misfit of the model is not."""

import numpy as np
import pytest

from scpjax.fit import fit
from scpjax.fit.data import Data
from scpjax.fit.fit import best_start, settle
from scpjax.fit.setup import Setup, prepare
from scpjax.fit.solve import outputs_of
from scpjax.physics.presets import plant
from scpjax.recordings.recording import Metadata, Recording
from scpjax.simulate.simulate import simulate

NOISE = np.array([0.05, 1e-5])  # K, m
SPRUNG = plant(
    resistance=1.2, conductance=0.11, thermal_mass=1.5, coefficient=0.025, stiffness=250.0, damping=4.6, mass=0.277
)


def recorded(wild: dict[int, float]) -> Setup:
    """The problem of a plant heated for 15 s before its recording begins; ``wild`` [m] is added to displacements."""
    time, volts = 0.1 * np.arange(900), np.repeat([7.0, 0.0, 5.0, 2.0, 6.5, 0.0, 4.0, 6.0, 1.0], 100)
    known = (("resistance_ohm", 1.2), ("moving_mass_kg", 0.277))
    meta = Metadata(ambient_K=float(SPRUNG.ambient), known=known, model="plant")
    unread = {"temperature_degC": np.zeros(900), "displacement_mm": np.zeros(900)}
    blank = Recording.from_arrays(time, {"voltage_V": volts}, unread, metadata=meta)
    y = np.asarray(simulate(SPRUNG, blank).outputs)
    noisy = blank.with_outputs(y + NOISE * np.random.default_rng(0).standard_normal(y.shape)).slice(15.0)
    read = np.array(noisy.outputs)
    for at, by in wild.items():
        read[at, 1] += by
    return prepare([noisy.with_outputs(read)])


def left_out(before: Data, after: Data) -> set[int]:
    return set(np.flatnonzero(np.any(np.asarray(before.weights) != np.asarray(after.weights), axis=(0, 2))))


@pytest.mark.parametrize("wild", [{}, {400: 3e-4}, {4: -1e-3, 200: 4e-4, 201: 4e-4}])
def test_what_stands_out_is_left_out(wild):
    setup = recorded(wild)
    trial, _, _ = best_start(setup, setup.data)
    _, data, notes = settle(setup, trial, setup.data)
    assert left_out(setup.data, data) == set(wild)
    assert notes == ((f"{len(wild)} isolated wild samples were left out",) if wild else ())


@pytest.mark.parametrize(("share", "out"), [(0.03, True), (0.08, False)])
def test_so_many_may_be_wild(share, out):
    """A loose contact spoils every thirtieth sample; what spoils every twelfth is something else."""
    draw = np.random.default_rng(4)
    at = np.arange(5, 745)[:: int(1 / share)]
    setup = recorded({int(k): float(draw.choice([-1, 1]) * draw.uniform(2e-4, 5e-4)) for k in at})
    trial, _, _ = best_start(setup, setup.data)
    _, data, _ = settle(setup, trial, setup.data)
    assert left_out(setup.data, data) == (set(at.tolist()) if out else set())


@pytest.mark.parametrize("bends", [True, False])
def test_what_has_bent_the_fit_until_it_stood_out_no_more_is_left_out(monkeypatch, bends):
    """A least-squares fit may go through a wild sample (by ringing at the start); one on which it pulls no harder the
    farther it lies does not. Which samples are wild beside the first is played here.
    """
    setup = recorded({4: -1e-3} if bends else {})
    trial, _, _ = best_start(setup, setup.data)
    true, judged = fit.outliers, []

    def blind(problem, data, judge):
        judged.append(judge)
        return np.asarray(data.weights) if len(judged) == 1 else true(problem, data, judge)

    monkeypatch.setattr(fit, "outliers", blind)
    _, data, _ = settle(setup, trial, setup.data)
    assert left_out(setup.data, data) == ({4} if bends else set())
    assert len(judged) == (2 if bends else 1)
    if bends:
        measured = np.asarray(setup.data.outputs)[0, 4, 1]
        first, second = (abs(np.asarray(outputs_of(t, setup.data, setup.space))[0, 4, 1] - measured) for t in judged)
        assert second > first


def test_a_misfit_of_the_model_is_not_wild():
    """A stretch of one second that lies beside the model."""
    setup = recorded(dict.fromkeys(range(300, 310), 2e-4))
    trial, _, _ = best_start(setup, setup.data)
    _, data, _ = settle(setup, trial, setup.data)
    assert left_out(setup.data, data) == set()
