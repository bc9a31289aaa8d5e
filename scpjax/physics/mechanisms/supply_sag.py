"""A battery or supply that gives less than it is asked for."""

from typing import ClassVar

import jax.numpy as jnp
from jax import Array

from scpjax.parameter import Parameter
from scpjax.physics.mechanism import Mechanism, Side, Values, View

LITTLE = 0.01  # of the greatest power
LEAST = 0.05  # of the volts, that the supply gives in any case
AT_ONCE, CHARGE, POLARISED, CELL = (0, 3), (1, 5, 8, 9, 16, 17), (2, 6), (4, 7)  # laws by what tires the supply
LATE = (10, 11)  # and laws load, later
EXHAUSTS = (8, 9)  # of those by charge, laws of one that comes to an end
THEVENIN = (12, 13, 14, 15)  # a resistance at once, polarised beside it
TWO_BRANCHES = (14, 15)  # of those, in two times
RESISTANCE = (*THEVENIN, 16, 17)  # laws of a resistance at once and what comes later; the last by charge
SHARED = (3, 5, 6, 7, 9, 11, 13, 15, 17)  # laws of one supply for both actuators of a joint


def _root(effort: Side) -> Side:
    """|V|, with a derivative of 0 at 0 V."""
    return jnp.where(effort > 0, jnp.sqrt(jnp.where(effort > 0, effort, 1.0)), 0.0)


def _one_of(law: Array, laws: tuple[int, ...]) -> Array:
    return jnp.any(jnp.asarray(laws) == law)


class SupplySag(Mechanism):
    name = "supply_sag"
    title = "The supply sags under load"
    subsystem = "drive"
    equation = (
        "V_wire = V (1 - s q);  law load: q = |V|/V_ref;  law charge: dq/dt = |V_wire|/(V_ref t_ref);  "
        "law polarisation: tau dq/dt = |V_wire|/V_ref - q;  law cell: V_wire = V - s V_ref q, not below 0, with the q "
        "of polarisation;  law exhaustion: q/(1 - q/c) in place of q, with the q of charge, 1 - q/c at least 0.05;  "
        "law late load: tau dq/dt = |V|/V_ref - q, V as it was recorded;  law Thevenin: V_wire = V (1 - s (1 - a) q)/"
        "(1 + s a |V|/V_ref), with the q of polarisation;  law Thevenin, two branches: (1 - b) q + b q_s in place of "
        "that q, r tau dq_s/dt = |V_wire|/V_ref - q_s;  law Thevenin, drained: with the q of charge;  laws shared "
        "load, shared charge, ...: a joint's one supply, of which q takes the sum over both actuators"
    )
    source = (
        "load: source resistance before a smoothed PWM, or, late, a source that folds back as it warms; charge, "
        "exhaustion and polarisation: Shepherd's battery equation, J. Electrochem. Soc. 112 (1965) 657; cell: a "
        "resistor and a capacitor in parallel before the wire; Thevenin: the model of Plett, Battery Management "
        "Systems I, ch. 2, a resistance in series with one such pair or two, or with volts that fall with the "
        "charge that is left, before a drive that is switched: the wire gets V/V_ref of what is left of the cell's "
        "volts"
    )
    says = "The battery gives fewer volts the more is drawn from it, so strong drives reach the wire weakened."
    needs = ("voltage",)
    excited_by = "strong and weak drives in one recording; long strong drives"
    laws = (
        "load",
        "charge",
        "polarisation",
        "shared load",
        "cell",
        "shared charge",
        "shared polarisation",
        "shared cell",
        "exhaustion",
        "shared exhaustion",
        "late load",
        "shared late load",
        "Thevenin",
        "shared Thevenin",
        "Thevenin, two branches",
        "shared Thevenin, two branches",
        "Thevenin, drained",
        "shared Thevenin, drained",
    )
    law_needs: ClassVar[dict[int, tuple[str, ...]]] = dict.fromkeys(SHARED, ("joint",))
    only_under: ClassVar[dict[str, tuple[int, ...]]] = {
        "time_constant": POLARISED + CELL + LATE + THEVENIN,
        "capacity": EXHAUSTS,
        "at_once": RESISTANCE,
        "slow_share": TWO_BRANCHES,
        "slow_ratio": TWO_BRANCHES,
    }
    states = ("drawn", "slow_drawn")
    parameters = (
        Parameter(
            name="sag",
            symbol="s",
            unit="1",
            description="share of the volts that is lost where the greatest drive is asked for (laws load), or "
            "given for long (laws polarisation, Thevenin) or asked for so long (laws late load) or given for the "
            "reference time (laws charge, drained; exhaustion: at the pace of the beginning); resistance of the cell "
            "over that of the wire (laws cell)",
            typical=0.15,
            bounds=(0.003, 0.9),
            null=0.0,
            spread=1.5,
        ),
        Parameter(
            name="time_constant",
            symbol="τ",
            unit="s",
            description="time in which the supply tires and recovers (laws polarisation, cell, late load, Thevenin; of "
            "two branches the quicker one)",
            typical=0.5,
            bounds=(0.02, 20.0),
            null=1.0,
            spread=2.0,
            time="response",
        ),
        Parameter(
            name="capacity",
            symbol="c",
            unit="1",
            description="charge that the supply holds, in units of what it gives at the greatest drive in the "
            "reference time (laws exhaustion)",
            typical=1.5,
            bounds=(0.05, 30.0),
            null=1.5,
            spread=1.0,
        ),
        Parameter(
            name="at_once",
            symbol="a",
            unit="1",
            description="share of what is lost that a resistance takes at once (laws Thevenin)",
            typical=0.3,
            bounds=(0.01, 0.99),
            null=0.3,
            scale="linear",
            spread=0.3,
        ),
        Parameter(
            name="slow_share",
            symbol="b",
            unit="1",
            description="share of what is lost later that the slower branch takes (laws Thevenin, two branches)",
            typical=0.5,
            bounds=(0.01, 0.99),
            null=0.5,
            scale="linear",
            spread=0.3,
        ),
        Parameter(
            name="slow_ratio",
            symbol="r",
            unit="1",
            description="time of the slower branch over that of the quicker one (laws Thevenin, two branches)",
            typical=6.0,
            bounds=(1.5, 100.0),
            null=6.0,
            spread=1.0,
        ),
        Parameter(
            name="reference",
            symbol="V_ref",
            unit="V",
            description="greatest drive",
            typical=3.7,
            bounds=(1e-9, 1e9),
            null=3.7,
            fixed=True,
        ),
        Parameter(
            name="reference_time",
            symbol="t_ref",
            unit="s",
            description="time for which the loss of laws charge, drained and exhaustion is stated",
            typical=100.0,
            bounds=(1e-9, 1e9),
            null=100.0,
            fixed=True,
        ),
    )
    starts = ((0.15, 0.5, 1.5, 0.3, 0.5, 6.0, 0.0, 0.0),)

    def _drives(self, p: Values, effort: Side) -> Side:
        """|V|/V_ref; the small floor keeps its derivative finite at 0 V."""
        return jnp.sqrt(jnp.maximum(effort, 0.0) / p.reference**2 + 1e-12)

    def _draws(self, p: Values, effort: Side) -> Side:
        """What each side's supply is asked for, |V|/V_ref: a shared one by both."""
        drives = self._drives(p, effort)
        return jnp.where(_one_of(p.law, SHARED), jnp.sum(drives), drives)

    def _drawn(self, p: Values, view: View) -> Side:
        """q, or what stands in its place near the end of a charge, or of two branches."""
        quick, slow = view.own
        left = jnp.maximum(1.0 - view.own[0] / p.capacity, LEAST)
        drawn = quick + jnp.where(_one_of(p.law, TWO_BRANCHES), p.slow_share, 0.0) * (slow - quick)
        return drawn / jnp.where(_one_of(p.law, EXHAUSTS), left, 1.0)

    def _at_once(self, p: Values) -> Side:
        """Share of what is lost that is lost at once, beside what is lost later."""
        return jnp.where(_one_of(p.law, RESISTANCE), p.at_once, 0.0)

    def effort(self, p: Values, view: View, effort: Side) -> Side:
        asked, at_once = self._draws(p, effort), self._at_once(p)
        drawn = jnp.where(_one_of(p.law, AT_ONCE), asked, (1.0 - at_once) * self._drawn(p, view))
        left = jnp.maximum(1.0 - p.sag * drawn, LEAST) / (1.0 + p.sag * at_once * asked)
        volts = _root(effort)
        cell = jnp.maximum(volts - p.sag * p.reference * view.own[0], 0.0) / jnp.where(volts > 0, volts, 1.0)
        return effort * jnp.where(_one_of(p.law, CELL), cell, left) ** 2

    def effort_for(self, p: Values, view: View, effort: Side) -> Side:
        given, at_once = self._draws(p, effort), self._at_once(p)
        share = _asked_for(p, given)
        drawn = (1.0 - at_once) * self._drawn(p, view)
        left = jnp.maximum(1.0 - p.sag * drawn, LEAST)
        later = 1.0 / jnp.maximum(left - p.sag * at_once * given, LEAST)
        asked = effort * jnp.where(_one_of(p.law, AT_ONCE), share, later) ** 2
        cell = jnp.where(effort > 0, (_root(effort) + p.sag * p.reference * view.own[0]) ** 2, 0.0)
        return jnp.where(_one_of(p.law, CELL), cell, asked)

    def rates(self, p: Values, view: View) -> tuple[Side, ...]:
        given = self._draws(p, jnp.where(_one_of(p.law, LATE), view.asked, view.effort))
        quick, slow = view.own
        charge = _one_of(p.law, CHARGE)
        return (
            jnp.where(charge, given / p.reference_time, (given - quick) / p.time_constant),
            jnp.where(_one_of(p.law, TWO_BRANCHES), (given - slow) / (p.slow_ratio * p.time_constant), 0.0),
        )

    def initial(self, p: Values, view: View) -> tuple[Side, ...]:
        """As long drained by what has kept it so warm (polarisation, cell, Thevenin): what it had given by then is not
        known.
        """
        share = jnp.maximum(view.effort, 0.0) / p.reference**2
        # nearly its root, but for the little that a cold one's temperature is uncertain by
        drawn = share / jnp.sqrt(share + LITTLE)
        drawn = jnp.where(_one_of(p.law, SHARED), jnp.sum(drawn), drawn)
        drawn = drawn * jnp.where(_one_of(p.law, LATE), _asked_for(p, drawn), 1.0)
        tired = POLARISED + CELL + LATE + THEVENIN
        return tuple(jnp.where(_one_of(p.law, laws), drawn, 0.0) for laws in (tired, TWO_BRANCHES))


def _asked_for(p: Values, drawn: Side) -> Side:
    """What is asked for as a multiple of what is given, by v (1 - s v) = w solved for the smaller root; beyond the most
    that the supply can give, its turning point.
    """
    return 2.0 / (1.0 + jnp.sqrt(jnp.maximum(1.0 - 4.0 * p.sag * drawn, 1e-12)))
