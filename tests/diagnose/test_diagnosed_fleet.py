"""What a fleet of diagnoses says: effects, spreads and outliers of made ones, against numbers worked out apart."""

import csv
import json

import numpy as np
import pytest
from scipy import stats

from scpjax.diagnose.fleet import Member, effects, not_compared, outliers, spreads, summary
from scpjax.report.fleet import write_fleet_diagnosis


def member(name: str, stiffness: float, std: float = 2.0, **named: float) -> Member:
    """A diagnosis with one base parameter and some effects, each with a parameter of size 0.3."""
    e = lambda v, s, u: {"value": v, "std": s, "unit": u, "low": v - 2 * s, "high": v + 2 * s, "at_limit": False}  # noqa: E731
    content = {
        "verdict": "explained" if named else "adequate",
        "says": "",
        "mechanisms": [
            {
                "name": k,
                "law": "",
                "probability": p,
                "equivalents": ["hysteresis"],
                "parameters": {"size": e(0.3, 0.01, "1")},
            }
            for k, p in named.items()
        ],
        "parameters": {"elastic_spring.stiffness": e(stiffness, std, "N/m")},
    }
    return Member(name, content)


FLEET = [
    *(member(n, 100.0 + d, creep=0.99) for n, d in zip("abcdef", (-1.5, 0.2, 1.1, -0.4, 0.9, -0.1), strict=True)),
    member("odd", 160.0, friction=0.8),
    Member("lost", None, "lost.csv: no columns"),
]


def test_effects_are_counted():
    assert effects(FLEET) == {"creep": tuple("abcdef"), "friction": ("odd",)}
    says = summary(FLEET, spreads(FLEET))
    assert says[0] == "7 of 8 actuators were diagnosed: 7 explained."
    assert says[1] == "Left out of the base model: creep in 6, friction in 1."
    assert "elastic_spring.stiffness" in says[2]
    assert says[2].startswith("Different")
    assert says[3] == "The same in all to within the errors: creep.size."


def test_cochran_tells_scatter_from_error():
    same = spreads(FLEET[:6])
    k = next(s for s in same if s.key == "elastic_spring.stiffness")
    x = np.log([98.5, 100.2, 101.1, 99.6, 100.9, 99.9])
    w = (np.exp(x) / 2.0) ** 2
    q = np.sum(w * (x - np.sum(w * x) / w.sum()) ** 2)
    assert k.logarithmic
    assert k.differs == pytest.approx(stats.chi2.sf(q, 5))
    assert k.relative == 0.0
    wide = [member(str(i), v, std=0.1) for i, v in enumerate((80.0, 90.0, 100.0, 110.0, 125.0))]
    (s,) = spreads(wide)
    assert s.differs < 1e-6
    assert s.relative == pytest.approx(np.std(np.log([80, 90, 100, 110, 125]), ddof=1), rel=0.02)
    x = np.log([80, 90, 100, 110, 125])  # errors that are nothing beside the scatter: the mean of five, by Student
    reach = stats.t.ppf(0.975, 4) * np.std(x, ddof=1) / np.sqrt(5)
    assert s.mean == pytest.approx(np.exp([x.mean(), x.mean() - reach, x.mean() + reach]), rel=1e-3)


@pytest.mark.parametrize("scatter", [0.0, 0.02, 0.1])
def test_the_mean_of_a_fleet_is_in_its_interval_as_often_as_that_says(scatter):
    """300 fleets of six actuators with stiffnesses about 100 N/m; some known three times as well as others."""
    rng = np.random.default_rng(7)
    errors = np.array([0.01, 0.01, 0.02, 0.02, 0.03, 0.03])
    inside, wide = 0, []
    for _ in range(300):
        at = 100.0 * np.exp(scatter * rng.standard_normal(6) + errors * rng.standard_normal(6))
        (s,) = spreads([member(str(i), v, std=v * e) for i, (v, e) in enumerate(zip(at, errors, strict=True))])
        value, low, high = s.mean
        assert low < value < high
        inside += low <= 100.0 <= high
        wide.append(np.log(high / low) / 2)
    assert 0.92 <= inside / 300 <= (1.0 if scatter == 0.0 else 0.985)
    best = np.sqrt(1 / np.sum(1 / (errors**2 + scatter**2)))  # of the mean, were the scatter known
    assert 1.5 < np.median(wide) / best < 4.0


def test_an_estimate_at_its_limit_has_no_error():
    a, b = member("a", 100.0), member("b", 200.0)
    b.content["parameters"]["elastic_spring.stiffness"]["at_limit"] = True
    (s,) = spreads([a, b])
    assert s.differs == 1.0
    assert np.isinf(s.std[1])
    assert np.isnan(s.mean).all()  # of one value


def test_what_is_not_like_the_others_is_told():
    found = outliers(FLEET, spreads(FLEET))
    assert found[0].name == "odd"
    assert found[0].score > 3.5
    assert "elastic_spring.stiffness = 160 N/m is far above the others' 100.2 N/m" in found[0].says
    assert {o.says for o in found[1:]} == {
        "friction was named here and in none of the others",
        "creep was not named here, but in 6 of 7",
    }
    assert all(o.name == "odd" for o in found)
    assert not outliers(FLEET[:4], spreads(FLEET[:4])), "four are too few"
    assert not outliers(FLEET[:6], spreads(FLEET[:6]))


def stated(name: str, mechanism: str, law: str, values: dict[str, float], **references: float) -> Member:
    """A diagnosis that names one mechanism, with parameters to 1 %, stated for references in metres or kelvin."""
    m = member(name, 100.0, **{mechanism: 0.99})

    def estimate(v: float) -> dict:
        return {"value": v, "std": 0.01 * v, "unit": "1", "low": 0.98 * v, "high": 1.02 * v, "at_limit": False}

    told = {k: {"value": v, "unit": "m" if k == "reference" else "K"} for k, v in references.items()}
    own = {"law": law, "parameters": {k: estimate(v) for k, v in values.items()}, "references": told}
    m.content["mechanisms"][0].update(own)
    scores = {"model": "plant", "train": {}, "held_out": {}, "noise": {}}
    m.content.update(base=scores, extended=scores, seconds=1.0)
    return m


def only(members: list[Member]) -> dict:
    return {s.key: s for s in spreads(members) if not s.key.startswith("elastic_spring")}


def test_what_is_stated_for_other_references_is_restated_or_left_out():
    """One spring, F = -k x (1 + 3e3 x^2), and one loss, each stated at the travel and warmth that was seen."""
    at = {"a": 0.01, "b": 0.02, "c": 0.04}
    springs = [
        stated(n, "nonlinear_stiffness", "polynomial", {"cubic": 3e3 * x**2}, reference=x) for n, x in at.items()
    ]
    found = only(springs)["nonlinear_stiffness.cubic"]
    np.testing.assert_allclose(found.values, 3e3 * 0.02**2)
    assert found.references == {"reference": {"value": 0.02, "unit": "m"}}
    assert found.differs == pytest.approx(1.0)
    assert found.estimates["c"]["low"] == pytest.approx(0.98 * 3e3 * 0.02**2)
    hot = {"a": 40.0, "b": 60.0, "c": 80.0}
    values = {n: {"strength": 0.5 * t**0.4, "exponent": 0.4} for n, t in hot.items()}
    losses = [stated(n, "nonlinear_heat_loss", "power", values[n], reference=t) for n, t in hot.items()]
    assert set(only(losses)) == {"nonlinear_heat_loss.exponent"}
    assert not_compared(losses) == ("nonlinear_heat_loss.strength",)
    assert summary(losses, spreads(losses))[-1] == (
        "Not compared, for each actuator states them for references or at places of its own: "
        "nonlinear_heat_loss.strength."
    )
    same = [stated(n, "nonlinear_heat_loss", "power", values["a"], reference=40.0) for n in "abc"]
    assert set(only(same)) == {"nonlinear_heat_loss.strength", "nonlinear_heat_loss.exponent"}
    assert not not_compared(same)


def test_only_parameters_of_the_same_law_and_unit_are_pooled():
    """A growth of 0.5 is a slope under one law and an exponent under the other; a free form has no such number."""
    slopes = [stated(n, "nonlinear_thermal_force", "quadratic", {"growth": 0.5}, reference=50.0) for n in "abcde"]
    powers = [stated(n, "nonlinear_thermal_force", "power", {"growth": 0.1}, reference=50.0) for n in "fg"]
    curves = [stated(n, "nonlinear_thermal_force", "free form", {"s1": 0.1, "s2": 0.2}) for n in "hi"]
    fleet = [*slopes, *powers, *curves]
    found = only(fleet)
    assert {k: s.names for k, s in found.items()} == {
        "nonlinear_thermal_force.growth (quadratic)": tuple("abcde"),
        "nonlinear_thermal_force.growth (power)": tuple("fg"),
    }
    assert all(s.differs > 0.9 for s in found.values())
    assert not_compared(fleet) == ("nonlinear_thermal_force (free form)",)
    assert not outliers(fleet, spreads(fleet))
    amps = stated("amps", "slack", "pull", {"corner": 0.1})
    amps.content["mechanisms"][0]["parameters"]["corner"]["unit"] = "A"
    assert not only([amps, stated("volts", "slack", "pull", {"corner": 0.1})])


def test_an_outlier_is_one_at_the_same_reference():
    at = dict(zip("abcdef", (0.01, 0.02, 0.04, 0.01, 0.02, 0.04), strict=True))
    gaps = [stated(n, "slack", "tendon", {"gap": (1 + 2 * (n == "f")) * 0.001 / x}, reference=x) for n, x in at.items()]
    (odd,) = outliers(gaps, spreads(gaps))
    assert odd.name == "f"
    assert odd.says.startswith("slack.gap = 0.15 1 is far above the others' 0.05 1, stated for reference 0.02 m (")


def test_law_and_references_are_in_the_table_and_on_the_page(tmp_path):
    fleet = [stated(n, "slack", "tendon", {"gap": 0.1}, reference=x) for n, x in (("a", 0.01), ("b", 0.02))]
    fleet += [stated(n, "slack", "free form", {"s1": 0.1}) for n in "cd"]
    fleet.append(Member("lost", None, "lost.csv: no columns"))
    write_fleet_diagnosis(fleet, spreads(fleet), (), tmp_path)
    head, *rows = csv.reader((tmp_path / "fleet.csv").read_text().splitlines())
    assert head[-3:] == ["message", "slack.law", "slack.reference"], "what was there before stays where it was"
    told = {row[0]: dict(zip(head, row, strict=True)) for row in rows}
    assert (told["b"]["slack.law"], told["b"]["slack.reference"], told["b"]["slack.gap"]) == ("tendon", "0.02", "0.1")
    assert (told["c"]["slack.law"], told["c"]["slack.reference"], told["lost"]["slack.law"]) == ("free form", "", "")
    content = json.loads((tmp_path / "fleet.json").read_text())
    assert content["spread"]["slack.gap"]["law"] == "tendon"
    assert content["spread"]["slack.gap"]["references"] == {"reference": {"value": 0.015, "unit": "m"}}
    assert content["not_compared"] == ["slack (free form)"]
    assert content["says"][-1].endswith("places of its own: slack (free form).")
    page = (tmp_path / "report.html").read_text()
    assert "places of its own: slack (free form)." in page
    assert "Stated for the same in all: slack.gap (reference 0.015 m)." in page


def named(name: str, effect: str, *equivalents: str) -> Member:
    m = member(name, 100.0, **{effect: 0.99})
    m.content["mechanisms"][0]["equivalents"] = list(equivalents)
    return m


def test_a_name_that_the_recordings_leave_open_makes_no_outlier():
    """Where "this or that" was found, it is chance which of both is the name."""
    sure, open_ = [named(n, "creep") for n in "abcde"], [named(n, "creep", "friction") for n in "abcde"]
    says = lambda fleet: {o.says for o in outliers(fleet, spreads(fleet))}  # noqa: E731
    alone, lacks = "friction was named here and in none of the others", "creep was not named here, but in 5 of 6"
    assert says([*sure, named("f", "friction")]) == {alone, lacks}
    assert says([*open_, named("f", "friction")]) == set(), "friction is left open in all others"
    assert says([*sure, named("f", "friction", "creep")]) == set(), "creep is left open here"
    assert says([*sure[:-1], open_[-1], named("f", "friction")]) == {lacks}, "left open in one, not in four"
