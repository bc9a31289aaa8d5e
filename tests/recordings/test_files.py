"""Recordings are read as written; a broken file is refused in one line that says where and how to mend."""

import os
import time
from pathlib import Path

import numpy as np
import pytest

from scpjax.errors import RecordingError
from scpjax.recordings import files, read_recording, read_recordings, write_recording

HEADER = "time_s,voltage_V,temperature_degC,displacement_mm"


def rows(n: int = 12, change: dict[int, str] | None = None) -> list[str]:
    """Rows 0.1 s apart; ``change`` replaces some by number."""
    made = [f"{k / 10:g},{3 * (k > 3)},{23 + k / 2:g},{k / 10:g}" for k in range(n)]
    for k, row in (change or {}).items():
        made[k] = row
    return made


def write(folder: Path, text: str | bytes | None = None, toml: str | None = None) -> Path:
    path = folder / "run.csv"
    text = "\n".join([HEADER, *rows()]) + "\n" if text is None else text
    path.write_bytes(text if isinstance(text, bytes) else text.encode())
    if toml is not None:
        path.with_suffix(".toml").write_text(toml)
    return path


def table(header: str = HEADER, change: dict[int, str] | None = None, n: int = 12) -> str:
    return "\n".join([header, *rows(n, change)]) + "\n"


def test_values_are_si(tmp_path):
    recording = read_recording(write(tmp_path))
    assert recording.n == 12
    np.testing.assert_allclose(recording.time, np.arange(12) / 10)
    np.testing.assert_allclose(recording.input("voltage"), [0] * 4 + [3] * 8)
    np.testing.assert_allclose(recording.output("temperature"), 273.15 + 23 + np.arange(12) / 2)
    np.testing.assert_allclose(recording.output("displacement_mm"), np.arange(12) * 1e-4)
    assert recording.hold == "zero_order"
    assert recording.metadata.name == "run"
    assert np.all(recording.weights == 1)


CLEAN = table()
VARIANTS = {
    "byte order mark": ("﻿" + CLEAN).encode(),
    "crlf": CLEAN.replace("\n", "\r\n"),
    "blank trailing lines": CLEAN + "\n\n  \n",
    "only delimiters at the end": CLEAN + ",,,\n,,,\n",
    "comments": "# rig 3\n" + CLEAN.replace("0.5,3", "# note\n0.5,3").replace("25.5,0.5", "25.5,0.5 # lamp"),
    "quoted header": CLEAN.replace(HEADER, ",".join(f'"{name}"' for name in HEADER.split(","))),
    "quoted cells": CLEAN.replace("0.5,3,", '0.5,"3",'),
    "spaces": CLEAN.replace(",", " , "),
    "semicolons": CLEAN.replace(",", ";"),
    "semicolons and decimal commas": CLEAN.replace(",", ";").replace(".", ","),
    "tabs": CLEAN.replace(",", "\t"),
    "delimiter at the end": CLEAN.replace("0.5,3,25.5,0.5\n", "0.5,3,25.5,0.5,\n"),
    "no final newline": CLEAN.rstrip("\n"),
    "milliseconds": "time_ms," + CLEAN.split(",", 1)[1].replace("\n0.", "\n").replace("\n1,", "\n10,"),
}


@pytest.mark.parametrize("name", VARIANTS)
def test_variants_read_like_the_clean_file(tmp_path, name):
    text = VARIANTS[name]
    if name == "milliseconds":
        lines = [row.split(",", 1) for row in rows()]
        text = "\n".join([HEADER.replace("time_s", "time_ms"), *(f"{float(t) * 1e3:g},{r}" for t, r in lines)])
    recording = read_recording(write(tmp_path, text))
    clean = tmp_path / "clean"
    clean.mkdir()
    expected = read_recording(write(clean))
    np.testing.assert_allclose(recording.time, expected.time, atol=1e-12)
    np.testing.assert_array_equal(recording.inputs, expected.inputs)
    np.testing.assert_array_equal(recording.outputs, expected.outputs)


@pytest.mark.parametrize("cell", ["", "nan", "NaN", " NA "])
def test_missing_output_cells_have_weight_0(tmp_path, cell):
    recording = read_recording(write(tmp_path, table(change={5: f"0.5,3,{cell},0.5"})))
    np.testing.assert_array_equal(recording.weight("temperature"), np.arange(12) != 5)
    assert recording.output("temperature")[5] == pytest.approx(273.15 + 25.5)  # interpolated
    assert np.all(recording.weight("displacement") == 1)


def test_text_in_a_column_without_role_is_ignored(tmp_path):
    text = "\n".join(row + end for row, end in zip([HEADER, *rows()], [",note", *["ok"] * 12], strict=True))
    text = text.replace("ok", ",ok")
    assert read_recording(write(tmp_path, text)).n == 12


TOML = """
[recording]
title = "A \\"run\\""
source = "bench"
hold = "linear"
model = "plant"

[roles]
response = "displacement_mm"

[actuator]
resistance_ohm = 1.489
moving_mass_g = 248.8
supply_V = 3.7

[environment]
ambient_degC = 23

[pulley]
radius_m = 0.015
mass_kg = 0.004
"""


def test_sidecar(tmp_path):
    recording = read_recording(write(tmp_path, toml=TOML))
    data = recording.metadata
    assert (data.title, data.source, data.model, recording.hold) == ('A "run"', "bench", "plant", "linear")
    assert data.known == (("resistance_ohm", 1.489), ("moving_mass_kg", pytest.approx(0.2488)))
    assert data.get_known("resistance_ohm") == 1.489
    assert data.get_known("stiffness_N_per_m") is None
    assert (data.supply_V, data.pulley_radius_m, data.pulley_mass_kg) == (3.7, 0.015, 0.004)
    assert data.ambient_K == pytest.approx(296.15)
    assert [c.stem for c in recording.output_channels] == ["displacement"]


def test_arguments_go_before_roles_and_roles_before_names(tmp_path):
    path = write(tmp_path, toml='[roles]\nresponse = ["displacement_mm"]')
    assert [c.stem for c in read_recording(path).output_channels] == ["displacement"]
    both = read_recording(path, response="displacement_mm, temperature_degC")
    assert [c.stem for c in both.output_channels] == ["displacement", "temperature"]
    tm = read_recording(path, drive="temperature_degC", response=["displacement_mm"])
    assert [c.stem for c in tm.input_channels] == ["temperature"]
    assert tm.hold == "linear"


def test_temperature_drives_a_tm_recording(tmp_path):
    text = CLEAN.replace("voltage_V", "humidity_pct")
    recording = read_recording(write(tmp_path, text, '[recording]\nmodel = "tm"'))
    assert [c.column for c in recording.input_channels] == ["temperature_degC"]
    assert [c.column for c in recording.output_channels] == ["displacement_mm"]


def test_unknown_suffix_is_kept_for_named_columns(tmp_path):
    path = write(tmp_path, CLEAN.replace("displacement_mm", "level_foo"))
    recording = read_recording(path, response="level_foo")
    np.testing.assert_allclose(recording.output("level"), np.arange(12) / 10)


def test_joint_columns(tmp_path):
    header = "time_s,voltage_agonist_V,voltage_antagonist_V,angle_deg"
    recording = read_recording(write(tmp_path, table(header)))
    assert [c.stem for c in recording.input_channels] == ["voltage_agonist", "voltage_antagonist"]
    assert recording.output("angle")[10] == pytest.approx(np.deg2rad(1.0))


def test_index_instead_of_time(tmp_path):
    header = "index,voltage_V,temperature_degC,displacement_mm"
    text = "\n".join([header, *(f"{k},{k},{23 + k},{k}" for k in range(10))])
    recording = read_recording(write(tmp_path, text))
    assert recording.metadata.quasi_static
    again = read_recording(write_recording(recording, tmp_path / "again.csv"))
    assert again.metadata.quasi_static
    np.testing.assert_array_equal(again.time, recording.time)


def test_round_trip(tmp_path):
    first = read_recording(
        write(
            tmp_path,
            table(change={5: "0.5,3,,0.5"}),
            TOML.replace('"displacement_mm"', '["temperature_degC", "displacement_mm"]'),
        )
    )
    path = write_recording(first, tmp_path / "new" / "copy.csv")
    second = read_recording(path)
    np.testing.assert_array_equal(second.time, first.time)
    np.testing.assert_allclose(second.inputs, first.inputs, rtol=1e-11)
    np.testing.assert_allclose(second.outputs, first.outputs, rtol=1e-11)
    np.testing.assert_array_equal(second.weights, first.weights)
    assert second.hold == first.hold
    assert second.output_channels == first.output_channels
    assert second.metadata.known == first.metadata.known
    assert second.metadata.title == first.metadata.title
    assert second.metadata.ambient_K == pytest.approx(first.metadata.ambient_K)
    assert sorted(p.name for p in path.parent.iterdir()) == ["copy.csv", "copy.toml"]


def test_a_failed_write_leaves_the_old_file(tmp_path, monkeypatch):
    recording = read_recording(write(tmp_path))
    path = write_recording(recording, tmp_path / "copy.csv")
    before = path.read_bytes()

    def full(*_: object) -> None:
        raise OSError(28, "No space left on device")

    monkeypatch.setattr(files.os, "replace", full)
    with pytest.raises(RecordingError, match="No space left"):
        write_recording(recording.slice(0.0, 0.9), path)
    assert path.read_bytes() == before
    assert sorted(p.name for p in tmp_path.iterdir()) == ["copy.csv", "copy.toml", "run.csv"]


def test_many(tmp_path):
    path = write(tmp_path)
    assert len(read_recordings([path, path])) == 2
    with pytest.raises(RecordingError, match="name at least one"):
        read_recordings([])


NUMBERS = "\n".join(rows())
BROKEN: dict[str, tuple[str | bytes, str, str]] = {
    # name: (CSV, place in the message, a word of the mend)
    "empty": ("", "run.csv:line 1", "export"),
    "only comments": ("# nothing\n\n", "run.csv:line 1", "export"),
    "header only": (HEADER + "\n", "run.csv:line 1", "record"),
    "too few rows": (table(n=5), "run.csv:line 6", "at least 8"),
    "no header": (NUMBERS, "run.csv:line 1", "add a first line"),
    "no time": (table(HEADER.replace("time_s", "t")), "run.csv", "time_s"),
    "time without unit": (table(HEADER.replace("time_s", "time")), "run.csv", "rename 'time'"),
    "no unit": (table(HEADER.replace("_mm", "")), "column displacement", "displacement_mm"),
    "wrong unit": (table(HEADER.replace("_mm", "_inch")), "column displacement_inch", "displacement_cm"),
    "wrong quantity": (table(HEADER.replace("_mm", "_V")), "column displacement_V", "displacement_mm"),
    "temperature_C": (table(HEADER.replace("degC", "C")), "column temperature_C", "temperature_degC"),
    "duplicate": (table(HEADER.replace("temperature_degC", "displacement_mm")), "run.csv:line 1", "rename"),
    "same stem": (table(HEADER.replace("temperature_degC", "displacement_cm")), "displacement_mm", "remove"),
    "nameless column": (table(HEADER.replace("temperature_degC", "")), "run.csv:line 1", "name it"),
    "one column": ("time_s\n" + "\n".join(str(k) for k in range(9)), "run.csv:line 1", "comma"),
    "no drive": (table(HEADER.replace("voltage_V", "humidity_pct")), "run.csv", "[roles]"),
    "no response": ("time_s,voltage_V\n" + "\n".join(f"{k},{k}" for k in range(9)), "run.csv", "[roles]"),
    "ragged short": (table(change={5: "0.5,3,25.5"}), "run.csv:line 7", "repair"),
    "ragged long": (table(change={5: "0.5,3,25.5,0.5,9"}), "run.csv:line 7", "repair"),
    "text": (table(change={5: "0.5,3,warm,0.5"}), "run.csv:line 7", "repair"),
    "decimal comma": (table(change={5: '0.5,"3,2",25.5,0.5'}), "run.csv:line 7", "decimal points"),
    "error text": (table(change={5: "0.5,3,#VALUE!,0.5"}), "'#VALUE!'", "repair"),
    "inf": (table(change={5: "0.5,3,25.5,inf"}), "run.csv:line 7", "repair"),
    "missing drive": (table(change={5: "0.5,,25.5,0.5"}), "run.csv:line 7", "fill it in"),
    "nan drive": (table(change={5: "0.5,nan,25.5,0.5"}), "run.csv:line 7", "repair"),
    "nan time": (table(change={5: "nan,3,25.5,0.5"}), "run.csv:line 7", "repair"),
    "time repeats": (table(change={5: "0.4,3,25.5,0.5"}), "run.csv:line 7", "remove"),
    "time goes back": (table(change={5: "0.1,3,25.5,0.5"}), "run.csv:line 7", "sort"),
    "line after comment": ("# a\n" + table(change={5: "# b\n0.1,3,25.5,0.5"}), "run.csv:line 9", "sort"),
    "kelvin as degC": (table(change={5: "0.5,3,2980,0.5"}), "column temperature_degC", "kelvin"),
    "failed sensor": (table(change={5: "0.5,3,-127,0.5"}), "line 7", "empty"),
    "degC as kelvin": (table(HEADER.replace("degC", "K")), "column temperature_K", "degC"),
    "pwm over 255": (table(HEADER.replace("voltage_V", "pwm"), {5: "0.5,300,25,0"}), "line 7", "255"),
    "latin-1": (table().replace("degC", "°C").encode("latin-1"), "run.csv:line 1", "UTF-8"),
    "latin-1 in row": (table(change={5: "0.5,3,25°,0"}).encode("latin-1"), "run.csv:line 7", "UTF-8"),
    "utf-16": (table().encode("utf-16"), "run.csv:line 1", "UTF-8"),
    "binary": (table().encode() + b"\0\0\0", "run.csv:line 14", "export"),
    "underscored number": (table(change={5: "0.5,1_000,25,0"}), "run.csv:line 7", "repair"),
}


def check_message(error: RecordingError, place: str, word: str, name: str) -> None:
    message = str(error)
    assert name in message
    assert place in message
    assert word in message
    assert "\n" not in message
    assert len(message) < 600


@pytest.mark.parametrize("name", BROKEN)
def test_broken_files(tmp_path, name):
    text, place, word = BROKEN[name]
    with pytest.raises(RecordingError) as caught:
        read_recording(write(tmp_path, text))
    check_message(caught.value, place, word, "run.csv")


BROKEN_TOML: dict[str, tuple[str, str, str]] = {
    "no TOML": ("[recording]\ntitle = x", "run.toml:line 2", "quotes"),
    "unclosed": ("[recording\n", "run.toml:line 1", "key = value"),
    "section": ("[recodring]\ntitle = 'x'", "run.toml:line 1", "'recording'"),
    "top key": ("title = 'x'", "run.toml:line 1", "use one of"),
    "section as value": ("pulley = 3", "run.toml:line 1", "[pulley]"),
    "key": ("[environment]\n\nambient_C = 20", "run.toml:line 3", "'ambient_degC'"),
    "hold": ('[recording]\nhold = "zoh"', "run.toml:line 2", "'zero_order'"),
    "hold misspelt": ('[recording]\nhold = "liner"', "run.toml:line 2", "'linear'"),
    "model": ('[recording]\nmodel = "TEM"', "run.toml:line 2", "use one of te, tm"),
    "ambient in kelvin": ("[environment]\nambient_degC = 296", "run.toml:line 2", "not K"),
    "text for number": ('[environment]\nambient_degC = "23"', "run.toml:line 2", "without quotes"),
    "nan": ("[actuator]\nstiffness_N_per_m = nan", "run.toml:line 2", "without quotes"),
    "boolean": ("[actuator]\nresistance_ohm = true", "run.toml:line 2", "without quotes"),
    "negative resistance": ("[actuator]\nresistance_ohm = -1.2", "run.toml:line 2", "sign"),
    "zero mass": ("[actuator]\nmoving_mass_kg = 0", "run.toml:line 2", "sign"),
    "negative radius": ("[pulley]\nradius_m = -0.01", "run.toml:line 2", "sign"),
    "misspelt actuator": ("[actuator]\nresistence_ohm = 1.2", "run.toml:line 2", "'resistance_ohm'"),
    "role not there": ('[roles]\ndrive = "voltag_V"', "run.csv", "'voltage_V'"),
    "role empty": ('[roles]\ndrive = ""', "run.toml:line 2", "COLUMN"),
    "role number": ("[roles]\ndrive = 3", "run.toml:line 2", "COLUMN"),
    "role twice": ('[roles]\nresponse = "displacement_mm, displacement_mm"', "run.csv", "once"),
    "drive is response": ('[roles]\ndrive = "voltage_V"\nresponse = "voltage_V"', "run.csv", "choose"),
    "title number": ("[recording]\ntitle = 3", "run.toml:line 2", "write title"),
}


@pytest.mark.parametrize("name", BROKEN_TOML)
def test_broken_sidecars(tmp_path, name):
    toml, place, word = BROKEN_TOML[name]
    with pytest.raises(RecordingError) as caught:
        read_recording(write(tmp_path, toml=toml))
    check_message(caught.value, place, word, "run.")


def test_not_there_and_folder(tmp_path):
    write(tmp_path)
    with pytest.raises(RecordingError, match=r"no such file; did you mean 'run.csv'"):
        read_recording(tmp_path / "rum.csv")
    with pytest.raises(RecordingError, match=r"is a folder.*such as run.csv"):
        read_recording(tmp_path)
    with pytest.raises(RecordingError, match="check the name"):
        read_recording(tmp_path / "nowhere" / "a.csv")
    with pytest.raises(RecordingError, match=r"end it in \.csv"):
        write_recording(read_recording(tmp_path / "run.csv"), tmp_path / "a.txt")


@pytest.mark.skipif(os.name != "posix" or os.geteuid() == 0, reason="root may write everywhere")
def test_folder_that_cannot_be_written(tmp_path):
    recording = read_recording(write(tmp_path))
    closed = tmp_path / "closed"
    closed.mkdir(mode=0o500)
    with pytest.raises(RecordingError, match="cannot be written"):
        write_recording(recording, closed / "a.csv")


def test_real_data(data_dir):
    paths = sorted(data_dir.glob("*/*.csv"))
    assert paths
    for path in paths:
        recording = read_recording(path)
        assert recording.is_uniform
        expected = np.genfromtxt(path, delimiter=",", names=True)
        for channel in (*recording.input_channels, *recording.output_channels):
            kind = recording.input if channel in recording.input_channels else recording.output
            np.testing.assert_allclose(
                channel.unit.from_si(kind(channel.stem)), expected[channel.column], rtol=1e-9, atol=1e-9
            )
        assert recording.metadata.quasi_static == (path.parent.name == "nylon")


def test_large_file_is_read_fast(data_dir):
    path = data_dir / "silverbox" / "multisine_train.csv"
    best = np.inf
    for _ in range(3):
        start = time.perf_counter()
        recording = read_recording(path)
        best = min(best, time.perf_counter() - start)
    assert recording.n == 78140
    assert best < 0.3


def test_practice(practice_dir):
    for path in sorted(practice_dir.glob("p0[0-9]/given/*.csv"))[::5]:
        recording = read_recording(path)
        assert recording.metadata.ambient_K == pytest.approx(296.15)
        assert recording.metadata.get_known("resistance_ohm") > 0
