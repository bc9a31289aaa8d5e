"""The law of drawn nylon: plays, curves and what differs, found again in recordings made with them."""

import numpy as np
import pytest

from fits.nylon.law import Sample, at, compare, fit, play, shared, strain
from fits.nylon.run import common_lines, law_lines, shared_lines

CYCLE = np.concatenate([np.linspace(25.0, 85.0, 61), np.linspace(84.0, 26.0, 50)])


def made(name: str, growth: float, loop: float, seed: int = 0, kind: str = "strain") -> Sample:
    rng = np.random.default_rng(seed)
    clean = strain(np.array([0.0, 1e-3, growth, 45.0, 10.0, loop]), CYCLE, "bend", kind)
    return Sample(name, CYCLE, clean + 1e-3 * rng.standard_normal(len(CYCLE)))


def test_a_play_follows_only_what_leaves_its_width():
    x = np.array([0.0, 1.0, 3.0, 2.5, 1.5, 0.0, 5.0])
    assert play(x, 1.0).tolist() == [0.0, 0.0, 2.0, 2.0, 2.0, 1.0, 4.0]
    assert play(x, 0.0).tolist() == x.tolist()


def test_the_loop_is_told_by_its_law():
    best = compare(made("made", 0.003, 4.0, kind="temperature"))[0]
    assert best.loop == "temperature"
    assert best.curve == "bend"
    assert best.values["loop"] == pytest.approx(4.0, abs=4 * best.std["loop"])
    assert best.values["growth"] == pytest.approx(0.003, abs=4 * best.std["growth"])
    assert best.rmse < 1.2e-3
    assert best.left_out < 2e-3
    other = made("other", 0.003, 0.02)
    assert fit(other, "bend", "strain", n=50).bic < fit(other, "bend", "temperature", n=50).bic - 50


def test_only_what_differs_is_said_to_differ():
    samples = [made("one", 0.003, 0.02, 1), made("two", 0.006, 0.02, 2)]
    choices = shared(samples, "bend", "strain")
    assert choices[0].differ == ("growth",)
    nothing = next(c for c in choices if not c.differ)
    assert nothing.delta_bic > choices[0].delta_bic + 50
    assert next(c.delta_bic for c in choices if len(c.differ) == 4) == 0.0


def test_the_page_says_it_in_lines():
    samples = [made("one", 0.003, 0.02, 1), made("two", 0.006, 0.02, 2)]
    found = [fit(s, "bend", "strain") for s in samples]
    (line,) = law_lines(samples[0], found[:1])
    assert line.startswith("| one | bend, loop strain |")
    assert f"growth {found[0].values['growth']:.3g} ±" in line
    up, down = at(samples[1], 60.0)
    assert down - up == pytest.approx(0.04, abs=5e-3)
    assert f"{up:.3f} / {down:.3f}" in "\n".join(common_lines(samples, found))
    text = "\n".join(shared_lines("both", shared(samples, "bend", "strain")))
    assert "growth the same for all costs" in text
