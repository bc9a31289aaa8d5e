"""Names in doubt: beyond what laws or nature allow, or acting at once; and what may stand in their place."""

from dataclasses import replace
from functools import partial
from types import SimpleNamespace

import numpy as np
import pytest
from diagnose.heated import LOSS, base_of, nothing, recorded, rubbed

from scpjax.diagnose import beyond, doubtful, given_up
from scpjax.diagnose.answer import _nearest
from scpjax.diagnose.choice import Choice
from scpjax.diagnose.closure import Learned
from scpjax.diagnose.doubtful import strained
from scpjax.diagnose.evidence import Evidence
from scpjax.diagnose.expression import _instead
from scpjax.diagnose.given_up import beyond_names, form_rather_than_name
from scpjax.diagnose.hypothesis import State, grown, trial_at
from scpjax.diagnose.remainder import AT_NOISE, level
from scpjax.diagnose.rivals import added
from scpjax.fit import identifiability
from scpjax.physics.mechanism import Values
from scpjax.physics.mechanisms.nonlinear_heat_loss import NonlinearHeatLoss


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


def test_a_loss_that_grows_faster_than_nature_allows_is_not_given(monkeypatch):
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
    monkeypatch.setattr(given_up, "in_place_of", lambda *_, **__: None)
    kept, learned = form_rather_than_name(parts, base, Choice(named, (), {"nonlinear_heat_loss": 1.0}, {}), Evidence())
    assert (kept.state, learned) == (named, None)
    (note,) = _nearest(kept)
    said = "named, as nothing else explains it, though it is more than physics allows"
    assert note == f"{said}: {NonlinearHeatLoss.impossible}"
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
    for name, value in (
        ("bend", None),
        ("learn", learned),
        ("reacting", None),
        ("carried_along", None),
        ("level", 1.0),
        ("ahead", ahead),
    ):
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
    monkeypatch.setattr(given_up, "closure", lambda *_, **__: None)
    choice, learned = beyond_names(parts, base, Choice(named, (), {"nonlinear_heat_loss": 1.0}, {}), Evidence(), [])
    assert choice.state.names == ()
    assert learned is None
    (note,) = _nearest(choice)
    said = "the recordings ask for more than physics allows: exponent of nonlinear_heat_loss outside 0.15 to 2"
    assert note == f"nearest in the catalogue: nonlinear_heat_loss; not named, for {said}"
    given_up_for = {"creep": ("compliance", "slow_compliance")}
    (note,) = _nearest(replace(choice, given_up=(("creep",), 0.1), overstretched=given_up_for))
    assert note.endswith("physics allows: compliance of creep above 5 and slow compliance of creep above 5")
    assert [n[:14] for n in _nearest(replace(choice, rang=True))] == ["nearest in the", "what was learn"]
    monkeypatch.setattr(identifiability, "_DETERMINED", 0.0)  # not determined, a value at its limit says nothing
    kept, _ = beyond_names(parts, base, Choice(named, (), {"nonlinear_heat_loss": 1.0}, {}), Evidence(), [])
    assert kept.state is named
