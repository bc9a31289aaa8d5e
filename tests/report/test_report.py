"""A diagnosis made by hand becomes one page that needs nothing else, and JSON in the form of the contract."""

import json
import math
import re
from dataclasses import replace
from html.parser import HTMLParser

import numpy as np
import pytest

from scpjax.diagnose.result import Closure, Diagnosis, Latent, Location, Named, Ranked, Scores, Window
from scpjax.fit.fleet import Fleet
from scpjax.fit.result import Estimate, Fit, Trace
from scpjax.physics import presets
from scpjax.physics.storage import load_model
from scpjax.recordings.recording import Recording
from scpjax.report.numbers import estimate, interval, number, percent, plus_minus
from scpjax.report.plot import envelope
from scpjax.report.report import command_line, write_diagnosis, write_fit, write_fleet

COLUMNS = ("temperature_degC", "displacement_mm")


def trace(name: str, column: str, n: int = 200) -> Trace:
    t = np.linspace(0, 20, n)
    y = 20 + 30 * (1 - np.exp(-t / 5))
    held = (t > 5) & (t < 8)
    drive = np.where(t > 1, 3.0, 0.0)[:, None]
    weights = np.where(np.arange(n) % 50 == 3, 0.0, 1.0)
    return Trace(name, column, t, drive, ("voltage_V",), y + 0.1, weights, y + 1, y, held)


def scores(model: str, size: float) -> Scores:
    values = {c: {"rmse": size, "nrmse": 100 - size, "mae": 0.8 * size} for c in COLUMNS}
    return Scores(model, values, values, dict.fromkeys(COLUMNS, 0.1))


MASS = Estimate(0.0872, 0.0012, "kg", 0.0848, 0.0896, "moving mass", "m")
GAIN = Estimate(3.93e-3, 4e-5, "1/K", 3.85e-3, 4.01e-3, "temperature coefficient of resistance", "alpha")
STIFF = Estimate(289.0, 1148.0, "N/m", 0.119, 7e5, "stiffness of the coil", "k")


def diagnosis(**changes) -> Diagnosis:
    base = presets.plant(
        resistance=1.0,
        conductance=0.3,
        thermal_mass=2.0,
        coefficient=0.01,
        stiffness=100.0,
        damping=0.5,
        mass=0.1,
    )
    copper = Named(
        "resistance_temperature",
        "Resistance rises with temperature",
        "thermoelectric",
        "voltage",
        0.98,
        {"coefficient": GAIN},
        ("nonlinear_heat_loss",),
        "The hot wire has a higher resistance, so <the same> voltage heats it less.",
        "P = P_0 / (1 + alpha T)",
        "thesis (3.13)",
    )
    made = Diagnosis(
        verdict="explained",
        says="Left out of the base model: resistance rises with temperature.",
        base=scores("plant", 1.25),
        extended=scores("plant + resistance_temperature", 0.11),
        location=Location(
            "thermoelectric",
            "temperature_degC",
            (Window("step", 5.0, 7.5, 0.4), Window("step", 10.0, 12.0, 0.2)),
            {"heating": 0.7, "cooling": 0.3},
            (("temperature", 0.8), ("time", 0.1)),
        ),
        mechanisms=(copper,),
        ranking=(
            Ranked("resistance_temperature", 1234.5, 0.9, 0.98, "voltage"),
            Ranked("nonlinear_heat_loss", 1200.0, 0.85, 0.02),
            Ranked("creep", -12.0, math.nan, 0.0),
            Ranked("creep", -9.0, 0.0, 0.0, round=2),
        ),
        base_parameters={"inertia.mass": MASS, "elastic_spring.stiffness": STIFF},
        not_identifiable=("viscous_damping.damping is not determined by these recordings",),
        notes=("2 isolated wild samples were left out",),
        model=base,
        base_model=base,
        traces=tuple(trace(name, c) for name in ("step", "multi/level") for c in COLUMNS),
        seconds=12.3,
        settings={"files": ["step.csv"], "bin": 4, "evidence": {"bic": 10.0}},
    )
    return replace(made, **changes)


def recordings() -> list[Recording]:
    t = np.arange(20) * 0.1
    return [Recording.from_arrays(t, {"voltage_V": np.sin(t)}, dict.fromkeys(COLUMNS, 20 + np.cos(t)), hold="linear")]


class Page(HTMLParser):
    """Text, tags in balance, and every address that a browser would fetch."""

    def __init__(self, html: str):
        super().__init__()
        self.text, self.fetched, self.open = [], [], []
        self.feed(html)

    def handle_starttag(self, tag, attrs):
        if tag not in ("meta", "img", "br", "link"):
            self.open.append(tag)
        assert tag not in ("script", "iframe", "link")
        self.fetched += [v for k, v in attrs if k in ("src", "href", "srcset", "data", "poster")]

    def handle_endtag(self, tag):
        assert self.open.pop() == tag

    def handle_data(self, data):
        self.text.append(data)


def read(path) -> tuple[Page, str]:
    page = Page(path.read_text())
    assert page.open == []
    assert all(address.startswith("data:image/png;base64,") for address in page.fetched)
    assert not re.search(r"https?://|url\(|@import", path.read_text())
    return page, " ".join(" ".join(page.text).split())


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
    assert {"name", "subsystem", "probability", "parameters", "equivalents", "says"} <= set(named)
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
        location=Location("sensor", "displacement_mm"),
        not_identifiable=(),
        notes=(),
    )
    page, text = read(write_diagnosis(made, tmp_path))
    assert ("earned its parameters" in text) == (verdict == "adequate")
    assert ("not earned" in text) == (verdict == "unexplained")
    assert "Notes" not in text
    assert "every parameter is determined" in text
    assert len(page.fetched) == 2


def fitted(**changes) -> Fit:
    d = diagnosis()
    made = Fit(
        model=d.model,
        parameters={"inertia.mass": MASS},
        known=("elastic_spring.stiffness",),
        scores=d.extended.held_out,
        noise=d.base.noise,
        rank=1,
        n_free=1,
        not_identifiable=("a is open", "a is open"),
        converged=True,
        notes=(),
        traces=tuple(replace(t, base=t.extended) for t in d.traces[:2]),
        cost=1.0,
        n_data=10,
        seconds=1.0,
    )
    return replace(made, **changes)


def test_fit(tmp_path):
    _, text = read(write_fit(fitted(), tmp_path, recordings=recordings(), command="scpjax fit"))
    for words in (
        "down to their noise",
        "0.0872 ± 0.0012",
        "Held as known: elastic_spring.stiffness = 100.0 N/m",
    ):
        assert words in text
    assert text.count("A is open.") == 1
    content = json.loads((tmp_path / "fit.json").read_text())
    assert content["parameters"]["inertia.mass"]["value"] == 0.0872
    assert content["known"] == {"elastic_spring.stiffness": 100.0}
    _, text = read(write_fit(fitted(converged=False), tmp_path))
    assert "not converged" in text


def test_fleet(tmp_path):
    heavy = replace(MASS, value=0.2, low=0.19, high=0.21)
    fits = (fitted(), "b.csv: drive never changes; use a step", fitted(parameters={"inertia.mass": heavy}))
    _, text = read(write_fleet(Fleet(("a", "b", "c"), fits, 3.0), tmp_path))
    for words in ("2 of 3 actuators", "b: b.csv: drive never changes", "0.144", "0.200"):
        assert words in text
    rows = [line.split(",") for line in (tmp_path / "fleet.csv").read_text().splitlines()]
    assert rows[0][:4] == ["actuator", "status", "inertia.mass", "inertia.mass_std"]
    assert [r[:3] for r in rows[1:]] == [["a", "ok", "0.0872"], ["b", "failed", ""], ["c", "ok", "0.2"]]
    assert {len(r) for r in rows} == {len(rows[0])}
    assert json.loads((tmp_path / "fleet.json").read_text())["actuators"]["b"] == {"failure": fits[1]}


@pytest.mark.parametrize("n", [50, 200_000])
def test_a_long_signal_is_thinned_and_keeps_its_peaks(n):
    rng = np.random.default_rng(0)
    y = rng.normal(size=n)
    y[n // 3], y[n // 2] = 50.0, -70.0
    y[5:10] = np.nan
    t, thin = envelope(np.arange(n), y)
    assert len(thin) <= max(1500, min(n, 50))
    assert np.nanmax(thin) == 50.0
    assert np.nanmin(thin) == -70.0
    assert np.all(np.diff(t) >= 0)


def test_a_hole_in_a_long_signal_stays_a_hole():
    y = np.ones(100_000)
    y[40_000:60_000] = np.nan
    t, thin = envelope(np.arange(100_000), y)
    assert np.isnan(thin[(t > 40_500) & (t < 59_500)]).all()


@pytest.mark.parametrize(
    ("said", "words"),
    [
        (number(0.0), "0"),
        (number(0.012345), "0.0123"),
        (number(-12.345), "−12.3"),
        (number(999.9), "1000"),
        (number(4.5e-7), "4.50 × 10⁻⁷"),
        (number(math.nan), "–"),
        (plus_minus(4.2123, 0.1312), "4.21 ± 0.13"),
        (plus_minus(4.2e-7, 1.3e-8), "(4.20 ± 0.13) × 10⁻⁷"),
        (plus_minus(129.3, 48.2), "129 ± 48"),
        (plus_minus(2.0, math.nan), "2.000"),
        (estimate(289.0, 1148.0, 0.119, 7e5), "about 290"),
        (estimate(30.0, 2.0, 26.0, 34.0, True), "30.00, at its limit"),
        (estimate(-0.1, 0.2, -0.5, 0.3), "−0.10 ± 0.20"),
        (interval(3.85e-3, 4.01e-3), "0.00385 to 0.00401"),
        (interval(1.00001, 1.00002), "1.000010 to 1.000020"),
        (percent(1.0), "> 99 %"),
        (percent(0.001), "< 1 %"),
        (percent(0.0), "0 %"),
        (percent(0.5), "50 %"),
    ],
)
def test_numbers(said, words):
    assert said == words


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
    assert "heat lost = (0.0012 ± 0.0001) W/(K²) T²" in text
    assert "What is missing, before it is named" in text
    assert "temperature (81 %)" in text
    assert "Power missing" in text
    assert "Missing in the temperature reading" in text
    assert (tmp_path / "figures" / "missing.png").stat().st_size > 10_000
    j = json.loads((tmp_path / "diagnosis.json").read_text())
    assert j["closure"]["expression"] == learned.expression
    assert [m["place"] for m in j["missing"]] == ["heat", "temperature reading"]
    assert j["missing"][0]["depends_on"][0] == {"variable": "temperature", "strength": 0.81}


def test_an_adequate_model_shows_no_missing_input(tmp_path):
    made = diagnosis(verdict="adequate", mechanisms=(), missing=(latent(),))
    _, text = read(write_diagnosis(made, tmp_path, recordings=recordings()))
    assert "before it is named" not in text
    assert not (tmp_path / "figures" / "missing.png").exists()
