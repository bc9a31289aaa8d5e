"""The proof's judge: scoring of made-up diagnoses, goals, and the page."""

import math
from dataclasses import replace

import numpy as np
import pytest
from judged import said, truth

from fits.concealed.page import write_page
from fits.concealed.score import score
from fits.concealed.tally import Goal, by_method, calibration, confusion, goals


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


@pytest.mark.parametrize(
    ("hits", "of", "asked", "at_most", "told"),
    [
        (132, 139, 0.95, False, "94.96%"),
        (133, 139, 0.95, False, "96%"),
        (19, 20, 0.95, False, "95%"),
        (1, 49, 0.02, True, "2.04%"),
        (1, 50, 0.02, True, "2%"),
        (0, 68, 0.02, True, "0%"),
    ],
)
def test_a_share_is_told_so_that_its_side_of_the_goal_is_seen(hits, of, asked, at_most, told):
    assert Goal("", hits, of, asked, at_most).told == told


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
        replace(score(truth("slack", name="b"), said("friction")), commit="abc"),
        score(truth(sort="null", name="c", tier="none"), said()),
        score(truth("coil", sort="outside", catalogue=False, name="d"), said(verdict="unexplained")),
    ]
    scores[0] = replace(scores[0], commit="abc", first=True)
    scores[2] = replace(scores[2], commit="older", first=True)
    effects, words, counts = confusion(scores)
    assert (effects, counts.sum()) == (["slack", "creep", "nothing", "coil"], 4)  # in the order of the catalogue
    assert counts[effects.index("slack"), words.index("friction")] == 1
    assert len(set(words)) == len(words)
    assert counts[effects.index("nothing"), words.index("nothing")] == 1
    assert counts[effects.index("coil"), words.index("something unnamed")] == 1
    others, asked = {"narx": {"a": 1.5, "b": math.inf}}, ["--unseen --cases 60", "--sort outside"]
    page = write_page(tmp_path, scores, others, commit="older, abc", of=515, asked=asked)
    text = page.read_text()
    assert "4 of the plan's 515 cases" in text
    assert "run.py --unseen --cases 60`\n- `python fits/concealed/run.py --sort outside`\n" in text
    assert "older, abc" in text
    for name in ("confusion", "kept", "calibration"):
        assert f"concealed/{name}.svg" in text
        assert (tmp_path / "concealed" / f"{name}.svg").stat().st_size > 1000
    assert "| `b` | single-slack | 5.0 | misnamed | friction |" in text
    assert "| `a` | single-creep | explained | creep | 2.00 |" in text
    assert "1 of 2, 50% (9% to 91%) | 1 of 1 |" in text
    assert "| 0 of 1, 0% (0% to 79%) | 0 of 1 |" in text
    assert "Of 2 cases it is noted that the engine was asked them for the first time (older, abc)" in text
    assert "| explained | 1 | 2 |" in text
    was = replace(scores[1], outcome="right", first=True)
    then = write_page(tmp_path, scores, others, commit="older, abc", of=515, asked=asked, first=[was]).read_text()
    assert "Of 3 cases it is noted" in then
    assert "1 of them were asked again since" in then
    assert "1 of 2, 50% (9% to 91%) | 2 of 2 |" in then, "misnamed when asked again: what was said first was right"
    assert "diverged" in text
    methods, common = by_method(scores, others | {"pysindy": {"b": 2.0}})
    assert methods["base model"] == {}
    assert common == {"b"}, "a method without any is none"
    judged = [replace(s, kept_base=5.0) for s in scores]
    methods, common = by_method(judged, others | {"pysindy": {"b": 2.0, "a": math.nan}})
    assert common == {"b"}
    assert methods["pysindy"] == {"b": 2.0}
    text = write_page(tmp_path, judged, others, commit="older, abc", of=515, asked=asked).read_text()
    assert "| single | scpjax | 2 |" in text
    assert "| null | base model | 1 |" in text
    assert "null, given to all" not in text
    text = write_page(tmp_path, judged, {"narx": {"a": 1.5}}, commit="older, abc", of=515, asked=asked).read_text()
    assert "| single, given to all | scpjax | 1 |" in text
    assert "| single, given to all | narx | 1 | 1.50 |" in text


def test_laws_that_are_the_librarys_do_not_count_as_foreign():
    named = score(truth("fatigue", sort="foreign"), said("fatigue"))
    of = lambda *labels: next(  # noqa: E731
        g.of for g in goals([replace(named, label=f"foreign-{x}-strong-full") for x in labels]) if "foreign" in g.title
    )
    assert of("fatigue:Arrhenius", "fatigue:wear", "creep:Arrhenius") == 2
