"""The words of a closure say, in their units, what its terms do in the simulation."""

from functools import cache
from types import SimpleNamespace

import numpy as np
import pytest

from scpjax.diagnose.closure import Learned, offers, references
from scpjax.diagnose.expression import describe, stands_for
from scpjax.diagnose.hypothesis import grown
from scpjax.fit.result import Estimate
from scpjax.fit.setup import Setup, prepare
from scpjax.physics.catalogue import mechanism
from scpjax.recordings import excitation
from scpjax.recordings.recording import Metadata, Recording

CONDUCTANCE, STIFFNESS, WEIGHT = 0.14, 180.0, -0.37
BASE = {"newton_cooling.conductance@agonist": CONDUCTANCE, "elastic_spring.stiffness": STIFFNESS}
LEARNED = [mechanism(n) for n in ("learned_heat", "learned_force", "learned_reading")]
EVERY = [f"{m.name}.{t.name}" for m in LEARNED for t in m.terms]  # pyright: ignore[reportAttributeAccessIssue]
RAISED = str.maketrans("⁰¹²³⁴⁵⁶⁷⁸⁹", "0123456789")


@cache
def problem() -> Setup:
    time, volts = excitation.step(duration_s=60, period_s=0.2, amplitude=4, start_s=5)
    response = 1 - np.exp(-np.maximum(time - 5, 0) / 8)
    outputs = {"temperature_degC": 20 + 40 * response, "displacement_mm": 4 * response}
    meta = Metadata(name="made", known=(("resistance_ohm", 1.2), ("moving_mass_kg", 0.25)), model="plant")
    setup = prepare([Recording.from_arrays(time, {"voltage_V": volts}, outputs, metadata=meta)])
    return grown(setup, *LEARNED)


def number(words: str) -> float:
    """What an expression `(0.5 ± 0.1) W/(K mm²) T x²` makes of a state, in the unit before its slash."""
    coefficient, rest = words[1:].split(") ", 1)
    value = float(coefficient.split(" ± ")[0])
    state = {"T": 31.0, "x": 2.5, "v": -4.0, "u": 3.0}  # K, mm, mm/s, drive
    product = rest.split(") ", 1)[1] if "(" in rest else rest.split(" ", 1)[1]
    for factor in product.split():
        name = factor.strip("|⁰¹²³⁴⁵⁶⁷⁸⁹")
        size = abs(state[name]) if factor.startswith("|") else state[name]
        power = factor.split(name)[1].strip("|").translate(RAISED)
        value *= size ** int(power or 1)
    return value


@pytest.mark.parametrize("key", EVERY)
def test_words_of_every_term_are_what_it_does(key):
    setup = problem()
    term = next(o.term for o in offers(setup) if o.key == key)
    every = {key: Estimate(WEIGHT, 0.01 * abs(WEIGHT), "1", 0.0, 0.0)}  # the base parameters are held: no estimates
    judged = SimpleNamespace(held_out_gain=0.5, delta_bic=20.0)
    closure = describe(Learned(SimpleNamespace(setup=setup), (key,), judged), every, BASE)  # type: ignore[arg-type]
    r = references(setup)
    shape = (31.0 / r["reference_temperature"]) ** term.temperature * (2.5e-3 / r["reference"]) ** term.displacement
    shape *= (4e-3 / r["velocity_scale"]) ** term.velocity * (3.0 / r["effort_scale"]) ** term.effort
    shape *= -1.0 if term.odd else 1.0
    size = {
        "heat lost": CONDUCTANCE * r["reference_temperature"],
        "force against contraction": STIFFNESS * r["reference"],
        "thermometer reads too much by": r["reference_temperature"],
        "displacement reads too much by": 1e3 * r["reference"],
        "contraction in series with the spring": 1e3 * r["reference"],
    }
    what, words = closure.expression.split(" = - ")
    assert -number(words) == pytest.approx(WEIGHT * size[what] * shape, rel=6e-3)  # three digits are told
    assert set(closure.depends_on) == set(term.variables)


@pytest.mark.parametrize(
    ("place", "variables", "subsystem"),
    [
        ("learned_reading displacement", ["temperature"], "thermomechanical"),  # it does not feel the wire
        ("learned_reading displacement", ["drive", "temperature"], "thermomechanical"),
        ("learned_reading displacement", ["drive"], "sensor"),  # a pick-up
        ("learned_reading displacement", ["displacement"], "sensor"),
        ("learned_reading temperature", ["temperature"], "sensor"),
        ("learned_heat", ["drive"], "drive"),
        ("learned_heat", ["drive", "temperature"], "thermoelectric"),
    ],
)
def test_whose_balance_a_closure_is_depends_on_what_it_depends_on(place, variables, subsystem):
    assert stands_for(place, variables)[2] == subsystem


def test_a_power_of_a_speed_is_not_an_acceleration():
    every = {"learned_force.v_speed": Estimate(1.0, 0.1, "1", 0.0, 0.0)}
    judged = SimpleNamespace(held_out_gain=0.5, delta_bic=20.0)
    state = SimpleNamespace(setup=problem())
    said = describe(Learned(state, tuple(every), judged), every, BASE).expression  # type: ignore[arg-type]
    assert said.endswith("N/((mm/s)²) |v| v")
