"""A mechanism from a user's own file is tried, diagnosed, written and found again; a faulty one is named."""

import json
import subprocess
import sys
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from own_files import assert_refused
from scipy.integrate import solve_ivp

from scpjax.cli import main
from scpjax.errors import ModelError
from scpjax.physics import catalogue as room
from scpjax.physics.catalogue import catalogue, forget, from_file, left_out, origin
from scpjax.recordings.files import write_recording
from scpjax.recordings.recording import Metadata, Recording
from scpjax.simulate.trial import try_null, use

EXAMPLE = Path(__file__).resolve().parents[2] / "examples" / "evaporation.py"
AMBIENT, GAIN, LOSS, MASS, ENERGY, DRYING = 295.15, 1 / 1.2, 0.14, 1.1, 60.0, 40.0


def wet(drive: np.ndarray, time: np.ndarray) -> np.ndarray:
    """Temperature above ambient [K] of a drying wire, by scipy."""

    def rates(t, z):
        u = drive[min(int(t / 0.5 + 1e-9), len(drive) - 1)]
        leaving = z[1] * z[0] / (50.0 * DRYING)
        return [(GAIN * u**2 - LOSS * z[0] - ENERGY * leaving) / MASS, -leaving]

    found = solve_ivp(rates, (0, time[-1]), [0.0, 1.0], t_eval=time, max_step=0.1, rtol=1e-8, atol=1e-9)
    return found.y[0]


def recording(name: str, drive: np.ndarray, seed: int) -> Recording:
    time = 0.5 * np.arange(len(drive))
    noise = 0.2 * np.random.default_rng(seed).standard_normal(len(time))
    y = wet(drive, time) + AMBIENT - 273.15 + noise
    meta = Metadata(name=name, known=(("resistance_ohm", 1.2),), ambient_K=AMBIENT, model="te")
    return Recording.from_arrays(time, {"voltage_V": drive}, {"temperature_degC": y}, metadata=meta)


@pytest.fixture
def example():
    yield EXAMPLE
    forget(EXAMPLE)


def test_the_example_is_found_and_named_and_predicts(example, tmp_path, monkeypatch, capsys):
    """As a user would: the file lies elsewhere; the model file finds it, in a process that has not seen it."""
    monkeypatch.chdir(tmp_path)
    up = np.repeat([3.0, 0.0, 3.5, 2.0, 3.5, 0.0], 80)
    write_recording(recording("one", up, 0), "one.csv")
    write_recording(recording("two", np.repeat([2.0, 3.5, 1.0, 3.0], 80), 1), "two.csv")
    Path("mine.py").write_text(EXAMPLE.read_text())
    assert main(["diagnose", "one.csv", "--mechanism", "mine.py", "--out", "found", "--quiet"]) == 0
    found = json.loads(Path("found/diagnosis.json").read_text())
    assert [m["name"] for m in found["mechanisms"]] == ["evaporation"]
    values = found["mechanisms"][0]["parameters"]
    for name, truth in (("energy", ENERGY), ("time_constant", DRYING)):
        assert abs(values[name]["value"] - truth) < 4 * values[name]["std"] + 0.02 * truth
    assert "Water evaporates" in Path("found/report.html").read_text()
    forget("mine.py")
    for words in (
        ["predict", "found/model.json", "two.csv"],
        ["simulate", "--model", "found/model.json", "--input", "two.csv"],
    ):
        call = [sys.executable, "-m", "scpjax.cli", *words, "--out", "said.csv"]
        done = subprocess.run(call, capture_output=True, text=True)
        assert done.returncode == 0, done.stderr
        said = np.genfromtxt("said.csv", delimiter=",", names=True)["temperature_degC"]
        truth = wet(np.repeat([2.0, 3.5, 1.0, 3.0], 80), 0.5 * np.arange(320)) + AMBIENT - 273.15
        assert np.sqrt(np.mean((said - truth) ** 2)) < 0.2
    Path("mine.py").rename("elsewhere.py")
    assert main(["predict", "found/model.json", "two.csv", "--out", "x.csv"]) == 2
    assert "put the file back" in capsys.readouterr().err


def test_it_joins_and_leaves_the_catalogue(example):
    assert "evaporation" not in catalogue()
    (m,) = use(example)
    assert m in left_out()
    assert catalogue()["evaporation"] is m
    assert origin(m) == EXAMPLE
    assert use(example) == (m,), "a class is made once"
    forget(example)
    assert "evaporation" not in catalogue()


SOURCE = EXAMPLE.read_text()
FAULTS = {
    "no class": ("x = 1\n", "defines no Mechanism"),
    "syntax": ("class Mine(\n", "line 1: cannot be run: SyntaxError"),
    "fails": ("import scpjax\n\n1 / 0\n", "line 3: cannot be run: ZeroDivisionError"),
    "taken": (SOURCE.replace('"evaporation"', '"creep"'), "the name 'creep' is taken"),
    "no words": (SOURCE.replace('says = "', 'said = "'), "evaporation: has no says"),
    "no null": (SOURCE.replace("null=0.0,", ""), "energy has no null value"),
    "no prior": (SOURCE.replace("spread=2.0,", "", 1), "energy has no prior"),
    "start": (SOURCE.replace("(30.0, 30.0)", "(30.0,)"), "starts do not give"),
    "start outside": (SOURCE.replace("(30.0, 30.0)", "(30.0, 0.5)"), "outside its bounds"),
    "subsystem": (SOURCE.replace('"thermoelectric"', '"heat"'), "subsystem is 'heat'"),
    "needs": (SOURCE.replace('("thermal",)', '("warmth",)'), "needs ['warmth']"),
    "null that is not": (SOURCE.replace("-p.energy * self", "-(5.0 + p.energy) * self"), "does not vanish at its null"),
    "nan at null": (
        SOURCE.replace("-p.energy * self", "-p.energy**2 / p.energy * self"),
        "does not vanish at its null",
    ),
    "cannot run": (SOURCE.replace("p.energy *", "p.heat *"), "cannot be simulated: AttributeError"),
}


@pytest.mark.parametrize("fault", FAULTS)
def test_a_fault_is_named_in_one_line(fault, tmp_path):
    assert_refused(use, tmp_path, *FAULTS[fault])


def test_a_file_that_is_not_there_is_named(tmp_path):
    with pytest.raises(ModelError, match="no such file"):
        from_file(tmp_path / "none.py")


@pytest.mark.parametrize("name", ["creep", "sensor_lag", "thermal_crosstalk", "supply_sag"])
def test_shipped_mechanisms_pass_the_trial_at_their_null_and_fail_it_elsewhere(name):
    m = catalogue()[name]
    assert try_null(m) is None
    moved = tuple(replace(p, null=start) for p, start in zip(m.parameters, m.starts[0], strict=True))
    elsewhere = type(m.__class__.__name__, (type(m),), {"parameters": moved})()
    with pytest.raises(ModelError, match=f"{name}.*does not vanish at its null"):
        try_null(elsewhere)


def test_entry_points_are_read(monkeypatch):
    class Point:
        value = "their.module:Evaporation"

        def __init__(self, given):
            self.given = given

        def load(self):
            if isinstance(self.given, Exception):
                raise self.given
            return self.given

    (m,) = from_file(EXAMPLE)
    forget(EXAMPLE)

    def offer(given):
        monkeypatch.setattr(room, "entry_points", lambda group: [Point(given)] if group == room.GROUP else [])
        room._installed.cache_clear()

    try:
        offer(type(m))
        assert type(catalogue()["evaporation"]) is type(m)
        offer(ImportError("no module their"))
        with pytest.raises(ModelError, match=r"their\.module.*no module their"):
            catalogue()
        offer(object())
        with pytest.raises(ModelError, match="defines no Mechanism"):
            catalogue()
    finally:
        monkeypatch.undo()
        room._installed.cache_clear()
