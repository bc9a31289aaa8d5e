"""``scpjax rig`` on the simulated bench, as a user would call it."""

import csv
import json

import numpy as np
import pytest

from scpjax.bench.simulated import muscle
from scpjax.cli import main
from scpjax.physics.storage import save_model
from scpjax.recordings.files import read_recording

COMMANDS = ("record", "play", "loop", "calibrate", "characterise", "validate")


@pytest.mark.parametrize("name", COMMANDS)
def test_every_command_has_help(name, capsys):
    with pytest.raises(SystemExit) as left:
        main(["rig", name, "--help"])
    assert left.value.code == 0
    said = capsys.readouterr().out
    assert "--port" in said
    assert "--out" in said


@pytest.mark.parametrize(
    ("call", "words"),
    [
        ("", ("COMMAND", "scpjax rig --help")),
        ("recrod", ("recrod", "did you mean record?")),
        ("record --port sim", ("--out",)),
        ("record --port sim --out a.txt", ("a.txt", "end it in .csv")),
        ("record --port sim --excite stiar --out a.csv", ("no excitation 'stiar'", "stair")),
        ("record --port sim --max-volts 9 --excite step --out a.csv", ("9 V with a supply of 3.7 V",)),
        ("record --port sim --period 0.0123 --out a.csv", ("--period", "whole 5 ms")),
        ("record --port sim --duration 1 --out a.csv", ("1 s is no duration",)),
        ("record --port sim --noise -1 --out a.csv", ("--noise", "0 or more")),
        ("record --port sim --sim muscel --out a.csv", ("no muscle named 'muscel'", "muscle, thesis")),
        ("record --port sim --conceal crep --out a.csv", ("--conceal crep", "creep")),
        ("record --port /dev/ttyNONE --out a.csv", ("/dev/ttyNONE", "no such port")),
        ("record --port /dev/ttyNONE --conceal creep --out a.csv", ("--conceal", "--port sim")),
        ("record --port sim --bench no.toml --out a.csv", ("no.toml", "calibrate writes one")),
        ("play no.csv --port sim --out a.csv", ("no.csv", "no such file")),
        ("loop --port sim --reference sien --out a.csv", ("sien", "sine")),
        ("loop --port sim --gains no.toml --out a.csv", ("no.toml", "no such gains file")),
        ("loop --port sim --dt 0.013 --out a.csv", ("--dt", "whole 5 ms")),
        ("calibrate --port sim --out bench.csv", ("bench.csv", "end it in .toml")),
        ("characterise --port sim --levels a,b --out d", ("--levels", "write 2,3")),
        ("characterise --port sim --mass -1 --out d", ("--mass", "above 0")),
        ("characterise --port sim --weights a,b --out d", ("--weights", "write 0.05")),
        ("characterise --port sim --weights 0.1 --out d", ("--weights", "two or more")),
        ("characterise --port sim --weights 0.1,-2 --out d", ("--weights", "-2 kg", "above 0")),
        ("characterise --port sim --weights 0.1,0.2 --mass 1 --out d", ("--mass", "the last of --weights")),
        ("characterise --port sim --actuators 2 --weights 0.1,0.2 --out d", ("--weights", "one actuator")),
        ("validate --port sim --model no.json --out d", ("no.json",)),
        ("validate --port sim --model MODEL --until-explained -1 --out d", ("--until-explained", "0 or more")),
        ("record --port sim --max-temperature 500 --out a.csv", ("refused", "loosen a limit")),
    ],
)
def test_bad_calls_end_in_one_line(call, words, tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    save_model(muscle(), tmp_path / "model.json")
    assert main(["rig", *call.replace("MODEL", "model.json").split()]) == 2
    said = capsys.readouterr().err
    assert said.startswith("scpjax: ")
    assert said.count("\n") == 1
    for word in words:
        assert word in said
    assert not (tmp_path / "a.csv").exists()


def test_record_then_play_what_was_recorded(tmp_path, capsys):
    a, b, bench = (str(tmp_path / n) for n in ("a.csv", "b.csv", "bench.toml"))
    assert main(["rig", "calibrate", "--port", "sim", "--out", bench]) == 0
    assert "wire resistance: 1.07" in capsys.readouterr().out
    call = ["rig", "record", "--port", "sim", "--bench", bench, "--duration", "20", "--out", a]
    assert main([*call, "--excite", "prbs", "--hold", "2"]) == 0
    assert main(["rig", "play", a, "--port", "sim", "--bench", bench, "--out", b, "--quiet"]) == 0
    first, second = read_recording(a), read_recording(b)
    n = min(first.n, second.n)
    np.testing.assert_allclose(first.inputs[:n], second.inputs[:n], atol=1e-6)
    np.testing.assert_allclose(first.outputs[:n], second.outputs[:n], atol=0.6)
    assert np.ptp(first.output("displacement")) > 1e-3
    assert "samples, 0 frames lost" in capsys.readouterr().out


def test_characterise_with_weights_leaves_a_bench_and_a_model_that_fit_together(tmp_path, capsys):
    bench, out = tmp_path / "bench.toml", tmp_path / "found"
    assert main(["rig", "calibrate", "--port", "sim", "--out", str(bench), "--quiet"]) == 0
    call = ["rig", "characterise", "--port", "sim", "--bench", str(bench), "--levels", "3", "--duration", "20"]
    assert main([*call, "--weights", "0.15,0.25", "--out", str(out)]) == 0
    said = capsys.readouterr().out
    assert "stiffness 18" in said
    assert "a third would show" in said
    assert "under 0.15 kg, Displacement" in said
    series = json.loads((out / "weights.json").read_text())
    assert series["stiffness_N_per_m"]["ci95"][0] < 180 < series["stiffness_N_per_m"]["ci95"][1]
    page = (out / "report.html").read_text()
    assert "A series of weights" in page
    assert "elastic_spring.stiffness = 1" in page  # held, and said so
    assert (out / "figures" / "weights.png").stat().st_size > 5000
    again = ["rig", "record", "--port", "sim", "--bench", str(out / "bench.toml"), "--excite", "step"]
    assert main([*again, "--duration", "10", "--out", str(tmp_path / "a.csv"), "--quiet"]) == 0
    known = dict(read_recording(tmp_path / "a.csv").metadata.known)
    assert known["moving_mass_kg"] == 0.25
    assert known["stiffness_N_per_m"] == pytest.approx(series["stiffness_N_per_m"]["value"], rel=1e-4)


def test_loop_writes_the_columns_of_the_loop(tmp_path, capsys):
    out = tmp_path / "loop.csv"
    call = ["rig", "loop", "--port", "sim", "--sim", "thesis", "--duration", "10", "--amplitude", "10"]
    assert main([*call, "--out", str(out)]) == 0
    assert "RMSE" in capsys.readouterr().out
    with open(out) as file:
        rows = list(csv.DictReader(file))
    assert list(rows[0]) == ["time_s", "reference_deg", "angle_deg", "voltage_agonist_V", "voltage_antagonist_V"]
    assert len(rows) == 501
    assert max(float(r["voltage_agonist_V"]) for r in rows) > 1
    samples = read_recording(tmp_path / "loop_samples.csv")  # kept as they came
    assert samples.n >= 501
    assert (tmp_path / "loop_samples.raw").stat().st_size > 501 * 30


def test_a_recording_does_not_overwrite_its_bench_and_takes_no_earlier_remarks(tmp_path, capsys):
    (tmp_path / "bench.toml").write_text("supply_V = 3.7\n")
    call = ["rig", "record", "--port", "sim", "--bench", str(tmp_path / "bench.toml"), "--duration", "5", "--out"]
    assert main([*call, str(tmp_path / "bench.csv")]) == 2
    assert "its TOML is" in capsys.readouterr().err
    (tmp_path / "a.markers.csv").write_text("time_s,marker\n1.0,of an earlier run\n")
    assert main([*call, str(tmp_path / "a.csv"), "--quiet"]) == 0
    assert not (tmp_path / "a.markers.csv").exists()


def test_validate_says_that_a_right_model_agrees(tmp_path, capsys):
    save_model(muscle(), tmp_path / "model.json")
    call = ["rig", "validate", "--port", "sim", "--model", str(tmp_path / "model.json"), "--duration", "30"]
    assert main([*call, "--gains", "thesis", "--out", str(tmp_path / "out")]) == 0
    said = capsys.readouterr().out
    assert said.count("agrees") == 3
    assert "diagnosis" not in said
    found = json.loads((tmp_path / "out" / "validation.json").read_text())
    assert found["open loop"]["displacement_mm"]["nrmse"] > 95
    assert not found["closed loop"]["angle_deg"]["parts"]
    assert (tmp_path / "out" / "report.html").stat().st_size > 20_000
