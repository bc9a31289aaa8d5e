"""Wild samples that a strong misfit conceals are found once the effect has its name."""

import numpy as np
from creeping import AMBIENT, BASE

from scpjax.diagnose import naming
from scpjax.diagnose.diagnose import DiagnoseOptions, diagnose
from scpjax.diagnose.holdout import split
from scpjax.fit.setup import prepare
from scpjax.physics.catalogue import mechanism
from scpjax.physics.model import Model
from scpjax.physics.presets import structure
from scpjax.recordings import excitation
from scpjax.recordings.recording import Metadata, Recording
from scpjax.simulate.simulate import Adaptive, simulate

NOISE = 0.05  # K
WILD = 30


def lagging() -> Recording:
    """A thermometer 1.5 s late, read with fine noise, and wild now and then."""
    time, drive = excitation.multilevel_random(duration_s=120, period_s=0.1, low=0.5, high=4, hold_s=6, seed=1)
    own = {k: v for k, v in BASE.items() if k.startswith(("joule", "newton"))}
    model = Model(structure("te").with_mechanisms(mechanism("sensor_lag")), ambient=AMBIENT)
    model = model.replace({**own, "sensor_lag.time_constant": 1.5})
    played = Recording.from_arrays(time, {"voltage_V": drive}, {}, require_outputs=False)
    clean = np.asarray(simulate(model, played, method=Adaptive(rtol=1e-8, atol=1e-10)).outputs)[:, 0] - 273.15
    rng = np.random.default_rng(3)
    read = clean + NOISE * rng.standard_normal(len(time))
    at = rng.choice(np.arange(5, len(time) - 5), WILD, replace=False)
    read[at] += NOISE * rng.choice([-1, 1], WILD) * rng.uniform(10, 40, WILD)
    meta = Metadata(name="late", known=(("resistance_ohm", 1.2),), ambient_K=AMBIENT, model="te")
    return Recording.from_arrays(time, {"voltage_V": drive}, {"temperature_degC": read}, metadata=meta)


def test_wild_samples_are_looked_for_again_beside_the_first_name():
    found = diagnose([lagging()])
    assert found.verdict == "explained"
    assert [m.name for m in found.mechanisms] == ["sensor_lag"]
    beside_base, beside_name = (int(next(w for w in note.split() if w.isdigit())) for note in found.notes[-2:])
    assert found.notes[-1].endswith(", the first name tried")
    assert beside_base > 0
    assert beside_name > 0
    assert WILD - 2 <= beside_base + beside_name <= WILD + 2


def test_what_is_named_is_fitted_anew_without_them_where_the_search_took_longer_than_is_left(monkeypatch):
    """As where they stand out only beside all that was named: the first name does not tell of them."""
    asked = []

    def later(state, parts):
        asked.append(state.names)
        return wild(state, parts) & (len(asked) > 1)

    wild = naming._wild
    monkeypatch.setattr(naming, "_wild", later)
    found = diagnose([lagging()], options=DiagnoseOptions(patience=0.0))
    assert [m.name for m in found.mechanisms] == ["sensor_lag"]
    told = next(note for note in found.notes if "more were" in note)
    assert told.endswith("which stood out beside sensor_lag; nothing else was sought without them")
    time_constant = found.mechanisms[0].parameters["time_constant"]
    assert time_constant.low < 1.5 < time_constant.high
    assert found.extended.held_out["temperature_degC"]["rmse"] < 1.15 * NOISE


def test_samples_left_out_leave_the_stretches_as_they_were():
    data = prepare([lagging()]).data
    parts = split(data)
    weights = np.array(data.weights)
    weights[0, 700:702] = 0.0
    fewer = parts.with_weights(weights)
    np.testing.assert_array_equal(fewer.mask, parts.mask)
    np.testing.assert_array_equal(fewer.whole.weights, weights)
    np.testing.assert_array_equal(fewer.train.weights, np.where(parts.mask, 0.0, weights))
    gone = np.asarray(parts.whole.norm) != np.asarray(fewer.whole.norm)
    gone &= np.isfinite(np.asarray(parts.whole.norm))
    assert 1 <= gone.sum() <= 2
