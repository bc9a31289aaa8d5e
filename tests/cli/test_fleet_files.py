"""Which files of a folder ``scpjax fleet`` takes for recordings, and what it says of the rest."""

from pathlib import Path

import pytest

from scpjax.cli import main
from scpjax.cli.fleet import empty_folders, find_actuators
from scpjax.errors import RecordingError


@pytest.fixture
def muscles(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    for name in (
        "m1/step.csv",
        "m1/._step.csv",
        "m1/next_experiment.csv",
        "m2/sine.csv",
        "m3/STEP.CSV",
        "m4/notes.txt",
    ):
        Path("muscles", name).parent.mkdir(parents=True, exist_ok=True)
        Path("muscles", name).write_bytes(b"\x00\xa3" if "._" in name else b"")
    return tmp_path


ALL = {"m1": ["muscles/m1/step.csv"], "m2": ["muscles/m2/sine.csv"], "m3": ["muscles/m3/STEP.CSV"]}


def test_loggers_shout_and_systems_litter(muscles):
    assert find_actuators("muscles", Path("out")) == ALL
    assert find_actuators("muscles/*", Path("out")) == ALL
    assert empty_folders("muscles", Path("out")) == ["muscles/m4"]


def test_what_was_written_beside_the_actuators_is_none(muscles):
    for name in ("fleet.csv", "figures/spread.png", "actuators/m1/diagnosis.json"):
        Path("muscles", name).parent.mkdir(parents=True, exist_ok=True)
        Path("muscles", name).write_bytes(b"")
    assert find_actuators("muscles", Path("muscles")) == ALL
    assert empty_folders("muscles", Path("muscles")) == ["muscles/m4"]
    with pytest.raises(RecordingError, match="no CSV files"):
        find_actuators("muscles/fleet.csv", Path("out"))


def test_a_folder_with_nothing_in_it_is_named(muscles, capsys):
    assert main(["fleet", "muscles", "--out", "out"]) == 2, "the recordings are empty files"
    assert "no recordings (*.csv) in muscles/m4: not among the actuators" in capsys.readouterr().out
