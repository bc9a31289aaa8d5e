"""What an experiment may not be: beyond what hypotheses can predict, too hot, or not of this drive; and how it counts
noise, steps, rooms and what differs by recording.
"""

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest

from scpjax.diagnose import experiment, heat
from scpjax.diagnose.experiment import check_limits, propose
from scpjax.diagnose.heat import limit
from scpjax.diagnose.holdout import split
from scpjax.diagnose.hypothesis import State, grown, trial_at
from scpjax.diagnose.naming import state_at
from scpjax.diagnose.own import with_own
from scpjax.diagnose.profiles import Limits, frame, near
from scpjax.diagnose.separation import Imitation, Scene, Separated, noise_weights, rival, room, separate, slope
from scpjax.errors import FitError
from scpjax.fit.setup import Setup, prepare
from scpjax.physics.catalogue import forget, mechanism
from scpjax.recordings.recording import Metadata, Recording
from scpjax.simulate.trial import use_base

BASE = """
from scpjax.parameter import Parameter
from scpjax.physics.mechanism import Mechanism
from scpjax.physics.system import System


def free(name, low, high, null=None, typical=0.5):
    return Parameter(name=name, symbol=name, unit="1", description=name, typical=typical, bounds=(low, high), null=null,
                     scale="linear", spread=1.0 if null is not None else float("inf"))


class Kettle(System):
    name, title, equation, source, says = "kettle", "Kettle", "dh/dt = g u - k h", "mass", "It fills and drains."
    states, outputs, substeps = ("level",), ("level_V",), 3
    parameters = (free("gain", 0.0, 5.0), free("rate", 0.0, 5.0))

    def rates(self, p, view):
        return (p.gain * view.effort - p.rate * view.own[0],)

    def observe(self, p, view):
        return view.own


class Runaway(Mechanism):
    name, title, subsystem, equation, source, says = "runaway", "Runaway", "balance", "c h^3", "gain", "It runs away."
    needs, starts = ("kettle",), ((0.02,),)
    parameters = (free("size", -1.0, 1.0, 0.0, 0.02),)

    def flows(self, p, view):
        return {"level": p.size * view.states["level"] ** 3}
"""
TIME = 0.2 * np.arange(200)
DRIVE = np.repeat(np.random.default_rng(0).uniform(0.0, 1.0, 10), 20)


def recording(drive: dict, response: dict, **told) -> Recording:
    return Recording.from_arrays(TIME, drive, response, metadata=Metadata(**told))


def followed(drive: np.ndarray, seed: int = 0) -> np.ndarray:
    """A first-order response to a drive, with noise."""
    out = np.zeros(len(drive))
    for i in range(len(drive) - 1):
        out[i + 1] = out[i] + 0.2 * (drive[i] - 0.5 * out[i])
    return out + 0.01 * np.random.default_rng(seed).standard_normal(len(drive))


def heated(ambient: float = 293.15, **drive: np.ndarray) -> Recording:
    """A thermometer (`te`) under a drive in volts unless told."""
    given = drive or {"voltage_V": DRIVE}
    kelvin = 10 * followed(next(iter(given.values())) ** 2 / np.max(next(iter(given.values())) ** 2))
    return recording(given, {"temperature_degC": kelvin + ambient - 273.15}, name=f"{ambient:g}", ambient_K=ambient)


def pulled() -> Recording:
    """A displacement driven by a temperature (`tm`)."""
    return recording({"temperature_degC": 20 + 30 * DRIVE}, {"displacement_mm": followed(DRIVE)}, model="tm")


@pytest.fixture(scope="module")
def kettle(tmp_path_factory):
    """(the base alone, with a runaway in it) and their data: level 2 with full drive, and no return from beyond 5."""
    path = tmp_path_factory.mktemp("base") / "kettle.py"
    path.write_text(BASE)
    use_base(path)
    setup = prepare([recording({"drive_V": DRIVE}, {"level_V": followed(DRIVE)}, name="a", model="kettle")])
    parts = split(setup.data)
    more = grown(setup, mechanism("runaway"))
    values = [np.r_[1.0, 0.5, 0.0], np.r_[1.0, 0.5, 0.02, 0.0]]
    states = [
        state_at(s, parts, trial_at(s, v, np.zeros(len(s.structure.mechanisms))))
        for s, v in zip((setup, more), values, strict=True)
    ]
    yield states, setup.data
    forget(path)


def as_they_are(monkeypatch) -> None:
    """Hypotheses are not fitted anew."""
    monkeypatch.setattr(experiment, "_by_short_steps", lambda states, data: (list(states), data))


def test_a_rival_that_blows_up_is_not_well_separated():
    y, bad, hot = np.ones((4, 1)), np.array([[1.0], [2.0], [np.nan], [np.inf]]), np.zeros((4, 1))
    both = {(0, 1): Imitation(np.inf, np.zeros(1), bad), (1, 0): Imitation(np.inf, np.zeros(1), bad)}
    assert Separated(hot, both, (y, bad), (hot, hot)).least == -np.inf
    assert Separated(hot, both, (y, bad), (hot, hot)).unpredictable == (1,)
    fine = {k: Imitation(v, np.zeros(1), y) for k, v in (((0, 1), 3.0), ((1, 0), 2.0))}
    assert Separated(hot, fine, (y, y), (hot, hot)).least == 2.0
    assert Separated(hot, fine, (y, y), (hot, hot * np.nan)).least == -np.inf


def test_an_experiment_stays_where_all_rivals_can_be_predicted(monkeypatch, kettle):
    """With a range of the drive four times that recorded, the runaway never comes back."""
    as_they_are(monkeypatch)
    states, data = kettle
    found = propose(states, data, labels=("base model", "runaway"), limits=Limits(highest=4.0))
    assert found is not None
    assert 1.0 < found.expected_bits < 1e6
    assert found.standard_bits <= found.expected_bits
    farthest = 1.5 * (4.0 - DRIVE.min()) / np.ptp(DRIVE) * np.ptp(states[0].setup.recordings[0].outputs)
    for said in found.predicted.values():
        assert np.all(np.isfinite(said["level_V"]))
        assert np.max(said["level_V"]) <= 1.01 * farthest


def test_where_nothing_can_be_predicted_that_is_said(monkeypatch, kettle):
    as_they_are(monkeypatch)
    states, data = kettle
    with pytest.raises(FitError, match=r"no experiment within these limits can be predicted: .*under runaway blows up"):
        propose(states, data, labels=("base model", "runaway"), limits=Limits(lowest=30.0, highest=40.0))


def test_predictions_stay_near_what_was_seen():
    seen, rest = np.array([[0.0, 1.0], [2.0, 3.0]]), np.array([[0.0, 0.0], [0.0, 0.0]])
    np.testing.assert_allclose(near(seen, rest, 1.0), [[-1.0, -1.5], [3.0, 4.5]])
    np.testing.assert_allclose(near(seen, rest, 4.0)[1], [12.0, 18.0])  # four times the drive
    np.testing.assert_allclose(near(seen, rest, 1.0, both_ways=True), [[-4.0, -6.0], [4.0, 6.0]])


def test_a_drive_that_takes_a_prediction_too_far_is_drawn_back(kettle):
    states, data = kettle
    search = experiment._search(states, data, Limits(), ("a", "b"))
    full = np.full((search.frame.n, 1), search.frame.high)
    said = [search.scene.said(i, r.centre, full)[0] for i, r in enumerate(search.scene.rivals)]
    assert search.keeps(full)
    closer = replace(search, near=np.array([[-np.inf], [0.5 * np.max(said)]]))
    assert not closer.keeps(full)
    cooled = closer.cooled(full)
    assert closer.keeps(cooled)
    assert np.max(cooled) > 0.4
    count = np.full((search.frame.count, 1), search.frame.high)
    samples = closer.verified(count)
    for r in search.scene.rivals:
        outputs, _ = heat.played(r, closer.recording(samples), substeps=closer.substeps)
        assert np.max(outputs * search.scene.weights) <= 0.5 * np.max(said)
    with pytest.raises(FitError, match="keeps what hypotheses predict near what was recorded"):
        replace(search, near=np.array([[1e3], [2e3]])).verified(count)


def test_gradient_of_what_goes_too_far_is_that_of_finite_differences(kettle):
    states, data = kettle
    weights = noise_weights(states[0], data)
    where = Scene(tuple(rival(s, data, weights, n) for s, n in zip(states, "ab", strict=True)), weights, 0.4, 2)
    rng = np.random.default_rng(1)
    drive, d, by = rng.uniform(0, 1, (60, 1)), rng.standard_normal((60, 1)), rng.standard_normal((60, 1)) * 1e-2

    def value(u):
        s = separate(where, u, steps=200, tolerance=1e-13)
        return np.log(s.smooth[0]) + sum(float(np.sum(by * y)) for y in s.said)

    s = separate(where, drive, steps=200, tolerance=1e-13)
    g = slope(where, s, [np.zeros((60, 1))] * 2, [by] * 2)
    by_hand = (value(drive + 1e-4 * d) - value(drive - 1e-4 * d)) / 2e-4
    assert float(np.sum(g * d)) == pytest.approx(by_hand, rel=2e-3)


def test_a_temperature_that_drives_stays_below_the_limit():
    setup = prepare([pulled()])
    check_limits(Limits(hottest=310.0), setup)
    f, _ = experiment._framed(Limits(hottest=310.0, highest=400.0), setup)
    assert f.high == 310.0
    assert np.max(f.samples(np.full((f.n, 1), 400.0))) <= 310.0
    assert experiment._framed(Limits(hottest=400.0), setup)[0].high == pytest.approx(293.15 + 30 * DRIVE.max())
    with pytest.raises(FitError, match="leaves nothing to choose; allow a higher temperature"):
        check_limits(Limits(hottest=280.0), setup)


def test_a_limit_on_temperature_that_means_nothing_is_refused(kettle):
    states, _ = kettle
    with pytest.raises(FitError, match="means nothing to the model kettle, which has no heat balance; leave it out"):
        check_limits(Limits(hottest=330.0), states[0].setup)


def test_an_experiment_is_simulated_by_steps_as_short_as_the_fit(kettle):
    states, data = kettle
    setup = states[0].setup
    assert experiment._steps(setup, data, 0.2) == 3  # as the base asks
    assert experiment._steps(setup, data, 1.0) == 15
    assert experiment._steps(setup, data, 1.0, 8) == 8
    assert experiment._steps(setup, data.finer(2), 0.2) == 6
    assert experiment._steps(prepare([heated()]), prepare([heated()]).data, 1.0) == 1
    search = experiment._search(states, data, Limits(), ("a", "b"))
    assert (search.scene.parts, search.substeps) == (3 * search.frame.every, 3)
    weights = np.ones(1)
    rivals = tuple(rival(s, data, weights, n) for s, n in zip(states, "ab", strict=True))
    u = np.random.default_rng(2).uniform(0, 1, (30, 1))
    coarse, fine = Scene(rivals, weights, 1.0, 5), Scene(rivals, weights, 0.2)
    for i, r in enumerate(rivals):
        said = fine.said(i, r.centre, np.repeat(u, 5, axis=0))[0][::5]
        np.testing.assert_allclose(coarse.said(i, r.centre, u)[0], said, atol=1e-12)
        assert np.max(np.abs(Scene(rivals, weights, 1.0).said(i, r.centre, u)[0] - said)) > (1e-6 if i else 0.0)


def test_the_last_simulation_goes_by_those_steps_too(monkeypatch, kettle):
    states, data = kettle
    asked = []
    monkeypatch.setattr(heat, "simulate", lambda *given, method, **rest: asked.append(method) or _path())
    heat.played(rival(states[0], data, np.ones(1), "a"), states[0].setup.recordings[0], substeps=6)
    assert asked[0].substeps == 6


def _path() -> SimpleNamespace:
    return SimpleNamespace(states=np.zeros((3, 1)), outputs=np.zeros((3, 1)))


def test_steps_that_a_hypothesis_asks_for_are_those_of_all(monkeypatch, kettle):
    states, data = kettle

    def resolved(state, parts, patience):
        finer = parts.whole.finer(2) if state is states[1] else parts.whole
        return replace(parts, train=finer, whole=finer), state, ()

    monkeypatch.setattr(experiment, "resolved", resolved)
    monkeypatch.setattr(experiment, "_refitted", lambda state, data: (state, data.bin))
    fitted, fine = experiment._by_short_steps(states, data)
    assert fine.bin == 2 * data.bin
    assert fitted == [(s, fine.bin) for s in states]


def coloured(period: float = 0.2) -> tuple[SimpleNamespace, SimpleNamespace]:
    """A state whose residuals last for some bins, and its data."""
    rng = np.random.default_rng(3)
    x = np.convolve(rng.standard_normal(4000), np.exp(-np.arange(60) / 10.0))[:4000]
    setup = SimpleNamespace(recordings=[SimpleNamespace(period=period)])
    data = SimpleNamespace(norm=np.ones((1, 4000, 1)), sigma=np.array([0.1]))
    return SimpleNamespace(residual=(x / x.std())[None, :, None], setup=setup), data


def test_quicker_samples_say_no_more_of_what_is_coloured():
    state, data = coloured()
    old, quick, slow = (float(noise_weights(state, data, period=p)[0]) for p in (None, 0.02, 2.0))
    assert noise_weights(state, data, period=0.2)[0] == old
    excess = lambda w: (10.0 / w) ** 2 - 1.0  # noqa: E731  # of the variance of a sample, over that of white noise
    assert excess(old) > 5.0
    assert excess(quick) == pytest.approx(10 * excess(old), rel=1e-2)
    assert excess(slow) == pytest.approx(excess(old) / 10, rel=1e-2)


def test_a_new_recording_has_a_value_of_its_own_of_what_differs():
    setup = with_own(prepare([heated(), heated(294.0)]), "newton_cooling.conductance")
    value = np.array(setup.starts[0])
    at = setup.structure.where["newton_cooling.conductance"]
    value[at] = [0.1, 0.4]
    parts = split(setup.data)
    state = state_at(setup, parts, setup.trial(value, setup.base_active))
    r = rival(state, parts.whole, np.ones(1), "a")
    n, (place,) = len(r.index), r.own
    assert r.structure.plain.slots[place].key == "newton_cooling.conductance"
    spread = np.std(np.log([0.1, 0.4]), ddof=1) * np.sqrt(1.5)
    assert r.known[n, n] == 1.0
    assert not r.known[n, :n].any()
    off = r.centre.copy()
    off[n] = 1.0
    assert r.model(r.centre).value("newton_cooling.conductance") == pytest.approx(0.2)
    assert r.model(off).value("newton_cooling.conductance") == pytest.approx(0.2 * np.exp(spread))
    hot = np.zeros((3, 1, len(r.centre)))
    hot[..., n] = 5.0
    assert heat.doubt(r, hot) == pytest.approx(10.0)
    assert len(r.begun(r.centre)) == setup.space.locals.count(setup.structure)


PWM = {"pwm": np.round(200 * DRIVE)}


@pytest.mark.parametrize(
    ("limits", "drive", "words"),
    [
        (Limits(duration=np.inf), {}, "a duration of inf; give a number"),
        (Limits(highest=np.inf), {}, "a greatest drive of inf; give a number"),
        (Limits(lowest=-np.inf), {}, "a least drive of -inf; give a number"),
        (Limits(period=np.nan), {}, "a period of nan; give a number"),
        (Limits(slew=np.inf), {}, "a slew of inf; give a number"),
        (Limits(hottest=np.nan), {}, "a limit on temperature of nan; give a number"),
        (Limits(highest=300.0), PWM, "a drive of 300 pwm is outside 0 to 255; give one inside"),
        (Limits(lowest=-1.0), PWM, "a drive of -1 pwm is outside 0 to 255; give one inside"),
    ],
)
def test_limits_that_are_no_numbers_or_no_drive_are_refused(limits, drive, words):
    r = heated(**drive)
    with pytest.raises(FitError, match=words):
        frame(limits, [r], r.input_channels)
    assert frame(Limits(highest=255.0 if drive else 5.0), [r], r.input_channels).high > 1.0


def two_rooms() -> tuple[Setup, State]:
    setup = prepare([heated(290.0), heated(300.0)])
    parts = split(setup.data)
    return setup, state_at(setup, parts, setup.trial(setup.starts[0], setup.base_active))


def test_the_warmest_room_counts():
    setup, state = two_rooms()
    assert limit(setup, 320.0) == 20.0
    assert limit(prepare([heated(300.0), heated(290.0)]), 320.0) == 20.0
    with pytest.raises(FitError, match="below ambient"):
        limit(setup, 295.0)
    assert float(rival(state, setup.data, np.ones(1), "a").ambient) == 300.0
    assert room(prepare([pulled()]).structure, prepare([pulled()]).data) == pytest.approx(pulled().inputs[0, 0])


def test_what_was_reached_is_that_of_a_thermometer(monkeypatch):
    """40 K above the colder room is only 30 K above the warmer."""
    setup, state = two_rooms()
    monkeypatch.setattr(heat, "_reached", lambda *given: np.array([40.0, 25.0]))
    assert heat.reached(state, setup.data) == 30.0
