"""A drive stage through which small drives do not come."""

from collections.abc import Callable
from typing import ClassVar

import jax
import jax.numpy as jnp

from scpjax.parameter import Parameter
from scpjax.physics.mechanism import Mechanism, Side, Values, View
from scpjax.physics.smooth import clipped, root

WEIBULL = 3
OPEN = 4.0  # logarithm of what Weibull's gate takes the exponential of, where it is wide open: what closes is e^-54
SHUT = -30.0  # the same, where no more than its argument, e^-30, is left of 1 - exp(-e^-30)
NEWTON = 6  # steps, by which gates as sharp as the bounds allow are within what LEAST makes of them
LEAST = 1e-6  # of the greatest drive squared, that is told from none under law gate


class DriveDeadZone(Mechanism):
    name = "drive_dead_zone"
    title = "Small drives do not reach the wire"
    subsystem = "drive"
    equation = (
        "law threshold: V_wire = max(|V| - V_t, 0), V_t = V_0 V_ref, corner rounded over w V_t;  "
        "law gate: V_wire = V / sqrt(1 + (V_t/V)^(2 n)): V well above V_t, nothing well below;  "
        "law gate, shouldered: V_wire = V (1 + (V_t/V)^(a n))^(-1/a), which is law gate for a = 2;  law gate, Weibull: "
        "V_wire = V (1 - exp(-(V/V_t)^n))"
    )
    source = (
        "dead zone of an actuator: Tao, Kokotovic, Adaptive Control of Systems with Actuator and Sensor Nonlinearities "
        "(1996), ch. 2; threshold: base-emitter drop of a Darlington stage; gate: undervoltage lockout of a driver, "
        "of channels that open one after another: Burr, Ann. Math. Stat. 13 (1942) 215, his type III; Weibull, J. "
        "Appl. Mech. 18 (1951) 293"
    )
    says = "Nothing reaches the wire until the drive exceeds a threshold."
    needs = ("electric",)
    excited_by = "small drives beside large ones"
    laws = ("threshold", "gate", "gate, shouldered", "gate, Weibull")
    only_under: ClassVar[dict[str, tuple[int, ...]]] = {"sharpness": (1, 2, WEIBULL), "corner": (0,), "shoulder": (2,)}
    parameters = (
        Parameter(
            name="threshold",
            symbol="V_0",
            unit="1",
            description="drive (volts, or amperes) below which nothing passes, as a share of the greatest drive",
            typical=0.15,
            bounds=(0.003, 0.95),
            null=0.0,
            spread=1.5,
        ),
        Parameter(
            name="sharpness",
            symbol="n",
            unit="1",
            description="how sharply the gate opens (laws gate)",
            typical=8.0,
            bounds=(1.5, 500.0),
            null=8.0,
            spread=1.0,
        ),
        Parameter(
            name="corner",
            symbol="w",
            unit="1",
            description="how gradually the drive comes through, as a share of the threshold (law threshold)",
            typical=0.1,
            bounds=(0.005, 1.0),
            null=0.1,
            spread=1.0,
        ),
        Parameter(
            name="shoulder",
            symbol="a",
            unit="1",
            description="how abruptly it is wide open beyond V_0; short of it n alone tells (law gate, shouldered)",
            typical=2.0,
            bounds=(0.5, 20.0),
            null=2.0,
            spread=0.7,
        ),
        Parameter(
            name="reference",
            symbol="V_ref",
            unit="V",
            description="greatest drive (volts, or amperes)",
            typical=3.7,
            bounds=(1e-9, 1e9),
            null=3.7,
            fixed=True,
        ),
    )
    starts = ((0.1, 8.0, 0.1, 2.0, 0.0), (0.35, 8.0, 0.1, 2.0, 0.0))

    def effort(self, p: Values, view: View, effort: Side) -> Side:
        limit = p.threshold * p.reference
        volts = root(jnp.maximum(effort, 0.0))  # what a dead time shifts may fall short of 0 by rounding
        passed = 1.0 - clipped(volts, limit, p.corner * limit) / volts
        above = _logarithm(volts * volts + LEAST * p.reference**2) - _logarithm(limit * limit)
        return effort * jnp.where(p.law == 0, passed * passed, jnp.exp(_closing(p, above)))

    def effort_for(self, p: Values, view: View, effort: Side) -> Side:
        limit = p.threshold * p.reference
        wanted, corner = root(jnp.maximum(effort, 0.0)), p.corner * limit
        # from what would do if the corner at -V_0 were not rounded, too
        volts = jnp.maximum(limit + wanted - 0.25 * corner * corner / wanted, 0.0)
        volts = _solved(lambda v: v - clipped(v, limit, corner), volts, wanted)
        # ln((V/V_0)^2) + ln(gate) rises, is concave and stays below its first term, and (1 + n) times that
        log_wanted = _logarithm(jnp.maximum(effort, 0.0)) - _logarithm(limit * limit)
        above = jnp.maximum(log_wanted, log_wanted / (1.0 + p.sharpness))
        above = _solved(lambda u: u + _closing(p, u), above, log_wanted)  # but for LEAST
        asked = jnp.where(p.law == 0, volts * volts, jnp.exp(above + _logarithm(limit * limit)))
        return jnp.where(effort > 0, asked, 0.0)


def _solved(function: Callable[[Side], Side], start: Side, wanted: Side) -> Side:
    """Where a function that rises is as wanted, by Newton; its derivative is that of the implicit function."""
    x = start
    for _ in range(NEWTON):
        x = jax.lax.stop_gradient(x)
        value, slope = jax.jvp(function, (x,), (jnp.ones_like(x),))
        x = x + (wanted - value) / jax.lax.stop_gradient(slope)
    return x


def _closing(p: Values, above: Side) -> Side:
    """Logarithm of the share of the drive squared that a gate lets through, ``above`` ln((V/V_0)^2)."""
    shoulder = jnp.where(p.law == 1, 2.0, p.shoulder)
    burr = -2.0 / shoulder * jax.nn.softplus(-0.5 * shoulder * p.sharpness * above)
    # a gate nearly closed passes exp(n u/2) of the drive, and no logarithm of it is taken there
    opens = jnp.clip(0.5 * p.sharpness * above, SHUT, OPEN)
    weibull = 2.0 * (jnp.log(-jnp.expm1(-jnp.exp(opens))) + jnp.minimum(0.5 * p.sharpness * above - SHUT, 0.0))
    return jnp.where(p.law == WEIBULL, weibull, burr)


def _logarithm(squared: Side) -> Side:
    """Of volts squared, with 1e-30 beside them: in single precision, too, its derivative is a number at 0."""
    return jnp.log(squared + 1e-30)
