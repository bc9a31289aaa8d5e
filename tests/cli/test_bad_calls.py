"""A wrong call or broken file: exit code 2, one line saying where, what and the mend, and nothing written."""

from pathlib import Path

import numpy as np
import pytest

from scpjax.cli import main
from scpjax.cli.fleet import find_actuators
from scpjax.cli.program import staged
from scpjax.physics import presets
from scpjax.physics.storage import save_model

HEADER = "time_s,voltage_V,displacement_mm"


def rows(n: int = 40, **change: str) -> str:
    """A step response as CSV text; ``row_7="..."`` replaces row 7 (line 9 of the file)."""
    lines = [f"{k / 10:g},{3 * (k > 5)},{max(k - 5, 0) / 20:g}" for k in range(n)]
    for name, text in change.items():
        lines[int(name.removeprefix("row_"))] = text
    return "\n".join([HEADER, *lines]) + "\n"


def column(values) -> str:
    return "\n".join([HEADER, *[f"{k / 10:g},{u:g},{y:g}" for k, (u, y) in enumerate(values)]]) + "\n"


FILES: dict[str, str | bytes] = {
    "good.csv": rows(),
    "empty.csv": "",
    "header.csv": HEADER + "\n",
    "short.csv": rows(5),
    "text.csv": rows(row_7="0.7,oops,0.1"),
    "ragged.csv": rows(row_7="0.7,3"),
    "nan_drive.csv": rows(row_7="0.7,,0.1"),
    "infinite.csv": rows(row_7="0.7,inf,0.1"),
    "back.csv": rows(row_7="0.1,3,0.1"),
    "twice.csv": rows().replace("displacement_mm", "voltage_V"),
    "no_header.csv": rows().split("\n", 1)[1],
    "no_time.csv": rows().replace("time_s", "clock"),
    "no_unit.csv": rows().replace("displacement_mm", "displacement_inch"),
    "no_response.csv": rows().replace("displacement_mm", "note"),
    "binary.csv": b"\x00\xff\x00\xfe" * 40,
    "utf16.csv": rows().encode("utf-16"),
    "kelvin.csv": rows().replace("displacement_mm", "temperature_degC").replace(",0.1\n", ",2981\n"),
    "constant.csv": column((3.0, np.sin(k)) for k in range(40)),
    "dead.csv": column((3.0 * (k > 5), 0.0) for k in range(40)),
    "angle.csv": rows().replace("displacement_mm", "angle_deg"),
    "power.csv": rows().replace("voltage_V", "power_W"),
    "bad_toml.csv": rows(),
    "bad_toml.toml": "[recording\nhold = 1\n",
    "bad_key.csv": rows(),
    "bad_key.toml": '[recording]\nhodl = "linear"\n',
    "bad_hold.csv": rows(),
    "bad_hold.toml": '[recording]\nhold = "lineal"\n',
    "bad_mass.csv": rows(),
    "bad_mass.toml": "[actuator]\nmoving_mass_kg = -0.1\n",
    "bad_role.csv": rows(),
    "bad_role.toml": '[roles]\nresponse = "displacment_mm"\n',
    "not.json": "{",
    "list.json": "[]",
    "schema.json": '{"schema": "scpjax.diagnosis/1"}',
}

# words of the call (files lie in the folder it is made from), and what the line must say
CALLS: list[tuple[str, str, tuple[str, ...]]] = [
    ("no command", "", ("COMMAND", "--help")),
    ("unknown command", "diagnoze good.csv --out OUT", ("diagnoze", "did you mean diagnose?")),
    ("no files", "fit --out OUT", ("fit:", "FILE", "scpjax fit --help")),
    ("no out", "fit good.csv", ("fit:", "--out")),
    ("unknown option", "fit good.csv --out OUT --robst", ("--robst", "did you mean --robust?")),
    ("unknown preset", "fit good.csv --out OUT --model plnt", ("plnt", "did you mean plant?")),
    ("missing file", "fit god.csv --out OUT", ("god.csv: no such file", "good.csv")),
    ("a folder", "diagnose . --out OUT", ("is a folder", "name a file in it")),
    ("same file twice", "diagnose good.csv ./good.csv --out OUT", ("./good.csv", "twice")),
    ("empty", "diagnose empty.csv --out OUT", ("empty.csv:line 1", "empty")),
    ("header only", "diagnose header.csv --out OUT", ("header.csv:line 1", "no rows")),
    ("too short", "diagnose short.csv --out OUT", ("short.csv:line 6", "at least 8")),
    ("text in a cell", "diagnose text.csv --out OUT", ("text.csv:line 9", "'oops'", "repair")),
    ("ragged", "fit ragged.csv --out OUT", ("ragged.csv:line 9", "2 cells", "3")),
    ("drive missing", "fit nan_drive.csv --out OUT", ("nan_drive.csv:line 9", "voltage_V", "no value")),
    ("infinite", "fit infinite.csv --out OUT", ("infinite.csv:line 9", "infinite")),
    ("time goes back", "fit back.csv --out OUT", ("back.csv:line 9", "goes back", "sort")),
    ("column twice", "fit twice.csv --out OUT", ("twice.csv:line 1", "voltage_V", "twice")),
    ("no header", "fit no_header.csv --out OUT", ("no_header.csv:line 1", "no header")),
    ("no time", "fit no_time.csv --out OUT", ("no_time.csv", "time_s")),
    ("unknown unit", "fit no_unit.csv --out OUT", ("displacement_inch", "displacement_mm")),
    ("no response", "diagnose no_response.csv --out OUT", ("no_response.csv", "response", "[roles]")),
    ("binary", "diagnose binary.csv --out OUT", ("binary.csv", "CSV")),
    ("utf-16", "diagnose utf16.csv --out OUT", ("utf16.csv:line 1", "UTF-16", "UTF-8")),
    ("counts as degrees", "diagnose kelvin.csv --out OUT", ("temperature_degC", "line 9", "convert")),
    ("constant drive", "fit constant.csv --out OUT", ("constant.csv", "never changes", "step")),
    ("dead sensor", "diagnose dead.csv --out OUT", ("displacement_mm", "never changes", "sensor")),
    ("toml syntax", "fit bad_toml.csv --out OUT", ("bad_toml.toml:line 1", "TOML")),
    ("toml key", "fit bad_key.csv --out OUT", ("bad_key.toml:line 2", "'hodl'", "did you mean 'hold'?")),
    ("toml hold", "fit bad_hold.csv --out OUT", ("bad_hold.toml:line 2", "lineal", "linear")),
    ("negative mass", "fit bad_mass.csv --out OUT", ("bad_mass.toml:line 2", "moving_mass_kg", "positive")),
    ("role misspelt", "fit bad_role.csv --out OUT", ("displacment_mm", "did you mean 'displacement_mm'?")),
    ("drive not there", "diagnose good.csv --out OUT --drive volts_V", ("no column 'volts_V'", "voltage_V")),
    ("fixed, no value", "fit good.csv --out OUT --fixed mass", ("--fixed mass", "KEY=VALUE")),
    ("fixed, no number", "fit good.csv --out OUT --fixed inertia.mass=heavy", ("'heavy'", "KEY=VALUE")),
    ("fixed, no parameter", "fit good.csv --out OUT --fixed inertia.mas=1", ("inertia.mas", "inertia.mass")),
    ("joint without pulley", "fit angle.csv --out OUT", ("angle.csv", "[pulley] radius_m")),
    ("out is a file", "fit good.csv --out good.csv", ("--out good.csv", "is a file", "folder")),
    ("out below a file", "fit good.csv --out good.csv/x", ("good.csv is a file",)),
    ("fleet of nothing", "fleet nowhere --out OUT", ("nowhere", "no such folder")),
    ("fleet, no csv", "fleet bare --out OUT", ("bare", "no CSV files")),
    ("fleet, all broken", "fleet empt*.csv --out OUT", ("empty.csv:line 1", "empty")),
    ("model broken", "predict not.json good.csv --out OUT.csv", ("not.json:line 1", "is not JSON")),
    ("model a list", "predict list.json good.csv --out OUT.csv", ("list.json", "no model file")),
    (
        "model of other kind",
        "predict schema.json good.csv --out OUT.csv",
        ("scpjax.diagnosis/1", "scpjax.model/1"),
    ),
    ("model missing", "predict model.jso good.csv --out OUT.csv", ("model.jso: no such file",)),
    ("model's drive", "predict model.json power.csv --out OUT.csv", ("power_W", "voltage", "--drive")),
    ("predict onto input", "predict model.json good.csv --out good.csv", ("is also an input",)),
    ("predict to a folder", "predict model.json good.csv --out bare", ("bare", "is a folder")),
    ("predict to text", "predict model.json good.csv --out OUT.txt", ("no CSV file name", ".csv")),
    ("no such preset", "simulate --model plnt --input good.csv --out OUT.csv", ("'plnt'", "plant")),
    ("preset without gain", "simulate --model tm --input good.csv --out OUT.csv", ("tm", "temperature")),
    (
        "joint, one drive",
        "simulate --model aaa --input good.csv --out OUT.csv",
        ("agonist", "voltage_agonist_V"),
    ),
    ("no time at all", "diagnose good.csv --out OUT --minutes 0", ("--minutes", "'0'", "positive")),
    ("minutes of a fit of a fleet", "fleet . --out OUT --minutes 3", ("--minutes", "--diagnose")),
    ("no number of minutes", "diagnose good.csv --out OUT --minutes soon", ("--minutes", "'soon'", "positive")),
    ("loud and quiet", "fit good.csv --out OUT --quiet --progress", ("not allowed with",)),
]


@pytest.fixture
def folder(tmp_path, monkeypatch) -> Path:
    for name, content in FILES.items():
        (tmp_path / name).write_bytes(content if isinstance(content, bytes) else content.encode())
    (tmp_path / "bare").mkdir()
    model = presets.te(resistance=1.0, conductance=0.3, thermal_mass=2.0)
    save_model(model, tmp_path / "model.json", extra={"drive": ["voltage_V"]})
    monkeypatch.chdir(tmp_path)
    return tmp_path


def everything(folder: Path) -> dict[str, bytes | None]:
    """Every path below a folder and what is in it, hidden ones too."""
    return {str(p.relative_to(folder)): p.read_bytes() if p.is_file() else None for p in sorted(folder.rglob("*"))}


@pytest.mark.parametrize(("call", "says"), [c[1:] for c in CALLS], ids=[c[0] for c in CALLS])
def test_one_line_and_nothing_written(folder, capsys, call, says):
    before = everything(folder)
    assert main(call.split()) == 2
    out, err = capsys.readouterr()
    assert out == ""
    assert err.startswith("scpjax: ")
    assert err.count("\n") == 1
    assert err.endswith("\n")
    for words in says:
        assert words in err, err
    assert everything(folder) == before


def test_an_earlier_result_survives_a_failure(folder, capsys):
    (folder / "OUT").mkdir()
    (folder / "OUT" / "report.html").write_text("earlier")
    assert main(["diagnose", "text.csv", "--out", "OUT"]) == 2
    assert everything(folder / "OUT") == {"report.html": b"earlier"}
    assert "text.csv:line 9" in capsys.readouterr().err


def test_a_failure_while_writing_leaves_nothing(folder, monkeypatch):
    """The report breaks half way: an unexpected error is not swallowed, and no folder is left behind."""
    from scpjax.cli.program import staged

    before = everything(folder)

    def work() -> None:
        with staged(folder / "deep" / "OUT") as place:
            (place / "model.json").write_text("half")
            raise ZeroDivisionError

    with pytest.raises(ZeroDivisionError):
        work()
    assert everything(folder) == before


def test_writing_keeps_what_is_not_ours(folder):
    from scpjax.cli.program import staged

    (folder / "bare" / "notes.txt").write_text("mine")
    (folder / "bare" / "model.json").write_text("old")
    with staged(folder / "bare") as place:
        (place / "figures").mkdir()
        (place / "figures" / "a.png").write_text("new")
        (place / "model.json").write_text("new")
    assert everything(folder / "bare") == {
        "figures": None,
        "figures/a.png": b"new",
        "model.json": b"new",
        "notes.txt": b"mine",
    }


def test_an_unexpected_error_is_not_swallowed(folder, monkeypatch):
    monkeypatch.setattr("scpjax.cli.inputs.read_recording", lambda *a, **k: 1 / 0)
    with pytest.raises(ZeroDivisionError):
        main(["fit", "good.csv", "--out", "OUT"])


def test_simulate_and_predict_agree(folder, capsys):
    """What the model file says of a file, from rest, by two ways through the program."""
    assert main(["simulate", "--model", "model.json", "--input", "good.csv", "--out", "a.csv"]) == 0
    assert main(["predict", "model.json", "good.csv", "--out", "b.csv"]) == 0
    assert "a.csv: 40 samples" in capsys.readouterr().out
    a, b = (np.genfromtxt(f, delimiter=",", names=True) for f in ("a.csv", "b.csv"))
    assert b.dtype.names == ("time_s", "temperature_degC")
    np.testing.assert_allclose(a["temperature_degC"], b["temperature_degC"], rtol=1e-8)
    t = np.maximum(a["time_s"] - 0.6, 0.0)  # the drive is held, 3 V from 0.6 s on
    expected = 20.0 + 9.0 / 0.3 * (1 - np.exp(-t * 0.3 / 2.0))
    np.testing.assert_allclose(a["temperature_degC"], expected, atol=1e-6)


def test_inputs_alone_are_enough(folder, capsys):
    lines = rows().replace(",displacement_mm", "").splitlines()
    (folder / "in.csv").write_text("\n".join([lines[0], *(line.rsplit(",", 1)[0] for line in lines[1:])]))
    assert main(["predict", "model.json", "in.csv", "--out", "p.csv", "--quiet"]) == 0
    assert main(["simulate", "--model", "plant", "--input", "in.csv", "--out", "s.csv", "--quiet"]) == 0
    assert capsys.readouterr().out == ""
    assert Path("p.csv").read_text().startswith("time_s,temperature_degC\n0,20")
    assert Path("s.csv").read_text().startswith("time_s,voltage_V,temperature_degC,displacement_mm\n")


def test_simulate_takes_the_room_that_the_file_tells(folder):
    """As predict does, and for the preset tm, too."""
    Path("good.toml").write_text("[environment]\nambient_degC = 30\n")
    assert main(["simulate", "--model", "model.json", "--input", "good.csv", "--out", "a.csv"]) == 0
    assert main(["predict", "model.json", "good.csv", "--out", "b.csv"]) == 0
    a, b = (np.genfromtxt(f, delimiter=",", names=True) for f in ("a.csv", "b.csv"))
    assert a["temperature_degC"][0] == pytest.approx(30.0)
    np.testing.assert_allclose(a["temperature_degC"], b["temperature_degC"], atol=1e-3)


def test_results_are_staged_where_they_will_be(tmp_path):
    """On the disk, and with the rights, of the folder that is there: what is beside it may be another's."""
    out = tmp_path / "there"
    out.mkdir()
    (out / "old.txt").write_text("stays")
    with staged(out) as folder:
        assert folder.parent == out
        (folder / "figures").mkdir()
        (folder / "figures" / "new.txt").write_text("comes")
    assert sorted(p.relative_to(out).as_posix() for p in out.rglob("*")) == ["figures", "figures/new.txt", "old.txt"]
    with staged(tmp_path / "new") as folder:
        assert folder.parent == tmp_path


def test_actuators_of_a_glob_keep_names_of_their_own(tmp_path):
    for name in "abc":
        (tmp_path / name / "run").mkdir(parents=True)
        (tmp_path / name / "run" / "step.csv").write_text(rows())
    found = find_actuators(str(tmp_path / "*" / "run" / "step.csv"), tmp_path / "out")
    assert sorted(len(f) for f in found.values()) == [1, 1, 1]
    assert found == {f"{n}/run/step": [str(tmp_path / n / "run" / "step.csv")] for n in "abc"}
    found = find_actuators(str(tmp_path / "*" / "run"), tmp_path / "out")
    assert sorted(found) == ["a/run", "b/run", "c/run"]
    (tmp_path / "a.csv").write_text(rows())
    (tmp_path / "c" / "own.csv").write_text(rows())
    (tmp_path / "a" / "own.csv").write_text(rows())
    found = find_actuators(str(tmp_path), tmp_path / "out")  # a folder and a file beside it of the same name
    assert len(found) == 3
    assert found["c"] == [str(tmp_path / "c" / "own.csv")]
    assert sorted(f for files in found.values() for f in files) == sorted(
        str(p) for p in (tmp_path / "a.csv", tmp_path / "a" / "own.csv", tmp_path / "c" / "own.csv")
    )
