"""Loops on the bench, and muscles with something concealed in them."""

import itertools
from dataclasses import replace

import jax
import numpy as np
import pytest

from scpjax.bench.device import EmulatedDevice
from scpjax.bench.errors import BenchError
from scpjax.bench.frames import Decoder
from scpjax.bench.parameters import BoardConfig
from scpjax.bench.play import follow, set_gains, within_supply
from scpjax.bench.rig import Rig, RigOptions
from scpjax.bench.sessions import Excite, record_profile
from scpjax.bench.simulated import muscle, simulated, with_concealed
from scpjax.bench.validate import closed_loop, open_loop
from scpjax.bench.wiring import Wiring
from scpjax.bench.world import Muscle, Noise
from scpjax.control.loop import Loop, run
from scpjax.control.pid import PID, thesis_pair
from scpjax.control.reference import Reference

QUIET = Noise(volts=0.0)


def emulated(made, **options):
    return EmulatedDevice(made.world, config=made.config, **options)


@pytest.mark.parametrize("on", ["board", "host"])
def test_tracking_is_that_of_pure_simulation_within_5_percent(board, on):
    """The 0.05 Hz, 25 degree sine on the joint of the thesis's fitted plant (4.4), with noise and converters."""
    made = simulated("thesis", sides=2)
    device = board(made.world, config=replace(made.config, max_temperature_C=150.0))
    _, reference = Reference().make("sine")
    pair = thesis_pair()
    with Rig(device, made.wiring, options=RigOptions(keep=1 << 16)) as rig:
        found = follow(rig, pair, reference, every=4, on=on)
    assert len(found.time) >= len(reference) - 1
    said = jax.jit(lambda loop, r: run(loop, r, dt=0.02))(Loop(made.plant, pair), reference)
    pure = float(np.sqrt(np.mean(np.asarray(said.error) ** 2)))
    print(f"{on}: {np.degrees(found.rmse):.4f} deg, pure simulation {np.degrees(pure):.4f} deg")
    assert found.rmse == pytest.approx(pure, rel=0.05)


@pytest.mark.parametrize(
    ("controller", "words"),
    [
        (thesis_pair(form="tustin"), "does not do this form"),
        (thesis_pair(anti_windup="none"), "does not do this form"),
        (thesis_pair(derivative_weight=0.0), "does not do this form"),
        (PID.per_degree(0.5), "not the agonist's opposite"),
    ],
)
def test_controllers_that_the_firmware_has_not_are_refused(controller, words):
    with Rig(EmulatedDevice(), Wiring(sides=2)) as rig, pytest.raises(BenchError, match=words):
        set_gains(rig, controller)


def test_angles_stand_beside_the_reference_of_their_time(monkeypatch):
    """Though frames are lost on the line, and the reference is longer than what a rig keeps for late readers."""
    made = simulated("thesis", sides=2)
    _, reference = Reference().make("sine")
    pair = thesis_pair()
    feed = Decoder.feed
    count = itertools.count()

    def lossy(self, data):
        return [f for f in feed(self, data) if not (f.kind == "D" and next(count) % 50 == 49)]

    monkeypatch.setattr(Decoder, "feed", lossy)
    device = emulated(replace(made, config=replace(made.config, max_temperature_C=150.0)))
    with Rig(device, made.wiring, options=RigOptions(keep=256)) as rig:
        found = follow(rig, pair, reference, every=4)
    said = jax.jit(lambda loop, r: run(loop, r, dt=0.02))(Loop(made.plant, pair), reference)
    lost = np.isnan(found.angle)
    assert 0.01 < lost.mean() < 0.03
    assert len(found.time) >= len(reference) - 1
    off = np.degrees(found.angle - np.asarray(said.angle)[: len(found.angle)])[~lost]
    assert np.sqrt(np.mean(off**2)) < 0.3
    assert closed_loop(made.plant, pair, found).rmse < 0.3


def test_a_firmware_for_another_supply_is_refused():
    """It would take duties of its own supply, and limit efforts to that."""
    for built, words in ((5.0, "for a higher supply"), (3.0, "for a lower supply")):
        device = EmulatedDevice(config=BoardConfig(supply_V=built))
        with Rig(device, Wiring(sides=2)) as rig, pytest.raises(BenchError, match=words):
            set_gains(rig, thesis_pair())


@pytest.mark.parametrize("on", ["board", "host"])
def test_a_weaker_supply_limits_loop_and_simulation_alike(on):
    made = simulated("thesis", sides=2, wiring=replace(simulated("thesis", sides=2).wiring, supply_V=2.5))
    _, reference = Reference().make("sine")
    pair = within_supply(thesis_pair(), 2.5)
    assert float(pair.antagonist.high) == 6.25
    with Rig(emulated(made), made.wiring) as rig:
        found = follow(rig, thesis_pair(), reference, every=4, on=on)
    assert np.nanmax(found.voltage) == pytest.approx(2.5)
    assert closed_loop(made.plant, pair, found).rmse < 0.3


# -- simulated benches -----------------------------------------------------------------------------------------------


def test_a_concealed_mechanism_is_in_the_muscle():
    model = with_concealed(muscle(), ["creep:compliance=0.4,time_constant=7", "two_node_thermal"])
    assert float(model.value("creep.compliance")) == pytest.approx(0.4)
    assert float(model.value("two_node_thermal.time_constant")) == pytest.approx(0.05 * 1.1 / 0.14, rel=1e-5)


@pytest.mark.parametrize(
    ("words", "said"),
    [("crep", "creep"), ("creep:tau=1", "no 'tau'"), ("creep:compliance=x", "'x' is no number"), ("inertia", "every")],
)
def test_bad_names_to_conceal(words, said):
    with pytest.raises(BenchError, match=said):
        with_concealed(muscle(), [words])


def test_a_model_that_is_right_agrees_and_one_that_is_wrong_parts(tmp_path):
    for concealed, parts in (((), False), (("creep:compliance=0.3,time_constant=8",), True)):
        made = simulated("muscle", concealed=concealed)
        with Rig(emulated(made), made.wiring, options=RigOptions(every=20)) as rig:
            time, volts = Excite(duration=40.0).make("multilevel")
            recording = record_profile(rig, tmp_path / f"{len(concealed)}.csv", time, volts)
        found = {c.column: c for c in open_loop(muscle(), recording)}
        assert found["displacement_mm"].parts == parts
        assert not found["temperature_degC"].parts


def test_the_board_guards_a_muscle_hotter_than_it_was_built_for():
    """A muscle that cools a third worse than the board believes: the thermistor is what saves it."""
    made = simulated("muscle")
    hot = muscle().replace({"newton_cooling.conductance": 0.095})
    world = Muscle(replace_plant(made, hot), made.wiring, seed=1)
    device = EmulatedDevice(world, config=made.config)
    with pytest.raises(BenchError, match="thermistor read the temperature limit"), Rig(device, made.wiring) as rig:
        rig.set_voltage(3.7)
        rig.wait(120.0)
    assert world.hottest - 273.15 <= made.config.max_temperature_C


def replace_plant(made, model):
    from scpjax.control.plant import Difference

    return Difference(model, radius=None)
