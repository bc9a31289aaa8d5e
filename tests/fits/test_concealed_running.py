"""The proof's run: going on after a stop, runs told together, workers that fail, and the baselines."""

import json
import math
import shutil

import numpy as np
import pytest
from judged import said, truth

from fits.concealed import run as program
from fits.concealed.baselines import narx, sindy
from fits.concealed.baselines.series import factors, monomials, read_series, terms
from fits.concealed.cases import plan
from fits.concealed.making import make
from fits.concealed.pool import Worker
from fits.concealed.score import Score, score
from fits.concealed.seal import seal
from fits.concealed.store import Store


@pytest.fixture(scope="module")
def case(tmp_path_factory):
    """A te case without anything concealed, made and sealed."""
    chosen = next(c for c in plan() if c.sort == "null" and c.kind == "te" and not c.mess and c.files == 1)
    out = tmp_path_factory.mktemp("proof")
    make(chosen, out / "cases")
    seal(out / "cases", [chosen.name])
    return out, chosen


def test_it_goes_on_where_it_was_stopped(case, monkeypatch):
    out, chosen = case
    asked = []

    file = sorted((out / "cases" / chosen.name / "kept").glob("*.csv"))[0].stem

    def ask(self, job):
        asked.append(job)
        assert not any("truth" in str(v) for v in job.values())
        if job["do"] == "narx":
            raise KeyboardInterrupt
        return said() | {"kept": {file: {"temperature_degC": 0.2}}}

    def proof(methods):
        return program.Run([chosen], out, way="library", methods=methods, limit=1.0)

    monkeypatch.setattr(Worker, "ask", ask)
    monkeypatch.setattr("threading.excepthook", lambda args: None)
    monkeypatch.setattr(program, "seen", frozenset)
    first = proof(["scpjax", "narx"])
    first.answer(first.missing(retry=False), workers=1)
    assert [job["do"] for job in asked] == ["library", "narx"]
    monkeypatch.setattr(program, "seen", lambda: frozenset({chosen.name}))  # as it is once the engine is changed
    again = proof(["scpjax", "narx"])
    assert [method for _, method, _ in again.missing(retry=False)] == ["narx"]
    scores, others = again.scores()
    assert [s.outcome for s in scores] == ["right"]
    assert others == {"narx": {}}
    (told,) = scores
    assert (told.commit, told.first) == (first.commit, True)
    assert not list((out / "answers").glob("*.part"))


def test_what_was_said_first_is_kept_when_a_case_is_asked_again(case, tmp_path, monkeypatch):
    out, chosen = case
    shutil.copytree(out / "cases", tmp_path / "cases")
    monkeypatch.setattr(program, "seen", frozenset)
    kept = {"kept": {}}
    monkeypatch.setattr(Worker, "ask", lambda self, job: said("friction") | kept)
    earlier = None
    for turn, name in enumerate(("", "creep", "slack")):
        run = program.Run([chosen], tmp_path, way="library", methods=["scpjax"], limit=1.0, earlier=earlier)
        jobs = run.missing(retry=False) or [(chosen.name, "scpjax", run.sealed[chosen.name])]
        run.answer(jobs, workers=1)
        run.report(None)
        earlier = json.loads((tmp_path / "results.json").read_text())
        (row,) = earlier["cases"]
        assert row["first"] == (turn == 0)
        assert [s["outcome"] for s in earlier["first_answers"]] == ["false name"] * (turn > 0)
        monkeypatch.setattr(Worker, "ask", lambda self, job, name=name: said(name or "creep") | kept)
        monkeypatch.setattr(program, "seen", lambda: frozenset({chosen.name}))


def test_runs_that_are_scored_together_are_told(case, tmp_path, monkeypatch):
    """Each run notes what it was asked for; all that lies there is scored without a selection."""
    out, chosen = case
    shutil.copytree(out / "cases", tmp_path / "cases")
    monkeypatch.setattr(program, "generate", lambda *args, **others: None)
    monkeypatch.setattr(Worker, "ask", lambda self, job: said() | {"kept": {}})
    where = ["--out", str(tmp_path), "--no-baselines"]
    for options in (["--only", chosen.name], ["--only", chosen.name, "--seeds", str(chosen.seed)]):
        program.main([*options, *where])
        assert json.loads((tmp_path / "results.json").read_text())["asked"] == [
            f"--only '{chosen.name}'" + f" --seeds {chosen.seed}" * (len(options) > 2)
        ]
    program.main(["--score-only", *where])
    found = json.loads((tmp_path / "results.json").read_text())
    assert [c["name"] for c in found["cases"]] == [chosen.name]
    assert found["asked"] == [f"--only '{chosen.name}'", f"--only '{chosen.name}' --seeds {chosen.seed}"]


def test_runs_elsewhere_are_told_with_these(case, tmp_path, monkeypatch):
    """Their scores come from the file that they left; what was run here again counts as it went here."""
    out, chosen = case
    shutil.copytree(out / "cases", tmp_path / "cases")
    monkeypatch.setattr(program, "generate", lambda *args, **others: None)
    monkeypatch.setattr(Worker, "ask", lambda self, job: said() | {"kept": {}})
    elsewhere = [
        score(truth("creep", name="elsewhere"), said("creep") | {"kept": {"3_sweep": {"displacement_mm": math.inf}}})
    ]
    elsewhere.append(score(truth("slack", name=chosen.name), said("friction")))
    left = {"commit": "abc, def", "asked": ["--all"], "cases": [s.plain() for s in elsewhere]}
    left["baselines"] = {"narx": {"elsewhere": None}}
    (tmp_path / "left.json").write_text(json.dumps(left))
    docs = tmp_path / "docs"
    where = ["--out", str(tmp_path), "--no-baselines", "--docs", str(docs), "--add", str(tmp_path / "left.json")]
    program.main(["--only", chosen.name, *where])
    found = json.loads((docs / "concealed" / "results.json").read_text())
    assert {c["name"]: c["outcome"] for c in found["cases"]} == {chosen.name: "right", "elsewhere": "right"}
    assert found["asked"] == ["--all", f"--only '{chosen.name}'"]
    assert found["commit"].startswith("abc, def, ")
    assert found["baselines"] == {"narx": {"elsewhere": None}}
    again = [Score.read(row) for row in found["cases"]]
    assert math.isinf(next(s.kept for s in again if s.name == "elsewhere"))
    assert next(s for s in again if s.name == "elsewhere").plain() == elsewhere[0].plain()


def test_baselines_alone_are_told_with_what_was_named_elsewhere(case, tmp_path, monkeypatch):
    """They take hours of their own, and no change of the package asks for them again."""
    out, chosen = case
    shutil.copytree(out / "cases", tmp_path / "cases")
    monkeypatch.setattr(program, "generate", lambda *args, **others: None)
    monkeypatch.setattr(program.sindy, "installed", lambda: True)
    asked = []

    def answer(self, job):
        asked.append(job["do"])
        return {"kept": {}}

    monkeypatch.setattr(Worker, "ask", answer)
    elsewhere = score(truth("slack", name=chosen.name), said("slack") | {"kept": {}})
    (tmp_path / "left.json").write_text(json.dumps({"commit": "abc", "cases": [elsewhere.plain()]}))
    where = ["--out", str(tmp_path), "--only-baselines", "--add", str(tmp_path / "left.json")]
    program.main(["--only", chosen.name, *where])
    assert sorted(asked) == ["narx", "pysindy"]
    found = json.loads((tmp_path / "results.json").read_text())
    assert [(c["name"], c["outcome"]) for c in found["cases"]] == [(chosen.name, "right")]
    assert found["baselines"] == {"narx": {chosen.name: None}, "pysindy": {chosen.name: None}}


def test_answers_belong_to_a_truth(tmp_path):
    store = Store(tmp_path)
    store.write("a", "scpjax", "hash", {"error": "none came"})
    assert store.read("a", "scpjax", "hash") == {"truth_sha256": "hash", "error": "none came"}
    assert store.read("a", "scpjax", "other") is None
    assert store.read("b", "scpjax", "hash") is None


def test_a_worker_that_hangs_is_ended(tmp_path, monkeypatch):
    silent = tmp_path / "silent.py"
    silent.write_text("import time\ntime.sleep(60)\n")
    monkeypatch.setattr("fits.concealed.pool.COMMAND", ("-u", str(silent)))
    worker = Worker(limit=0.5, log=tmp_path / "log")
    assert "no answer within" in worker.ask({"do": "library"})["error"]
    assert worker.process is None


def test_a_worker_that_dies_is_replaced(tmp_path, monkeypatch):
    dying = tmp_path / "dying.py"
    dying.write_text("import sys\nprint('chatter')\nsys.exit(1)\n")
    monkeypatch.setattr("fits.concealed.pool.COMMAND", ("-u", str(dying)))
    worker = Worker(limit=20, log=tmp_path / "log")
    assert "error" in worker.ask({"do": "library"})
    echo = tmp_path / "echo.py"
    echo.write_text("import sys\nfor line in sys.stdin:\n    print('@answer ' + line, flush=True)\n")
    monkeypatch.setattr("fits.concealed.pool.COMMAND", ("-u", str(echo)))
    assert worker.ask({"do": "this"}) == {"do": "this"}
    worker.close()


def test_a_worker_that_does_not_listen_is_an_error(tmp_path, monkeypatch):
    deaf = tmp_path / "deaf.py"
    deaf.write_text("import os, time\nos.close(0)\nprint('deaf', flush=True)\ntime.sleep(60)\n")
    monkeypatch.setattr("fits.concealed.pool.COMMAND", ("-u", str(deaf)))
    worker = Worker(limit=20, log=tmp_path / "log")
    worker._open()
    assert worker.lines.get(timeout=20) == "deaf\n"
    assert "process is gone" in worker.ask({"do": "library"})["error"]
    assert worker.process is None


def test_monomials():
    powers = terms(2, 2)
    assert powers.tolist() == [[0, 0], [1, 0], [0, 1], [2, 0], [1, 1], [0, 2]]
    assert monomials(np.array([2.0, 3.0]), factors(powers)).tolist() == [1, 2, 3, 4, 6, 9]


def kept_ratio(case, judge):
    out, chosen = case
    folder = out / "cases" / chosen.name
    found = json.loads((folder / "truth.json").read_text())
    noise = found["files"]["given/0_multilevel"]["noise"]
    judged = judge(
        sorted((folder / "given").glob("*.csv")),
        sorted((folder / "kept").glob("*.csv")),
        np.array(list(noise.values())),
    )
    return max(judged.kept[f][c] / noise[c] for f in judged.kept for c in noise)


def test_narx_learns_a_linear_system(case, monkeypatch):
    monkeypatch.setattr(narx, "DEGREES", (1,))
    assert kept_ratio(case, narx.judge) < 1.05


def test_pysindy_learns_a_linear_system(case, monkeypatch):
    if not sindy.installed():
        pytest.skip("skipped: PySINDy is not installed")
    monkeypatch.setattr(sindy, "DEGREES", (1,))
    monkeypatch.setattr(sindy, "THRESHOLDS", (0.0, 1e-3))
    assert kept_ratio(case, sindy.judge) < 1.3


def test_series_keep_the_drive_s_integral(case):
    out, chosen = case
    file = sorted((out / "cases" / chosen.name / "given").glob("*.csv"))[0]
    table = np.loadtxt(file, delimiter=",", skiprows=1)
    s = read_series(file)
    dt = table[1, 0] - table[0, 0]
    whole = int(len(s.u) - 1)
    inside = table[:, 0] < whole * 0.1 - 1e-9
    assert np.sum(s.u[:whole]) * 0.1 == pytest.approx(np.sum(table[inside, 1] ** 2) * dt, rel=2e-3)
    assert s.rest[0] == pytest.approx(table[0, 2], abs=3.0)
