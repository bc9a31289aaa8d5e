"""Jumps of the drive inside gaps are timed anew once something is named: the base model timed them by what it lacks."""

from types import SimpleNamespace

import numpy as np
import pytest

from scpjax.diagnose import naming
from scpjax.diagnose.choice import Choice
from scpjax.diagnose.diagnose import diagnose
from scpjax.diagnose.evidence import Evidence
from scpjax.fit.gaps import find_gaps
from scpjax.fit.setup import prepare
from scpjax.physics.presets import te
from scpjax.recordings.recording import Metadata, Recording
from scpjax.simulate.simulate import simulate

HEATER = te(resistance=3.2, conductance=0.06, thermal_mass=0.26)
PERIOD, NOISE, DEAD = 0.05, 0.05, 1.0  # s, K, V
LEVELS = (0.0, 3.0, 0.0, 2.0, 0.5, 3.0, 1.5, 0.0, 2.5, 0.4, 0.0, 2.0)  # V, some of them within the dead zone


def recorded() -> Recording:
    """A heater behind a dead zone, driven by jumps that happen in the second to last of five skipped samples."""
    ticks = np.arange(150 * len(LEVELS))
    volts = np.array(LEVELS)[ticks // 150]
    meta = Metadata(ambient_K=float(HEATER.ambient), known=(("resistance_ohm", 3.2),), model="te")
    reaching = {"voltage_V": np.maximum(volts - DEAD, 0.0)}
    blank = Recording.from_arrays(PERIOD * ticks, reaching, {"temperature_degC": np.zeros(len(ticks))}, metadata=meta)
    exact = np.asarray(simulate(HEATER, blank).outputs)
    noisy = exact + NOISE * np.random.default_rng(0).standard_normal(exact.shape)
    left = ~((ticks % 150 < 2) | (ticks % 150 > 146)) | (ticks == 0)
    return blank.with_samples(blank.time[left], volts[left, None], noisy[left], None)


def test_jumps_are_timed_anew_by_what_is_named():
    """The base model, which times all of them by a drive that no dead zone weakens, is far from any noise."""
    setup = prepare([recorded()])
    assert len(find_gaps(setup.data)) == len(LEVELS) - 1
    found = diagnose([recorded()])
    assert found.verdict == "explained"
    (m,) = found.mechanisms
    assert (m.name, m.law) == ("drive_dead_zone", "threshold")
    assert m.parameters["threshold"].value == pytest.approx(DEAD / max(LEVELS), abs=0.005)
    assert found.base_parameters["newton_cooling.conductance"].value == pytest.approx(0.06, rel=0.01)
    assert found.base_parameters["newton_cooling.thermal_mass"].value == pytest.approx(0.26, rel=0.01)
    first, *others = (r.delta_bic for r in found.ranking)
    assert first > 100 * max(others)  # by the base model's times it was four times as much as of the next
    assert any("the drive changed in gaps at other times" in note for note in found.notes)


@pytest.mark.parametrize("stays", [False, True])
def test_a_single_name_that_only_made_up_for_a_time_goes(monkeypatch, stays):
    """As an excursion of the room did, in a recording that lacked nothing, for a jump that had been timed too late."""
    state, bare, after = (SimpleNamespace(names=names) for names in (("ambient_drift",), (), ()))
    timed, parts = SimpleNamespace(train=None), SimpleNamespace()
    base = SimpleNamespace(setup=None, trial=None)
    monkeypatch.setattr(naming, "_timed", lambda *_: (state, timed))
    monkeypatch.setattr(naming, "refine", lambda *_: (None, None, None))
    monkeypatch.setattr(naming, "state_at", lambda *_: after)
    monkeypatch.setattr(naming, "prune", lambda *_: state if stays else bare)
    before = Choice(state, (), {"ambient_drift": 0.9}, {"ambient_drift": ()})
    found = naming._settled(parts, base, before, Evidence())  # type: ignore[arg-type]
    assert found[:2] == (timed, after)
    assert found[2] == (before if stays else Choice(after, (), {}, {}))  # type: ignore[arg-type]
