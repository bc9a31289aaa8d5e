"""A series of weights: what hangs draws the actuator out, and the line through it is the stiffness."""

import csv
import io
import sys

import numpy as np
import pytest
from scipy.constants import g

from scpjax.bench.device import EmulatedDevice
from scpjax.bench.errors import BenchError
from scpjax.bench.rig import Rig, RigOptions
from scpjax.bench.sessions import Characterise, characterise, rest
from scpjax.bench.simulated import simulated
from scpjax.bench.weights import Hung, figure, section, stand, stiffness, table
from scpjax.bench.wiring import Position, Thermistors, Wiring
from scpjax.bench.world import Noise, Still
from scpjax.cli.rig import hang
from scpjax.cli.rig_bench import Bench
from scpjax.fit.fit import fit
from scpjax.report import plot

K = 180.0


def series(rng, masses, *, error=2e-5, bend=0.0):
    """Readings of an actuator of 180 N/m that stiffens by ``bend`` of it for each newton."""
    force = g * np.array(masses)
    at = 0.01 - force / (K * (1 + bend * force)) + error * rng.standard_normal(len(masses))
    return [Hung(m, float(x), error) for m, x in zip(masses, at, strict=True)]


@pytest.mark.parametrize("masses", [(0.05, 0.2), (0.05, 0.1, 0.2), (0.05, 0.1, 0.15, 0.2, 0.25)])
def test_the_interval_holds_the_stiffness_as_often_as_it_says(masses):
    rng = np.random.default_rng(len(masses))
    found = [stiffness(series(rng, masses)) for _ in range(1000)]
    held = np.mean([f.low <= K <= f.high for f in found])
    assert 0.93 < held < 0.985
    assert np.mean([f.value for f in found]) == pytest.approx(K, rel=1e-3)
    assert np.mean([not f.straight for f in found]) < 0.02


def test_errors_that_were_thought_too_small_are_taken_from_the_scatter():
    rng, held = np.random.default_rng(1), 0
    for _ in range(500):
        seen = [Hung(h.mass, h.position, h.error / 10) for h in series(rng, (0.05, 0.1, 0.15, 0.2, 0.25))]
        found = stiffness(seen)
        held += found.low <= K <= found.high
    assert held > 0.93 * 500


def test_a_stiffness_that_grows_with_the_load_is_no_line():
    found = stiffness(series(np.random.default_rng(0), (0.05, 0.1, 0.2, 0.3), bend=0.1))
    assert not found.straight
    assert "no straight line" in found.says
    assert "third" in stiffness(series(np.random.default_rng(0), (0.05, 0.3))).says


@pytest.mark.parametrize(
    ("masses", "words"),
    [((0.1,), "one weight"), ((0.1, 0.1), "one weight"), ((0.1, -1.0), "no weight"), ((0.1, 0.10001), "by more than")],
)
def test_a_series_without_a_stiffness_is_refused(masses, words):
    with pytest.raises(BenchError, match=words):
        stiffness(series(np.random.default_rng(0), masses))


def test_what_hangs_on_the_simulated_muscle_draws_it_out_and_swings():
    made = simulated("muscle", noise=Noise(volts=0.0))
    world = made.world
    world.hang(0.35)
    moved = []
    for _ in range(1000):
        world.advance((0.0, 0.0), 0.005)
        moved.append(world.position)
    still = -0.1 * g / K
    assert moved[-1] == pytest.approx(still, rel=1e-4)
    # (3.4) with 0.35 kg, 8 N s/m and 180 N/m overshoots by exp(-pi zeta / sqrt(1 - zeta^2))
    zeta = 8 / (2 * np.sqrt(0.35 * K))
    over = np.exp(-np.pi * zeta / np.sqrt(1 - zeta**2))
    assert min(moved) / still - 1 == pytest.approx(over, rel=0.02)
    assert world.temperature[0] == pytest.approx(295.15)
    with pytest.raises(BenchError, match="above 0"):
        world.hang(0.0)


def test_a_series_of_weights_gives_stiffness_and_force_apart(board, tmp_path):
    made = simulated("muscle", noise=Noise(volts=2e-3))
    device = board(made.world, config=made.config)
    options = Characterise(duration=20.0, levels=(3.0,), weights=(0.1, 0.2, 0.25))
    with Rig(device, made.wiring, options=RigOptions(every=20)) as rig:
        found = characterise(rig, tmp_path / "recordings", options, hang=made.world.hang)
        wiring = rig.wiring
    assert found.stiffness is not None
    assert found.stiffness.value == pytest.approx(K, rel=6e-3)
    assert found.stiffness.straight
    assert dict(wiring.known)["moving_mass_kg"] == 0.25
    assert wiring.position.zero == pytest.approx(800, abs=3)
    assert [dict(r.metadata.known)["moving_mass_kg"] for r in found.steps] == [0.1, 0.2]
    for r in (*found.steps, *found.recordings):
        assert abs(np.mean(r.output("displacement")[:10])) < 5e-5
    standing = sorted((tmp_path / "weights").glob("*_standing.csv"))
    assert len(standing) == 3
    for file, hung in zip(standing, found.series, strict=True):  # what the stiffness rests on is on disk
        assert file.with_suffix(".raw").read_bytes().count(b"$D") >= 25
        at = [float(row["displacement_mm"]) for row in csv.DictReader(file.open())]
        assert np.mean(at) == pytest.approx(1e3 * hung.position, abs=5e-3)
    lifts = [h.lift for h in found.series]
    assert max(lifts) - min(lifts) < 1e-4
    assert min(lifts) > 4e-3
    fitted = fit(found.recordings)
    assert "elastic_spring.stiffness" in fitted.known
    assert fitted.parameters["thermal_actuation.coefficient"].value == pytest.approx(0.024, rel=0.02)
    rows = list(csv.DictReader(io.StringIO(table(found.series))))
    assert [float(r["mass_kg"]) for r in rows] == [0.1, 0.2, 0.25]
    image = plot.png(figure(found.series, found.stiffness))
    assert "Weight (g)" in section(found.series, found.stiffness, image, ["seen"])


def test_creep_is_waited_for_so_that_the_stiffness_is_that_of_the_crept_fibre(tmp_path):
    made = simulated("muscle", concealed=["creep:compliance=0.3,time_constant=12"], noise=Noise(volts=0.0))
    seen = []
    with Rig(EmulatedDevice(made.world, config=made.config), made.wiring, options=RigOptions(every=20)) as rig:
        for mass in (0.1, 0.3):
            made.world.hang(mass)
            rest(rig)
            at = stand(rig, tmp_path / f"{mass}.csv")
            seen.append(Hung(mass, at.m, at.error))
    assert stiffness(seen).value == pytest.approx(K / 1.3, rel=0.02)


@pytest.mark.parametrize(
    ("position", "volts", "words"),
    [
        (Position(source="none"), 2.5, "no position sensor"),
        (Position(), 5.0, "at its end"),
        (Position(), 0.0, "at its"),
    ],
)
def test_where_no_position_can_be_read(position, volts, words, tmp_path):
    wiring = Wiring(position=position, thermistors=Thermistors())
    with (
        Rig(EmulatedDevice(Still((0.5, 0.5, volts, 0.0, 3.0, 3.0))), wiring, options=RigOptions(every=20)) as rig,
        pytest.raises(BenchError, match=words),
    ):
        stand(rig, tmp_path / "a.csv")


def test_a_joint_has_no_series(tmp_path):
    made = simulated("muscle", sides=2)
    with (
        Rig(EmulatedDevice(made.world, config=made.config), made.wiring) as rig,
        pytest.raises(BenchError, match="one actuator"),
    ):
        characterise(rig, tmp_path, Characterise(weights=(0.1, 0.2)), hang=made.world.hang)


def test_somebody_is_asked_to_hang_the_weight(monkeypatch, capsys):
    with Rig(EmulatedDevice()) as rig:
        monkeypatch.setattr(sys, "stdin", io.StringIO("\n"))
        hang(Bench(rig, None), 0.0827)
        assert "hang 0.0827 kg" in capsys.readouterr().out
        with pytest.raises(BenchError, match="nobody to hang"):
            hang(Bench(rig, None), 0.1)
