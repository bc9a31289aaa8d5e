"""The last fit: by steps so short that the parameters are the actuator's, and not the integrator's."""

from functools import cache
from types import SimpleNamespace

import numpy as np
import pytest
from scipy import signal
from scipy.integrate import solve_ivp

from scpjax.diagnose import final
from scpjax.diagnose.diagnose import _base
from scpjax.diagnose.final import fitted_to_all, resolved
from scpjax.diagnose.hypothesis import from_their_starts, grown, trial_at
from scpjax.diagnose.patience import Patience
from scpjax.diagnose.trials import at_rest
from scpjax.fit.colour import Whitener
from scpjax.fit.data import Data
from scpjax.fit.fit import final_model
from scpjax.fit.predict import predict
from scpjax.fit.problem import CEILING
from scpjax.fit.setup import prepare
from scpjax.fit.solve import outputs_of
from scpjax.physics.catalogue import mechanism
from scpjax.recordings import Metadata, Recording

NOISE_MM, NOISE_K, PERIOD = 0.004, 0.02, 0.2
R, LAM, C_TH, C, K, BETA, M = 1.2, 0.15, 0.9, 0.03, 200.0, 8.0, 0.3
STRENGTH, WIDTH, SHARP = 0.8, 4e-4, 1.5


def hysteretic(volts: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """(K above ambient, m) of a plant beside whose spring a Bouc-Wen element slips, integrated by LSODA."""

    def rates(_t, s, power):
        warm, x, v, z = s
        slip = v / WIDTH * (1 - abs(z) ** SHARP * (1 + np.sign(v * z)) / 2)
        force = C * warm - K * x - BETA * v - STRENGTH * K * WIDTH * z
        return [(power - LAM * warm) / C_TH, v, force / M, slip]

    states, z = [np.zeros(4)], np.zeros(4)
    for v in volts[:-1]:
        z = solve_ivp(rates, (0, PERIOD), z, "LSODA", args=(v**2 / R,), rtol=1e-8, atol=1e-11, max_step=0.02).y[:, -1]
        states.append(z)
    return np.array(states)[:, 0], np.array(states)[:, 1]


@cache
def recording(seed: int, hold_s: float) -> Recording:
    rng = np.random.default_rng(seed)
    n = 500
    levels = rng.choice([0.0, 1.5, 2.5, 3.3, 4.0], size=n)
    volts = np.repeat(levels, round(hold_s / PERIOD))[:n]
    volts[:5] = 0.0
    warm, x = hysteretic(volts)
    columns = {
        "temperature_degC": 22.0 + warm + NOISE_K * rng.standard_normal(n),
        "displacement_mm": 1e3 * x + NOISE_MM * rng.standard_normal(n),
    }
    meta = Metadata(
        name=f"hold_{hold_s:g}", known=(("resistance_ohm", R), ("moving_mass_kg", M)), model="plant", ambient_K=295.15
    )
    return Recording.from_arrays(PERIOD * np.arange(n), {"voltage_V": volts}, columns, metadata=meta)


@cache
def fitted():
    given = (recording(1, 5.0), recording(2, 12.0))
    parts, base, _ = _base(prepare(given))
    problem = grown(base.setup, mechanism("hysteresis"))
    laws = np.zeros(len(problem.structure.mechanisms))
    state = at_rest(problem, parts, [trial_at(problem, v, laws) for v in from_their_starts(problem, laws)])
    return parts, state


def test_steps_divided_are_those_of_data_packed_so():
    parts, state = fitted()
    data: Data = parts.whole
    finer = data.finer(3)
    packed = prepare(state.setup.recordings, bin=data.bin, substeps=3).data
    assert finer.bin == packed.bin == 3 * data.bin
    np.testing.assert_allclose(finer.target, data.target)
    np.testing.assert_allclose(finer.norm, data.norm)
    steps = min(np.asarray(d.grids.effort).shape[1] for d in (finer, packed))
    np.testing.assert_allclose(finer.grids.effort[:, :steps], packed.grids.effort[:, :steps], atol=1e-12)
    space = state.setup.space
    n = min(finer.outputs.shape[1], packed.outputs.shape[1])
    seen = np.asarray(data.weights)[:, :n] > 0
    one, other = (np.asarray(outputs_of(state.trial, d, space))[:, :n] for d in (finer, packed))
    np.testing.assert_allclose(one[seen], other[seen], rtol=1e-9)


def test_the_last_fit_does_not_make_up_for_long_steps():
    """Fitted by steps as long as a sample, the width is off; by short ones it is the actuator's, and what the given
    drives hardly show is predicted to the noise."""
    parts, state = fitted()
    fine, again, notes = resolved(state, parts)
    assert notes == ()
    assert fine.whole.bin > parts.whole.bin
    assert np.array_equal(fine.is_held, parts.is_held)

    def found(split, start):
        trial, _ = fitted_to_all(split, start)
        return final_model(state.setup, trial)

    coarse, model = found(parts, state), found(fine, again)
    reference = float(model.value("hysteresis.reference"))
    off = [abs(float(m.value("hysteresis.width")) * reference / WIDTH - 1) for m in (coarse, model)]
    assert off[1] < 0.05
    assert off[1] < 0.5 * off[0]
    kept = recording(3, 60.0)
    error = []
    for m in (coarse, model):
        _, said = predict(m, kept, noise={"displacement_mm": NOISE_MM, "temperature_degC": NOISE_K})
        error.append(float(np.sqrt(np.mean((said["displacement_mm"] - 1e3 * kept.output("displacement")) ** 2))))
    assert error[1] < 1.15 * NOISE_MM
    assert error[1] < error[0]


def test_what_is_resolved_stays_as_it_is():
    parts, state = fitted()
    base = grown(state.setup)
    simple = _base(prepare(base.recordings))
    assert resolved(simple[1], parts) == (parts, simple[1], ())


def test_where_no_steps_are_short_enough_it_says_so(monkeypatch):
    monkeypatch.setattr(final, "_FINE", 2)
    monkeypatch.setattr(final, "_FINEST", 2)
    monkeypatch.setattr(final, "_HIGHER", 2)
    parts, state = fitted()
    fine, _, notes = resolved(state, parts)
    assert fine.whole.bin == 2 * parts.whole.bin
    assert "2 steps a sample" in notes[0]


def _refitted(monkeypatch, changes, seconds=0.0, *, before=1, nodes=100, blows_up_by=np.inf):
    """What comes of a fit by 8 steps a sample (``before`` of them already in the data), where halving the steps changes
    predictions by ``changes`` in turn; by which it was refitted, and the notes."""
    left = iter(changes)
    whole = SimpleNamespace(bin=2 * before, grids=SimpleNamespace(effort=np.zeros((2, nodes, 1))))
    state = lambda factor: SimpleNamespace(setup=SimpleNamespace(data=SimpleNamespace(bin=2)), by=factor)  # noqa: E731
    monkeypatch.setattr(final, "_outputs", lambda *_: None)
    monkeypatch.setattr(final, "_change", lambda *_: next(left))
    again = lambda _s, _parts, factor: (factor, None if factor >= blows_up_by else state(factor))  # noqa: E731
    monkeypatch.setattr(final, "fitted_finer", again)
    first = 8 // before
    args = (first, state(first), SimpleNamespace(whole=whole), first, Patience(20.0), seconds)
    finer, found, notes = final._by_still_shorter(*args)  # type: ignore[arg-type]
    assert finer == found.by  # type: ignore[attr-defined]
    assert next(left, None) is None
    return finer, notes


@pytest.mark.parametrize(
    ("changes", "by"),
    [([0.05], 8), ([0.4, 0.05], 16), ([0.4, 0.4, 0.4], 32)],  # what was refitted may be resolved at once
)
def test_what_is_refitted_is_by_still_shorter_steps_until_they_change_little(monkeypatch, changes, by):
    found, notes = _refitted(monkeypatch, changes)
    assert found == by
    assert len(notes) == (changes[-1] > 0.1)
    assert all(f"{by} steps a sample" in n for n in notes)


def test_no_shorter_steps_are_tried_than_there_is_time_or_room_for(monkeypatch):
    assert _refitted(monkeypatch, [0.4], seconds=10.0)[0] == 8  # half as long ones might take 30 s of 20
    found, (note,) = _refitted(monkeypatch, [], nodes=150_000)
    assert found == 8
    assert "8 steps a sample" in note
    assert "was not tried" in note
    found, (note,) = _refitted(monkeypatch, [0.4, 0.4, 0.4], before=4)
    assert found == 8  # on data that were simulated by a quarter of their steps before
    assert "32 steps a sample" in note


def test_where_still_shorter_steps_blow_up_it_stays_by_those_that_did_not(monkeypatch):
    for changes, how in (([0.4], {"blows_up_by": 16}), ([np.nan], {"seconds": 10.0})):
        found, (note,) = _refitted(monkeypatch, changes, **how)
        assert found == 8
        assert "with 8 steps a sample, and by half as long ones its predictions blow up" in note


def test_what_was_fitted_by_shorter_steps_is_asked_again_on_the_same_data():
    parts, state = fitted()
    finer, refitted, notes = resolved(state, parts)
    assert notes == ()
    assert resolved(refitted, finer) == (finer, refitted, ())


def test_late_it_is_not_refitted_by_shorter_steps_and_says_what_they_would_change():
    parts, state = fitted()
    patience = Patience(0.0, 0.0)
    fine, same, (note,) = resolved(state, parts, patience)
    assert (fine, same) == (parts, state)
    assert "too late to fit it by shorter ones" in note
    assert "the last fit by shorter steps" in patience.notes()[-1]


def test_what_blows_up_by_shorter_steps_is_told_as_it_was_found(monkeypatch):
    """A fit that holds by the errors of long steps alone has no uncertainty by short ones: nothing there is finite."""
    parts, state = fitted()
    cut_off = state.residual.copy()
    cut_off[0, -1, 0] = CEILING
    monkeypatch.setattr(final, "residual_on", lambda *_: cut_off)
    same, found, notes = resolved(state, parts)
    assert same is parts
    assert found is state
    assert "blow up" in notes[0]


@pytest.mark.parametrize(("farther", "taken"), [(1.02, True), (1.2, False)])
def test_a_fit_to_coloured_residuals_may_miss_the_samples_by_little_more(monkeypatch, farther, taken):
    """What the filter takes out nothing holds: where that leads far off, the plain fit is told."""
    size = (2, 300, 1)
    noise = np.random.default_rng(0).standard_normal(size)
    residual = signal.lfilter([1.0], [1.0, -0.8], noise, axis=1)
    whole = SimpleNamespace(with_colour=lambda colour: "coloured")
    train = SimpleNamespace(with_colour=lambda colour: "coloured")
    parts = SimpleNamespace(whole=whole, train=train, is_train=np.ones(size, bool), is_held=np.ones(size, bool))
    missed = {"plain": 1.0, "coloured": farther}
    monkeypatch.setattr(
        final, "refine", lambda s, data, t, **_: ("coloured" if data == "coloured" else "plain", True, 0.0)
    )
    monkeypatch.setattr(final, "residual_on", lambda trial, *_: missed[trial] * residual)
    monkeypatch.setattr(Whitener, "__call__", lambda self, r, there: (1.0, 1))  # filtered, both predict the same
    state = SimpleNamespace(setup=None, residual=residual, trial="begun")
    assert fitted_to_all(parts, state)[0] == ("coloured" if taken else "plain")  # type: ignore[arg-type]
    late = Patience(0.0, 0.0)
    assert fitted_to_all(parts, state, late) == ("plain", whole)  # type: ignore[arg-type]
    assert "filter for coloured residuals" in late.notes()[-1]
