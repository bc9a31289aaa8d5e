"""A broken file is refused in one line that says where and how to mend it."""

import os

import numpy as np
import pytest
from made_files import HEADER, rows, table, write

from scpjax.errors import RecordingError
from scpjax.recordings import read_recording, write_recording

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
    "milliseconds by another name": (table(HEADER.replace("time_s", "t_ms")), "run.csv", "rename 't_ms' to 'time_ms'"),
    "milliseconds in words": (table(HEADER.replace("time_s", "Time (ms)")), "run.csv", "to 'time_ms'"),
    "millis": (table(HEADER.replace("time_s", "millis")), "run.csv", "rename 'millis' to 'time_ms'"),
    "minutes": (table(HEADER.replace("time_s", "time_min")), "run.csv", "'time_min' does not say"),
    "seconds in words": (table(HEADER.replace("time_s", "Time [sec]")), "run.csv", "rename 'Time [sec]' to 'time_s'"),
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
    "index beside time": (
        "index,time,voltage_V,displacement_mm\n" + "\n".join(f"{k},{k / 10:g},3,{k}" for k in range(12)),
        "run.csv: header",
        "rename 'time' to 'time_s'",
    ),
    "broken after a note": (
        "time_s,voltage_V,displacement_mm,note\n"
        + "\n".join(f'{k},3,{k},"changed\nweight #{k}"' for k in range(9))
        + "\n8.5,3,warm,-",
        "run.csv:line 20",
        "repair",
    ),
    "time goes back after a note": (
        'time_s,voltage_V,displacement_mm,note\n0,3,0,"a\nb"\n'
        + "\n".join(f"{k},3,{k},-" for k in range(1, 9))
        + "\n7.5,3,9,-",
        "run.csv:line 12",
        "sort",
    ),
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


@pytest.mark.parametrize(
    ("cell", "column"),
    [("-127", 2), ("2980", 2), ("ERR", 2), ("inf", 3), ("nan", 3), ("", 3)],
)
def test_of_a_file_that_is_to_be_predicted_only_the_drive_need_be_whole(tmp_path, cell, column):
    """What a failed sensor wrote counts as empty there: nothing but its first reading is looked at."""
    row = ["0.5", "3", "25.5", "0.5"]
    row[column] = cell
    path = write(tmp_path, table(change={5: ",".join(row)}))
    read = read_recording(path, require_outputs=False)
    stem = ("temperature", "displacement")[column - 2]
    assert np.flatnonzero(read.weight(stem) == 0).tolist() == [5]
    assert np.all(read.weight("displacement" if column == 2 else "temperature") == 1)
    if cell not in ("nan", ""):
        with pytest.raises(RecordingError):
            read_recording(path)
    row[column], row[1] = "25.5", cell or "nan"
    with pytest.raises(RecordingError):
        read_recording(
            write(tmp_path, table(change={5: ",".join(row)}).replace("voltage_V", "pwm")), require_outputs=False
        )


@pytest.mark.parametrize("cell", ["2980", "ERR", '"25,5"'])
def test_a_column_that_has_failed_altogether_is_told(tmp_path, cell):
    rows = {k: f"{k / 10:g},3,{cell},0.5" for k in range(12)}
    with pytest.raises(RecordingError, match="temperature_degC"):
        read_recording(write(tmp_path, table(n=12, change=rows)), require_outputs=False)


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
