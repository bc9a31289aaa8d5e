"""What a fleet shares: copper whose resistance rises alike, of actuators that lose heat and warm unlike, by scipy."""

from dataclasses import replace
from functools import cache

import numpy as np
import pytest
from scipy import stats
from scipy.integrate import solve_ivp
from scipy.signal import lfilter

from scpjax.diagnose.at_once import fit_at_once, held
from scpjax.diagnose.diagnose import diagnose
from scpjax.diagnose.evidence import Evidence, compare
from scpjax.diagnose.fleet import Member
from scpjax.diagnose.holdout import split
from scpjax.diagnose.hypothesis import State, residual_on
from scpjax.diagnose.rebuilt import Actuator, rebuilt
from scpjax.diagnose.rivals import by_law
from scpjax.diagnose.shared import HAS_IT, HAS_NOT, OPEN, SharedEffect, shared_effects, sharing
from scpjax.errors import FitError
from scpjax.fit.fit import best_start, scores
from scpjax.fit.setup import prepare
from scpjax.recordings.excitation import multilevel_random
from scpjax.recordings.recording import Metadata, Recording

COPPER, LAW, KEY = "resistance_temperature", "voltage", "resistance_temperature.coefficient"
R, AMBIENT, PERIOD, NOISE = 1.5, 295.15, 0.4, 0.15


@cache
def warmed(
    alpha: float, conductance: float, mass: float, high: float, plan: int, dead: float = 0.0, count: int = 300
) -> tuple:
    """Volts and excess temperature [K]: C dT/dt = max(V - dead, 0)^2 / (R (1 + alpha T)) - lambda T, a random level
    every 10 s.
    """
    low, duration = 0.1 * high, PERIOD * count
    time, volts = multilevel_random(duration_s=duration, period_s=PERIOD, low=low, high=high, hold_s=10, seed=plan)
    rate = lambda t, T, v: (max(v - dead, 0) ** 2 / (R * (1 + alpha * T)) - conductance * T) / mass  # noqa: E731
    warm = [np.zeros(1)]
    for i in range(len(time) - 1):
        found = solve_ivp(rate, (time[i], time[i + 1]), warm[-1], args=(volts[i],), rtol=1e-8, atol=1e-8)
        warm.append(found.y[:, -1])
    return time, volts, np.concatenate(warm)


def recording(
    name: str,
    alpha: float,
    conductance: float,
    mass: float,
    high: float,
    *,
    seed: int,
    plan: int,
    dead: float = 0.0,
    wander: float = 0.0,
) -> Recording:
    """Of one actuator, with noise, and with what is no white noise: ``wander`` [K], correlated over some 8 s."""
    time, volts, warm = warmed(alpha, conductance, mass, high, plan, dead)
    rng = np.random.default_rng(1000 + seed)
    noise = NOISE * rng.standard_normal(len(time))
    noise += wander * lfilter([np.sqrt(1 - 0.95**2)], [1.0, -0.95], rng.standard_normal(len(time) + 200))[200:]
    seen = {"temperature_degC": AMBIENT - 273.15 + warm + noise}
    known = (("resistance_ohm", R),)
    meta = Metadata(name=name, known=known, ambient_K=AMBIENT, model="te", path=f"{name}.csv")
    return Recording.from_arrays(time, {"voltage_V": volts}, seen, metadata=meta)


def actuator(r: Recording, *, named: bool = True, name: str = COPPER, law: str = LAW) -> Actuator:
    """Fitted from its data, with copper (or another mechanism) where it is named."""
    setup = prepare([r])
    parts = split(setup.data)
    trial, _, cost = best_start(setup, parts.train)
    state = State(setup, trial, residual_on(trial, parts.whole, setup), cost)
    if named:
        found = by_law(state, name, parts, close=np.inf).values()
        state = next(s for s in found if s.laws[name] == law)
    return Actuator(r.metadata.name, parts, state, {})


BASES = {"a": (0.10, 1.0, 3.4), "b": (0.13, 1.2, 3.5), "c": (0.08, 0.9, 3.0), "d": (0.11, 1.3, 3.3)}


BASE_LIST = list(enumerate(BASES.items()))


def fleet(seed: int = 0, alpha: float = 0.0039) -> list[Actuator]:
    """Four actuators of the same copper."""
    made = enumerate(BASES.items())
    return [actuator(recording(n, alpha, *base, seed=4 * seed + i, plan=i)) for i, (n, base) in made]


@pytest.fixture(scope="module")
def alike() -> list[Actuator]:
    return fleet()


def test_what_all_share_is_told_with_its_error_and_found_where_it_was_too_weak_for_a_name(alike):
    slight = recording("weak", 0.0039, 0.1, 1.0, 2.0, seed=55, plan=9)
    weak = actuator(slight, named=False)
    alone = compare(weak.state, actuator(slight).state, COPPER, LAW, weak.parts, Evidence(), 1)
    assert not alone.accepted, "by itself it has too little evidence for a name"
    none = actuator(recording("none", 0.0, 0.1, 1.0, 3.3, seed=52, plan=8), named=False)
    cold = actuator(recording("cold", 0.0039, 0.1, 1.0, 0.3, seed=53, plan=7), named=False)
    (effect,) = shared_effects([*alike, weak, none, cold]).effects
    assert (effect.name, effect.law) == (COPPER, LAW)
    assert effect.actuators == tuple(BASES)
    assert not effect.apart
    assert effect.is_shared
    assert effect.p > 0.01
    found = effect.parameters["coefficient"]
    assert found.low < 0.0039 < found.high
    own = [a.state.values[a.state.setup.structure.index[KEY]] for a in alike]
    assert np.ptp(own) > 0, "each had its own"
    assert effect.held_out[1] < effect.held_out[0] * 1.02
    assert {n: e.says for n, e in effect.elsewhere.items()} == {"weak": HAS_IT, "none": HAS_NOT, "cold": OPEN}
    assert "also in weak" in effect.says
    assert "not in none" in effect.says


def test_the_values_are_those_of_least_squares_over_all(alike):
    """By refits of each actuator beside values that are held, which the search does not use: a parabola through three
    of the sums has its bottom there, and its width is the error.
    """
    shared = fit_at_once([a.state for a in alike], [a.parts for a in alike], COPPER)
    step = np.array([0.02])

    def total(inner: np.ndarray) -> float:
        states = [held(a.state, a.parts, COPPER, inner) for a in alike]
        return sum(float(np.sum(s.residual[a.parts.is_train] ** 2)) for s, a in zip(states, alike, strict=True))

    below, here, above = total(shared.inner - step), total(shared.inner), total(shared.inner + step)
    bend = (below - 2 * here + above) / step[0] ** 2
    assert below > here < above
    assert abs((below - above) / (2 * step[0]) / bend) < 0.1 * np.sqrt(2 / bend), "a tenth of the error"
    mean_square = here / sum(int(a.parts.is_train.sum()) for a in alike)
    told = shared.estimates["coefficient"]
    share = np.mean([a.parts.is_train.sum() / (a.parts.is_train | a.parts.is_held).sum() for a in alike])
    assert told.std / told.value == pytest.approx(np.sqrt(2 * mean_square / bend * share), rel=0.2), "told of all data"
    assert told.std / told.value == pytest.approx(float(np.sum(shared.information)) ** -0.5, rel=0.02)


def test_one_with_values_of_its_own_is_told_apart(alike):
    other = actuator(recording("other", 0.0030, 0.12, 1.1, 3.3, seed=60, plan=5))
    (effect,) = shared_effects([*alike[:3], other]).effects
    assert effect.apart == ("other",)
    assert effect.actuators == ("a", "b", "c")
    assert effect.is_shared
    low, high = effect.parameters["coefficient"].low, effect.parameters["coefficient"].high
    assert low < 0.0039 < high


def test_where_each_has_its_own_nothing_is_shared(alike):
    unlike = [
        actuator(recording(f"u{i}", a, 0.11, 1.1, 3.4, seed=70 + i, plan=i)) for i, a in enumerate((0.0026, 0.0052))
    ]
    (effect,) = shared_effects([alike[0], *unlike]).effects
    assert not effect.is_shared
    assert effect.p < 1e-3
    assert not effect.elsewhere
    assert "differs from actuator to actuator" in effect.says


def test_one_under_another_law_is_asked_under_that_of_most(alike):
    bent = actuator(recording("bent", 0.0039, 0.12, 1.1, 3.3, seed=61, plan=4), law="voltage, curved")
    (effect,) = shared_effects([bent, *alike[:3]]).effects
    assert effect.law == LAW
    assert effect.actuators == ("bent", "a", "b", "c")
    assert list(effect.parameters) == ["coefficient"]


def test_values_stated_for_the_greatest_drive_are_stated_for_the_same():
    """A driver that drops 0.8 V, whatever its actuator is driven with: a share of that which differs."""
    made = enumerate(((0.1, 1.0, 3.4), (0.13, 1.2, 3.0), (0.08, 0.9, 2.6)))
    recordings = [recording(f"r{i}", 0.0, *base, seed=90 + i, plan=i, dead=0.8) for i, base in made]
    members = [actuator(r, name="drive_dead_zone", law="threshold") for r in recordings]
    alone = [a.state.values[a.state.setup.structure.index["drive_dead_zone.threshold"]] for a in members]
    assert max(alone) > 1.2 * min(alone)
    (effect,) = shared_effects(members).effects
    assert effect.is_shared
    volts, threshold = effect.references["reference"], effect.parameters["threshold"]
    assert volts == pytest.approx(np.median([r.inputs.max() for r in recordings]), rel=0.01)
    assert threshold.low * volts < 0.8 < threshold.high * volts
    assert threshold.std * volts < 0.02


def test_an_equivalent_elsewhere_is_set_against_what_all_share(alike):
    """An actuator named something else by a hair: a law of its loss that imitates copper."""
    r = recording("loss", 0.0039, 0.1, 1.1, 2.4, seed=80, plan=6)
    bare = actuator(r, named=False)
    loss = next(iter(by_law(bare.state, "nonlinear_heat_loss", bare.parts, close=np.inf).values()))
    asked = replace(bare, state=loss, stand_ins={"nonlinear_heat_loss": (COPPER,)})
    (effect,) = shared_effects([*alike, asked]).effects
    told = effect.elsewhere["loss"]
    assert told.in_place_of == "nonlinear_heat_loss"
    assert told.says == HAS_IT
    assert "also in loss (in the place of nonlinear_heat_loss)" in effect.says


def test_intervals_cover_and_a_chance_is_as_rare_as_it_says():
    """Twenty-four fleets: of 95 % intervals 20 or more hold the truth, and p is uniform where all have the same."""
    held_in, p = 0, []
    for seed in range(1, 25):
        members = fleet(seed)
        shared: SharedEffect = shared_effects(members).effects[0]
        e = shared.parameters["coefficient"]
        if shared.apart:
            p.append(0.0)
        else:
            p.append(shared.p)
        held_in += e.low < 0.0039 < e.high
    assert held_in >= stats.binom.ppf(0.005, 24, 0.95)
    assert stats.kstest(p, "uniform").pvalue > 0.005


def test_one_that_its_model_misses_counts_for_less():
    """Twelve fleets of three, the third far from the noise by a room that wanders: its own value is off by many times
    the error of the others', which it neither draws after it nor makes unlikely.
    """
    held_in, apart = 0, 0
    for seed in range(12):
        made = [(n, BASES[n], i) for i, n in enumerate("abc")]
        recordings = [
            recording(n, 0.0039, *base, seed=300 + 3 * seed + i, plan=i, wander=0.8 * (n == "c")) for n, base, i in made
        ]
        (effect,) = shared_effects([actuator(r) for r in recordings]).effects
        e = effect.parameters["coefficient"]
        held_in += e.low < 0.0039 < e.high
        apart += effect.differs
    assert held_in >= stats.binom.ppf(0.005, 12, 0.95)
    assert apart <= 1


def test_a_law_of_two_values_shares_both():
    curved = [
        actuator(recording(n, 0.0039, *b, seed=400 + i, plan=i), law="voltage, curved") for i, (n, b) in BASE_LIST
    ]
    (effect,) = shared_effects(curved).effects
    assert list(effect.parameters) == ["coefficient", "curvature"]
    assert effect.is_shared
    for key, truth in (("coefficient", 0.0039), ("curvature", 0.0)):
        e = effect.parameters[key]
        assert truth - 3 * e.std < e.value < truth + 3 * e.std


def content(a: Actuator) -> dict:
    """What the diagnosis of an actuator says of its model."""
    setup, parts = a.state.setup, a.parts
    keys, values = setup.space.keys, a.state.values
    each = {k: {"value": float(v)} for k, v in zip(keys, values, strict=True) if not k.startswith("recording_")}
    own = {k.split(".")[1]: e for k, e in each.items() if k == KEY}
    base = {k: e for k, e in each.items() if k.split(".")[0] in ("newton_cooling", "sensor_offset")}
    named = {"name": COPPER, "law": LAW, "parameters": own, "by_recording": [], "equivalents": [], "probability": 0.9}
    return {
        "base": {"model": "te"},
        "extended": {"train": scores(setup, parts.whole, a.state.trial, np.asarray(parts.train.weights))},
        "mechanisms": [named] if a.state.names else [],
        "parameters": base,
        "closure": None,
        "settings": {"bin": setup.data.bin, "order": 2, "substeps": None},
    }


def test_a_fleet_is_asked_from_what_its_diagnoses_say():
    recordings = {n: [recording(n, 0.0039, *b, seed=i, plan=i)] for i, (n, b) in enumerate(BASES.items())}
    found = {n: actuator(rs[0]) for n, rs in recordings.items()}
    told = {n: content(a) for n, a in found.items()}
    again = rebuilt("a", told["a"], recordings["a"])
    assert again.state.values[:-1] == pytest.approx(found["a"].state.values[:-1], rel=2e-3, abs=2e-3)
    told["b"] = {**told["b"], "closure": {"expression": "a T^2"}}
    told["c"]["extended"]["train"]["temperature_degC"]["rmse"] *= 0.5
    members = [*(Member(n, c) for n, c in told.items()), Member("lost", None, "no columns")]
    asked = sharing(members, recordings)
    assert list(asked.left_out) == ["b", "c"]
    assert "not mechanisms alone" in asked.left_out["b"]
    assert "misses temperature_degC by" in asked.left_out["c"]
    assert asked.effects[0].actuators == ("a", "d")
    wrong = {**told["a"], "parameters": {"newton_cooling.speed": {"value": 1.0}}}
    with pytest.raises(FitError, match="no parameter 'newton_cooling"):
        rebuilt("a", wrong, recordings["a"])


def test_what_is_diagnosed_is_fitted_again_as_it_was():
    recordings = [recording("a", 0.0039, *BASES["a"], seed=0, plan=0)]
    told = diagnose(recordings).to_json()
    assert [m["name"] for m in told["mechanisms"]] == [COPPER]
    again = rebuilt("a", told, recordings)
    setup, trial = again.state.setup, again.state.trial
    found = scores(setup, again.parts.whole, trial, np.asarray(again.parts.train.weights))["temperature_degC"]["rmse"]
    assert found == pytest.approx(told["extended"]["train"]["temperature_degC"]["rmse"], rel=1e-3)


def test_nothing_is_fitted_again_where_no_effect_is_in_two(monkeypatch):
    member = Member("a", {"mechanisms": [{"name": COPPER, "probability": 1.0, "equivalents": []}]})
    monkeypatch.setattr("scpjax.diagnose.shared.rebuilt", lambda *a: pytest.fail("was fitted"))
    assert sharing([member, Member("b", {"mechanisms": []})], {}).effects == ()
