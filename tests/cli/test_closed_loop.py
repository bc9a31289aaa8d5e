"""``scpjax loop`` and ``scpjax tune`` from end to end, and what they refuse."""

import json

import numpy as np
import pytest

from scpjax.cli import main
from scpjax.control.reference import Reference
from scpjax.physics.known import known_model
from scpjax.physics.storage import save_model

TIME = np.arange(0, 4.0, 0.05)
FILES = {
    "gains.toml": "Kp = 0.5\nKi = 0.12\nKd = 0.47\nN = 5.84\n",
    "nan.toml": "Kp = nan\nKi = 0.12\nKd = 0.47\nN = 5.84\n",
    "negative.toml": "Kp = 0.5\nKi = 0.12\nKd = 0.47\nN = -1\n",
    "good.csv": "time_s,reference_deg\n" + "".join(f"{t:g},{10 * np.sin(t):g}\n" for t in TIME),
    "uneven.csv": "time_s,reference_deg\n0,0\n0.02,1\n0.1,2\n",
    "back.csv": "time_s,reference_deg\n0,0\n0.02,1\n0.01,2\n",
    "radians.csv": "time_s,reference_rad\n0,0\n0.02,1\n",
    "text.csv": "time_s,reference_deg\n0,0\n0.02,up\n",
}


@pytest.fixture
def here(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    monkeypatch.setenv("SCPJAX_CACHE", "")
    for name, text in FILES.items():
        (tmp_path / name).write_text(text)
    return tmp_path


def read(path):
    with open(path) as file:
        names = file.readline().strip().split(",")
    return names, np.loadtxt(path, delimiter=",", skiprows=1)


def test_loop_writes_the_contract(here, capsys):
    call = ["loop", "--plant", "thesis", "--gains", "thesis", "--reference", "sine"]
    assert main([*call, "--out", "out.csv"]) == 0
    names, rows = read("out.csv")
    assert names == ["time_s", "reference_deg", "angle_deg", "voltage_agonist_V", "voltage_antagonist_V"]
    assert np.sqrt(np.mean((rows[:, 1] - rows[:, 2]) ** 2)) == pytest.approx(5.77, rel=0.005)
    assert rows[:, 3:].min() >= 0
    assert rows[:, 3:].max() <= 3.7
    said = capsys.readouterr().out
    assert "RMSE: 5.766 deg" in said
    assert "The loop is stable" in said
    assert main([*call[:4], "gains.toml", *call[5:], "--out", "same.csv", "--quiet"]) == 0
    np.testing.assert_allclose(read("same.csv")[1], rows)
    assert capsys.readouterr().out == ""


def test_loop_over_a_file_with_a_model(here):
    save_model(known_model("thesis"), here / "model.json")
    call = ["loop", "--plant", "model.json", "--reference", "good.csv", "--quiet"]
    assert main([*call, "--out", "out.csv"]) == 0
    _, rows = read("out.csv")
    np.testing.assert_allclose(rows[:, 0], TIME, atol=1e-9)
    np.testing.assert_allclose(rows[:, 1], 10 * np.sin(TIME), atol=1e-4)
    assert main([*call, "--dt", "0.01", "--radius", "0.02", "--out", "fine.csv"]) == 0
    assert len(read("fine.csv")[1]) == 396


@pytest.mark.parametrize("seed", [None, 3])
def test_the_levels_are_those_of_the_thesis_unless_a_seed_is_given(here, seed, capsys):
    call = ["loop", "--plant", "thesis", "--reference", "multilevel"]
    assert main([*call, *(() if seed is None else ("--seed", str(seed))), "--out", "out.csv"]) == 0
    assert "within reach: the joint comes to rest between -82.2 and 82.2 deg" in capsys.readouterr().out
    _, expected = Reference(seed=seed).make("multilevel")
    np.testing.assert_allclose(read("out.csv")[1][:, 1], np.degrees(expected), atol=1e-4)
    levels = set(np.round(np.degrees(expected), 6))
    assert (levels == {15.0, -10.0, -25.0, 5.0, 25.0, 10.0, -15.0}) == (seed is None)


def test_out_of_reach_is_said(here, capsys):
    call = ["loop", "--plant", "thesis", "--reference", "sine", "--amplitude", "100", "--duration", "5"]
    assert main([*call, "--out", "out.csv"]) == 0
    assert "comes to rest between -82.2 and 82.2 deg" in capsys.readouterr().out


def test_tune_writes_gains_that_are_better(here, capsys):
    call = ["--plant", "thesis", "--reference", "sine", "--duration", "6", "--frequency", "0.1"]
    assert main(["tune", *call, "--out", "tuned"]) == 0
    said = capsys.readouterr().out
    assert "→" in said
    for name in ("gains.toml", "loop.csv", "tuning.json", "report.html", "figures/tracking.png"):
        assert (here / "tuned" / name).stat().st_size > 0
    found = json.loads((here / "tuned" / "tuning.json").read_text())
    assert found["objective"]["after"] < found["objective"]["before"]
    assert main(["loop", *call, "--gains", "tuned/gains.toml", "--out", "after.csv", "--quiet"]) == 0
    rows = read("after.csv")[1]
    rmse = np.sqrt(np.mean((rows[:, 1] - rows[:, 2]) ** 2))
    assert rmse == pytest.approx(np.degrees(found["objective"]["after"]), rel=1e-6)
    page = (here / "tuned" / "report.html").read_text()
    assert "instead of" in page
    assert "nan" not in page.lower().split("<body>")[1].split("base64")[0]


@pytest.mark.parametrize(("options", "said"), [
    ("--gains nan.toml", "Kp is nan"),
    ("--gains negative.toml", "N is -1"),
    ("--gains none.toml", "no such gains file"),
    ("--plant thesi", "no plant named 'thesi'"),
    ("--plant te", "does not turn a joint"),
    ("--plant none.json", "no such file"),
    ("--reference sin", "no reference 'sin'"),
    ("--reference uneven.csv", "not even in time"),
    ("--reference back.csv", "does not go on"),
    ("--reference radians.csv", "no column reference_deg"),
    ("--reference text.csv", "is not a number"),
    ("--reference good.csv --amplitude 3", "--amplitude has no meaning"),
    ("--amplitude -5", "--amplitude: is -5 degrees"),
    ("--frequency 30", "frequency 30 Hz"),
    ("--dt 0", "a sample every 0 s"),
    ("--duration 0", "duration 0"),
    ("--radius 0", "pulley radius of 0 m"),
    ("--radius nan", "pulley radius of nan m"),
    ("--plant aaa --radius 0", "pulley radius of 0 m"),
    ("--out folder/", "no CSV file name"),
])  # fmt: skip
def test_bad_calls_end_in_one_line(here, capsys, options, said):
    given = options.split()
    usual = {"--plant": "thesis", "--reference": "sine", "--out": "out.csv"}
    for name, value in usual.items():
        given += [] if name in given else [name, value]
    assert main(["loop", *given]) == 2
    error = capsys.readouterr().err
    assert error.startswith("scpjax: ")
    assert error.count("\n") == 1
    assert said in error
    assert not (here / "out.csv").exists()
    if "--out" not in options:
        given[given.index("--out") + 1] = "tuned"
        assert main(["tune", *given]) == 2
        assert said in capsys.readouterr().err
        assert not (here / "tuned").exists()


def test_tune_refuses_its_own_options(here, capsys):
    call = ["tune", "--plant", "thesis", "--reference", "sine", "--out", "tuned"]
    for option, said in ((["--spread", "2"], "spread of 2"), (["--hottest", "nan"], "--hottest: is nan"),
                         (["--effort", "-1"], "weight of Effort")):  # fmt: skip
        assert main([*call, *option]) == 2
        assert said in capsys.readouterr().err
