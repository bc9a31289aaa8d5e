"""Intervals by profile likelihood: of a threshold between two levels, against scipy's own profile, and as often right
as they say."""

from functools import cache
from itertools import pairwise

import numpy as np
import pytest
import scipy.integrate
import scipy.optimize
from diagnose.heated import base_of

from scpjax.diagnose import intervals
from scpjax.diagnose.final import fitted_to_all
from scpjax.diagnose.hypothesis import moving_parameters
from scpjax.diagnose.intervals import profiled
from scpjax.diagnose.own import with_own
from scpjax.diagnose.patience import Patience
from scpjax.diagnose.rivals import added
from scpjax.diagnose.trials import under_law
from scpjax.fit.fit import refine
from scpjax.fit.identifiability import estimates, uncertainty
from scpjax.recordings.recording import Metadata, Recording

RESISTANCE, LOSS, MASS, AMBIENT, NOISE = 1.2, 0.14, 1.1, 294.0, 0.15
STEP = 0.5  # [s]
STRENGTH, POWER = 0.5, 0.6  # of the loss at 40 K beyond LOSS T


def heated(volts: np.ndarray, seed: int, strength: float = 0.0, power: float = POWER) -> Recording:
    """By scipy: a wire that loses LOSS T (1 + strength (T/40)^power)."""
    time = STEP * np.arange(len(volts))
    read = temperature(volts, RESISTANCE, LOSS, MASS, strength, power) + AMBIENT - 273.15
    read = read + NOISE * np.random.default_rng(seed).standard_normal(len(time))
    meta = Metadata(name=f"heated {seed}", known=(("resistance_ohm", RESISTANCE),), ambient_K=AMBIENT, model="te")
    return Recording.from_arrays(time, {"voltage_V": volts}, {"temperature_degC": read}, metadata=meta)


def temperature(volts, resistance, loss, mass, strength, power, start=0.0) -> np.ndarray:
    """[K] above the room, at every sample, by scipy with steps of its own."""
    changes = [0, *(np.flatnonzero(np.diff(volts)) + 1), len(volts)]
    out, now = np.empty(len(volts)), start
    for a, b in pairwise(changes):

        def rate(_t, z, power_in=volts[a] ** 2 / resistance):
            return (power_in - loss * z * (1.0 + strength * np.abs(z / 40.0) ** power)) / mass

        at = STEP * np.arange(b - a + 1)
        z = scipy.integrate.solve_ivp(rate, (0.0, at[-1]), [now], t_eval=at, rtol=1e-8, atol=1e-9).y[0]
        out[a:b], now = z[:-1], z[-1]
    return out


def held(*levels: float, seconds: float = 12.0) -> np.ndarray:
    return np.repeat(levels, int(seconds / STEP)).astype(float)


def of_named(name: str, *recordings: Recording, law: str = ""):
    """(setup, trial, data, doubt, estimates by the Jacobian) of the base model with one mechanism, under a law or that
    which fits best, fitted to all.
    """
    base, parts = base_of(*recordings)
    state = added(base, name, parts)
    state = (under_law(state, name, law, parts) if law else None) or state
    trial, data = fitted_to_all(parts, state)
    doubt = uncertainty(trial, data, state.setup.space)
    return state.setup, trial, data, doubt, estimates(trial, state.setup.space, doubt)


LOW, CUT, HIGH = 1.4, 1.9, 2.4  # [V]
LEVELS = (3.0, LOW, HIGH, 0.0, LOW, 3.6, HIGH, 2.8, LOW, 0.0, HIGH, 3.3)


def test_a_threshold_between_two_levels_may_be_anywhere_between_them():
    """Nothing below CUT reaches the wire, and nothing was driven between LOW and HIGH."""
    volts = held(*LEVELS)
    asked = heated(np.where(volts < CUT, 0.0, volts), 1)
    recording = Recording.from_arrays(
        asked.time, {"voltage_V": volts}, {"temperature_degC": asked.outputs[:, 0] - 273.15}, metadata=asked.metadata
    )
    setup, trial, data, doubt, every = of_named("drive_dead_zone", recording)
    found = profiled(setup, trial, data, doubt, every)
    greatest = setup.fixed[setup.structure.index["drive_dead_zone.reference"]]
    by_jacobian, by_profile = (
        [greatest * v for v in (e["drive_dead_zone.threshold"].low, e["drive_dead_zone.threshold"].high)]
        for e in (every, found)
    )
    assert by_profile[0] < LOW + 0.2 * (HIGH - LOW)
    assert by_profile[1] > HIGH - 0.2 * (HIGH - LOW)
    assert by_profile[0] > LOW - 0.1
    assert by_profile[1] < HIGH + 0.1
    assert np.diff(by_jacobian) < 0.5 * np.diff(by_profile) or np.diff(by_jacobian) > 2.0 * np.diff(by_profile)


@cache
def lossy(seed: int):
    drives = (held(1.0, 2.0, 3.0, 1.5, 0.0, 2.5), held(3.6, 0.5, 2.8, 0.0, 3.2, 1.2))
    recordings = (heated(v, 2 * seed + i, STRENGTH) for i, v in enumerate(drives))
    return of_named("nonlinear_heat_loss", *recordings, law="power")


def test_at_the_ends_the_sum_of_squares_has_risen_by_as_much_as_it_must():
    """Scipy fits the same law with the exponent held at an end of its interval, by a simulation of its own."""
    setup, trial, data, doubt, every = lossy(3)
    key = "nonlinear_heat_loss.exponent"
    found = profiled(setup, trial, data, doubt, every)[key]
    drives = [r.inputs[:, 0] for r in setup.recordings]
    reads = [r.outputs[:, 0] for r in setup.recordings]

    def least(power: float | None) -> float:
        def residual(x):
            loss, mass, strength, of = np.exp(np.clip(x[:4], -6.0, 3.0))
            runs = zip(drives, reads, x[4:6], strict=True)
            at = [
                temperature(u, RESISTANCE, loss, mass, strength, of if power is None else power, t) for u, _, t in runs
            ]
            return np.concatenate([(t + x[6] - y) / NOISE for t, y in zip(at, reads, strict=True)])

        first = [*np.log([0.2, 1.4, 0.3, 0.8]), 0.0, 0.0, AMBIENT]
        return 2.0 * scipy.optimize.least_squares(residual, first, x_scale=0.1).cost

    best = least(None)
    variance = best / (sum(map(len, reads)) - 7)  # of the residuals, in units of the noise's
    for end in (found.low, found.high):
        assert np.sqrt((least(end) - best) / variance) == pytest.approx(1.96, abs=0.3)
    assert (every[key].low, every[key].high) != (found.low, found.high)


def test_intervals_cover_as_often_as_they_say():
    inside = {"strength": 0, "exponent": 0}
    seeds = range(24)
    for seed in seeds:
        setup, trial, data, doubt, every = lossy(seed)
        found = profiled(setup, trial, data, doubt, every)
        at = float(setup.fixed[setup.structure.index["nonlinear_heat_loss.reference"]])
        true = {"strength": STRENGTH * (at / 40.0) ** POWER, "exponent": POWER}
        for name, value in true.items():
            e = found[f"nonlinear_heat_loss.{name}"]
            inside[name] += e.low <= value <= e.high
    assert min(inside.values()) >= 20, inside  # of 24: fewer in 1 % of such tests


def test_none_is_sought_late():
    setup, trial, data, doubt, every = lossy(3)
    late = Patience(0.0, 0.0)
    assert profiled(setup, trial, data, doubt, every, late) == every
    assert "intervals by profile likelihood" in late.notes()[-1]


def test_an_end_that_was_not_found_in_time_stays_as_it_was(monkeypatch):
    """Patience that runs out after the ends were looked at once: what was tried by then is no end."""
    setup, trial, data, doubt, every = lossy(3)
    answers = iter([False, False, True])
    patience = Patience()
    monkeypatch.setattr(patience, "late", lambda what: next(answers))
    monkeypatch.setattr(intervals, "_CLOSE", 0.0)
    found = profiled(setup, trial, data, doubt, every, patience)
    assert found == every
    assert next(answers, None) is None


@pytest.mark.parametrize("key", ["nonlinear_heat_loss.strength", "nonlinear_heat_loss.exponent"])
def test_values_that_differ_by_recording_have_intervals_too(key):
    """Held, such a value leaves its place to one that all recordings depend on: shapes must not differ for that."""
    setup, trial, *_ = lossy(3)
    data = setup.data
    own = with_own(setup, key)
    laws = np.asarray(trial.laws)
    first = np.asarray(own.starts[0]).copy()
    moves = moving_parameters(own, laws)
    for width in range(int(moves.sum()), int(moves.sum()) + 4):
        begun = own.trial(first, moves, laws, width)
        found, _, _ = refine(own, data, begun)
        doubt = uncertainty(found, data, own.space)
        every = estimates(found, own.space, doubt)
        told = profiled(own, found, data, doubt, every)
        mine = [k for k in told if k.startswith(f"{key}@")]
        assert len(mine) == 2
        assert all(told[k].low < told[k].value < told[k].high for k in mine)
