"""Values that are hardly meant are doubted, each with its mend; ordinary ones are not."""

import numpy as np
import pytest

from scpjax.recordings import read_recording
from scpjax.recordings.plausible import LOOK, doubts, doubts_of_ambient
from scpjax.recordings.recording import Metadata, Recording

TIME = np.arange(60) * 0.1


def recorded(time=TIME, **changes) -> Recording:
    shape = 1 - np.exp(-TIME / 2)
    columns = {"voltage_V": 3 * (TIME > 1), "temperature_degC": 22 + 60 * shape, "displacement_mm": 8 * shape}
    columns |= changes
    drive = {k: v for k, v in columns.items() if k.startswith(("voltage", "current", "power"))}
    outputs = {k: v for k, v in columns.items() if k not in drive}
    return Recording.from_arrays(time, drive, outputs, metadata=Metadata(name="made"))


def test_ordinary_values_are_not_doubted():
    assert doubts(recorded()) == ()
    assert doubts(recorded(angle_deg=25 * np.sin(TIME))) == ()
    assert doubts_of_ambient("made", 295.15) == ()


@pytest.mark.parametrize(
    ("changes", "words"),
    [
        ({"voltage_V": 3000.0 * (TIME > 1)}, "made, voltage_V: reaches 3000 V; is it in thousandths (voltage_mV)?"),
        ({"displacement_mm": 8e-3 * np.sin(TIME)}, "is it in m or cm (displacement_m, displacement_cm)?"),
        ({"displacement_mm": 8e3 * np.sin(TIME)}, "all of its travel is"),
        ({"temperature_degC": 300.0 + TIME}, "is it in kelvin (temperature_K)"),
        ({"temperature_degC": 512.0 + 20 * TIME}, "raw counts"),
        ({"angle_deg": 4000 * np.sin(TIME)}, "is it in another unit?"),
        ({"time": 1000 * TIME}, "samples are 100 s apart; stamps in milliseconds belong in a column time_ms"),
    ],
)
def test_what_is_hardly_meant_is_doubted(changes, words):
    (found,) = doubts(recorded(**changes))
    assert found.startswith(LOOK)
    assert words in found


@pytest.mark.parametrize("ambient", [273.14, 344.8])
def test_an_ambient_of_no_room_is_doubted(ambient):
    (found,) = doubts_of_ambient("made", ambient)
    assert "ambient_degC in the .toml" in found


@pytest.mark.parametrize(
    ("column", "meant"),
    [
        ("Temperature_degC", "temperature_degC"),
        ("temp_degC", "temperature_degC"),
        ("temprature_K", "temperature_K"),
        ("Force_N", "force_N"),
        ("humidity_pct", ""),
        ("temperature_ambient_degC", ""),
        ("voltage2_V", ""),
    ],
)
def test_a_column_whose_name_is_nearly_right_is_asked_about(tmp_path, column, meant):
    path = tmp_path / "a.csv"
    path.write_text(
        f"time_s,voltage_V,displacement_mm,{column}\n" + "\n".join(f"{k},{k % 3},{k},{20 + k}" for k in range(12))
    )
    said = [d for d in doubts(read_recording(path)) if "is not read" in d]
    assert len(said) == bool(meant)
    if meant:
        assert said[0].endswith(f"the column {column} is not read; is it {meant}?")


@pytest.mark.parametrize(
    ("column", "told", "asked"), [("degC", "", True), ("humidity_pct", "", False), ("degC", "20.0", False)]
)
def test_a_column_of_the_room_is_asked_for_in_the_toml(tmp_path, column, told, asked):
    path, name = tmp_path / "a.csv", f"ambient_{column}"
    path.write_text(f"time_s,voltage_V,displacement_mm,{name}\n" + "\n".join(f"{k},{k % 3},{k},21" for k in range(9)))
    if told:
        (tmp_path / "a.toml").write_text(f"[environment]\nambient_degC = {told}\n")
    said = [d for d in doubts(read_recording(path)) if "is not read" in d]
    mend = "give the room's temperature as ambient_degC in the .toml"
    assert said == ([f"{LOOK}a: the column {name} is not read; {mend}"] if asked else [])


def test_a_recording_without_times_says_so(tmp_path):
    path = tmp_path / "a.csv"
    path.write_text("index,voltage_V,displacement_mm\n" + "\n".join(f"{k},{k % 3},{k}" for k in range(12)))
    assert any("a sample counts as a second" in d for d in doubts(read_recording(path)))
