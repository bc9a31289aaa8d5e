"""Effects outside the catalogue: what is missing is found where it is, and learned as an expression, without a name."""

from dataclasses import replace
from functools import cache
from pathlib import Path
from types import SimpleNamespace
from typing import cast

import numpy as np
import pytest
from diagnose.creeping import AMBIENT, BASE
from diagnose.heated import DRIVE, LOSS, TIME, base_of, lacking_in, nothing, recorded, rubbed, rubbed_by_air

from scpjax.diagnose import diagnose as room
from scpjax.diagnose import remainder
from scpjax.diagnose.answer import TRUSTED, _subsystem
from scpjax.diagnose.beyond import able
from scpjax.diagnose.choice import Choice
from scpjax.diagnose.closure import learn, offers
from scpjax.diagnose.evidence import Evidence
from scpjax.diagnose.holdout import Split
from scpjax.diagnose.hypothesis import State
from scpjax.diagnose.naming import Found
from scpjax.diagnose.patience import Patience
from scpjax.diagnose.remainder import level, swings_within_bins, takes_most
from scpjax.diagnose.result import Latent
from scpjax.physics.terms import Term

ROOT = Path(__file__).resolve().parents[2]
DRAUGHT = np.where((TIME > 30) & (TIME < 75), -0.25 * np.sin((TIME - 30) / 45 * np.pi) ** 2, 0.0)  # [W]


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
    assert np.mean(np.abs(off) <= 1.96 * std) > 0.85
    assert np.all(std > 0)
    assert np.median(1.96 * std) < 0.25 * np.sqrt(np.mean(truth**2))  # the band is none that holds everything


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
    assert able(found, base, parts) == ("thermoelectric",)


@cache
def recorded_temperature() -> np.ndarray:
    return recorded(nothing).output("temperature") - AMBIENT


@pytest.mark.parametrize(("times", "where"), [(10.0, ("thermomechanical", "sensor")), (1.2, ("thermomechanical",))])
def test_a_balance_is_in_question_by_what_it_answers_for_of_what_is_no_noise(times, where):
    """Where most of a misfit is noise, a few hundredths of it are a good part of what is missing."""
    whole = np.ones((1, 800, 2), bool)
    base = cast(State, SimpleNamespace(residual=np.full(whole.shape, times)))
    parts = cast(Split, SimpleNamespace(is_train=whole, is_held=~whole))
    lacking = [SimpleNamespace(subsystem=s, explained=e) for s, e in (("thermomechanical", 0.2), ("sensor", 0.16))]
    assert able(cast("list[Latent]", lacking), base, parts) == where


@pytest.mark.parametrize(("rings", "found"), [(0.0, False), (3.0, True), (np.nan, True)])
def test_what_rings_within_the_bins_is_no_closure(monkeypatch, rings, found):
    """Every other sample too high and too low by as much: no bin of two tells of it."""
    outputs, weights = np.zeros((1, 400, 1)), np.ones((1, 400, 1))
    data = SimpleNamespace(outputs=outputs, weights=weights, sigma=np.array([0.1]))
    predicted = {
        "before": outputs + 0.2,
        "learned": outputs + 0.1 + 0.1 * rings * np.resize([1.0, -1.0], outputs.shape),
    }
    monkeypatch.setattr(remainder, "outputs_of", lambda trial, _data, _space: predicted[trial])
    state = lambda trial: cast(State, SimpleNamespace(trial=trial, setup=SimpleNamespace(space=None)))  # noqa: E731
    parts = cast(Split, SimpleNamespace(whole=data))
    assert swings_within_bins(state("learned"), state("before"), parts) is found


@pytest.mark.parametrize("rings", [False, True])
def test_names_stay_that_only_a_closure_which_rings_was_better_than(monkeypatch, rings):
    state = cast(State, SimpleNamespace(names=("creep",)))
    named, instead = Choice(state, (), {"creep": 0.9}, {}), Choice(state, (), {}, {}, outdone=True)
    closure = SimpleNamespace(state=state)
    monkeypatch.setattr(room, "level", lambda *_: 1.0)
    monkeypatch.setattr(room, "form_rather_than_name", lambda *_: (instead, closure))
    monkeypatch.setattr(room, "swings_within_bins", lambda *_: rings)
    monkeypatch.setattr(room, "nothing_explains", lambda *_: False)
    found = Found(None, state, named)  # type: ignore[arg-type]
    told = room._beyond(found, None, (), Evidence(), Patience(), lambda *_: None)  # type: ignore[arg-type]
    assert told[:2] == ((replace(named, rang=True), None) if rings else (instead, closure))


def test_nothing_is_missing_where_nothing_is():
    base, parts = base_of(recorded(nothing, seed=1))
    _, found = lacking_in(base, parts)
    assert max(m.evidence for m in found) < 6
    assert learn(base, parts, Evidence()) is None


def test_closure_is_learned_in_its_balance_and_is_the_loss_that_was_concealed():
    base, parts = rubbed()
    assert level(base, parts) > 2
    _, lacking = lacking_in(base, parts)
    assert "thermoelectric" in able(lacking, base, parts)
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


@pytest.mark.parametrize(("leaves", "says"), [(1.7, True), (2.2, False)])
def test_a_closure_says_where_the_misfit_lies_by_what_it_takes_beyond_the_noise(leaves, says):
    base, parts = rubbed()
    flat = lambda level: replace(base, residual=np.full_like(base.residual, level))  # noqa: E731
    assert takes_most(flat(np.sqrt(5.0)), flat(np.sqrt(leaves)), parts) == says


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
