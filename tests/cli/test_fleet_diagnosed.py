"""``scpjax fleet --diagnose``: a page of all, one folder each, and a call that was stopped goes on where it was."""

import csv
import json
import re
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest
from made import made_diagnosis

from scpjax.cli import build_parser, main
from scpjax.cli.then import earlier, with_earlier
from scpjax.diagnose import diagnose as room
from scpjax.diagnose import shared
from scpjax.errors import FitError
from scpjax.fit.result import Estimate
from scpjax.simulate import trial

FLEET = ("fleet", "rig", "--out", "out", "--diagnose")


@pytest.fixture
def rig(tmp_path, monkeypatch):
    """Six actuators, one of them unreadable; diagnoses are made by hand, and listed in what is given."""
    monkeypatch.chdir(tmp_path)
    rows = "\n".join(f"{0.1 * i:.1f},{i % 7},{np.sin(i):.3f}" for i in range(40))
    for i, name in enumerate(("a", "b", "c", "d", "e")):
        Path("rig", name).mkdir(parents=True)
        Path("rig", name, "step.csv").write_text(f"time_s,voltage_V,displacement_mm\n{rows}\n0{i}9.0,1,1\n")
    Path("rig/broken.csv").write_text("time_s,voltage_V\n")
    asked: list[str] = []

    def diagnose(recordings, **options):
        name = Path(recordings[0].metadata.path).parent.name
        asked.append(name)
        if name == "d":
            raise FitError("the drive never changes")
        return made_diagnosis(
            recordings[0], stiffness=200.0 if name == "e" else 100.0, named="" if name == "b" else "creep"
        )

    monkeypatch.setattr(room, "diagnose", diagnose)
    monkeypatch.setattr(shared, "rebuilt", _made_by_hand)
    return asked


def _made_by_hand(name, content, recordings):
    raise FitError("it was made by hand")


def test_what_the_fleet_shares_is_told(rig, monkeypatch, capsys):
    values = {"size": Estimate(0.3, 0.01, "1", 0.28, 0.32, symbol="J")}
    elsewhere = {"b": shared.Elsewhere(shared.HAS_IT, 19.5, 0.02), "c": shared.Elsewhere(shared.OPEN, 1.0, 0.0)}
    effect = shared.SharedEffect("creep", "", ("a", "c"), ("e",), values, 31.4, 0.23, (1.01, 1.0), {}, elsewhere)
    asked = []

    def shared_effects(actuators, tell):
        asked.extend(actuators)
        return shared.Sharing((effect,), {"friction in e": "it differs by recording there"})

    monkeypatch.setattr(shared, "shared_effects", shared_effects)
    monkeypatch.setattr(shared, "rebuilt", lambda name, content, recordings: (name, len(recordings)))
    assert main([*FLEET]) == 0
    assert asked == [(name, 1) for name in "abce"]
    says = (
        "creep: one set of values serves 2 actuators, J = 0.3 (0.28 to 0.32) (BIC +31.4 for it, p = 0.23); with values "
        "of its own in e. By these values it is also in b."
    )
    assert says in capsys.readouterr().out
    content = json.loads(Path("out/fleet.json").read_text())
    assert says in content["says"]
    (told,) = content["shared"]
    assert (told["name"], told["actuators"], told["apart"]) == ("creep", ["a", "c"], ["e"])
    assert told["elsewhere"]["b"] == {
        "says": "has it",
        "evidence": 19.5,
        "held_out_gain": 0.02,
        "in_place_of": "",
        "why": "",
    }
    assert content["shared_left_out"] == {"friction in e": "it differs by recording there"}
    page = Path("out/report.html").read_text()
    for words in (
        "Shared by the fleet",
        "2, apart: e",
        "1.010 → 1.000",
        "has it: b; cannot be told: c",
        "Not asked",
        "friction in e",
    ):
        assert words in page


def test_what_cannot_be_fitted_again_is_told(rig):
    assert main([*FLEET, "--quiet"]) == 0
    content = json.loads(Path("out/fleet.json").read_text())
    assert content["shared"] == []
    assert content["shared_left_out"] == dict.fromkeys("abce", "it was made by hand")
    assert ">a: it was made by hand<" in Path("out/report.html").read_text()


def test_the_page_says_what_is_in_which(rig, capsys):
    assert main([*FLEET]) == 0
    said = capsys.readouterr().out
    assert "4 of 6 actuators were diagnosed: 1 adequate, 3 explained." in said
    assert "Left out of the base model: creep in 3." in said
    assert "  d: the drive never changes" in said
    content = json.loads(Path("out/fleet.json").read_text())
    assert content["schema"] == "scpjax.fleet/1"
    assert content["effects"] == {"creep": ["a", "c", "e"]}
    assert content["spread"]["elastic_spring.stiffness"]["p"] < 1e-6
    assert set(content["actuators"]) == {"a", "b", "c", "d", "e", "broken"}
    rows = {r["actuator"]: r for r in csv.DictReader(Path("out/fleet.csv").read_text().splitlines())}
    assert rows["e"]["elastic_spring.stiffness"] == "200.0"
    assert rows["b"]["mechanisms"] == ""
    assert rows["d"]["status"] == "failed"
    page = Path("out/report.html").read_text()
    for words in ("Which effects are in which", "How the parameters spread", "Not diagnosed", "broken.csv", "3 of 4"):
        assert words in page
    assert not re.search(r"https?://|<script|<link", page)
    for name in ("a", "b", "c", "e"):
        assert (Path("out/actuators") / name / "report.html").is_file()
    assert not Path("out/actuators/d").exists()


def test_other_names_are_sought_for_as_long_as_told(rig, monkeypatch):
    told = []
    whole = room.diagnose

    def noting(recordings, *, options, **rest):
        told.append(options.patience)
        return whole(recordings, **rest)

    monkeypatch.setattr(room, "diagnose", noting)
    assert main([*FLEET, "--minutes", "0.5"]) == 0
    assert set(told) == {30.0}
    told.clear()
    assert main([*FLEET]) == 0
    assert len(told) == 5, "told otherwise, all are diagnosed again"
    assert set(told) == {600.0}


def test_what_lies_there_is_not_diagnosed_again(rig, capsys):
    assert main([*FLEET]) == 0
    first = Path("out/report.html").read_text()
    rig.clear()
    assert main([*FLEET]) == 0
    assert rig == ["d"], "only what failed is tried again"
    assert "4 actuators had been diagnosed before" in capsys.readouterr().out
    assert Path("out/report.html").read_text() == first
    rig.clear()
    with Path("rig/c/step.csv").open("a") as file:
        file.write("60.0,1,1\n")
    Path("out/actuators/a/diagnosis.json").write_text('{"half')
    assert main([*FLEET]) == 0
    assert rig == ["a", "c", "d"], "a changed recording and half a file are done anew"


def test_a_call_that_is_stopped_keeps_what_it_has(rig, monkeypatch, capsys):
    whole = room.diagnose

    def stopped(recordings, **options):
        if "/c/" in recordings[0].metadata.path:
            raise KeyboardInterrupt
        return whole(recordings, **options)

    monkeypatch.setattr(room, "diagnose", stopped)
    assert main([*FLEET]) == 130
    assert "2 of 5 actuators are in out/actuators; the same call goes on from there" in capsys.readouterr().err
    assert not Path("out/report.html").exists()
    monkeypatch.setattr(room, "diagnose", whole)
    rig.clear()
    assert main([*FLEET, "--quiet"]) == 0
    assert rig == ["c", "d", "e"]


def test_a_call_that_is_stopped_while_it_asks_what_is_shared_keeps_what_it_has(rig, monkeypatch, capsys):
    def stopped(name, content, recordings):
        raise KeyboardInterrupt

    monkeypatch.setattr(shared, "rebuilt", stopped)
    assert main([*FLEET]) == 130
    said = capsys.readouterr().err
    assert "all 4 actuators that could be diagnosed are in out/actuators; the same call goes on from there" in said
    monkeypatch.setattr(shared, "rebuilt", _made_by_hand)
    rig.clear()
    assert main([*FLEET, "--quiet"]) == 0
    assert rig == ["d"]


def test_nothing_to_diagnose_is_one_line(rig, capsys):
    assert main(["fleet", "rig/d", "--out", "out", "--diagnose"]) == 2
    assert capsys.readouterr().err.strip() == (
        "scpjax: none of 1 actuators could be fitted; the first: the drive never changes"
    )
    assert main(["fleet", "rig", "--out", "out", "--mechanism", "x.py"]) == 2
    assert "add --diagnose" in capsys.readouterr().err


def test_an_actuator_is_read_again_as_the_fleet_read_it(rig, monkeypatch):
    monkeypatch.setattr(trial, "use", lambda file: ())
    monkeypatch.setattr(trial, "use_base", lambda file: SimpleNamespace(name="two_tanks"))
    told = ("--drive", "voltage_V", "--response", "displacement_mm", "--base", "two_tanks.py", "--mechanism", "leak.py")
    assert main([*FLEET, *told, "--quiet"]) == 0
    out = Path("out/actuators/a")
    again = build_parser().parse_args(["diagnose", "--then", "new.csv", "--out", str(out)])
    read = with_earlier(again, earlier(out), out)
    assert read.files == ["rig/a/step.csv", "new.csv"]
    assert (read.drive, read.response, read.model) == ("voltage_V", "displacement_mm", None)
    assert (read.base, read.mechanisms) == ("two_tanks.py", ["leak.py"])
