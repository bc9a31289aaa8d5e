"""What differs by recording: a room with a course of its own in each, and a mechanism of another strength in each."""

import json
from functools import cache

import numpy as np
import pytest
from diagnose.heated import LOSS, base_of, nothing, recorded, rubbed_by_air

from scpjax.diagnose.diagnose import diagnose
from scpjax.diagnose.evidence import Evidence
from scpjax.diagnose.holdout import Split
from scpjax.diagnose.hypothesis import State
from scpjax.diagnose.own import own_room, released
from scpjax.diagnose.remainder import AT_NOISE, level
from scpjax.diagnose.rivals import added
from scpjax.fit.fit import final_model
from scpjax.recordings import excitation
from scpjax.report.diagnosis import write_diagnosis

DRIVES = [
    excitation.multilevel_random(duration_s=120, period_s=0.1, hold_s=6, low=0, high=4, seed=seed)[1]
    for seed in (3, 4, 5)
]
COLD, TAU = 3.0, 5.0  # [K] by which the room falls, and how quickly [s]
DOORS = ((20.0, 70.0), (35.0, 100.0), (50.0, 80.0))  # [s] opened and shut, in each recording
STRENGTHS = (0.2, 0.6, 1.0)  # of a loss that grows with the temperature, in each recording


def settled(since: float) -> float:
    return 1.0 - np.exp(-max(since, 0.0) / TAU)


def door(opened: float, shut: float):
    return lambda t, _temperature, _x: LOSS * COLD * (settled(t - opened) - settled(t - shut))


def warmer(strength: float):
    """A loss [W] in excess of Newton's law, by the square of the temperature."""
    return lambda _t, temperature, _x: strength * LOSS * temperature * abs(temperature) / 30.0


@cache
def fitted(which: str) -> tuple[State, Split]:
    heats = {
        "door": [door(*d) for d in DOORS],
        "loss": [warmer(s) for s in STRENGTHS],
        "one loss": [warmer(0.6)] * 3,
        "air": [rubbed_by_air] * 3,
        "nothing": [nothing] * 3,
    }[which]
    return base_of(*(recorded(h, seed=i, drive=d) for i, (h, d) in enumerate(zip(heats, DRIVES, strict=True))))


def values_of(state: State, name: str) -> np.ndarray:
    return state.values[state.setup.structure.where[name]]


def test_a_door_opened_at_other_times_in_each_recording_is_found():
    base, parts = fitted("door")
    found = own_room(base, parts, Evidence())
    assert found is not None
    assert found.accepted
    assert found.law == "excursion"
    assert level(found.state, parts) < AT_NOISE < 3.0 < level(base, parts)
    opened, shut = np.transpose(DOORS)
    np.testing.assert_allclose(values_of(found.state, "ambient_drift.begin"), opened, atol=1.5)
    np.testing.assert_allclose(values_of(found.state, "ambient_drift.end"), shut, atol=1.5)
    reference = values_of(found.state, "ambient_drift.reference")
    np.testing.assert_allclose(values_of(found.state, "ambient_drift.drift") * reference, -COLD, rtol=0.15)


@pytest.mark.parametrize("which", ["nothing", "one loss", "air"])
def test_no_room_is_blamed_for_what_the_drive_brings_about(which):
    base, parts = fitted(which)
    found = own_room(base, parts, Evidence())
    assert found is None or level(found.state, parts) > AT_NOISE


def test_a_mechanism_of_another_strength_in_each_recording_is_released():
    base, parts = fitted("loss")
    shared = added(base, "nonlinear_heat_loss", parts)
    assert level(shared, parts) > 1.5
    own = released(shared, parts, Evidence())
    assert own is not None
    assert own.setup.structure.own == ("nonlinear_heat_loss.strength",)
    assert level(own, parts) < AT_NOISE
    strength = values_of(own, "nonlinear_heat_loss.strength")
    np.testing.assert_allclose(strength / strength[1], np.array(STRENGTHS) / STRENGTHS[1], rtol=0.15)
    assert own_room(own, parts, Evidence()) is None  # nor is more asked of what differs already
    assert released(own, parts, Evidence()) is None
    model = final_model(own.setup, own.trial)
    assert not model.structure.own
    mean = np.exp(np.mean(np.log(strength)))  # it is on log scale
    np.testing.assert_allclose(model.value("nonlinear_heat_loss.strength"), mean, rtol=1e-6)


def test_what_all_recordings_share_is_not_released():
    base, parts = fitted("one loss")
    assert released(added(base, "nonlinear_heat_loss", parts), parts, Evidence()) is None


def test_a_room_that_differs_is_told_as_such(tmp_path):
    recordings = [recorded(door(*d), seed=i, drive=v) for i, (d, v) in enumerate(zip(DOORS, DRIVES, strict=True))]
    found = diagnose(recordings)
    assert found.verdict == "explained"
    (room,) = found.mechanisms
    assert (room.name, room.law) == ("ambient_drift", "excursion")
    assert room.by_recording == ("drift", "begin", "end")
    begun = [e for key, e in room.parameters.items() if key.startswith("begin@")]
    assert len(begun) == 3
    for e, (opened, _) in zip(begun, DOORS, strict=True):
        assert e.value == pytest.approx(opened, abs=max(4 * e.std, 0.5))
    assert any(r.name == "ambient_drift" and r.law == "excursion, by recording" for r in found.ranking)
    write_diagnosis(found, tmp_path)
    told = json.loads((tmp_path / "diagnosis.json").read_text(encoding="utf-8"))["mechanisms"][0]
    assert told["by_recording"] == ["drift", "begin", "end"]
    size, drifts = told["references"]["reference"], [e.value for k, e in room.parameters.items() if "drift@" in k]
    assert size["unit"] == "K"
    np.testing.assert_allclose(size["value"] * np.array(drifts), -COLD, rtol=0.1)  # what the room fell by, in kelvin
    page = (tmp_path / "report.html").read_text(encoding="utf-8")
    assert "It differs by recording (drift, begin and end)" in page
    assert f"Stated for T_ref = {size['value']:.3g} K" in page
