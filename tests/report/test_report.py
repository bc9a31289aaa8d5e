"""A diagnosis made by hand becomes one page that needs nothing else, and JSON in the form of the contract."""

import json
from dataclasses import replace

import numpy as np
import pytest
from made_pages import COLUMNS, GAIN, diagnosis, read, recordings

from scpjax.diagnose.fleet import Member
from scpjax.diagnose.result import FREE, Closure, Latent, Location, Ranked
from scpjax.physics.catalogue import catalogue
from scpjax.physics.storage import load_model
from scpjax.report.fleet import write_fleet_diagnosis
from scpjax.report.numbers import number
from scpjax.report.report import command_line, write_diagnosis


def test_the_page_says_it_all_and_needs_nothing(tmp_path):
    command = command_line(["diagnose", "my file.csv", "--out", "found"])
    path = write_diagnosis(diagnosis(), tmp_path, recordings=recordings(), command=command)
    page, text = read(path)
    says = [
        "Left out of the base model: resistance rises with temperature.",
        "explained",
        "Where",
        "In the heat balance",
        "while it heats up (70 % of the misfit)",
        "The residual goes with the temperature.",
        "What was left out",
        "so <the same> voltage heats it less",
        "0.003930 ± 0.000040",
        "0.00385 to 0.00401",
        "1/K",
        "P = P_0 / (1 + alpha T)",
        "thesis (3.13)",
        "98 %",
        "Before and after",
        "1.25",
        "0.110",
        "What was tried",
        'By its law as the catalogue has it, "heat loss grows faster than the temperature" would',
        "What these recordings cannot tell apart",
        "Heat loss grows faster than the temperature",
        "viscous_damping.damping is not determined by these recordings.",
        "Parameters of the extended model",
        "0.0872 ± 0.0012",
        "about 290",
        "Notes",
        "2 isolated wild samples were left out",
        "How to make this again",
        "scpjax diagnose 'my file.csv' --out found",
    ]
    at = 0
    for words in says:
        assert words in text, words
    for heading in ("Where", "What was left out", "Before and after", "What was tried", "How to make"):
        at = text.index(heading, at)
    assert len(page.fetched) == 4  # two overlays, where, ranking
    names = {p.name for p in (tmp_path / "figures").iterdir()}
    assert names == {"overlay_step.png", "overlay_multi_level.png", "misfit.png", "ranking.png"}
    assert all(p.read_bytes().startswith(b"\x89PNG") for p in (tmp_path / "figures").iterdir())


@pytest.mark.parametrize(("behind", "by_form"), [(9.0, False), (11.0, True)])
def test_equivalents_of_which_the_law_is_behind_are_told_of(behind, by_form):
    best, other = "resistance_temperature", "nonlinear_heat_loss"
    ranking = Ranked(best, 100.0, 0.9, 0.98), Ranked(other, 100.0 - behind, 0.9, 0.0)
    made = diagnosis(ranking=ranking)
    (named,) = made.mechanisms
    assert made.only_by_form(named) == (named.equivalents if by_form else ())
    assert made.to_json()["mechanisms"][0]["equivalents_by_form"] == list(made.only_by_form(named))


@pytest.mark.parametrize("by_form", [False, True])
def test_the_page_of_a_fleet_marks_an_equivalent_of_which_the_law_is_behind(by_form, tmp_path):
    content = diagnosis().to_json()
    if not by_form:
        content["mechanisms"][0]["equivalents_by_form"] = []
    _, text = read(write_fleet_diagnosis([Member("left knee", content)], [], [], tmp_path))
    assert ("or nonlinear_heat_loss *" in text) == by_form
    assert ("far less likely" in text) == by_form
    assert "or nonlinear_heat_loss" in text


def test_of_names_that_no_round_compares_alike_none_is_an_equivalent_by_form():
    made = diagnosis()
    (named,) = made.mechanisms
    assert made.only_by_form(named) == named.equivalents
    assert made.only_by_form(replace(named, law=FREE)) == ()
    assert replace(made, mechanisms=(named, replace(named, name="creep"))).only_by_form(named) == ()
    assert replace(made, ranking=()).only_by_form(named) == ()


def test_json_has_the_keys_of_the_contract(tmp_path):
    write_diagnosis(diagnosis(), tmp_path, recordings=recordings())
    d = json.loads((tmp_path / "diagnosis.json").read_text(), parse_constant=lambda c: pytest.fail(c))
    assert d["schema"] == "scpjax.diagnosis/1"
    assert d["verdict"] in ("adequate", "explained", "unexplained")
    for side in ("base", "extended"):
        assert {"model", "train", "held_out", "noise"} <= set(d[side])
        assert {"rmse", "nrmse"} <= set(d[side]["held_out"]["temperature_degC"])
    where = d["location"]
    assert {"subsystem", "column", "windows", "regimes", "depends_on"} <= set(where)
    assert {"recording", "start_s", "end_s", "share"} <= set(where["windows"][0])
    assert where["depends_on"][0] == {"variable": "temperature", "strength": 0.8}
    named = d["mechanisms"][0]
    assert {"name", "subsystem", "probability", "parameters", "equivalents", "says", "equation", "source"} <= set(named)
    assert named["as_well"] == ["heat lost = T s(x)"]
    said = "Nor from a term outside the catalogue: heat lost = T s(x), with s a smooth curve."
    assert said in (tmp_path / "report.html").read_text()
    assert {"value", "std", "unit"} <= set(named["parameters"]["coefficient"])
    assert {"name", "delta_bic", "held_out_gain", "probability"} <= set(d["ranking"][0])
    assert d["ranking"][2]["held_out_gain"] is None  # NaN is no JSON
    assert d["closure"] is None
    assert d["next_experiment"] is None


def test_the_model_beside_it_can_be_used(tmp_path):
    write_diagnosis(diagnosis(), tmp_path, recordings=recordings())
    model, extra = load_model(tmp_path / "model.json")
    assert model.values() == diagnosis().model.values()
    assert extra["drive"] == ["voltage_V"]
    assert extra["response"] == list(COLUMNS)
    assert extra["hold"] == "linear"
    assert extra["noise"] == dict.fromkeys(COLUMNS, 0.1)


@pytest.mark.parametrize("verdict", ["adequate", "unexplained"])
def test_nothing_named(tmp_path, verdict):
    made = diagnosis(
        verdict=verdict,
        says="Nothing was named.",
        mechanisms=(),
        ranking=(),
        location=Location("sensor", "displacement_mm", period_s=23.38 if verdict == "unexplained" else None),
        not_identifiable=(),
        notes=(),
    )
    page, text = read(write_diagnosis(made, tmp_path))
    assert ("earned its parameters" in text) == (verdict == "adequate")
    assert ("not earned" in text) == (verdict == "unexplained")
    assert ("It swings with a period of 23.4 s" in text) == (verdict == "unexplained")
    assert "Notes" not in text
    assert "every parameter is determined" in text
    assert len(page.fetched) == 2


def latent(subsystem: str = "thermoelectric", place: str = "heat", unit: str = "W") -> Latent:
    t = np.linspace(0, 20, 30)
    return Latent(
        subsystem, place, unit, 412.3, 0.93, 1.5, (t, t), (np.sin(t), 0.5 * t), (0.1 + 0 * t, 0.2 + 0 * t),
        (("temperature", 0.81), ("drive", 0.2)), (30 * t, 20 * t),
    )  # fmt: skip


def test_what_is_missing_is_drawn_and_what_was_learned_is_not_given_a_name(tmp_path):
    learned = Closure(
        "thermoelectric", "learned_heat", ("temperature",), "heat lost = (0.0012 ± 0.0001) W/(K²) T²",
        {"T2": GAIN}, 0.7, 88.0,
    )  # fmt: skip
    reading = latent("sensor", "temperature reading", "K")
    made = diagnosis(
        verdict="unexplained", says="Something is missing.", mechanisms=(), closure=learned, missing=(latent(), reading)
    )
    _, text = read(write_diagnosis(made, tmp_path, recordings=recordings()))
    assert "Learned, not named: heat" in text
    assert "extended model" in text  # which is the base model with what was learned
    before, after = (number(s.held_out["temperature_degC"]["rmse"], 3) for s in (made.base, made.extended))
    assert before != after
    facts = text[text.index("Temperature, held-out error") :][:120].split()
    assert before in facts  # what it was without
    assert after in facts
    assert "heat lost = (0.0012 ± 0.0001) W/(K²) T²" in text
    assert "What is missing, before it is named" in text
    assert "temperature (81 %)" in text
    assert "Power missing" in text
    assert "Missing in the temperature reading" in text
    assert (tmp_path / "figures" / "missing.png").stat().st_size > 10_000
    lines = (tmp_path / "missing.csv").read_text().splitlines()
    assert lines[0] == "place,unit,recording,time_s,mean,std"
    assert len(lines) == 1 + 2 * 2 * 30  # places, recordings, times
    assert lines[31].split(",")[:3] == ["heat", "W", "multi/level"]
    assert [float(v) for v in lines[32].split(",")[3:]] == pytest.approx([20 / 29, 10 / 29, 0.2], rel=1e-5)
    j = json.loads((tmp_path / "diagnosis.json").read_text())
    assert j["closure"]["expression"] == learned.expression
    assert [m["place"] for m in j["missing"]] == ["heat", "temperature reading"]
    assert j["missing"][0]["depends_on"][0] == {"variable": "temperature", "strength": 0.81}


def test_an_adequate_model_shows_no_missing_input(tmp_path):
    write_diagnosis(diagnosis(missing=(latent(),)), tmp_path, recordings=recordings())
    assert (tmp_path / "missing.csv").exists()  # of an earlier one, into the same folder
    made = diagnosis(verdict="adequate", mechanisms=(), missing=(latent(),))
    _, text = read(write_diagnosis(made, tmp_path, recordings=recordings()))
    assert "before it is named" not in text
    assert not (tmp_path / "figures" / "missing.png").exists()
    assert not (tmp_path / "missing.csv").exists()


def test_the_first_round_tells_its_probabilities_too(tmp_path):
    _, text = read(write_diagnosis(diagnosis(), tmp_path))
    tried = text[text.index("What was tried") : text.index("What these recordings cannot tell apart")]
    rows = tried.split("Probability ")[-1]
    assert rows.startswith("1 Resistance rises with temperature")
    assert rows.index("98 %") < rows.index("1 Heat loss grows faster") < rows.index(" 2 % 1 ") < rows.index(" 2 Creep")


@pytest.mark.parametrize("apart", [False, True])
def test_what_is_not_told_apart_says_what_would_show_it(tmp_path, apart):
    """By what shows each, and by which command, where there is no experiment yet and anything to tell apart."""
    named = diagnosis().mechanisms[0]
    made = diagnosis(mechanisms=(named if apart else replace(named, equivalents=(), as_well=()),))
    _, text = read(write_diagnosis(made, tmp_path))
    shows = 'What shows that "heat loss grows faster than the temperature": cooling curves and steady states at several'
    assert (shows in text) is apart
    assert ("The same command with --next designs the experiment" in text) is apart


def test_of_the_laws_of_a_mechanism_the_one_found_stands_out_and_every_balance_is_told(tmp_path):
    lag = catalogue()["sensor_lag"]
    named = diagnosis().mechanisms[0]
    late = replace(named, name=lag.name, subsystem=lag.subsystem, law="in part", equation=lag.equation)
    path = write_diagnosis(diagnosis(mechanisms=(named, late)), tmp_path)
    lines = path.read_text(encoding="utf-8").split('<div class="equation">tau')[1].split("</div>")[0].split("<br>")
    assert len(lines) == len(lag.laws)
    assert [line for line in lines if "strong" in line] == [
        "<strong>law in part: the reading is (1 - s) T + s y</strong>"
    ]
    _, text = read(path)
    assert "what is lost; and in the sensor: between" in text
