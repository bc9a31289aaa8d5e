"""A battery or supply that gives less than it is asked for."""

from typing import ClassVar

import jax.numpy as jnp

from scpjax.parameter import Parameter
from scpjax.physics.mechanism import Mechanism, Side, Values, View

LITTLE = 0.01  # of the greatest power
LEAST = 0.05  # of the volts, that the supply gives in any case


class SupplySag(Mechanism):
    name = "supply_sag"
    title = "The supply sags under load"
    subsystem = "drive"
    equation = (
        "V_wire = V (1 - s q);  law load: q = |V|/V_ref;  law charge: dq/dt = |V_wire|/(V_ref t_ref);  "
        "law polarisation: tau dq/dt = |V_wire|/V_ref - q;  law shared load: q = (|V| + |V_other|)/V_ref, in a joint"
    )
    source = (
        "load: source resistance before a smoothed PWM; charge and polarisation: Shepherd's battery equation, "
        "J. Electrochem. Soc. 112 (1965) 657, and its first-order dynamics: Plett, Battery Management Systems I, ch. 2"
    )
    says = "The battery gives fewer volts the more is drawn from it, so strong drives reach the wire weakened."
    needs = ("voltage",)
    excited_by = "strong and weak drives in one recording; long strong drives"
    laws = ("load", "charge", "polarisation", "shared load")
    law_needs: ClassVar[dict[int, tuple[str, ...]]] = {3: ("joint",)}
    only_under: ClassVar[dict[str, tuple[int, ...]]] = {"time_constant": (2,)}
    states = ("drawn",)
    parameters = (
        Parameter(
            name="sag",
            symbol="s",
            unit="1",
            description="share of the volts that is lost at the greatest drive: at once (load, shared load), when it "
            "has lasted long (polarisation), when it has lasted for the reference time (charge)",
            typical=0.15,
            bounds=(0.003, 0.9),
            null=0.0,
            spread=1.5,
        ),
        Parameter(
            name="time_constant",
            symbol="τ",
            unit="s",
            description="time in which the supply tires and recovers (law polarisation)",
            typical=0.5,
            bounds=(0.02, 20.0),
            null=1.0,
            spread=2.0,
            time="response",
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
            description="time for which the loss of law charge is stated",
            typical=100.0,
            bounds=(1e-9, 1e9),
            null=100.0,
            fixed=True,
        ),
    )
    starts = ((0.15, 0.5, 0.0, 0.0),)

    def _asked(self, p: Values, effort: Side) -> Side:
        """|V|/V_ref; the small floor keeps its derivative finite at 0 V."""
        return jnp.sqrt(jnp.maximum(effort, 0.0) / p.reference**2 + 1e-12)

    def effort(self, p: Values, view: View, effort: Side) -> Side:
        asked = self._asked(p, effort)
        drawn = jnp.where(p.law == 0, asked, jnp.where(p.law == 3, jnp.sum(asked), view.own[0]))
        return effort * jnp.maximum(1.0 - p.sag * drawn, LEAST) ** 2

    def effort_for(self, p: Values, view: View, effort: Side) -> Side:
        # v (1 - s v) = w, solved for the smaller root; beyond the most that the supply can give, its turning point
        given = self._asked(p, effort)
        given = jnp.where(p.law == 3, jnp.sum(given), given)
        share = 2.0 / (1.0 + jnp.sqrt(jnp.maximum(1.0 - 4.0 * p.sag * given, 1e-12)))
        later = 1.0 / jnp.maximum(1.0 - p.sag * view.own[0], LEAST)
        return effort * jnp.where((p.law == 0) | (p.law == 3), share, later) ** 2

    def rates(self, p: Values, view: View) -> tuple[Side, ...]:
        given = self._asked(p, view.effort)
        return (jnp.where(p.law == 1, given / p.reference_time, (given - view.own[0]) / p.time_constant),)

    def initial(self, p: Values, view: View) -> tuple[Side, ...]:
        """As long drained by what has kept it so warm (law polarisation): what it had given by then is not known."""
        share = jnp.maximum(view.effort, 0.0) / p.reference**2
        # nearly its root, but for the little that a cold one's temperature is uncertain by
        return (jnp.where(p.law == 2, share / jnp.sqrt(share + LITTLE), 0.0),)
