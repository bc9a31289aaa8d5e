"""Files as a newcomer has them: a column in the wrong unit, one under a wrong name, a thermometer glued on loosely."""

import json
from pathlib import Path

import numpy as np
import pytest

from scpjax.cli import main

LAG, NOISE = 1.5, 0.05  # s, of the loose thermometer; K


def write(path: Path, header: str = "time_s,voltage_V,temperature_degC", lag: float = 0.0, **scale: float) -> str:
    """A heated wire in a room of 21 degC, by Euler steps of 10 ms, as a logger writes it every 100 ms."""
    rng = np.random.default_rng(3)
    volts = np.repeat([0.0, 2.5, 1.5, 3.5, 0.0, 3.0, 1.0, 2.0, 0.0], 100)
    warm = felt = 0.0
    rows = []
    for i, u in enumerate(volts):
        rows.append((0.1 * i, u * scale.get("drive", 1.0), scale.get("room", 21.0) + (felt if lag else warm)))
        for _ in range(10):
            warm += 0.01 * (u**2 / 2.0 - 0.08 * warm) / 0.9
            felt += 0.01 * (warm - felt) / (lag or 1.0)
    lines = [f"{t:.2f},{u:g},{y + NOISE * rng.standard_normal():.3f}" for t, u, y in rows]
    path.write_text("\n".join((header, *lines)) + "\n")
    return str(path)


@pytest.mark.parametrize(
    ("wrong", "words"),
    [
        ({"drive": 1000.0}, "reaches 3500 V; is it in thousandths (voltage_mV)?"),
        ({"room": 294.15}, "is it in kelvin (temperature_K)"),
    ],
)
def test_a_wrong_unit_is_doubted_before_anything_is_believed(tmp_path, capsys, wrong, words):
    assert main(["fit", write(tmp_path / "step.csv", **wrong), "--out", str(tmp_path / "fit")]) == 0
    told = capsys.readouterr().out
    assert words in told
    assert told.index("look again: ") == 0


@pytest.mark.parametrize(
    ("header", "words"),
    [
        ("time_s,voltage_V,temp_degC", ("step.csv", "temp_degC", "temperature_degC", "[roles]")),
        ("time_s,voltage_mm,temperature_degC", ("step.csv", "voltage_mm", "voltage_V")),
        ("t,voltage_V,temperature_degC", ("step.csv", "time_s")),
    ],
)
def test_a_column_under_a_wrong_name_is_named_with_the_mend(tmp_path, capsys, header, words):
    assert main(["fit", write(tmp_path / "step.csv", header), "--out", str(tmp_path / "fit")]) != 0
    (line,) = capsys.readouterr().err.splitlines()
    for word in words:
        assert word in line, line
    assert not (tmp_path / "fit").exists()


def test_a_loose_thermometer_is_named_in_one_command(tmp_path, capsys):
    loose = write(tmp_path / "loose.csv", lag=LAG)
    assert main(["diagnose", loose, "--out", str(tmp_path / "found")]) == 0
    told = capsys.readouterr().out
    assert told.startswith("EXPLAINED: Left out of the base model: ")
    assert (tmp_path / "found" / "report.html").stat().st_size > 10_000
    found = json.loads((tmp_path / "found" / "diagnosis.json").read_text())
    (named,) = found["mechanisms"]
    assert {named["name"], *named["equivalents"]} == {"sensor_lag", "two_node_thermal"}  # one transfer function
    assert "not told apart from: " in told
    assert "--next designs the experiment" in told
    tau = named["parameters"]["time_constant"]
    assert abs(tau["value"] - LAG) < 4 * tau["std"] + 0.05 * LAG  # the steps are Euler's
    assert found["extended"]["held_out"]["temperature_degC"]["rmse"] < 1.15 * NOISE
