"""Names beside a closure: given up for it, corrected by it, or kept, as what they leave says."""

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest
from diagnose.heated import LOSS, base_of, lacking_in, recorded, rubbed

from scpjax.diagnose import beyond, doubtful, given_up, remainder
from scpjax.diagnose.answer import TRUSTED, answer
from scpjax.diagnose.beyond import able
from scpjax.diagnose.choice import Choice
from scpjax.diagnose.evidence import Evidence
from scpjax.diagnose.given_up import beyond_names
from scpjax.diagnose.holdout import Split
from scpjax.diagnose.hypothesis import State
from scpjax.diagnose.patience import Patience
from scpjax.diagnose.remainder import form_at_most, level
from scpjax.diagnose.rivals import added


def test_names_that_explain_less_than_a_closure_are_not_given():
    """A name forced upon it is dropped for a closure that explains nearly all; the answer says so, with units."""
    base, parts = rubbed()
    binned, lacking = lacking_in(base, parts)
    forced = Choice(added(base, "sensor_lag", parts), (), {"sensor_lag": 0.9}, {"sensor_lag": ()})
    assert forced.state.names == ("sensor_lag",)
    choice, learned = beyond_names(parts, base, forced, Evidence(), ["thermoelectric"])
    assert choice.state.names == ()
    assert learned is not None
    said = answer(parts, base, choice, learned, binned, lacking, notes=(), patience=Patience(), settings={})
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
        (0.4, 80.0, None, True),  # noise so small that no law comes near it: more than half went of what was fitted
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
    monkeypatch.setattr(given_up, "closure", lambda state, *_, **__: closed if state is base else None)
    monkeypatch.setattr(remainder, "squares_in_turn", lambda s, parts: remainder.unexplained(s, parts.is_held))
    choice, learned = beyond_names(parts, base, Choice(named, (), {"ambient_drift": 1.0}, {}), Evidence(), ["sensor"])
    assert (choice.state is named) == stays
    if stays:
        assert choice.given_up == ((), 0.0)
    else:
        assert learned is closed
        assert choice.given_up[0] == ("ambient_drift",)
        assert choice.given_up[1] == pytest.approx(leaves)


@pytest.mark.parametrize(
    ("fitted", "in_turn", "alone", "stays"),
    [
        (0.4, 0.9, None, True),
        (0.4, 1.0, None, False),  # they predict no better
        (0.6, 0.3, None, False),  # they leave more than half
        (0.4, 0.9, 0.5, True),
        (0.4, 0.9, 0.4, False),  # a closure without them does far better
    ],
)
def test_where_the_noise_is_no_scale_all_sets_held_out_in_turn_decide(monkeypatch, fitted, in_turn, alone, stays):
    """Of the one set the names leave twice what the base model does."""
    base, parts = rubbed()
    named = added(base, "ambient_drift", parts)
    base = replace(base, residual=np.full_like(base.residual, 150.0))
    named = replace(named, residual=150.0 * np.sqrt(np.where(parts.is_held, 2.0, fitted)))
    closed = None if alone is None else SimpleNamespace(state=replace(base))
    left = {id(base): 1e6, id(named): 1e6 * in_turn} | ({id(closed.state): 1e6 * alone} if closed else {})
    monkeypatch.setattr(remainder, "squares_in_turn", lambda s, _: left[id(s)])
    monkeypatch.setattr(given_up, "closure", lambda state, *_, **__: closed if state is base else None)
    choice, _ = beyond_names(parts, base, Choice(named, (), {"ambient_drift": 1.0}, {}), Evidence(), ["sensor"])
    assert (choice.state is named) == stays
    if not stays:
        assert choice.given_up == (("ambient_drift",), pytest.approx(max(fitted, in_turn), rel=1e-3))


@pytest.mark.parametrize(("fitted", "held", "stays"), [(0.15, 0.15, True), (0.47, 0.15, False), (0.15, 0.47, False)])
def test_names_that_leave_much_of_what_they_were_fitted_to_are_given_up_too(monkeypatch, fitted, held, stays):
    """Whatever they leave of the held-out stretches, which may be easy ones."""
    base, parts = rubbed()
    named = added(base, "ambient_drift", parts)
    square = np.where(parts.is_held, 1.0 + 900.0 * held, np.where(parts.is_train, 1.0 + 900.0 * fitted, 0.0))
    named = replace(named, residual=np.sqrt(square))
    base = replace(base, residual=np.full_like(base.residual, np.sqrt(901.0)))
    monkeypatch.setattr(given_up, "closure", lambda *_, **__: None)
    choice, _ = beyond_names(parts, base, Choice(named, (), {"ambient_drift": 1.0}, {}), Evidence(), ["sensor"])
    assert (choice.state is named) == stays
    assert choice.given_up == (((), 0.0) if stays else (("ambient_drift",), pytest.approx(0.47)))


@pytest.mark.parametrize(("far", "where"), [(1.0, ["thermoelectric"]), (4.0, [])])
def test_names_that_leave_little_are_corrected_in_their_balance_near_the_noise(monkeypatch, far, where):
    """What names leave may be the form of their laws there, and anything far from it; they stay in any case."""
    base, parts = rubbed()
    named = added(base, "ambient_drift", parts)
    scale = far * 2.0 / level(named, parts)
    named = replace(named, residual=named.residual * scale)
    base = replace(base, residual=base.residual * 20.0 * far)
    assert form_at_most(base, named, parts)
    asked = []
    monkeypatch.setattr(given_up, "acting_at_once", lambda *_: ())
    monkeypatch.setattr(
        beyond, "form", lambda state, _parts, _rules, where, _patience: asked.append((state, list(where)))
    )
    monkeypatch.setattr(beyond, "reacting", lambda *_: None)
    monkeypatch.setattr(beyond, "carried_along", lambda *_: None)
    choice, learned = beyond_names(parts, base, Choice(named, (), {}, {}), Evidence(), ["sensor"])
    assert choice.state is named
    assert learned is None
    assert asked == [(named, where)]


def test_far_from_the_noise_a_reaction_alone_comes_before_a_closure_beyond_the_names(monkeypatch):
    base, parts = rubbed()
    named = added(base, "ambient_drift", parts)
    named = replace(named, residual=named.residual * 8.0 / level(named, parts))
    base = replace(base, residual=base.residual * 80.0)
    reaction = SimpleNamespace(state=named)
    monkeypatch.setattr(given_up, "acting_at_once", lambda *_: ())
    monkeypatch.setattr(given_up, "one_reaction", lambda *_: reaction)
    monkeypatch.setattr(given_up, "closure", lambda *_, **__: pytest.fail("asked for a closure"))
    choice, learned = beyond_names(parts, base, Choice(named, (), {"ambient_drift": 1.0}, {}), Evidence(), ["sensor"])
    assert learned is reaction
    assert not choice.state.names


def test_a_name_of_which_nothing_stays_beside_the_closure_is_taken_out(monkeypatch):
    base, parts = rubbed()
    named = added(added(base, "ambient_drift", parts), "sensor_lag", parts)
    learned = SimpleNamespace(state=named)
    monkeypatch.setattr(given_up, "acting_at_once", lambda *_: ())

    class Later(Patience):
        """It is late from the second time on that it is asked."""

        asked = 0

        def late(self, what: str) -> bool:
            self.asked += 1
            return self.asked > 1

    def closure(*_, patience):
        return None if patience.late("a closure") else learned

    monkeypatch.setattr(given_up, "closure", closure)
    monkeypatch.setattr(remainder, "_CLEARLY", np.inf)
    monkeypatch.setattr(given_up, "_FAR_BETTER", 0.0)
    monkeypatch.setattr(doubtful, "at_its_least", lambda state, name: name == "sensor_lag" and name in state.names)
    asked = []

    def taken_out(state: State, name: str, _parts: Split) -> State:
        asked.append((state.names, name))
        return added(base, "ambient_drift", parts)

    monkeypatch.setattr(given_up, "without", taken_out)
    chosen = Choice(named, (), {"ambient_drift": 0.9, "sensor_lag": 0.8}, {"sensor_lag": ("creep",)})
    patience = Later()
    choice, found = beyond_names(parts, base, chosen, Evidence(), ["thermoelectric"], patience)
    assert patience.asked == 1, "what is learned in the end decides nothing more"
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
    monkeypatch.setattr(*((beyond, "form") if corrects else (given_up, "closure")), lambda *_, **__: learned)
    monkeypatch.setattr(remainder, "_CLEARLY", np.inf)
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
    monkeypatch.setattr(given_up, "correction", lambda *_: SimpleNamespace(state=corrected))
    parts = SimpleNamespace(is_held=None)
    choice = Choice(both, (), {"a": 0.9, "b": 0.8}, {"a": (), "b": ("c",)})  # type: ignore[arg-type]
    found, learned = given_up._corrected_rather_than_named(parts, base, choice, Evidence(), Patience())  # type: ignore[arg-type]
    assert found.state.names == kept
    assert set(found.probability) == set(found.equivalents) == set(kept)
    assert (learned is not None) == (kept == ("a",))


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
    said = answer(parts, base, choice, learned, binned, lacking, notes=(), patience=Patience(), settings={})
    assert said.verdict == ("explained" if level(learned.state, parts) <= 1.15 else "unexplained")
    assert said.mechanisms[0].probability == pytest.approx(0.99 * TRUSTED[said.verdict])
    assert said.closure is not None
    assert said.closure.expression in said.says
