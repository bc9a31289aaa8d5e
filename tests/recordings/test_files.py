"""Recordings are read as written, and written as read."""

import time

import numpy as np
import pytest
from made_files import HEADER, rows, table, write

from scpjax.errors import RecordingError
from scpjax.recordings import files, read_recording, read_recordings, write_recording


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


def test_a_quoted_note_may_go_on_in_the_next_line_and_hold_a_hash(tmp_path):
    """Such a cell is one cell; outside of quotes a hash after a space begins a comment."""
    notes = {3: '"changed\nthe weight"', 5: '"run #3, warm"', 7: "-  # by hand"}
    rows = [f"{0.1 * k:.1f},3,{0.5 * k:.1f},{notes.get(k, '-')}" for k in range(12)]
    path = tmp_path / "a.csv"
    path.write_text("time_s,voltage_V,displacement_mm,note\n" + "\n".join(rows) + "\n")
    found = read_recording(path)
    np.testing.assert_allclose(found.time, 0.1 * np.arange(12))
    np.testing.assert_allclose(found.output("displacement"), 0.5e-3 * np.arange(12))


@pytest.mark.parametrize("column", ["T_amb_degC", "second_temperature_degC", "time_constant_s"])
def test_an_index_stays_the_clock_beside_what_is_no_time(tmp_path, column):
    path = tmp_path / "a.csv"
    path.write_text(f"index,voltage_V,displacement_mm,{column}\n" + "\n".join(f"{k},{k % 3},{k},20" for k in range(12)))
    assert read_recording(path).metadata.quasi_static


def test_the_drive_of_tm_is_the_temperature(tmp_path):
    """By the TOML, or as asked for; though a voltage is there, and also where nothing else is."""
    both = tmp_path / "both.csv"
    both.write_text(
        "time_s,voltage_V,temperature_degC,displacement_mm\n"
        + "\n".join(f"{k},{k % 3},{20 + k},{0.1 * k:.1f}" for k in range(12))
    )
    warm = tmp_path / "warm.csv"
    warm.write_text("time_s,temperature_degC,displacement_mm\n" + "\n".join(f"{k},{20 + k},{k}" for k in range(12)))
    for path in (both, warm):
        found = read_recording(path, model="tm")
        assert [c.column for c in found.input_channels] == ["temperature_degC"]
        assert [c.column for c in found.output_channels] == ["displacement_mm"]
        assert found.hold == "linear"
    assert [c.column for c in read_recording(both).input_channels] == ["voltage_V"]
    both.with_suffix(".toml").write_text('[recording]\nmodel = "tm"\n')
    assert [c.column for c in read_recording(both).input_channels] == ["temperature_degC"]
    assert [c.column for c in read_recording(both, drive="voltage_V").input_channels] == ["voltage_V"]
