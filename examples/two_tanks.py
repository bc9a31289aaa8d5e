"""A base model of one's own: two tanks, one above the other, a pump into the upper one, the level of the lower one.

    scpjax diagnose est.csv --base two_tanks.py --out found

The base is linear: each tank loses water in proportion to its level. Beside it stands what it may leave out. Levels
are in volts of the lower tank's sensor (the upper tank's on the scale on which both tanks are alike).
"""

from typing import ClassVar

import jax.numpy as jnp

from scpjax.parameter import Parameter
from scpjax.physics.mechanism import Mechanism
from scpjax.physics.smooth import ramp
from scpjax.physics.system import System

LENGTH = 10.0  # V, level at which outflows are compared
CORNER = 0.05  # V, how gradually a weir sets in


def rate(name, symbol, description, typical, null=None):
    """A parameter in 1/s."""
    bounds, spread = (1e-5, 1.0), 2.0 if null is not None else float("inf")
    return Parameter(
        name=name, symbol=symbol, unit="1/s", description=description, typical=typical, bounds=bounds, null=null,
        spread=spread,
    )  # fmt: skip


class TwoTanks(System):
    name = "two_tanks"
    title = "Two linear tanks"
    equation = "dh1/dt = g u - k1 h1,  dh2/dt = k1 h1 - k2 h2,  level = h2"
    source = "mass balances; Schoukens, Mattsson, Wigren, Noel, Cascaded tanks benchmark (2016), section 2, linearised"
    says = "Water is pumped into the upper tank, runs into the lower one, and out."
    states = ("upper", "lower")
    outputs = ("level_V",)
    substeps = 4  # an edge lets water off within seconds
    parameters = (
        rate("gain", "g", "rise of the upper level per volt at the pump", 0.05),
        rate("upper_rate", "k₁", "outflow of the upper tank by its level", 0.02),
        rate("lower_rate", "k₂", "outflow of the lower tank by its level", 0.015),
    )
    starts = ((0.05, 0.02, 0.015), (0.05, 0.015, 0.03), (0.05, 0.05, 0.01))

    def rates(self, p, view):
        upper, lower = view.own
        between = p.upper_rate * upper
        return (p.gain * view.effort - between, between - p.lower_rate * lower)

    def observe(self, p, view):
        return (view.own[1],)


class TorricelliOutflow(Mechanism):
    name = "torricelli_outflow"
    title = "Water does not run out in proportion to the level"
    subsystem = "balance"
    equation = (
        "outflow = k L ((h + z)/L)^n in place of k h, L = 10 V, z = 0 above;  Torricelli: n = 1/2;  "
        "law two outlets: the upper one has an exponent of its own"
    )
    source = (
        "Torricelli's law; exponents of real orifices, pipes and weirs (up to 3/2): White, Fluid Mechanics, ch. 6, 10"
    )
    says = "A fuller tank drains faster, but less than in proportion: with a root of the head above its outlet."
    needs = ("two_tanks",)
    excited_by = "high and low levels in one recording"
    laws = ("like outlets", "two outlets")
    only_under: ClassVar[dict[str, tuple[int, ...]]] = {"upper_exponent": (1,)}
    parameters = (
        Parameter(
            name="exponent", symbol="n", unit="1", description="of the head, 1/2 by Torricelli's law", typical=0.5,
            bounds=(0.3, 1.5), null=1.0, scale="linear", spread=0.2,
        ),
        Parameter(
            name="head", symbol="z", unit="V", description="height of the lower sensor's zero above the outlet",
            typical=0.0, bounds=(-1.0, 6.0), null=0.0, scale="linear", spread=2.0,
        ),
        Parameter(
            name="upper_exponent", symbol="n₁", unit="1", description="of the upper tank's level (law two outlets)",
            typical=0.5, bounds=(0.3, 1.5), null=1.0, scale="linear", spread=0.5,
        ),
    )  # fmt: skip
    starts = ((0.5, 0.5, 0.5), (0.5, 0.5, 1.0), (0.8, 0.0, 0.8))

    def flows(self, p, view):
        upper, lower = view.states["upper"], view.states["lower"]
        above = jnp.where(p.law == 1, p.upper_exponent, p.exponent)
        between = view.shared["upper_rate"] * (self._law(above, upper, 0.0) - upper)  # counted from its outlet
        out = view.shared["lower_rate"] * (self._law(p.exponent, lower, p.head) - lower)
        return {"upper": -between, "lower": between - out}

    def _law(self, exponent, level, head):
        wet = ramp(level + head, 0.0, jnp.asarray(0.01)) / LENGTH
        law = LENGTH * jnp.where(wet > 1e-9, wet, 1e-9) ** exponent
        return jnp.where((exponent == 1.0) & (head == 0.0), level, law)


class UpperOverflow(Mechanism):
    name = "upper_overflow"
    title = "The upper tank overflows"
    subsystem = "balance"
    equation = "spill = w (h1 - H1)+;  dh1/dt -= spill,  dh2/dt += c spill"
    source = "a weir; that some of the spilt water reaches the lower tank: the benchmark's description, section 2"
    says = "When the upper tank is full, water runs over its edge, and some of it into the lower tank."
    needs = ("two_tanks",)
    excited_by = "a long spell of strong pumping"
    parameters = (
        rate("weir", "w", "overflow by how far the level is above the edge", 0.1, null=0.0),
        Parameter(
            name="edge", symbol="H₁", unit="V", description="level at which the upper tank overflows", typical=9.0,
            bounds=(1.0, 60.0), null=9.0, spread=0.7,
        ),
        Parameter(
            name="share", symbol="c", unit="1", description="of the water spilt, what reaches the lower tank",
            typical=0.5, bounds=(0.0, 1.0), null=0.5, scale="linear", spread=0.5,
        ),
    )  # fmt: skip
    starts = ((0.1, 7.0, 0.7), (0.1, 10.0, 0.7), (0.1, 15.0, 0.7))

    def flows(self, p, view):
        spill = p.weir * ramp(view.states["upper"], p.edge, jnp.asarray(CORNER))
        return {"upper": -spill, "lower": p.share * spill}


class LowerOverflow(Mechanism):
    name = "lower_overflow"
    title = "The lower tank overflows"
    subsystem = "balance"
    equation = "dh2/dt -= w (h2 - H2)+"
    source = "a weir"
    says = "When the lower tank is full, water runs over its edge."
    needs = ("two_tanks",)
    excited_by = "a long spell of strong pumping"
    parameters = (
        rate("weir", "w", "overflow by how far the level is above the edge", 0.2, null=0.0),
        Parameter(
            name="edge", symbol="H₂", unit="V", description="level at which the lower tank overflows", typical=9.5,
            bounds=(1.0, 60.0), null=9.5, spread=0.7,
        ),
    )  # fmt: skip
    starts = ((0.2, 9.5), (0.05, 8.0))

    def flows(self, p, view):
        return {"lower": -p.weir * ramp(view.states["lower"], p.edge, jnp.asarray(CORNER))}


class LevelLimit(Mechanism):
    name = "level_limit"
    title = "The level sensor saturates"
    subsystem = "sensor"
    equation = "level = h2 - s (h2 - S)+"
    source = "a sensor at the end of its range"
    says = "The sensor shows less and less of what the level rises above the end of its range."
    needs = ("two_tanks",)
    excited_by = "levels beyond the range"
    parameters = (
        Parameter(
            name="loss", symbol="s", unit="1", description="of a rise beyond the end of the range, what is not shown",
            typical=0.9, bounds=(0.0, 1.0), null=0.0, scale="linear", spread=0.5,
        ),
        Parameter(
            name="end", symbol="S", unit="V", description="end of the range", typical=9.5, bounds=(1.0, 60.0), null=9.5,
            spread=0.7,
        ),
    )  # fmt: skip
    starts = ((0.9, 9.5), (0.5, 8.0))

    def reading(self, p, view, quantity, value):
        return value - p.loss * ramp(value, p.end, jnp.asarray(CORNER))


class PumpThreshold(Mechanism):
    name = "pump_threshold"
    title = "The pump needs some volts before it delivers"
    subsystem = "drive"
    equation = "u = (u - U0)+ in place of u"
    source = "static head of a pump"
    says = "The pump has to lift the water first: nothing flows below some volts."
    needs = ("two_tanks",)
    excited_by = "weak and strong pumping"
    parameters = (
        Parameter(
            name="threshold", symbol="U₀", unit="V", description="below which nothing flows", typical=0.3,
            bounds=(-2.0, 3.0), null=0.0, scale="linear", spread=1.0,
        ),
    )  # fmt: skip
    starts = ((0.3,), (1.0,))

    def effort(self, p, view, effort):
        there = ramp(effort, p.threshold, jnp.asarray(CORNER))
        return jnp.where(p.threshold == 0.0, effort, there)
