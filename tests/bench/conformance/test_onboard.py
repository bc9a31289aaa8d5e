"""The stored table and the PID on every board."""

import jax
import numpy as np
import pytest
from boards import Talk, of

from scpjax.bench import messages as m
from scpjax.bench.messages import Event
from scpjax.bench.parameters import BoardConfig
from scpjax.bench.play import Profile, loop_on_board, play
from scpjax.bench.rig import Rig
from scpjax.bench.wiring import Wiring
from scpjax.bench.world import Muscle
from scpjax.control.pid import thesis_pair
from scpjax.control.plant import Difference
from scpjax.control.reference import Reference
from scpjax.physics.known import known_model


def test_a_table_is_played_entry_by_entry(board):
    counts = np.random.default_rng(0).integers(0, 256, (600, 2))
    device = board()
    with Rig(device) as rig:
        rig.stream(1)
        seen = []
        rig.quality.samples = 0
        play(rig, Profile(counts, 2), watch=lambda t: seen.append(t))
        played = [s.pwm for _, s in rig._samples if s.mode == m.PLAY]
    assert seen
    assert seen[-1] == pytest.approx(6.0, abs=0.1)
    first = played.index(tuple(counts[0]))
    np.testing.assert_array_equal(np.array(played[first:])[::2], counts)
    assert device.duty() == (0.0, 0.0)


def test_a_table_that_runs_dry_ends_the_drive(talk):
    talk.ask("T", 0, 0xFFFF, 0xFFFF, 0xFFFF)
    talk.ask("P", 10, 100)
    messages = talk.wait(0.3)
    assert [e.what for e in of(Event, messages)] == [m.UNDERRUN]
    assert talk.device.duty() == (0.0, 0.0)


def test_the_table_takes_entries_in_order_and_says_when_it_is_full(talk):
    for i in range(0, 252, 12):
        assert talk.ask("T", i, *range(12)).status == m.OK
    full = talk.ask("T", 252, *range(12))
    assert (full.status, full.value >> 16, full.value & 0xFFFF) == (m.FULL, 252, 3)
    again = talk.ask("T", 240, 1)
    assert (again.status, again.value >> 16) == (m.OUT_OF_RANGE, 252)
    assert talk.ask("S").status == m.OK
    assert talk.ask("T", 0, 1).status == m.OK


# -- the controller --------------------------------------------------------------------------------------------------


def joint() -> tuple[Difference, Wiring]:
    muscle = known_model("thesis")
    return Difference(muscle, muscle, radius=0.015), Wiring(sides=2)


@pytest.mark.parametrize("shape", ["sine", "square"])
def test_pid_on_the_board_is_that_of_the_host_within_a_count_over_60_s(board, shape):
    plant, wiring = joint()
    config = BoardConfig(max_temperature_C=200.0)
    device = board(Muscle(plant, wiring), config=config)
    pair = thesis_pair()
    _, reference = Reference().make(shape)
    with Rig(device, wiring) as rig:
        rig.stream(4)
        loop_on_board(rig, pair, reference, 4)
        samples = [s for _, s in rig._samples if s.mode == m.LOOP]
    assert len(samples) >= len(reference) - 1
    seen = np.array([wiring.angle(s) for s in samples[: len(reference)]])
    wanted = np.deg2rad(np.round(100 * np.rad2deg(reference)) / 100)[: len(seen)]

    def step(state, x):
        state, said = pair.step(state, x[0], x[1], 0.02)
        return state, said.effort

    efforts = np.stack(jax.lax.scan(step, pair.initial(), (seen, wanted))[1], axis=1)
    counts = np.floor(255 * efforts / 3.7**2 + 0.5)
    given = np.array([s.pwm for s in samples[: len(seen)]])
    assert np.ptp(given[:, 0]) > 150
    assert (np.max(given) == 255) == (shape == "square")  # the limit and the clamp are at work
    assert np.max(np.abs(counts - given)) <= 1
    assert np.mean(counts != given) < 0.02


def test_the_loop_needs_the_host_too(board):
    plant, wiring = joint()
    talk = Talk(board(Muscle(plant, wiring)))
    talk.ask("T", 0, *[2000] * 12)
    talk.ask("C", 200, 12)
    talk.wait(0.5)
    assert talk.device.duty()[0] > 0
    assert talk.until_off(1.0) < 0.7
