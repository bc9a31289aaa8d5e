"""A fit and a fleet of fits become one page each, and JSON and CSV beside it."""

import json
from dataclasses import replace

from made_pages import MASS, diagnosis, read, recordings

from scpjax.fit.fleet import Fleet
from scpjax.fit.result import Fit
from scpjax.report.report import write_fit, write_fleet


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
