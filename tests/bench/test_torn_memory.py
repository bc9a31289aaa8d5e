"""A reset in the middle of whatever the firmware writes does not make an actuator cold."""

import random

import boards
import pytest
from boards import Talk

from rig.simulation.firmware import CLOCK_HZ, missing
from scpjax.bench import messages as m
from scpjax.bench.parameters import TICK_S, BoardConfig

CONFIG = BoardConfig(max_energy_J=1.5, sustained_power_W=4.0, model_thermal_mass_J_per_K=50.0)
NET_W = 3.7**2 / 1.07 - 4.0
TICK = round(CLOCK_HZ * TICK_S)
RESETS = 3000 if boards.FULL_SIZE else 400


@pytest.mark.skipif(bool(missing()), reason=f"skipped: not installed: {missing()} (rig/simulation/install.sh)")
def test_a_reset_at_any_cycle_forgets_nothing():
    device = boards.make("firmware", config=CONFIG)
    talk, rng, given = Talk(device), random.Random(3), []
    for _ in range(RESETS):  # the board's ticks begin anew at each, so a random cycle of ours is one of its own
        talk.wait(0.3)
        assert talk.ask("F").status == m.OK
        assert talk.ask("W", 255, 0).status == m.OK
        talk.wait(0.1)
        talk.ask("S")
        on = 0.1 + TICK_S  # and the tick in which the answer comes
        device.run_on(rng.randrange(TICK))
        device.reset()
        talk.wait(2 * TICK_S)
        assert talk.ask("W", 255, 0).status == m.OK
        given.append((on + talk.until_off(1.0)) * NET_W)
    assert max(given) < 1.5 + 4 * TICK_S * NET_W
    assert min(given) > 1.0
