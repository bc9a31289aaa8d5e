"""Names beside a closure: given up for it, corrected by it, or kept, as what they leave says."""

from dataclasses import replace
from functools import partial
from types import SimpleNamespace

import numpy as np
import pytest
from diagnose.heated import LOSS, base_of, lacking_in, nothing, recorded, rubbed

from scpjax.diagnose import beyond, doubtful, given_up, remainder
from scpjax.diagnose.answer import TRUSTED, _nearest, answer
from scpjax.diagnose.beyond import able
from scpjax.diagnose.choice import Choice
from scpjax.diagnose.closure import Learned
from scpjax.diagnose.doubtful import strained
from scpjax.diagnose.evidence import Evidence
from scpjax.diagnose.expression import _instead
from scpjax.diagnose.given_up import beyond_names, form_rather_than_name
from scpjax.diagnose.holdout import Split
from scpjax.diagnose.hypothesis import State, grown, trial_at
from scpjax.diagnose.remainder import AT_NOISE, form_at_most, level
from scpjax.diagnose.rivals import added
from scpjax.fit import identifiability
from scpjax.physics.mechanism import Values
from scpjax.physics.mechanisms.nonlinear_heat_loss import NonlinearHeatLoss


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
    monkeypatch.setattr(given_up, "closure", lambda state, *_: closed if state is base else None)
    choice, learned = beyond_names(parts, base, Choice(named, (), {"ambient_drift": 1.0}, {}), Evidence(), ["sensor"])
    assert (choice.state is named) == stays
    if stays:
        assert choice.given_up == ((), 0.0)
    else:
        assert learned is closed
        assert choice.given_up[0] == ("ambient_drift",)
        assert choice.given_up[1] == pytest.approx(leaves)


@pytest.mark.parametrize(("fitted", "held", "stays"), [(0.15, 0.15, True), (0.47, 0.15, False), (0.15, 0.47, False)])
def test_names_that_leave_much_of_what_they_were_fitted_to_are_given_up_too(monkeypatch, fitted, held, stays):
    """Whatever they leave of the held-out stretches, which may be easy ones."""
    base, parts = rubbed()
    named = added(base, "ambient_drift", parts)
    square = np.where(parts.is_held, 1.0 + 900.0 * held, np.where(parts.is_train, 1.0 + 900.0 * fitted, 0.0))
    named = replace(named, residual=np.sqrt(square))
    base = replace(base, residual=np.full_like(base.residual, np.sqrt(901.0)))
    monkeypatch.setattr(given_up, "closure", lambda *_: None)
    choice, _ = beyond_names(parts, base, Choice(named, (), {"ambient_drift": 1.0}, {}), Evidence(), ["sensor"])
    assert (choice.state is named) == stays
    assert choice.given_up == (((), 0.0) if stays else (("ambient_drift",), pytest.approx(0.47)))


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
    monkeypatch.setattr(given_up, "acting_at_once", lambda *_: ())
    monkeypatch.setattr(beyond, "form", lambda state, _parts, _rules, where: asked.append((state, list(where))))
    choice, learned = beyond_names(parts, base, Choice(named, (), {}, {}), Evidence(), ["sensor"])
    assert choice.state is named
    assert learned is None
    assert asked == ([(named, ["thermoelectric"])] if corrected else [])


def test_a_name_of_which_nothing_stays_beside_the_closure_is_taken_out(monkeypatch):
    base, parts = rubbed()
    named = added(added(base, "ambient_drift", parts), "sensor_lag", parts)
    learned = SimpleNamespace(state=named)
    monkeypatch.setattr(given_up, "acting_at_once", lambda *_: ())
    monkeypatch.setattr(given_up, "closure", lambda *_: learned)
    monkeypatch.setattr(given_up, "_CLEARLY", np.inf)
    monkeypatch.setattr(given_up, "_FAR_BETTER", 0.0)
    monkeypatch.setattr(doubtful, "at_its_least", lambda state, name: name == "sensor_lag" and name in state.names)
    asked = []

    def taken_out(state: State, name: str, _parts: Split) -> State:
        asked.append((state.names, name))
        return added(base, "ambient_drift", parts)

    monkeypatch.setattr(given_up, "without", taken_out)
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
    monkeypatch.setattr(given_up, "acting_at_once", lambda *_: ())
    monkeypatch.setattr(*((beyond, "form") if corrects else (given_up, "closure")), lambda *_: learned)
    monkeypatch.setattr(given_up, "_CLEARLY", np.inf)
    monkeypatch.setattr(given_up, "_FAR_BETTER", 0.0)
    monkeypatch.setattr(given_up, "form_at_most", lambda *_: corrects)
    monkeypatch.setattr(given_up, "_NEAR_NOISE", np.inf)
    choice, found = beyond_names(
        parts, base, Choice(named, (), {"ambient_drift": 0.9}, {}), Evidence(), ["thermoelectric"]
    )
    assert choice.state.names == (("ambient_drift",) if stays else ())
    assert found is learned


@pytest.mark.parametrize(("after", "kept"), [(110.0, ("a",)), (300.0, ("a", "b"))])
@pytest.mark.parametrize(
    ("before", "named", "comes_to", "may"),  # the base model's misfit; levels with the names, and beside a correction
    [
        (5000.0, 2.0, 2.0, True),
        (2600.0, 2.0, 1.1, True),
        (2600.0, 2.0, 1.2, False),
        (2600.0, 1.1, 1.1, False),
        (2400.0, 2.0, 1.1, False),
    ],
)
def test_a_small_last_name_gives_way_to_a_correction_that_does_better(
    monkeypatch, after, kept, before, named, comes_to, may
):
    """Where 5 % stayed without it; or 10 %, if the correction comes down to the noise and the names do not."""
    kept = kept if may else ("a", "b")

    def state(names, left):
        return SimpleNamespace(names=names, left=left)

    both, one, corrected = state(("a", "b"), 200.0), state(("a",), 250.0), state(("a",), after)
    monkeypatch.setattr(given_up, "without", lambda s, name, split: one if name == "b" else None)
    base = state((), before)
    for room in (remainder, given_up):
        monkeypatch.setattr(room, "unexplained", lambda s, there: s.left)
    monkeypatch.setattr(given_up, "level", lambda s, parts: {id(corrected): comes_to, id(both): named}.get(id(s), 2.0))
    monkeypatch.setattr(given_up, "correction", lambda s, parts, rules: SimpleNamespace(state=corrected))
    parts = SimpleNamespace(is_held=None)
    choice = Choice(both, (), {"a": 0.9, "b": 0.8}, {"a": (), "b": ("c",)})  # type: ignore[arg-type]
    found, learned = given_up._corrected_rather_than_named(parts, base, choice, Evidence())  # type: ignore[arg-type]
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
    assert choice.overstretched == {"nonlinear_heat_loss": ("exponent", NonlinearHeatLoss.impossible)}
    assert isinstance(learned, Learned)
    assert learned.terms == ("learned_heat.Tx2",)


def test_a_loss_that_grows_faster_than_nature_allows_is_not_given():
    """A loss that doubles as the coil contracts by 5 mm, where that follows the temperature: in proportion to it, which
    no parameter forbids alone. One of natural convection may be as large.
    """
    base, parts = base_of(recorded(lambda _t, temperature, moved: LOSS * temperature * moved / 5e-3))
    named = added(base, "nonlinear_heat_loss", parts)
    assert level(base, parts) > 10.0
    assert level(named, parts) < AT_NOISE
    assert doubtful.asking_for_more(named, parts) == {}
    told = {"nonlinear_heat_loss": (NonlinearHeatLoss.impossible,)}
    assert doubtful.impossible(named, parts) == told
    choice, learned = form_rather_than_name(
        parts, base, Choice(named, (), {"nonlinear_heat_loss": 1.0}, {}), Evidence()
    )
    assert choice.state is base
    assert choice.overstretched == told
    assert learned is not None
    assert level(learned.state, parts) < AT_NOISE
    (note,) = _nearest(choice)
    assert note.endswith(f"ask for more than physics allows: {NonlinearHeatLoss.impossible}")
    air, its = base_of(
        recorded(lambda _t, temperature, _x: 2.0 * LOSS * temperature * (abs(temperature) / 30.0) ** 0.3)
    )
    warmed = added(air, "nonlinear_heat_loss", its)
    assert level(warmed, its) < AT_NOISE
    assert doubtful.impossible(warmed, its) == {}
    assert doubtful.impossible(air, its) == {}


@pytest.mark.parametrize("law", ["power", "radiation"])
def test_what_grows_faster_than_nature_allows_by_the_growth_itself(law):
    """Beside the derivative of the loss per degree, written out; a black body alone is just allowed."""
    m, reference, room = NonlinearHeatLoss(), 120.0, 293.15

    def loss(a: float, n: float, excess: float) -> float:
        def extra(t: float) -> float:
            if law == "power":
                return (t / reference) ** n
            glow = lambda u: ((room + u) ** 4 - room**4) / (4 * room**3 * u) - 1.0  # noqa: E731
            return glow(t) / glow(reference)

        return 1.0 + a * extra(excess)

    def beyond(a: float, n: float) -> float:
        values = {"strength": a, "exponent": n, "reference": reference, "law": m.laws.index(law)}
        return float(m.beyond_physics(Values({k: np.asarray(v) for k, v in values.items()}), room))

    black = ((room + reference) ** 4 - room**4) / (4 * room**3 * reference)
    step = 1e-4
    grow = lambda f: np.log(f(reference * (1 + step)) / f(reference * (1 - step))) / (2 * step)  # noqa: E731
    fastest = grow(lambda t: ((room + t) ** 4 - room**4) / t)
    assert fastest > 1 / 3
    for a, n in ((0.5, 0.3), (1.0, 1.0), (20.0, 0.33), (3.0, 1.5)):
        assert beyond(a, n) == pytest.approx(grow(lambda t, a=a, n=n: loss(a, n, t)) - fastest - 0.1, abs=1e-5)
    if law == "power":
        assert beyond(20.0, 0.33) < 0.0
    else:
        assert beyond(black - 1.0, 0.5) == pytest.approx(-0.1, abs=1e-9)
    assert beyond(3.0, 1.5) > 0.0


@pytest.mark.parametrize(("strength", "std", "never"), [(2.0, 0.01, True), (2.0, 0.5, False), (0.2, 0.01, False)])
def test_only_what_errors_do_not_make_up_for_is_beyond_nature(monkeypatch, strength, std, never):
    """A loss that grows by the first power, told with such errors of all that was fitted."""
    base, parts = base_of(recorded(nothing))
    grown_ = grown(base.setup, NonlinearHeatLoss())
    value = np.asarray(grown_.starts[0]).copy()
    index = grown_.structure.index
    value[index["nonlinear_heat_loss.strength"]], value[index["nonlinear_heat_loss.exponent"]] = strength, 1.0
    laws = np.zeros(len(grown_.structure.mechanisms))
    trial = trial_at(grown_, value, laws)
    space = grown_.space
    keys = tuple(space.keys[i] for i in np.asarray(trial.index) if i < space.size)
    error = SimpleNamespace(keys=keys, covariance=std**2 * np.eye(len(keys)))
    monkeypatch.setattr(doubtful, "uncertainty", lambda *_: error)
    state = State(grown_, trial, base.residual, base.cost)
    assert bool(doubtful.impossible(state, parts)) == never


def test_a_delay_of_no_time_is_no_name_where_a_force_follows_the_drive(monkeypatch):
    """Turns that attract each other at once pull as a second node would that follows the power without delay; nor is
    one such a name of which another parameter stands at its end, but only where the force has more evidence.
    """
    base, parts = base_of(recorded(nothing, attraction=0.005))
    named = added(base, "two_node_thermal", parts)
    assert 2.0 * level(named, parts) < level(base, parts)
    found = beyond.in_place_of(base, named, parts, Evidence())
    assert isinstance(found, Learned)
    assert found.terms == ("learned_force.u",)
    (instead,) = _instead(found)
    assert instead == "displacement reads too much by = s(u)", "a sensor that feels the drive does as well"
    monkeypatch.setattr(given_up, "in_place_of", lambda *_, **__: found)
    for told in (form_rather_than_name, partial(beyond_names, where=())):  # at the noise, and away from it
        choice, learned = told(parts, base, Choice(named, (), {"two_node_thermal": 1.0}, {}), Evidence())
        assert choice.state is base
        assert choice.outdone
        assert learned is found
    slow, its = base_of(recorded(lambda _t, temperature, _x: 0.6 * LOSS * temperature * abs(temperature) / 30.0))
    assert doubtful.acting_at_once(added(slow, "nonlinear_heat_loss", its), its) == ()
    monkeypatch.setattr(given_up, "acting_at_once", lambda *_: ())
    for stretched, bic, outdone in (((), 30.0, False), (named.names, 20.0, False), (named.names, 30.0, True)):
        monkeypatch.setattr(given_up, "strained", lambda state, names=stretched: names)
        monkeypatch.setattr(given_up, "ahead", lambda *_, bic=bic: bic)
        assert (given_up._instead_of_doubtful(base, named, parts, Evidence()) is found) == outdone
    two = SimpleNamespace(names=("two_node_thermal", "creep"))  # of which one may make up for the other's law
    assert given_up._instead_of_doubtful(base, two, parts, Evidence()) is None  # type: ignore[arg-type]


@pytest.mark.parametrize(
    ("width", "std", "at_once"), [(2.0, 0.6, True), (2.0, 0.4, False), (0.5, 0.6, False), (2.0, np.nan, True)]
)
def test_a_time_within_a_bin_that_is_not_told_from_none_is_none(monkeypatch, width, std, at_once):
    """Times of the time constant: a bin lasts ``width`` of them, and the error is ``std``."""
    base, parts = base_of(recorded(nothing, attraction=0.005))
    named = added(base, "two_node_thermal", parts)
    (slot,) = (s for s in named.setup.structure.slots if s.key == "two_node_thermal.time_constant")
    time = named.values[slot.index]
    monkeypatch.setattr(doubtful, "at_limit", lambda trial, space: np.zeros(len(trial.active), bool))
    monkeypatch.setattr(doubtful, "_bin_width", lambda _: width * time)
    monkeypatch.setattr(doubtful, "uncertainty", lambda *_: None)
    monkeypatch.setattr(doubtful, "estimates", lambda *_: {slot.key: SimpleNamespace(value=time, std=std * time)})
    assert doubtful.acting_at_once(named, parts) == (("two_node_thermal",) if at_once else ())


@pytest.mark.parametrize(
    ("more", "ahead", "as_well", "impossible", "found"),
    [
        (-1.0, -9.0, False, False, True),
        (1.0, 5.0, False, False, False),
        (1.0, 5.0, True, False, True),
        (1.0, -5.0, True, False, False),
        (7.0, 50.0, True, False, False),
        (1.0, -5.0, False, True, True),
        (7.0, 50.0, False, True, False),
    ],
)
def test_a_closure_with_more_evidence_need_only_predict_as_well(monkeypatch, more, ahead, as_well, impossible, found):
    """``more`` of the held-out misfit than names leave, in units of the noise; of impossible ones without evidence."""
    held = np.ones((1, 1, 1), bool)
    state = lambda left: SimpleNamespace(residual=np.full((1, 1, 1), np.sqrt(left)))  # noqa: E731
    learned = SimpleNamespace(state=state(100.0 + more))
    for name, value in (("bend", None), ("learn", learned), ("reacting", None), ("level", 1.0), ("ahead", ahead)):
        monkeypatch.setattr(beyond, name, lambda *_, value=value: value)
    monkeypatch.setattr(beyond, "_is_none_of", lambda *_: True)
    parts = SimpleNamespace(is_held=held)
    two = {"as_well": as_well, "impossible": impossible}
    told = beyond.in_place_of(None, state(100.0), parts, Evidence(), **two)  # type: ignore[arg-type]
    assert (told is learned) == found


def test_away_from_the_noise_it_is_given_up_and_the_note_says_why(monkeypatch):
    base, parts = rubbed()
    named = added(base, "nonlinear_heat_loss", parts)
    monkeypatch.setattr(given_up, "AT_NOISE", 0.5)
    monkeypatch.setattr(given_up, "closure", lambda *_: None)
    choice, learned = beyond_names(parts, base, Choice(named, (), {"nonlinear_heat_loss": 1.0}, {}), Evidence(), [])
    assert choice.state.names == ()
    assert learned is None
    (note,) = _nearest(choice)
    said = "the recordings ask for more than physics allows: exponent of nonlinear_heat_loss outside 0.15 to 2"
    assert note == f"nearest in the catalogue: nonlinear_heat_loss; not named, for {said}"
    (note,) = _nearest(replace(choice, overstretched={"creep": ("compliance", "slow_compliance")}))
    assert note.endswith("physics allows: compliance of creep above 5 and slow compliance of creep above 5")
    assert [n[:14] for n in _nearest(replace(choice, rang=True))] == ["nearest in the", "what was learn"]
    monkeypatch.setattr(identifiability, "_DETERMINED", 0.0)  # not determined, a value at its limit says nothing
    kept, _ = beyond_names(parts, base, Choice(named, (), {"nonlinear_heat_loss": 1.0}, {}), Evidence(), [])
    assert kept.state is named


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
    choice, learned = beyond_names(parts, base, chosen, Evidence(), able(lacking, base, parts))
    assert choice.state.names == ("nonlinear_heat_loss",)
    assert learned is not None
    assert learned.state.setup.structure.mechanisms[-1].name in ("learned_heat", "learned_heat_curve")
    assert level(learned.state, parts) < level(named, parts)
    said = answer(parts, base, choice, learned, binned, lacking, notes=(), seconds=0.0, settings={})
    assert said.verdict == ("explained" if level(learned.state, parts) <= 1.15 else "unexplained")
    assert said.mechanisms[0].probability == pytest.approx(0.99 * TRUSTED[said.verdict])
    assert said.closure is not None
    assert said.closure.expression in said.says
