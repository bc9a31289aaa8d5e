"""``diagnose --next`` and ``--then``: what is read again, what is refused, and how changes are said."""

import json
from argparse import Namespace
from pathlib import Path

import numpy as np
import pytest
from made import made_diagnosis

from scpjax.cli import build_parser, main
from scpjax.cli.then import earlier, limits_of, with_earlier
from scpjax.diagnose import diagnose as room
from scpjax.recordings.recording import Recording

TIME = 0.1 * np.arange(40)


def write(name: str, drive: str = "voltage_V") -> None:
    rows = "\n".join(f"{t:.1f},{i % 5},{20 + i % 7}" for i, t in enumerate(TIME))
    Path(name).write_text(f"time_s,{drive},temperature_degC\n{rows}\n")


@pytest.fixture
def folder(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    for name in ("old.csv", "new.csv"):
        write(name)
    write("watts.csv", "power_W")
    found = {
        "settings": {"files": ["old.csv", "old.csv"], "read": {"drive": "voltage_V", "mechanisms": ["mine.py"]}},
        "ranking": [{"name": "creep", "probability": 0.97}, {"name": "slack", "probability": 0.3}],
        "mechanisms": [{"name": "creep", "probability": 0.9}],
    }
    Path("found").mkdir()
    Path("found/diagnosis.json").write_text(json.dumps(found))
    return tmp_path


def arguments(line: str) -> Namespace:
    return build_parser().parse_args(line.split())


def test_the_earlier_files_are_read_again_as_before(folder):
    a = arguments("diagnose --then new.csv --out found")
    before = earlier(Path("found"))
    assert before is not None
    assert before.probabilities == {"creep": 0.9, "slack": 0.3}
    read = with_earlier(a, before, Path("found"))
    assert (read.files, read.drive, read.mechanisms) == (["old.csv", "new.csv"], "voltage_V", ["mine.py"])
    named = with_earlier(arguments("diagnose old.csv --then new.csv --out x"), None, Path("x"))
    assert named.files == ["old.csv", "new.csv"]
    assert named.mechanisms == []


@pytest.mark.parametrize(
    ("told", "model", "base"), [("", None, "tanks.py"), ("--model plant", "plant", None), ("--base x.py", None, "x.py")]
)
def test_a_model_told_now_takes_the_place_of_a_base_told_then(folder, told, model, base):
    out = Path("found")
    old = json.loads((out / "diagnosis.json").read_text())
    old["settings"]["read"]["base"] = "tanks.py"
    (out / "diagnosis.json").write_text(json.dumps(old))
    read = with_earlier(arguments(f"diagnose --then new.csv --out found {told}"), earlier(out), out)
    assert (read.model, read.base) == (model, base)


@pytest.mark.parametrize(
    ("line", "says"),
    [
        ("diagnose --out found", "the following arguments are required: FILE"),
        ("diagnose --then new.csv --out nowhere", "no earlier diagnosis there to add to"),
        ("diagnose old.csv --then none.csv --out found", "none.csv"),
        ("diagnose old.csv --then old.csv --out found", "is named twice"),
        ("diagnose old.csv --then found/next_experiment.csv --out found", "copy what was recorded"),
        ("diagnose watts.csv --out x --max-volts 5", "power_W is not in volts; give --max-drive"),
        ("diagnose old.csv --mechanism none.py --out x", "none.py: no such file"),
    ],
)
def test_one_line_says_what_is_wrong(folder, capsys, line, says):
    write("found/next_experiment.csv")
    assert main(line.split()) == 2
    error = capsys.readouterr().err
    assert says in error
    assert error.count("\n") == 1


def test_earlier_files_that_are_gone_are_named(folder, capsys):
    Path("old.csv").unlink()
    assert main(["diagnose", "--then", "new.csv", "--out", "found"]) == 2
    assert "old.csv: was read by the earlier diagnosis" in capsys.readouterr().err
    Path("found/diagnosis.json").write_text("{}")
    assert main(["diagnose", "--then", "new.csv", "--out", "found"]) == 2
    assert "is not a diagnosis that can be added to" in capsys.readouterr().err


def test_limits_are_in_the_units_of_the_column():
    drive = {"voltage_mV": 1e3 * (np.arange(40) % 3)}
    r = [Recording.from_arrays(TIME, drive, {}, require_outputs=False)]
    assert limits_of(arguments("diagnose a.csv --out x"), r) is None
    plain = limits_of(arguments("diagnose a.csv --out x --next"), r)
    assert plain is not None
    assert plain.highest is None
    told = limits_of(
        arguments("diagnose a.csv --out x --max-volts 5 --min-drive 500 --max-temperature 90 --slew 200"), r
    )
    assert told is not None
    assert (told.highest, told.lowest) == (5.0, 0.5)
    assert told.hottest == pytest.approx(363.15)
    assert told.slew == pytest.approx(0.2)


def test_a_proposal_goes_where_nothing_is_proposed_any_more(folder, monkeypatch):
    """But no file that is not ours: of another name, or with columns that were measured."""
    Path("moved.csv").write_text("time_s,voltage_V,displacement_mm\n" + "".join(f"{t:.1f},1,{t:.2f}\n" for t in TIME))
    monkeypatch.setattr(room, "diagnose", lambda recordings, **_: made_diagnosis(recordings[0]))
    Path("found/figures").mkdir()
    figures = [Path("found/figures", name) for name in ("next_experiment.png", "mine.png")]
    for path in (*figures, Path("found/my_next_experiment.csv")):
        path.write_text("x")
    proposed = Path("found/next_experiment.csv")
    proposed.write_text("time_s,voltage_V,displacement_mm\n0,1,2\n")
    assert main(["diagnose", "moved.csv", "--out", "found", "--quiet"]) == 0
    assert proposed.is_file(), "somebody recorded that"
    assert [path.is_file() for path in figures] == [False, True]
    proposed.write_text("time_s,voltage_V\n0,1\n")
    assert main(["diagnose", "moved.csv", "--out", "found", "--quiet"]) == 0
    assert not proposed.exists()
    assert Path("found/my_next_experiment.csv").is_file()
