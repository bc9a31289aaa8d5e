"""An effect under a law that the catalogue does not hold: named by what it depends on, where a curve is enough."""

from dataclasses import replace

import numpy as np
import pytest
from diagnose.creeping import BASE
from diagnose.heated import DRIVE, LOSS, TIME, base_of, lacking_in, nothing, recorded, rubbed_by_air
from scipy.signal import lfilter

from scpjax.diagnose.answer import TRUSTED, answer
from scpjax.diagnose.choice import Choice
from scpjax.diagnose.curve import curves, drives_differ
from scpjax.diagnose.diagnose import diagnose
from scpjax.diagnose.distil import given
from scpjax.diagnose.evidence import Evidence, at_its_least, compare
from scpjax.diagnose.expression import in_words
from scpjax.diagnose.free import free_law, named_by, nameless, one_for_several
from scpjax.diagnose.hypothesis import State
from scpjax.diagnose.patience import Patience
from scpjax.diagnose.remainder import level
from scpjax.diagnose.result import Ranked
from scpjax.diagnose.rivals import Outcome, added, rivals
from scpjax.fit.setup import prepare
from scpjax.physics.catalogue import catalogue, mechanism
from scpjax.physics.mechanisms.learned_force_curve import LearnedForceCurve
from scpjax.physics.mechanisms.learned_heat_curve import LearnedHeatCurve
from scpjax.physics.mechanisms.learned_reading_curve import LearnedReadingCurve
from scpjax.recordings import excitation
from scpjax.recordings.recording import Recording


def softest(temperature: float) -> float:
    """Softest about 30 K and stiffer again beyond: no law of the catalogue."""
    return 1.0 - 0.15 * np.exp(-(((temperature - 30.0) / 20.0) ** 2))


def test_a_spring_that_softens_and_stiffens_again_is_a_softening_by_a_curve():
    found = diagnose([recorded(nothing, stiff=softest, quiet=0.2)])
    assert found.verdict == "explained"
    (m,) = found.mechanisms
    assert (m.name, m.law, m.subsystem) == ("thermal_softening", "free form", "thermomechanical")
    assert found.location.subsystem == "thermomechanical"
    assert found.closure is not None
    assert found.closure.curve is not None
    assert found.closure.expression in found.says
    assert 0.5 < m.probability <= TRUSTED["explained"]
    curve = found.closure.curve  # N/mm against the spring, with its band
    k = found.base_parameters["elastic_spring.stiffness"].value
    warm = curve.at > 2.0
    lost = -curve.value[warm] * 1e3
    # stiffness and curve together are what was made, up to a factor that the pull's own coefficient takes up
    whole = k - lost
    made = np.array([softest(t) for t in curve.at[warm]])
    scale = float(whole @ made / (made @ made))
    np.testing.assert_allclose(whole / scale, made, atol=0.06)
    assert list(m.parameters) == ["s1", "s2", "s3", "s4"]
    middle, far = m.parameters["s2"], m.parameters["s4"]
    assert middle.unit == "N/m"
    assert middle.value == pytest.approx(1e3 * np.interp(curve.at[-1] / 2, curve.at, curve.value))
    assert far.value == pytest.approx(1e3 * curve.value[-1])
    assert far.low < far.value < far.high
    text = found.to_json()
    assert text["mechanisms"][0]["law"] == "free form"


def test_no_name_for_a_curve_that_is_no_mechanism():
    """A loss that grows with the displacement has no name, whatever a curve of the temperature makes of it."""
    base, parts = base_of(recorded(rubbed_by_air))
    assert free_law(base, base, parts, Evidence()) is None


def test_a_law_of_the_catalogue_that_does_as_well_is_not_given_up():
    base, parts = base_of(recorded(lambda _t, temperature, _x: 0.3 * LOSS * temperature * (temperature / 40.0)))
    named = added(base, "nonlinear_heat_loss", parts)
    assert free_law(base, named, parts, Evidence()) is None
    assert free_law(base, base, parts, Evidence()) is not None


def test_what_no_mechanism_is_and_predicts_the_same_as_a_single_name_is_told():
    """Where the contraction follows the temperature, a loss that grows with either is one."""
    base, parts = base_of(recorded(lambda _t, temperature, _x: 0.3 * LOSS * temperature * (temperature / 40.0)))
    named = Choice(added(base, "nonlinear_heat_loss", parts), (), {"nonlinear_heat_loss": 1.0}, {})
    found = nameless(base, named, parts, Evidence())
    assert "heat lost = T s(x)" in [in_words(c) for c in found]
    assert not any(c.form.names for c in found)
    rivals_ = rivals(Outcome(base, named.state, None, (), {}, {in_words(c): c.state for c in found}), parts)
    assert list(rivals_)[:2] == ["nonlinear_heat_loss", in_words(found[0])]
    binned, lacking = lacking_in(base, parts)
    told = answer(parts, base, named, None, binned, lacking, as_well=found, notes=(), patience=Patience(), settings={})
    assert "heat lost = T s(x)" in told.to_json()["mechanisms"][0]["as_well"]
    softens = Choice(added(base, "thermal_softening", parts), (), {}, {})
    assert nameless(base, softens, parts, Evidence()) == (), "it does not reach the noise"
    two = Choice(added(named.state, "sensor_lag", parts), (), {}, {})
    assert nameless(base, two, parts, Evidence()) == ()


def held_back(volts: np.ndarray) -> np.ndarray:
    """V^2 that a driver keeps back, hardly any before it limits its current: by no law of the catalogue."""
    return volts**2 - (volts * (1.0 - 0.35 * (volts / 4.0) ** 4)) ** 2


def starved(t: float, _temperature: float, _x: float) -> float:
    """Heating that is lost in the driver."""
    return BASE["joule_heating.gain"] * float(held_back(DRIVE[min(int(t / 0.1 + 1e-6), len(DRIVE) - 1)]))


def test_a_drive_that_reaches_the_wire_by_a_law_of_its_own_goes_by_the_nearest_name():
    base, parts = base_of(recorded(starved, quiet=0.2))
    sag = added(base, "supply_sag", parts)
    free = free_law(base, sag, parts, Evidence())
    assert free is not None
    assert free.curve.form.variable == "effort"
    assert level(free.curve.state, parts) < 1.1 < level(sag, parts)
    for near in ("supply_sag", "drive_dead_zone"):
        ranking = tuple(Ranked(n, 10.0 + (n == near), 0.5, 0.5) for n in ("drive_dead_zone", "supply_sag"))
        choice = free.choice(base, Choice(sag, ranking, {}, {}))
        assert choice.free == near
        assert set(choice.equivalents[near]) | {near} >= {"supply_sag", "drive_dead_zone"}
    binned, lacking = lacking_in(base, parts)
    said = answer(parts, base, choice, free.curve, binned, lacking, notes=(), patience=Patience(), settings={})
    assert said.closure is not None
    assert "which can take up a straight part of it" in said.says
    assert said.closure.expression in said.says
    drawn = said.closure.curve
    assert drawn is not None
    # nothing tells how much of it is the heater's gain: the band, wide only where no level was near, is beside that
    assert 1.96 * np.median(drawn.std) < 0.05 * np.max(np.abs(drawn.value))
    volts = np.sqrt(drawn.at)
    made = held_back(volts)
    both = np.stack([drawn.at, drawn.value / BASE["joule_heating.gain"]], axis=1)
    weights = np.linalg.lstsq(both, made, rcond=None)[0]
    np.testing.assert_allclose(both @ weights, made, atol=0.03 * np.max(made))


def test_a_band_beside_what_is_told_is_the_normal_distributions():
    root = np.random.default_rng(0).standard_normal((6, 6)) * np.array([1e-3, 1.0, 50.0, 1.0, 1e4, 1.0])[:, None]
    covariance = root @ root.T
    these, held = [1, 4, 5], [0, 2, 3]
    wanted = np.linalg.inv(np.linalg.inv(covariance)[np.ix_(these, these)])
    np.testing.assert_allclose(given(covariance, these, held), wanted, rtol=1e-6)
    np.testing.assert_allclose(given(covariance, these, []), covariance[np.ix_(these, these)])


def test_a_drift_by_a_law_of_its_own_is_told_by_two_drives_not_by_one():
    slips = 0.4 * np.log1p(TIME / 0.5) / np.log1p(240.0)  # mm, the most at once and ever less
    _, other = excitation.multilevel_random(duration_s=120, period_s=0.1, hold_s=6, low=0, high=4, seed=8)
    both = [recorded(nothing, rattle=slips, quiet=0.2, drive=drive) for drive in (DRIVE, other)]
    assert drives_differ(both)
    assert not drives_differ([both[0], both[0]])
    base, parts = base_of(*both)
    named = added(base, "sensor_drift", parts)
    free = free_law(base, named, parts, Evidence())
    assert free is not None
    assert free.names[0] == "sensor_drift"
    assert (free.curve.form.variable, free.curve.form.of) == ("time", "displacement")
    assert level(free.curve.state, parts) < 1.15 < level(named, parts)
    base, parts = base_of(both[0])
    assert all(c.form.variable != "time" for c in curves(base, parts, Evidence(), allowed=lambda form: True))


def test_one_mechanism_by_a_curve_stands_for_two_that_do_no_better():
    base, parts = base_of(recorded(lambda _t, temperature, _x: 0.3 * LOSS * temperature * (temperature / 40.0)))
    one = added(base, "nonlinear_heat_loss", parts)
    for second, found in (("resistance_temperature", True), ("slack", False)):
        both = added(one, second, parts)
        chance = {"nonlinear_heat_loss": 0.9, second: 0.6}
        free = one_for_several(base, Choice(both, (), chance, {}), parts, Evidence())
        assert (free is not None) == found
        if free is not None:
            assert free.names[0] == "nonlinear_heat_loss"
            assert free.probability == 0.6
    assert one_for_several(base, Choice(one, (), chance, {}), parts, Evidence()) is None


@pytest.mark.parametrize("curve", [LearnedForceCurve, LearnedHeatCurve, LearnedReadingCurve])
def test_forms_go_by_names_of_the_catalogue_in_the_same_balance(curve):
    for form in curve.forms:
        where = (
            "drive" if (form.factor, form.variable) == ("", "effort") and curve is LearnedHeatCurve else curve.subsystem
        )
        for name in form.names:
            assert catalogue()[name].subsystem == where


def at_strength(state: State, name: str, value: float) -> State:
    """The hypothesis with another strength of a mechanism, its residual as it was."""
    setup = state.setup
    values = state.values
    values[setup.structure.index[f"{name}.{mechanism(name).parameters[0].name}"]] = value
    trial = setup.trial(values, np.asarray(state.trial.active), np.asarray(state.trial.laws), len(state.trial.index))
    return replace(state, trial=trial)


def test_a_strength_at_its_least_is_no_evidence():
    base, parts = base_of(recorded(lambda _t, temperature, _x: 0.3 * LOSS * temperature * (temperature / 40.0)))
    named = added(base, "nonlinear_heat_loss", parts)
    least = mechanism("nonlinear_heat_loss").parameters[0].bounds[0]
    for strength, counts in ((2.0 * least, True), (1.01 * least, False)):
        after = at_strength(named, "nonlinear_heat_loss", strength)
        assert at_its_least(after, "nonlinear_heat_loss") != counts
        found = compare(base, after, "nonlinear_heat_loss", "power", parts, Evidence(), 2)
        assert found.accepted == counts
    assert not at_its_least(named, "closure")


@pytest.mark.parametrize(
    ("column", "names"),
    [("voltage_V", ("supply_sag", "drive_dead_zone")), ("current_A", ("drive_dead_zone",)), ("power_W", ())],
)
def test_a_curve_goes_by_no_name_that_cannot_act_here(column, names):
    """What a source of power keeps to itself is no sag of a supply."""
    time = 0.1 * np.arange(200)
    drive = 1.0 + (time % 10 > 5)
    excess = np.asarray(lfilter([0.05], [1, -0.95], drive)) + 0.01 * np.random.default_rng(0).normal(size=time.size)
    setup = prepare([Recording.from_arrays(time, {column: drive}, {"temperature_degC": 20 + excess})])
    form = next(f for f in catalogue()["learned_heat_curve"].forms if (f.factor, f.variable) == ("", "effort"))
    assert named_by(form, setup) == names
