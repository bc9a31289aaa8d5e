"""The proof's judge: scoring of made-up diagnoses, goals, the page, going on after a stop, and the baselines."""

import json
import math
import shutil
from dataclasses import replace

import numpy as np
import pytest

from fits.concealed import run as program
from fits.concealed.baselines import narx, sindy
from fits.concealed.baselines.series import factors, monomials, read_series, terms
from fits.concealed.cases import plan
from fits.concealed.making import make
from fits.concealed.page import write_page
from fits.concealed.pool import Worker
from fits.concealed.score import Score, score
from fits.concealed.seal import seal
from fits.concealed.store import Store
from fits.concealed.tally import by_method, calibration, confusion, goals


def truth(*effects, sort="single", catalogue=True, subsystem="thermoelectric", tier="strong", name="a"):
    return {
        "name": name,
        "label": f"{sort}-{'+'.join(effects)}",
        "sort": sort,
        "tier": tier,
        "kind": "full",
        "noise": "fine",
        "mess": [],
        "seed": 1,
        "subset": True,
        "effects": list(effects),
        "catalogue": catalogue,
        "subsystems": [subsystem] * len(effects),
        "misfit": 5.0,
        "files": {"kept/3_sweep": {"noise": {"temperature_degC": 0.1, "displacement_mm": 0.05}}},
    }


def said(*names, verdict=None, subsystem="thermoelectric", equivalents=None, probability=0.99):
    """A result with a diagnosis that names these."""
    mechanisms = [
        {"name": n, "subsystem": subsystem, "probability": probability, "equivalents": (equivalents or {}).get(n, [])}
        for n in names
    ]
    diagnosis = {
        "schema": "scpjax.diagnosis/1",
        "verdict": verdict or ("explained" if names else "adequate"),
        "location": {"subsystem": subsystem},
        "mechanisms": mechanisms,
        "ranking": [{"name": "friction", "probability": 0.02}, {"name": "creep", "probability": 0.4}],
    }
    kept = {"3_sweep": {"temperature_degC": 0.11, "displacement_mm": 0.1}}
    return {"diagnosis": diagnosis, "kept": kept, "kept_base": {}, "seconds": 30.0}


@pytest.mark.parametrize(
    ("concealed", "answer", "outcome"),
    [
        (truth("creep"), said("creep"), "right"),
        (truth("creep"), said("friction", equivalents={"friction": ["creep"]}), "equivalent"),
        (truth("creep"), said("friction", equivalents={"friction": ["a", "b", "creep"]}), "equivalent"),
        (truth("creep"), said("friction", equivalents={"friction": ["a", "b", "c", "creep"]}), "misnamed"),
        (truth("creep"), said("friction"), "misnamed"),
        (truth("creep"), said("creep", "friction"), "extra"),
        (truth("creep"), said(verdict="unexplained"), "unnamed"),
        (truth("creep"), said(), "missed"),
        (truth("creep", "slack", sort="pair"), said("slack", "creep"), "right"),
        (truth("creep", "slack", sort="pair"), said("slack"), "partly"),
        (truth("creep", "slack", sort="pair"), said("slack", "friction"), "misnamed"),
        # one name cannot stand for two effects
        (truth("creep", "slack", sort="pair"), said("slack", equivalents={"slack": ["creep"]}), "partly"),
        # the name that is right stays with its effect; the other stands for the other
        (
            truth("creep", "slack", sort="pair"),
            said("slack", "friction", equivalents={"slack": ["creep"], "friction": ["creep"]}),
            "equivalent",
        ),
        (
            truth("creep", "slack", sort="pair"),
            said("fatigue", "creep", equivalents={"fatigue": ["creep"], "creep": ["slack"]}),
            "equivalent",
        ),
        (truth(sort="null"), said(), "right"),
        (truth(sort="null"), said(verdict="unexplained"), "alarm"),
        (truth(sort="null"), said("creep"), "false name"),
        (truth("coil", sort="outside", catalogue=False), said(verdict="unexplained"), "right"),
        (truth("coil", sort="outside", catalogue=False), said(verdict="unexplained", subsystem="drive"), "misplaced"),
        (truth("coil", sort="outside", catalogue=False), said("creep", verdict="unexplained"), "false name"),
        (truth("coil", sort="outside", catalogue=False), said("coil"), "right"),
        (truth("coil", sort="outside", catalogue=False), said(), "missed"),
        (truth("creep"), {"error": "no answer within 1200 s"}, "failed"),
    ],
)
def test_outcomes(concealed, answer, outcome):
    assert score(concealed, answer).outcome == outcome


def test_figures_of_a_score():
    s = score(truth("creep", subsystem="thermomechanical"), said("creep"))
    assert s.kept == pytest.approx(2.0)  # displacement: 0.1 mm at a noise of 0.05 mm
    assert math.isnan(s.kept_base)
    assert s.minutes == 0.5
    assert not s.placed
    assert s.believed == [(0.99, True)]
    assert dict(s.ranked) == {0.02: False, 0.99: True}  # the last word on creep, not 0.4
    assert s.plain()["kept_base"] is None


def test_goals_count_what_they_say():
    scores = [
        *(score(truth("creep", name=str(i)), said("creep")) for i in range(3)),
        score(truth("creep"), said("friction")),
        score(truth("creep", tier="weak"), said()),
        score(truth("creep", tier="weak"), said("friction")),
        score(truth(sort="null", tier="none"), said("friction")),
        score(truth("coil", sort="outside", catalogue=False), said(verdict="unexplained", subsystem="sensor")),
    ]
    found = {g.title.split(":")[0] + g.title[-8:]: g for g in goals(scores)}
    single = next(g for g in goals(scores) if g.title.startswith("single effects, moderate"))
    assert (single.hits, single.of, single.met) == (3, 4, False)
    low, high = single.interval()
    assert (low, high) == pytest.approx((0.3006, 0.9544), abs=2e-4)  # Wilson's interval for 3 of 4
    weak = next(g for g in goals(scores) if "weak" in g.title)
    assert weak.share == 0.5
    alarms = next(g for g in goals(scores) if "false alarms" in g.title)
    assert (alarms.share, alarms.met) == (1.0, False)
    placed = next(g for g in goals(scores) if "balance" in g.title)
    assert placed.share == 0.0
    assert next(g for g in goals(scores) if g.title.startswith("pairs")).met is None
    assert len(found) == len(goals(scores))


def test_calibration_of_known_beliefs():
    rng = np.random.default_rng(0)
    believed = rng.uniform(0.0, 1.0, 20_000)
    bins, gap = calibration(zip(believed, rng.random(20_000) < believed, strict=True))
    assert gap < 0.01
    assert sum(b.number for b in bins) == 20_000
    _, gap = calibration([(0.9, True), (0.9, False)])
    assert gap == pytest.approx(0.4)
    assert math.isnan(calibration([])[1])


def test_the_page_shows_every_case(tmp_path):
    scores = [
        score(truth("creep"), said("creep")),
        score(truth("slack", name="b"), said("friction")),
        score(truth(sort="null", name="c", tier="none"), said()),
        score(truth("coil", sort="outside", catalogue=False, name="d"), said(verdict="unexplained")),
    ]
    effects, words, counts = confusion(scores)
    assert (effects, counts.sum()) == (["slack", "creep", "nothing", "coil"], 4)  # in the order of the catalogue
    assert counts[effects.index("slack"), words.index("friction")] == 1
    assert len(set(words)) == len(words)
    assert counts[effects.index("nothing"), words.index("nothing")] == 1
    assert counts[effects.index("coil"), words.index("something unnamed")] == 1
    others, asked = {"narx": {"a": 1.5, "b": math.inf}}, ["--unseen --cases 60", "--sort outside"]
    page = write_page(tmp_path, scores, others, commit="abc", of=515, asked=asked, seen={"b"})
    text = page.read_text()
    assert "run.py --unseen --cases 60` and `python fits/concealed/run.py --sort outside`: 4 of" in text
    for name in ("confusion", "kept", "calibration"):
        assert f"concealed/{name}.svg" in text
        assert (tmp_path / "concealed" / f"{name}.svg").stat().st_size > 1000
    assert "| `b` | single-slack | 5.0 | misnamed | friction |" in text
    assert "1 of 2, 50% (9% to 91%) | 1 of 1 |" in text
    assert "1 of the cases had been run" in text
    assert "| explained | 1 | 2 |" in text
    assert "diverged" in text
    methods, common = by_method(scores, others | {"pysindy": {"b": 2.0}})
    assert methods["base model"] == {}
    assert common == {"b"}, "a method without any is none"
    judged = [replace(s, kept_base=5.0) for s in scores]
    methods, common = by_method(judged, others | {"pysindy": {"b": 2.0, "a": math.nan}})
    assert common == {"b"}
    assert methods["pysindy"] == {"b": 2.0}
    text = write_page(tmp_path, judged, others, commit="abc", of=515, asked=asked, seen={"b"}).read_text()
    assert "| single | scpjax | 2 |" in text
    assert "| null | base model | 1 |" in text
    assert "null, given to all" not in text
    text = write_page(tmp_path, judged, {"narx": {"a": 1.5}}, commit="abc", of=515, asked=asked, seen={"b"}).read_text()
    assert "| single, given to all | scpjax | 1 |" in text
    assert "| single, given to all | narx | 1 | 1.50 |" in text


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
    first = proof(["scpjax", "narx"])
    first.answer(first.missing(retry=False), workers=1)
    assert [job["do"] for job in asked] == ["library", "narx"]
    again = proof(["scpjax", "narx"])
    assert [method for _, method, _ in again.missing(retry=False)] == ["narx"]
    scores, others = again.scores()
    assert [s.outcome for s in scores] == ["right"]
    assert others == {"narx": {}}
    assert not list((out / "answers").glob("*.part"))


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
