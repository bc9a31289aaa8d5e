"""Effects outside the catalogue: what is missing is found where it is, and learned as an expression, without a name."""

from dataclasses import replace
from functools import cache
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest
from diagnose.creeping import AMBIENT, BASE
from diagnose.heated import DRIVE, LOSS, TIME, base_of, nothing, recorded, rubbed_by_air

from scpjax.diagnose import outside
from scpjax.diagnose.answer import TRUSTED, _nearest, _subsystem, answer
from scpjax.diagnose.closure import Learned, learn, offers
from scpjax.diagnose.evidence import Evidence
from scpjax.diagnose.holdout import Split
from scpjax.diagnose.latent import Misfit, missing
from scpjax.diagnose.locate import observe
from scpjax.diagnose.outside import (
    AT_NOISE,
    able,
    beyond_names,
    form_at_most,
    form_rather_than_name,
    level,
    takes_most,
)
from scpjax.diagnose.rivals import added
from scpjax.diagnose.select import Choice
from scpjax.diagnose.trials import State, strained
from scpjax.fit import identifiability
from scpjax.physics.terms import Term

ROOT = Path(__file__).resolve().parents[2]
DRAUGHT = np.where((TIME > 30) & (TIME < 75), -0.25 * np.sin((TIME - 30) / 45 * np.pi) ** 2, 0.0)  # [W]


@cache
def rubbed() -> tuple[State, Split]:
    return base_of(recorded(rubbed_by_air))


def lacking_in(base: State, parts: Split):
    binned = observe(base.setup, parts.whole, base.trial, base.residual)
    return binned, missing(Misfit(base.setup, parts.whole, base.trial, binned))


def test_a_draught_is_found_in_the_heat_balance_when_it_blew():
    """A loss that depends on nothing but when: its power is recovered within its band, in watts."""
    base, parts = base_of(recorded(lambda t, _T, _x: -float(np.interp(t, TIME, DRAUGHT))))
    _, found = lacking_in(base, parts)
    best = found[0]
    assert (best.subsystem, best.place, best.unit) == ("thermoelectric", "heat", "W")
    assert best.explained > 0.9
    assert best.evidence > found[1].evidence + 10
    (t,), (mean,), (std,) = best.time, best.mean, best.std
    truth = np.interp(t, TIME, DRAUGHT)
    # a constant, and what is in proportion to temperature or drive, the base model's own parameters take up
    known = [np.ones_like(t), np.interp(t, TIME, DRIVE**2), np.interp(t, TIME, recorded_temperature())]
    taken = np.stack(known, axis=1)
    off = mean - truth
    off = off - taken @ np.linalg.lstsq(taken, off, rcond=None)[0]
    assert np.sqrt(np.mean(off**2)) < 0.25 * np.sqrt(np.mean(truth**2))
    assert np.all(std > 0)


OPEN = tuple((start, start + 2.5) for start in (17.0, 39.0, 64.0, 80.0, 103.0))  # [s]


def unplugged(t: float, _temperature: float, _moved: float) -> float:
    """All of the power is lost while a plug is open."""
    volts = DRIVE[min(np.searchsorted(TIME, t, side="right") - 1, len(DRIVE) - 1)]
    return float(any(a <= t < b for a, b in OPEN)) * volts**2 * BASE["joule_heating.gain"]


def test_a_plug_that_opens_is_found_in_the_drive_when_it_was_open():
    base, parts = base_of(recorded(unplugged))
    _, found = lacking_in(base, parts)
    best = found[0]
    assert (best.subsystem, best.place, best.unit) == ("drive", "drive", "1")
    assert best.evidence > max(m.evidence for m in found[1:]) + 10
    (t,), (mean,) = best.time, best.mean
    driven = np.interp(t, TIME, DRIVE) > 1.0
    inside = driven & np.any([(t > a + 0.5) & (t < b - 0.5) for a, b in OPEN], axis=0)
    outside = driven & np.all([(t < a - 2.0) | (t > b + 2.0) for a, b in OPEN], axis=0)
    assert -1.5 < np.median(mean[inside]) < -0.75  # knots a second apart overshoot
    assert np.median(np.abs(mean[outside])) < 0.2
    assert able(found) == ("thermoelectric",)


@cache
def recorded_temperature() -> np.ndarray:
    return recorded(nothing).output("temperature") - AMBIENT


def test_nothing_is_missing_where_nothing_is():
    base, parts = base_of(recorded(nothing, seed=1))
    _, found = lacking_in(base, parts)
    assert max(m.evidence for m in found) < 6
    assert learn(base, parts, Evidence()) is None


def test_closure_is_learned_in_its_balance_and_is_the_loss_that_was_concealed():
    base, parts = rubbed()
    assert level(base, parts) > 2
    _, lacking = lacking_in(base, parts)
    assert "thermoelectric" in able(lacking)
    learned = learn(base, parts, Evidence(), ["thermoelectric"])
    assert learned is not None
    assert level(learned.state, parts) < 1.15
    assert all(k.startswith("learned_heat.") for k in learned.terms)
    # as a function: where the actuator has been it is the concealed loss, but for what a conductance can take up
    problem = learned.state.setup
    value = dict(
        zip((f"{s.mechanism}.{s.parameter.name}" for s in problem.structure.slots), learned.state.values, strict=False)
    )
    states = np.asarray(recorded(rubbed_by_air).outputs)
    warm, moved = states[:, 0] - AMBIENT, states[:, 1]
    terms = {o.key: o.term for o in offers(problem)}
    heat = np.zeros(len(warm))
    for key in learned.terms:
        term = terms[key]
        shape = (warm / value["learned_heat.reference_temperature"]) ** term.temperature
        shape = shape * (moved / value["learned_heat.reference"]) ** term.displacement
        assert term.velocity == term.effort == 0
        heat += value[key] * shape
    heat *= value["newton_cooling.conductance"] * value["learned_heat.reference_temperature"]
    heat += (value["newton_cooling.conductance"] - LOSS) * warm
    truth = rubbed_by_air(0.0, warm, moved)
    assert np.sqrt(np.mean((heat - truth) ** 2)) < 0.1 * np.sqrt(np.mean(truth**2))


def test_names_that_explain_less_than_a_closure_are_not_given():
    """A name forced upon it is dropped for a closure that explains nearly all; the answer says so, with units."""
    base, parts = rubbed()
    binned, lacking = lacking_in(base, parts)
    forced = Choice(added(base, "sensor_lag", parts), (), {"sensor_lag": 0.9}, {"sensor_lag": ()})
    assert forced.state.names == ("sensor_lag",)
    choice, learned = beyond_names(parts, base, forced, Evidence(), ["thermoelectric"])
    assert choice.state.names == ()
    assert learned is not None
    said = answer(parts, base, choice, learned, binned, lacking, notes=(), seconds=0.0, settings={})
    assert said.verdict == "unexplained"
    assert said.mechanisms == ()
    assert said.closure is not None
    assert said.closure.subsystem == said.location.subsystem == "thermoelectric"
    assert said.closure.expression.startswith("heat lost = ")
    assert "W/" in said.closure.expression
    assert any(n.startswith("nearest in the catalogue: sensor_lag; not named") for n in said.notes)
    assert said.closure.held_out_gain > 0.5
    assert said.closure.expression in said.says
    assert said.to_json()["closure"]["depends_on"] == list(said.closure.depends_on)


@pytest.mark.parametrize(
    ("leaves", "far", "alone", "stays"),
    [
        (0.5, 3.0, None, False),  # much, clearly above the noise
        (0.5, 2.0, None, True),
        (0.15, 3.0, None, True),
        (0.5, 2.0, 0.2, False),  # a closure without them does far better
        (0.5, 2.0, 0.3, True),
        (0.15, 2.0, 0.07, False),  # and explains nearly all
        (0.25, 2.0, 0.12, False),
        (0.4, 40.0, None, False),
        (0.4, 80.0, None, True),  # noise so small that no law comes near it: more than half went
        (0.6, 80.0, None, False),
        (0.15, 2.0, 0.08, True),
    ],
)
def test_names_that_leave_much_are_given_up_and_told_of_as_nearest(monkeypatch, leaves, far, alone, stays):
    base, parts = rubbed()
    named = added(base, "ambient_drift", parts)
    held = parts.is_held

    def with_excess(state: State, mean_square: float) -> State:
        there = held | parts.is_train
        flat = np.where(there, np.sqrt(mean_square), 0.0)
        return replace(state, residual=flat)

    base = with_excess(base, 1.0 + (far**2 - 1.0) / leaves)
    named = with_excess(named, far**2)
    closed = None if alone is None else SimpleNamespace(state=with_excess(base, 1.0 + alone * (far**2 - 1.0) / leaves))
    monkeypatch.setattr(outside, "closure", lambda state, *_: closed if state is base else None)
    choice, learned = beyond_names(parts, base, Choice(named, (), {"ambient_drift": 1.0}, {}), Evidence(), ["sensor"])
    assert (choice.state is named) == stays
    if stays:
        assert choice.given_up == ((), 0.0)
    else:
        assert learned is closed
        assert choice.given_up[0] == ("ambient_drift",)
        assert choice.given_up[1] == pytest.approx(leaves)


@pytest.mark.parametrize(("far", "corrected"), [(1.0, True), (4.0, False)])
def test_names_that_leave_little_are_corrected_in_their_balance_near_the_noise(monkeypatch, far, corrected):
    """What names leave is sought beyond them only where it may be the form of their laws; they stay in any case."""
    base, parts = rubbed()
    named = added(base, "ambient_drift", parts)
    scale = far * 2.0 / level(named, parts)
    named = replace(named, residual=named.residual * scale)
    base = replace(base, residual=base.residual * 20.0 * far)
    assert form_at_most(base, named, parts)
    asked = []
    monkeypatch.setattr(outside, "closure", lambda state, _parts, _rules, where: asked.append((state, list(where))))
    choice, learned = beyond_names(parts, base, Choice(named, (), {}, {}), Evidence(), ["sensor"])
    assert choice.state is named
    assert learned is None
    assert asked == ([(named, ["thermoelectric"])] if corrected else [])


def test_a_name_of_which_nothing_stays_beside_the_closure_is_taken_out(monkeypatch):
    base, parts = rubbed()
    named = added(added(base, "ambient_drift", parts), "sensor_lag", parts)
    learned = SimpleNamespace(state=named)
    monkeypatch.setattr(outside, "closure", lambda *_: learned)
    monkeypatch.setattr(outside, "_CLEARLY", np.inf)
    monkeypatch.setattr(outside, "_FAR_BETTER", 0.0)
    monkeypatch.setattr(outside, "at_its_least", lambda state, name: name == "sensor_lag" and name in state.names)
    asked = []

    def taken_out(state: State, name: str, _parts: Split) -> State:
        asked.append((state.names, name))
        return added(base, "ambient_drift", parts)

    monkeypatch.setattr(outside, "without", taken_out)
    chosen = Choice(named, (), {"ambient_drift": 0.9, "sensor_lag": 0.8}, {"sensor_lag": ("creep",)})
    choice, found = beyond_names(parts, base, chosen, Evidence(), ["thermoelectric"])
    assert asked[-1] == (("ambient_drift", "sensor_lag"), "sensor_lag")
    assert choice.state.names == ("ambient_drift",)
    assert choice.probability == {"ambient_drift": 0.9}
    assert found is learned


@pytest.mark.parametrize(("drift", "corrects", "stays"), [(0.0, False, False), (0.5, False, True), (0.0, True, True)])
def test_a_name_that_the_data_do_not_tell_from_none_beside_the_closure_is_taken_out(
    monkeypatch, drift, corrects, stays
):
    """Unless the closure is a correction of its law, which can do what the law does."""
    base, parts = rubbed()
    named = added(base, "ambient_drift", parts)
    setup, values = named.setup, named.values
    values[setup.structure.index["ambient_drift.drift"]] = drift
    trial = setup.trial(values, np.asarray(named.trial.active), np.asarray(named.trial.laws), len(named.trial.index))
    learned = SimpleNamespace(state=replace(named, trial=trial))
    monkeypatch.setattr(outside, "closure", lambda *_: learned)
    monkeypatch.setattr(outside, "_CLEARLY", np.inf)
    monkeypatch.setattr(outside, "_FAR_BETTER", 0.0)
    monkeypatch.setattr(outside, "form_at_most", lambda *_: corrects)
    monkeypatch.setattr(outside, "_NEAR_NOISE", np.inf)
    choice, found = beyond_names(
        parts, base, Choice(named, (), {"ambient_drift": 0.9}, {}), Evidence(), ["thermoelectric"]
    )
    assert choice.state.names == (("ambient_drift",) if stays else ())
    assert found is learned


@pytest.mark.parametrize(("after", "kept"), [(110.0, ("a",)), (300.0, ("a", "b"))])
def test_a_small_last_name_gives_way_to_a_correction_that_does_better(monkeypatch, after, kept):
    def state(names, left):
        return SimpleNamespace(names=names, left=left)

    both, one, corrected = state(("a", "b"), 200.0), state(("a",), 250.0), state(("a",), after)
    monkeypatch.setattr(outside, "_unexplained", lambda s, there: s.left)
    monkeypatch.setattr(outside, "without", lambda s, name, split: one if name == "b" else None)
    monkeypatch.setattr(outside, "form_at_most", lambda base, s, parts: True)
    monkeypatch.setattr(outside, "level", lambda s, parts: 2.0)
    monkeypatch.setattr(outside, "_correction", lambda s, parts, rules: SimpleNamespace(state=corrected))
    parts = SimpleNamespace(is_held=None)
    choice = Choice(both, (), {"a": 0.9, "b": 0.8}, {"a": (), "b": ("c",)})  # type: ignore[arg-type]
    found, learned = outside._corrected_rather_than_named(parts, one, choice, Evidence())  # type: ignore[arg-type]
    assert found.state.names == kept
    assert set(found.probability) == set(found.equivalents) == set(kept)
    assert (learned is not None) == (kept == ("a",))


def test_a_name_that_asks_for_more_than_its_law_allows_is_not_given():
    """A loss T x^2 is, along one load, nearly one of T^3: of heat that grows with temperature it has the exponent at
    its limit, beyond what air and glow can do.
    """
    base, parts = rubbed()
    named = added(base, "nonlinear_heat_loss", parts)
    assert level(base, parts) > 10.0
    assert level(named, parts) < AT_NOISE
    assert strained(named) == ("nonlinear_heat_loss",)
    choice, learned = form_rather_than_name(
        parts, base, Choice(named, (), {"nonlinear_heat_loss": 1.0}, {}), Evidence()
    )
    assert choice.state is base
    assert choice.overstretched == ("nonlinear_heat_loss",)
    assert isinstance(learned, Learned)
    assert learned.terms == ("learned_heat.Tx2",)


def test_away_from_the_noise_it_is_given_up_and_the_note_says_why(monkeypatch):
    base, parts = rubbed()
    named = added(base, "nonlinear_heat_loss", parts)
    monkeypatch.setattr(outside, "AT_NOISE", 0.5)
    monkeypatch.setattr(outside, "closure", lambda *_: None)
    choice, learned = beyond_names(parts, base, Choice(named, (), {"nonlinear_heat_loss": 1.0}, {}), Evidence(), [])
    assert choice.state.names == ()
    assert learned is None
    (note,) = _nearest(choice)
    said = "the recordings ask for more than physics allows: exponent of nonlinear_heat_loss outside 0.15 to 2"
    assert note == f"nearest in the catalogue: nonlinear_heat_loss; not named, for {said}"
    monkeypatch.setattr(identifiability, "_DETERMINED", 0.0)  # not determined, a value at its limit says nothing
    kept, _ = beyond_names(parts, base, Choice(named, (), {"nonlinear_heat_loss": 1.0}, {}), Evidence(), [])
    assert kept.state is named


@pytest.mark.parametrize(("leaves", "says"), [(1.7, True), (2.2, False)])
def test_a_closure_says_where_the_misfit_lies_by_what_it_takes_beyond_the_noise(leaves, says):
    base, parts = rubbed()
    flat = lambda level: replace(base, residual=np.full_like(base.residual, level))  # noqa: E731
    assert takes_most(flat(np.sqrt(5.0)), flat(np.sqrt(leaves)), parts) == says


def test_a_law_of_another_form_is_named_and_corrected():
    """A loss that sets in between two temperatures is no power of them: the name stays, a correction is learned."""

    def sets_in(_t: float, temperature: float, _moved: float) -> float:
        return 0.8 * LOSS * temperature / (1 + np.exp(-(temperature - 25.0) / 8.0))

    base, parts = base_of(recorded(sets_in))
    named = added(base, "nonlinear_heat_loss", parts)
    assert form_at_most(base, named, parts)
    assert 1.15 < level(named, parts) < 4
    binned, lacking = lacking_in(base, parts)
    chosen = Choice(named, (), {"nonlinear_heat_loss": 0.99}, {})
    choice, learned = beyond_names(parts, base, chosen, Evidence(), able(lacking))
    assert choice.state.names == ("nonlinear_heat_loss",)
    assert learned is not None
    assert learned.state.setup.structure.mechanisms[-1].name in ("learned_heat", "learned_heat_curve")
    assert level(learned.state, parts) < level(named, parts)
    said = answer(parts, base, choice, learned, binned, lacking, notes=(), seconds=0.0, settings={})
    assert said.verdict == ("explained" if level(learned.state, parts) <= 1.15 else "unexplained")
    assert said.mechanisms[0].probability == pytest.approx(0.99 * TRUSTED[said.verdict])
    assert said.closure is not None
    assert said.closure.expression in said.says


@pytest.mark.parametrize(("depends_on", "place"), [(("temperature", "drive"), "thermoelectric"), (("drive",), "drive")])
def test_what_depends_on_more_than_the_drive_is_not_the_drives(depends_on, place):
    """The drive answers for a misfit as well as the heat does, where the closure says which it is."""
    nothing = SimpleNamespace(state=SimpleNamespace(names=()), free="")
    closure = SimpleNamespace(subsystem="thermoelectric", depends_on=depends_on, held_out_gain=0.9)
    lacking = [SimpleNamespace(subsystem=s) for s in ("drive", "thermoelectric")]
    assert _subsystem(nothing, closure, lacking) == place  # type: ignore[arg-type]


def test_the_terms_of_a_closure_stop_growing_beyond_what_was_seen():
    references = {"reference_temperature": 60.0, "reference": 0.01, "velocity_scale": 0.1, "effort_scale": 16.0}
    term, p = Term("T2xu", temperature=2, displacement=1, effort=1), SimpleNamespace(**references)
    at = lambda k: SimpleNamespace(temperature=np.array(60.0 * k), displacement=0.01 * k, velocity=0.0, effort=16.0 * k)  # noqa: E731
    for k, counts in ((0.5, 0.5), (1.4, 1.4), (4.0, 1.5)):
        assert float(term.value(p, at(k))) == pytest.approx(counts**4)  # type: ignore[arg-type]


def test_how_far_a_name_is_trusted_is_what_the_proof_counted():
    rows = [line.split("|")[1:-1] for line in (ROOT / "docs" / "concealed.md").read_text().splitlines() if "|" in line]
    verdicts = {"explained", "unexplained"}
    counted = {row[0].strip(): [int(n) for n in row[1:]] for row in rows if row[0].strip() in verdicts}
    assert set(counted) == verdicts
    for verdict, (right, of) in counted.items():
        assert TRUSTED[verdict] == pytest.approx((right + 1) / (of + 2))
