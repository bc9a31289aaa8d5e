"""No sequence of commands, valid or not, keeps a channel on beyond its energy limit or above its temperature limit.

The limits are made narrow enough to be met within a second. The actuators behind the board are those that its thermal
model was made for, 5 % cooler, and the checks are on them: the energy that they were given and their own temperature.
"""

import math
import random

import boards
import numpy as np
import pytest

from scpjax.bench import messages as m
from scpjax.bench.device import EmulatedDevice
from scpjax.bench.frames import command, encode
from scpjax.bench.guard import Inputs
from scpjax.bench.parameters import NAMES, TICK_S, BoardConfig, to_bits
from scpjax.bench.wiring import Thermistors
from scpjax.bench.world import World

CONFIG = BoardConfig(
    max_temperature_C=50.0,
    max_energy_J=8.0,
    sustained_power_W=1.0,
    max_on_s=2.0,
    model_thermal_mass_J_per_K=0.3,
)
SEQUENCES = dict.fromkeys(boards.KINDS, 100_000) if boards.FULL_SIZE else {"emulator": 1_000, "firmware": 150}
COMMANDS = 8
COOLER = 1.05


class Actuators(World):
    """Two actuators by thesis (3.2), and what they were given: a bucket that leaks at the sustained power."""

    def __init__(self):
        c = CONFIG
        self.r, self.conductance = c.model_resistance_ohm * COOLER, c.model_conductance_W_per_K * COOLER
        self.mass, self.room = c.model_thermal_mass_J_per_K * COOLER, c.model_ambient_C
        self.temperature, self.energy, self.on = [self.room] * 2, [0.0] * 2, [0.0] * 2
        self.hottest, self.most, self.longest, self.driven_s = self.room, 0.0, 0.0, 0.0
        self.blind = False
        law = Thermistors()
        self.tap = [float(law.volts(t + 273.15)) for t in range(200)]

    def advance(self, duty, dt):
        for c in range(2):
            p = duty[c] * CONFIG.supply_V**2 / self.r
            self.temperature[c] += dt * (p - self.conductance * (self.temperature[c] - self.room)) / self.mass
            self.energy[c] = max(0.0, self.energy[c] + dt * (p - CONFIG.sustained_power_W))
            self.on[c] = max(0.0, self.on[c] + (dt if duty[c] > 0 else -dt))
        self.hottest = max(self.hottest, *self.temperature)
        self.most = max(self.most, *self.energy)
        self.longest = max(self.longest, *self.on)
        self.driven_s += dt * (max(duty) > 0)

    def quick_volts(self):
        out = []
        for t in self.temperature:
            i = min(int(t), 198)
            out.append(0.0 if self.blind else self.tap[i] + (t - i) * (self.tap[i + 1] - self.tap[i]))
        return out

    def volts(self):
        return np.array([*self.quick_volts(), 2.5, 0.5, 3.0, 3.0])


class Quick(EmulatedDevice):
    """The emulator before these actuators, without numpy in every tick."""

    def _tick(self):
        assert isinstance(self.world, Actuators)
        self.world.advance(self.duty(), TICK_S)
        a, b = (4 * int(v / 5 * 1024) for v in self.world.quick_volts())
        return self.board.tick(Inputs((a, b, 2048, 400, 2400, 2400)))


def any_number(rng: random.Random) -> int:
    return rng.choice([0, 1, 2, 12, 127, 255, 256, 0xDEAD, 0xFFFF, 0x10000, rng.randrange(1 << 32), rng.randrange(256)])


def any_float(rng: random.Random) -> int:
    special = [0.0, -1.0, 1e30, math.inf, -math.inf, math.nan, 1e-30, 3.7, 120.0, 50.0, 1e6]
    return to_bits(rng.choice([*special, rng.uniform(-10, 200), rng.uniform(0, 2)]))


def one(rng: random.Random) -> bytes:
    """Bytes for the board: mostly what heats, sometimes anything."""
    n, kind = rng.randrange(0x10000), rng.random()
    if kind < 0.35:
        return command("W", n, (rng.choice([255, 255, rng.randrange(256)]), rng.choice([0, 255, rng.randrange(256)])))
    if kind < 0.43:
        table = command("T", n, (0, *(rng.randrange(0x10000) for _ in range(rng.randrange(1, 13)))))
        mode = rng.choice("PC")
        return command("S", n) + table + command(mode, n, (rng.choice([1, 10, 255]), rng.choice([1, 12, 0xFFFF])))
    if kind < 0.55:
        return command("F", n)
    if kind < 0.63:
        return command("V", n, (rng.randrange(len(NAMES) + 1), any_float(rng)))
    if kind < 0.70:
        return command("V", n, (rng.randrange(8), any_float(rng)))
    if kind < 0.72:
        return command("X", n, (0xDEAD,))
    if kind < 0.84:
        fields = [any_number(rng) for _ in range(rng.randrange(4))]
        return command(rng.choice("?HWRTPCVUKZSFXQ"), n, fields)
    if kind < 0.92:
        good = bytearray(command("W", n, (255, 255)))
        good[rng.randrange(len(good))] = rng.randrange(256)
        return bytes(good)
    if kind < 0.96:
        return encode(",".join(rng.choice(["W", "FF", "-1", "1e9", "ZZ", ""]) or "W" for _ in range(4)))
    return bytes(rng.randrange(256) for _ in range(rng.randrange(1, 120)))


def play(device, world: Actuators, rng: random.Random, sequences: int) -> dict[int, int]:
    """Sequences one after another; how often each fault was met."""
    seen: dict[int, int] = {}
    device.open()
    device.pause(0.05)
    for _ in range(sequences):
        for _ in range(rng.randrange(1, COMMANDS)):
            device.write(one(rng))
            device.pause(TICK_S * rng.choice([0, 0, 1, 1, 2, 5, 20, 60]))
        what = rng.random()
        if what < 0.05:
            device.reset()
        elif what < 0.08:
            world.blind = not world.blind
        elif what < 0.2:
            device.pause(rng.choice([0.5, 1.5, 4.0]))
        data = device._given()
        for fault in range(1, 10):
            seen[fault] = seen.get(fault, 0) + data.count(b",%02X,0*" % fault) + data.count(b",%02X,1*" % fault)
    return seen


@pytest.mark.parametrize("kind", boards.KINDS)
def test_nothing_gets_past_the_limits(kind):
    world = Actuators()
    device = Quick(world, config=CONFIG) if kind == "emulator" else boards.make(kind, world, config=CONFIG)
    seen = play(device, world, random.Random(7), SEQUENCES[kind])
    full = CONFIG.supply_V**2 / world.r
    assert world.hottest <= CONFIG.max_temperature_C
    assert world.most <= CONFIG.max_energy_J + 2 * TICK_S * full
    assert world.longest <= CONFIG.max_on_s + 3 * TICK_S
    # and the limits were met, again and again: an idle board would pass as well
    assert world.hottest > CONFIG.max_temperature_C - 6
    assert world.most > 0.5 * CONFIG.max_energy_J
    assert world.driven_s > 0.02 * SEQUENCES[kind]
    met = {f for f in m.LASTING if seen.get(f)}
    assert {m.HOT_BY_MODEL, m.OVER_ENERGY} & met
    assert seen[m.HOST_TIMEOUT] > 0 or SEQUENCES[kind] < 1000


def near_a_limit(board) -> bool:
    """Whether so little is left to a limit, or to its recovery, that a few ticks decide."""
    mem = board.memory
    shares = []
    for c in range(2):
        shares.append((mem.temperature[c] - 15) / (board.cut_out - 15) if board.cut_out > 16 else 1.0)
        for have, name in ((mem.energy[c], "max_energy"), (mem.on[c], "max_on")):
            most = board.values[NAMES.index(name)]
            shares.append(have / most if most else 1.0)
    return any(s > 0.85 or abs(s - 0.5) < 0.1 for s in shares)


def test_emulator_and_firmware_do_the_same():
    """Any commands: afterwards both are in the same mode, with the same fault, and hold the same counts."""
    seeds = 200 if boards.FULL_SIZE else 12
    compared = sum(_compare(random.Random(seed)) for seed in range(seeds))
    assert compared > 8 * seeds


def _compare(rng: random.Random) -> int:
    python = Quick(Actuators())
    both = boards.Talk(python), boards.Talk(boards.make("firmware", Actuators()))
    compared = 0
    for _ in range(40):
        data, pause = one(rng), rng.choice([6, 10, 40])
        if any(kind in data for kind in (b"$?", b"$X", b"$Z")):
            continue
        for talk in both:
            talk.raw(data + b"\n")
            talk.wait(TICK_S * pause)
        if near_a_limit(python.board) or python.board.values[NAMES.index("host_timeout")] < 1:
            continue
        (a, counts_a), (b, counts_b) = (_state(talk) for talk in both)
        if a != b:  # a table ends a tick earlier on one of them
            for talk in both:
                talk.wait(4 * TICK_S)
            (a, counts_a), (b, counts_b) = (_state(talk) for talk in both)
        assert a == b, data
        compared += 1
        if a & 0xFF in (m.IDLE, m.HOLD):
            assert np.max(np.abs(counts_a - counts_b)) <= 1, data
        else:  # bytes reach the firmware some ms later: what comes next must not meet the table's end
            assert [talk.ask("S").status for talk in both] == [m.OK, m.OK]
    return compared


def _state(talk: boards.Talk) -> tuple[int, np.ndarray]:
    return talk.ask("H").value & 0xFFFF, np.round(255 * np.array(talk.device.duty()))
