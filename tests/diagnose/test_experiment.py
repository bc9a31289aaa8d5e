"""The next experiment separates what the present recordings cannot, by what it says, and within its limits."""

import sys
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest

from scpjax.diagnose import rivals as module
from scpjax.diagnose.experiment import propose
from scpjax.diagnose.heat import allowed
from scpjax.diagnose.profiles import Limits, frame
from scpjax.diagnose.result import Ranked
from scpjax.diagnose.rivals import Outcome, next_experiment, rivals
from scpjax.diagnose.separation import Scene, noise_weights, rival, separate, slope
from scpjax.errors import FitError
from scpjax.fit.fit import final_model
from scpjax.recordings import read_recording
from scpjax.report.experiment import name_of

sys.path.insert(0, str(Path(__file__).parent))
import creeping

NAMES = ("creep", "two_node_thermal")
TOLD = Limits(lowest=0.0, highest=5.0, hottest=273.15 + 75.0, duration=60.0, slew=2.0)


@pytest.fixture(scope="module")
def known():
    """(hypotheses fitted to all of the slow recording, its parts)."""
    states, parts = creeping.fitted([creeping.slow()], NAMES)
    return {n: creeping.again(s, [creeping.slow()]) if n in NAMES else s for n, s in states.items()}, parts


@pytest.fixture(scope="module")
def proposed(known):
    """Experiments within the limits of the recording, and within others."""
    states, parts = known
    pair = [states[n] for n in NAMES]
    return {
        "as recorded": propose(pair, parts.whole, labels=NAMES, limits=Limits(duration=60.0)),
        "told": propose(pair, parts.whole, labels=NAMES, limits=TOLD),
    }


def scene(known, nodes=200, step=0.4):
    states, parts = known
    weights = noise_weights(states["creep"], parts.whole)
    return Scene(tuple(rival(states[n], parts.whole, weights, n) for n in NAMES), weights, step), np.full(nodes, 0.5)


def test_the_slow_recording_hardly_tells_them_apart(known, proposed):
    states, _ = known
    apart = abs(states["creep"].cost - states["two_node_thermal"].cost) / 2
    assert apart < 10.0  # nats, a tenth of what the experiment brings
    assert proposed["as recorded"].expected_bits > 10 * apart / np.log(2)


def test_gradient_is_that_of_finite_differences(known):
    where, drive = scene(known)
    rng = np.random.default_rng(0)
    drive = (drive + np.repeat(rng.uniform(0, 3, 20), 10))[:, None]
    by_hot = [rng.standard_normal((200, 1)) * 1e-4 for _ in NAMES]

    def value(u):
        s = separate(where, u, steps=200, tolerance=1e-13)
        return np.log(s.smooth[0]) + sum(float(np.sum(b * h)) for b, h in zip(by_hot, s.hot, strict=True))

    g = slope(where, separate(where, drive, steps=200, tolerance=1e-13), by_hot)
    for _ in range(3):
        d = np.repeat(rng.standard_normal(20), 10)[:, None]
        by_hand = (value(drive + 1e-3 * d) - value(drive - 1e-3 * d)) / 2e-3
        assert float(np.sum(g * d)) == pytest.approx(by_hand, rel=2e-3, abs=1e-5)


def test_slew_is_differentiated_too():
    f = frame(TOLD, [creeping.slow()], [creeping.slow().input_channels[0]])
    rng = np.random.default_rng(1)
    nodes, by, d = (rng.uniform(0.3, 4.5, (f.n, 1)) for _ in range(3))
    by_hand = np.sum(by * (f.played(nodes + 1e-6 * d) - f.played(nodes - 1e-6 * d))) / 2e-6
    assert np.sum(f.played_slope(nodes, by) * d) == pytest.approx(by_hand, rel=1e-5)


@pytest.mark.parametrize("true", NAMES)
def test_expected_bits_are_those_that_are_obtained(known, proposed, true):
    """Over noise seeds: the truth simulated by adaptive steps, both hypotheses fitted to both recordings."""
    states, _ = known
    e = proposed["as recorded"]
    (other,) = set(NAMES) - {true}
    clean, _ = creeping.played(final_model(states[true].setup, states[true].trial), e.time, e.drive[:, 0])
    gains = []
    for seed in range(6):
        recordings = [creeping.slow(), creeping.noisy(e.time, e.drive[:, 0], clean, 300 + seed, "new")]
        more = {n: creeping.again(states[n], recordings).cost for n in NAMES}
        before = states[other].cost - states[true].cost
        gains.append((more[other] - more[true] - before) / 2 / np.log(2))
    mean, error = float(np.mean(gains)), float(np.std(gains, ddof=1) / np.sqrt(len(gains)))
    assert abs(mean - e.pair_bits[true, other]) < 3 * error
    assert error < 0.15 * mean


def test_the_experiment_tells_the_truth_from_its_rival(proposed):
    """As --then does: all recordings together, everything estimated anew."""
    e = proposed["as recorded"]
    clean, _ = creeping.played(creeping.truth(), e.time, e.drive[:, 0])
    new = creeping.noisy(e.time, e.drive[:, 0], clean, 7, "new")
    states, _ = creeping.fitted([creeping.slow(), new], NAMES)
    assert (states["two_node_thermal"].cost - states["creep"].cost) / 2 > 0.5 * e.expected_bits * np.log(2)
    model = final_model(states["creep"].setup, states["creep"].trial)
    assert model.values()["creep.compliance"] == pytest.approx(0.25, abs=0.08)
    assert model.values()["creep.time_constant"] == pytest.approx(6.0, rel=0.3)


@pytest.mark.parametrize("which", ["as recorded", "told"])
def test_it_beats_the_standard_excitations_and_a_repetition(proposed, which):
    e = proposed[which]
    assert e.expected_bits > 1.02 * e.standard_bits
    assert e.expected_bits > 2 * e.repeat_bits
    assert e.expected_bits == min(e.pair_bits.values())


def test_no_limit_is_broken(known, proposed):
    """By simulations with adaptive steps, of the hypotheses and of the truth."""
    states, _ = known
    recorded = creeping.slow().inputs
    for e, low, high in ((proposed["as recorded"], recorded.min(), recorded.max()), (proposed["told"], 0.0, 5.0)):
        assert e.drive.min() >= low - 1e-9
        assert e.drive.max() <= high + 1e-9
        assert e.time[-1] <= 60.0 + 1e-9
        for name in NAMES:
            model = final_model(states[name].setup, states[name].trial)
            hot = creeping.played(model, e.time, e.drive[:, 0])[1].max()
            assert hot <= e.hottest_allowed[name] + 0.02
            assert hot == pytest.approx(e.hottest[name], abs=0.1)
    told = proposed["told"]
    assert np.abs(np.diff(told.drive[:, 0], prepend=0.0)).max() <= 2.0 * 0.4 + 1e-9
    assert creeping.played(creeping.truth(), told.time, told.drive[:, 0])[1].max() <= TOLD.hottest
    assert all(h == TOLD.hottest for h in told.hottest_allowed.values())


def test_the_file_is_read_back(proposed, tmp_path):
    e = proposed["told"]
    (tmp_path / "next.csv").write_text(e.csv())
    back = read_recording(tmp_path / "next.csv", require_outputs=False)
    np.testing.assert_allclose(back.time, e.time, atol=1e-9)
    np.testing.assert_allclose(back.input("voltage"), e.drive[:, 0], atol=1e-9)
    said = e.to_json()
    assert said["separates"] == list(NAMES)
    assert said["expected_bits"] == e.expected_bits
    assert said["voltage_csv"] == "next_experiment.csv"


def test_nothing_is_proposed_where_nothing_can_be_told(known):
    """The same hypothesis twice; and no rival at all."""
    states, parts = known
    twice = [states["creep"], states["creep"]]
    assert propose(twice, parts.whole, labels=("a", "b"), limits=Limits(duration=30.0)) is None
    alone = Outcome(states["base model"], states["creep"], None, (Ranked("creep", 900.0, 0.5, 1.0),), {})
    assert next_experiment(alone, parts) is None


def test_who_is_a_rival(known):
    states, parts = known
    base, creep, node = (states[n] for n in ("base model", *NAMES))
    ranking = (Ranked("creep", 100.0, 0.5, 0.9), Ranked("two_node_thermal", 90.0, 0.5, 0.1))
    found = rivals(Outcome(base, creep, None, ranking, {}), parts)
    assert list(found)[:2] == list(NAMES)
    assert all(k.startswith("two_node_thermal (") for k in list(found)[2:]), "further laws of the rival"
    assert len({tuple(s.laws.items()) for s in found.values()}) == len(found)
    assert found["two_node_thermal"].names == ("two_node_thermal",)
    assert list(rivals(Outcome(base, creep, None, ranking, {}), parts, only_equivalents=True)) == ["creep"]
    far = (ranking[0], replace(ranking[1], delta_bic=60.0))
    assert list(rivals(Outcome(base, creep, None, far, {}), parts)) == ["creep"]
    same = Outcome(base, creep, None, far, {"creep": ("two_node_thermal",)})
    assert list(rivals(same, parts, only_equivalents=True))[:2] == list(NAMES)
    closure = rivals(Outcome(base, node, creep, ranking, {}), parts)  # any state may stand for the closure here
    assert list(closure) == ["closure", "two_node_thermal"]
    assert list(rivals(Outcome(base, base, None, (Ranked("creep", 3.0, 0.0, 0.1),), {}), parts)) == ["base model"]


def test_of_several_names_each_has_its_rival(monkeypatch):
    """The first equivalent of each, of two at most; of one alone as ever, wherever among the names it stands."""
    swaps: list[tuple[str, str]] = []

    def swap(state, out, name, split):
        swaps.append((out, name))
        return {name: (out, name), f"{name} (other law)": None}

    monkeypatch.setattr(module, "swapped", swap)
    chosen = SimpleNamespace(names=("a", "b", "c"))
    several = {"a": ("x", "y"), "b": (), "c": ("x", "a"), "d": ("y",)}
    told = lambda equivalents: rivals(Outcome(None, chosen, None, (), equivalents), None)  # type: ignore[arg-type]  # noqa: E731
    assert told(several) == {"a": chosen, "x": ("a", "x"), "x (for c)": ("c", "x")}
    assert swaps == [("a", "x"), ("c", "x")]
    monkeypatch.setattr(module, "_merged", lambda found: dict(next(iter(each.items())) for each in found))
    assert told({"c": ("x", "y")}) == {"c": chosen, "x": ("c", "x"), "y": ("c", "y")}
    assert name_of("creep (for hysteresis)") == "Creep (for hysteresis)"


def test_limits_that_leave_nothing_are_named(known):
    states, parts = known
    pair = [states[n] for n in NAMES]
    for limits, words in (
        (Limits(highest=0.2), "leaves nothing to choose"),
        (Limits(duration=5.0), "too short"),
        (Limits(hottest=280.0), "below ambient"),
        (Limits(slew=-1.0), "slew"),
    ):
        with pytest.raises(FitError, match=words):
            propose(pair, parts.whole, labels=NAMES, limits=limits)
    blind = [
        replace(s, setup=replace(s.setup, recordings=(creeping.slow().select_outputs("displacement"),))) for s in pair
    ]
    with pytest.raises(FitError, match="thermometer"):
        allowed(blind, parts.whole, 350.0)
