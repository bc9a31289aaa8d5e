"""Where the misfit lies: in a column that was recorded, in the windows and regimes where it is."""

import numpy as np
import pytest
import scipy.signal

from scpjax.diagnose.latent import Misfit, missing
from scpjax.diagnose.locate import Binned, locate, observe
from scpjax.fit.setup import Setup, prepare
from scpjax.physics import presets
from scpjax.recordings.recording import Metadata, Recording

N = 240


def setup_of(*columns: str) -> Setup:
    time = 0.1 * np.arange(N)
    drive = np.where((time // 4) % 2 == 0, 3.0, 0.0)
    warm = scipy.signal.lfilter([0.05], [1, -0.95], drive**2)
    outputs = {"temperature_degC": 20 + warm, "displacement_mm": 0.2 * warm}
    recording = Recording.from_arrays(
        time, {"voltage_V": drive}, {c: outputs[c] for c in columns}, metadata=Metadata(name="made", model="plant")
    )
    assert presets.structure("plant").outputs == ("temperature", "displacement")
    return prepare([recording])


def binned(residual: np.ndarray, there: np.ndarray) -> Binned:
    time = 0.1 * np.arange(N)[None]
    warm = 5 * np.sin(time)
    return Binned(residual, there, time, np.abs(warm), warm, 1e-3 * warm, 1e-3 * np.cos(time))


@pytest.mark.parametrize(("column", "j"), [("temperature_degC", 0), ("displacement_mm", 1)])
@pytest.mark.parametrize("size", [0.1, 0.9])
def test_a_column_that_was_not_recorded_is_never_the_worst(column, j, size):
    """Below the noise every recorded column has less than no misfit."""
    residual = np.zeros((1, N, 2))
    residual[..., j] = size * np.random.default_rng(0).standard_normal(N)
    there = np.zeros((1, N, 2), bool)
    there[..., j] = True
    found = locate(setup_of(column), binned(residual, there), "")
    assert found.column == column
    assert set(found.whiteness) == {column}
    assert all(np.isfinite(share) for _, share in found.depends_on)


def test_the_worst_column_and_its_windows_are_where_the_misfit_is():
    residual = np.random.default_rng(1).standard_normal((1, N, 2))
    residual[:, 100:120, 1] += 8.0
    found = locate(setup_of("temperature_degC", "displacement_mm"), binned(residual, np.ones((1, N, 2), bool)), "")
    assert found.column == "displacement_mm"
    assert found.windows[0].share > 0.6
    assert found.windows[0].start_s == pytest.approx(10.0, abs=0.2)
    assert found.windows[0].end_s == pytest.approx(12.0, abs=0.2)


@pytest.mark.parametrize(("columns", "seen"), [(("temperature_degC",), False), (("displacement_mm",), True)])
def test_a_force_is_missed_only_where_its_effect_was_recorded(columns, seen):
    setup = setup_of(*columns)
    trial = setup.trial(np.asarray(setup.starts[0]), setup.base_active)
    residual = np.random.default_rng(2).standard_normal(np.asarray(setup.data.target).shape)
    meanwhile = observe(setup, setup.data, trial, residual)
    found = missing(Misfit(setup, setup.data, trial, meanwhile))
    assert ("force" in {m.place for m in found}) == seen
    # nor does anything depend on a motion that nobody saw
    assert all(("displacement" in dict(m.depends_on)) == seen for m in found)
    assert all((b is not None) == seen for b in (meanwhile.displacement, meanwhile.velocity))
    assert "heat" in {m.place for m in found}
    assert all(np.all(np.isfinite(s)) for m in found for s in m.std)
