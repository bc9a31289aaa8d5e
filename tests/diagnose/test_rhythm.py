"""What swings whatever the drive does: its period, its place, and nothing where nothing swings."""

from dataclasses import replace
from functools import cache
from types import SimpleNamespace

import numpy as np
import pytest
from diagnose.heated import BASE, DRIVE, LOSS, NOISE, TIME, base_of, nothing, recorded, rubbed_by_air

from scpjax.diagnose import diagnose as room
from scpjax.diagnose.choice import Choice
from scpjax.diagnose.diagnose import diagnose
from scpjax.diagnose.evidence import Evidence
from scpjax.diagnose.given_up import outdone
from scpjax.diagnose.holdout import Split, split
from scpjax.diagnose.hypothesis import State, residual_on
from scpjax.diagnose.latent import Misfit, missing
from scpjax.diagnose.locate import observe
from scpjax.diagnose.naming import Found
from scpjax.diagnose.patience import Patience
from scpjax.diagnose.remainder import level
from scpjax.diagnose.rhythm import Rhythm, rhythms, ripple
from scpjax.diagnose.swing import swinging
from scpjax.fit.fit import best_start, refine
from scpjax.fit.identifiability import estimates, uncertainty
from scpjax.fit.setup import prepare
from scpjax.physics.catalogue import mechanism
from scpjax.physics.known import known_model
from scpjax.physics.mechanisms.learned_swing import Swings, law_of
from scpjax.physics.model import Model
from scpjax.recordings.recording import Metadata, Recording
from scpjax.report.diagnosis import write_diagnosis
from scpjax.simulate.simulate import simulate

PERIOD = 11.7  # [s]


def fan(t, temperature, _x):
    """Out of the wire [W]: it comes on for two fifths of every period."""
    return 0.3 * LOSS * temperature * (t % PERIOD < 0.4 * PERIOD)


def supply(t, _temperature, _x):
    """A power that wavers with the supply [W], as a loss."""
    now = DRIVE[min(int(t / (TIME[1] - TIME[0])), len(DRIVE) - 1)]
    return -0.2 * np.sin(2 * np.pi * t / PERIOD) * now**2 * BASE["joule_heating.gain"]


def sun(t, _temperature, _x):
    """Warmth [W] that comes and goes, as a loss."""
    return -0.15 * np.sin(2 * np.pi * t / PERIOD + 1.0)


@cache
def fitted(heat, shake: float = 0.0) -> tuple[State, Split]:
    return base_of(recorded(heat, rattle=shake * np.sin(2 * np.pi * TIME / PERIOD)))


@cache
def misfit_of(heat, shake: float = 0.0) -> Misfit:
    base, parts = fitted(heat, shake)
    return Misfit(base.setup, parts.whole, base.trial, observe(base.setup, parts.whole, base.trial, base.residual))


def found_in(misfit: Misfit) -> Rhythm | None:
    return next(iter(rhythms(misfit, missing(misfit))), None)


@pytest.mark.parametrize(
    ("heat", "shake", "places"),
    [
        (fan, 0.0, {"heat"}),
        (supply, 0.0, {"drive"}),
        (sun, 0.0, {"heat"}),
        (lambda t, T, x: 0.0, 0.5, {"force", "displacement reading"}),  # [mm], slow: what pulls would look the same
    ],
    ids=["a fan", "a wavering supply", "the sun", "a shaken sensor"],
)
def test_its_period_and_place(heat, shake, places):
    found = found_in(misfit_of(heat, shake))
    assert found is not None
    assert found.period == pytest.approx(PERIOD, rel=0.01)
    assert found.place in places
    assert found.share > 0.8


@pytest.mark.parametrize(
    ("measured", "share", "place"),
    [("displacement", 0.9, "force"), ("displacement", 0.97, "heat"), ("temperature", 0.9, "heat")],
)
def test_where_no_thermometer_was_a_force_swings_rather_than_a_heat(monkeypatch, measured, share, place):
    """Unless a heat takes clearly more away; with one nothing is guessed."""
    where = {"heat": "thermoelectric", "force": "thermomechanical"}
    shares = {"heat": share + 0.005, "force": 0.9}
    monkeypatch.setattr(
        "scpjax.diagnose.rhythm._of",
        lambda misfit, place, subsystem: [Rhythm(subsystem, place, "", PERIOD, shares[place])],
    )
    lacking = [SimpleNamespace(subsystem=s, place=p, explained=0.9) for p, s in where.items()]
    found = rhythms(SimpleNamespace(places={f"{measured} reading": None, **where}), lacking)  # type: ignore[arg-type]
    assert found[0].place == place
    assert {r.place for r in found} == set(where)


def test_on_each_side_of_a_joint_a_loss_swings_with_its_own_temperature():
    """One is hot while the other cools: in proportion to the temperature of one, it would hide on the other."""
    period, time = 20.9, np.arange(0.0, 240.0, 0.1)
    turns = np.random.default_rng(5).permutation(np.arange(16) % 4)[(time // 15.0).astype(int)]
    volts = {f"voltage_{side}_V": 3.0 * (turns == i) for i, side in enumerate(("agonist", "antagonist"))}
    plain = known_model("aaa")
    structure = plain.structure.with_mechanisms(mechanism("learned_swing"))
    laws = np.zeros(len(structure.mechanisms))
    laws[-1] = law_of(Swings("heat", "temperature"), 1)
    known = {f"learned_swing.{k}": v for k, v in {"period": period, "cos1": 0.05, "sin1": 0.05}.items()}
    model = Model(structure, laws=laws, ambient=plain.ambient).replace(plain.values() | known)
    drive = Recording.from_arrays(time, volts, {}, require_outputs=False)
    pulley = Metadata(pulley_radius_m=plain.structure.pulley_radius, pulley_mass_kg=plain.structure.pulley_mass)
    seen = np.asarray(simulate(model, drive).outputs)
    names = ("temperature_agonist_degC", "temperature_antagonist_degC", "angle_deg")
    seen = dict(zip(names, (seen - [273.15, 273.15, 0.0]).T * [[1.0], [1.0], [180.0 / np.pi]], strict=True))
    rng = np.random.default_rng(6)
    noisy = {n: x + 0.002 * np.ptp(x) * rng.standard_normal(len(x)) for n, x in seen.items()}
    base, parts = base_of(Recording.from_arrays(time, volts, noisy, metadata=pulley))
    binned = observe(base.setup, parts.whole, base.trial, base.residual)
    found = found_in(Misfit(base.setup, parts.whole, base.trial, binned))
    assert found is not None
    assert (found.place, found.factor, found.subsystem) == ("heat", "temperature", "thermoelectric")
    assert found.share > 0.9
    np.testing.assert_allclose(found.period, period, rtol=0.01)
    there = binned.time[0] < time[-1]
    at = np.searchsorted(time, binned.time[0][there])
    alike = lambda x, y: np.corrcoef(x[0][there], y[at])[0, 1] > 0.97  # noqa: E731
    for side in ("agonist", "antagonist"):  # which is also what its missing heat is set against
        own = binned.on(f"heat_{side}")
        assert alike(own.temperature, seen[f"temperature_{side}_degC"])
        assert alike(own.drive, volts[f"voltage_{side}_V"])
    assert alike(binned.on("angle reading").drive, volts["voltage_agonist_V"] - volts["voltage_antagonist_V"])


def test_nothing_swings_where_a_state_has_it():
    assert found_in(misfit_of(rubbed_by_air)) is None


def test_what_comes_and_goes_at_random_does_not_swing():
    """Thirty heat flows with a memory of a few seconds, in the place of what is missing: at most one passes for one."""
    misfit, rng = misfit_of(fan), np.random.default_rng(4)
    keep, alarms, places = misfit.target, 0, missing(misfit)
    for _ in range(30):
        kick = rng.standard_normal(misfit.binned.there.shape[1])
        memory = np.exp(-misfit.widths[0] / rng.uniform(1.0, 8.0))
        flow = np.zeros_like(kick)
        for i in range(1, len(flow)):
            flow[i] = memory * flow[i - 1] + kick[i]
        felt = misfit.responses("heat", [flow[:, None]])[:, 0]
        misfit.target = 10 * felt / np.std(felt) + rng.standard_normal(len(felt))
        alarms += bool(rhythms(misfit, places))
    misfit.target = keep
    assert alarms <= 1


def test_no_swing_where_the_drive_repeats_as_often():
    misfit = misfit_of(fan)
    time = misfit.binned.time
    kept, misfit.binned = misfit.binned, replace(misfit.binned, drive=4.0 * (time % PERIOD < 5.0))
    found = found_in(misfit)
    misfit.binned = kept
    assert found is None or abs(found.period / PERIOD - 1) > 0.02


@pytest.mark.parametrize(("heat", "harmonics"), [(supply, 1), (sun, 1), (fan, 4)], ids=["supply", "sun", "fan"])
def test_it_is_learned_down_to_the_noise(heat, harmonics):
    base, parts = fitted(heat)
    swing = swinging(base, parts, Evidence(), found_in(misfit_of(heat)))
    assert swing is not None
    assert swing.harmonics == harmonics
    assert level(swing.state, parts) < 1.15
    doubt = uncertainty(swing.state.trial, parts.train, swing.state.setup.space)
    every = estimates(swing.state.trial, swing.state.setup.space, doubt)
    period = every["learned_swing.period"]
    assert abs(period.value - PERIOD) < 4 * period.std
    assert period.std < 0.01 * PERIOD
    if heat is supply:  # as strong as it was made
        assert np.hypot(*(every[k].value for k in swing.keys)) == pytest.approx(0.2, rel=0.03)


def test_it_is_not_learned_where_every_recording_has_a_phase_of_its_own():
    """A sun that rises when it likes: the period and the balance are told all the same."""
    halves = [
        recorded(lambda t, T, x, ahead=ahead: sun(t + ahead, T, x)) for ahead in (0.0, PERIOD / 3, 2 * PERIOD / 3)
    ]
    setup = prepare(halves)
    parts = split(setup.data)
    trial, _, _ = best_start(setup, parts.train)
    trial, _, cost = refine(setup, parts.train, trial)
    base = State(setup, trial, residual_on(trial, parts.whole, setup), float(cost))
    found = found_in(Misfit(setup, parts.whole, trial, observe(setup, parts.whole, trial, base.residual)))
    assert found is not None
    assert (found.place, found.period) == ("heat", pytest.approx(PERIOD, rel=0.01))
    assert swinging(base, parts, Evidence(), found) is None


def test_a_diagnosis_tells_period_and_balance(tmp_path):
    """Of a thermometer alone; the sentence, the note and the JSON say it, no name is given, the swing is learned."""
    both = recorded(supply)
    warm = Recording.from_arrays(TIME, {"voltage_V": DRIVE}, {"temperature_degC": both.output("temperature") - 273.15})
    found = diagnose([warm], model="te")
    assert (found.verdict, found.mechanisms) == ("unexplained", ())
    assert "What is missing swings with a period of 11.7 s" in found.says
    assert found.location.subsystem == "drive"
    assert found.to_json()["location"]["period_s"] == pytest.approx(PERIOD, rel=0.01)
    assert any("a swing of drive" in note for note in found.notes)
    assert found.closure is not None
    assert found.closure.depends_on == ("time",)
    assert found.closure.expression.startswith("drive greater by s(t), s = 20")
    assert found.extended.held_out["temperature_degC"]["rmse"] < 1.15 * NOISE["temperature_degC"]
    drawn = found.closure.curve
    assert drawn.value.max() == pytest.approx(20.0, rel=0.03)  # [%]
    assert drawn.at[-1] == pytest.approx(PERIOD, rel=0.01)
    page = write_diagnosis(found, tmp_path).read_text(encoding="utf-8")
    assert "It swings with a period of 11.7 s" in page


PITCH = 0.9  # [mm]


@cache
def out_of_round() -> tuple[State, Split]:
    """A reading whose error repeats with every turn of a pulley."""
    moved = 1e3 * recorded(nothing, quiet=0.0).output("displacement")
    return base_of(recorded(nothing, rattle=0.2 * np.sin(2 * np.pi * moved / PITCH + 0.4)))


def test_what_repeats_with_the_displacement_is_found_in_the_reading_and_learned():
    base, parts = out_of_round()
    misfit = Misfit(base.setup, parts.whole, base.trial, observe(base.setup, parts.whole, base.trial, base.residual))
    found = ripple(misfit)
    assert found is not None
    assert (found.subsystem, found.place, found.variable) == ("sensor", "displacement reading", "displacement")
    assert found.period == pytest.approx(1e-3 * PITCH, rel=0.03)
    assert found.share > 0.9
    swing = swinging(base, parts, Evidence(), found)
    assert swing is not None
    assert swing.harmonics == 1
    assert level(swing.state, parts) < 1.1 < 3 < level(base, parts)
    doubt = uncertainty(swing.state.trial, parts.train, swing.state.setup.space)
    every = estimates(swing.state.trial, swing.state.setup.space, doubt)
    pitch = every["learned_swing.pitch"]
    assert abs(pitch.value - 1e-3 * PITCH) < 4 * pitch.std < 0.02e-3 * PITCH
    assert base.setup.scales.displacement * np.hypot(*(every[k].value for k in swing.keys)) == pytest.approx(
        0.2e-3, rel=0.03
    )


@pytest.mark.parametrize("heat", [fan, supply, rubbed_by_air], ids=["a fan", "a wavering supply", "a loss"])
def test_nothing_repeats_with_the_displacement_where_something_else_is_missing(heat):
    assert ripple(misfit_of(heat)) is None


def test_a_ripple_is_told_as_what_it_is(tmp_path):
    moved = 1e3 * recorded(nothing, quiet=0.0).output("displacement")
    found = diagnose([recorded(nothing, rattle=0.2 * np.sin(2 * np.pi * moved / PITCH + 0.4))])
    assert (found.verdict, found.mechanisms) == ("unexplained", ())
    assert "What is missing repeats with every 0.9 mm of displacement" in found.says
    assert found.location.subsystem == "sensor"
    assert found.to_json()["location"]["period_m"] == pytest.approx(1e-3 * PITCH, rel=0.01)
    assert found.to_json()["location"]["period_s"] is None
    assert any("pulley out of round" in note for note in found.notes)
    assert found.closure is not None
    assert found.closure.depends_on == ("displacement",)
    assert found.closure.expression.startswith("displacement reads too much by s(x), s = 0.2")
    assert found.extended.held_out["displacement_mm"]["rmse"] < 1.1 * NOISE["displacement_mm"]
    assert "It repeats with every 0.9 mm of displacement" in write_diagnosis(found, tmp_path).read_text("utf-8")


@pytest.mark.parametrize(
    ("free", "left", "by_swing", "told"),
    [
        ("thermal_softening", 1.0, 0.5, "swing"),  # a curve at the noise, and less is left by what repeats
        ("thermal_softening", 1.0, 2.0, "curve"),
        ("", 1.0, 0.5, "curve"),  # a closure at the noise: nothing is asked
        ("", 4.0, 3.0, "swing"),
        ("", 4.0, None, "curve"),
    ],
)
def test_what_repeats_stands_against_a_curve(monkeypatch, free, left, by_swing, told):
    """Where that goes by a name, or does not reach the noise."""
    played = lambda level: None if level is None else SimpleNamespace(state=SimpleNamespace(level=level, names=()))  # noqa: E731
    base = SimpleNamespace(level=9.0, names=())
    choice = Choice(base, (), {free: 0.9} if free else {}, {}, free=free)  # type: ignore[arg-type]
    curve, swing = played(left), played(by_swing)
    monkeypatch.setattr(room, "level", lambda state, parts: state.level)
    monkeypatch.setattr(room, "is_better", lambda a, b, parts, rules: a.level < b.level)
    monkeypatch.setattr(room, "nothing_explains", lambda *_: False)
    monkeypatch.setattr(room, "_repeating", lambda *_: ("period", swing))
    monkeypatch.setattr(room, "outdone", lambda before, best, base, parts: Choice(base, (), {}, {}, outdone=True))
    found = Found(None, base, choice, curve)  # type: ignore[arg-type]
    after, learned, period = room._beyond(found, None, (), Evidence(), Patience(), lambda *_: None)  # type: ignore[arg-type]
    assert learned is (swing if told == "swing" else curve)
    assert period == ("period" if told == "swing" else None)
    assert (after.outdone, after.free) == (told == "swing", "" if told == "swing" else free)


@pytest.mark.parametrize(
    ("ahead", "modelled", "place"),
    [
        (5.0, ("drive", "heat"), "drive"),
        (50.0, ("drive", "heat"), "heat"),
        (50.0, ("drive",), "drive"),
        (-50.0, ("heat",), "heat"),
        (50.0, (), None),
    ],
)
def test_of_places_that_come_near_each_other_the_model_decides(monkeypatch, ahead, modelled, place):
    """``ahead``: evidence of the other place's model against that of the likeliest one, where both have one."""
    likeliest, other = (Rhythm("thermoelectric", p, "", PERIOD, share) for p, share in (("drive", 0.86), ("heat", 0.8)))
    models = {p: SimpleNamespace(state=p, period=0.9 * PERIOD) for p in modelled}
    monkeypatch.setattr(room, "rhythms", lambda *_: [likeliest, other])
    monkeypatch.setattr(room, "ripple", lambda *_: None)
    monkeypatch.setattr(room, "swinging", lambda _b, _p, _r, found: models.get(found.place))
    monkeypatch.setattr(room, "ahead", lambda a, b, *_: 0.0 if a == b else ahead if a == "heat" else -ahead)
    base = SimpleNamespace(setup=SimpleNamespace(structure=SimpleNamespace(pulley_radius=None)))
    swing, by_swing = room._repeating(None, [], base, None, Evidence(), Patience())  # type: ignore[arg-type]
    if place is None:
        assert (swing, by_swing) == (likeliest, None)
    else:
        assert by_swing is models[place]
        assert swing == replace(likeliest if place == "drive" else other, period=0.9 * PERIOD)
    late = Patience(0.0, 0.0)
    assert room._repeating(None, [], base, None, Evidence(), late) == (likeliest, None)  # type: ignore[arg-type]
    assert "a model of what swings" in late.notes()[-1]


def test_a_curve_that_is_outdone_is_told_of():
    base, parts = out_of_round()
    after = outdone(Choice(base, (), {"slack": 0.9}, {}, free="slack"), base, base, parts)
    assert (after.given_up, after.outdone, after.free) == ((("slack",), pytest.approx(1.0)), True, "")
    nothing = Choice(base, (), {}, {}, given_up=(("creep",), 0.4))  # which stays told of
    assert outdone(nothing, base, base, parts) is nothing
