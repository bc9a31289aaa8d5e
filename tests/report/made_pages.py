"""A diagnosis made by hand, and a reader of pages."""

import math
import re
from dataclasses import replace
from html.parser import HTMLParser

import numpy as np

from scpjax.diagnose.result import Diagnosis, Location, Named, Ranked, Scores, Window
from scpjax.fit.result import Estimate, Trace
from scpjax.physics import presets
from scpjax.recordings.recording import Recording

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
        ("heat lost = T s(x)",),
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
