"""Slack in what couples the coil to the load."""

from typing import ClassVar

import jax.numpy as jnp

from scpjax.parameter import Parameter
from scpjax.physics.mechanism import Mechanism, Quantity, Side, Values, View
from scpjax.physics.smooth import clipped, root

SOFT = (0, 1)  # laws whose corners are as wide as the data say
ROUND = 0.02  # of the gap: the width of the other laws' corners
CABLES = 3


class Slack(Mechanism):
    name = "slack"
    title = "Slack in the tendon"
    subsystem = "thermomechanical"
    equation = (
        "law tendon: the sensor's side moves by x - clip(x, -G, G), G = g x_ref;  "
        "law pull: F = P - clip(P, -k G, k G), P all that warmth pulls;  corners of both rounded over w G;  "
        "law toe: F = P |P| / (4 k G) up to P = 2 k G, P - k G beyond;  law cables, of a joint: "
        "F = max(P - S - k G, 0) in place of P - S, S all with which the spring answers, for each side, rounded over "
        "k G/50; what else pushes still does"
    )
    source = (
        "dead zone of a slack cable: Tao, Kokotovic, Adaptive Control of Systems with Actuator and Sensor "
        "Nonlinearities (1996), ch. 2; slack and the toe of a tendon whose fibres straighten one after another: "
        "Zajac, Crit. Rev. Biomed. Eng. 17 (1989) 359"
    )
    says = "The coil first has to take up the slack of its tendon before anything moves."
    needs = ("mechanical",)
    excited_by = "heating slowly from cold, and small steps about cold"
    laws = ("tendon", "pull", "toe", "cables")
    law_needs: ClassVar[dict[int, tuple[str, ...]]] = {CABLES: ("joint",)}
    only_under: ClassVar[dict[str, tuple[int, ...]]] = {"corner": SOFT}
    parameters = (
        Parameter(
            name="gap",
            symbol="g",
            unit="1",
            description="contraction that only takes up slack, as a share of the greatest travel",
            typical=0.15,
            bounds=(0.003, 10.0),
            null=0.0,
            spread=1.5,
        ),
        Parameter(
            name="corner",
            symbol="w",
            unit="1",
            description="contraction over which the tendon grows taut, as a share of the slack (laws tendon, pull)",
            typical=0.1,
            bounds=(0.005, 1.0),
            null=0.1,
            spread=1.0,
        ),
        Parameter(
            name="reference",
            symbol="x_ref",
            unit="m",
            description="greatest travel that was seen",
            typical=0.01,
            bounds=(1e-12, 1e12),
            null=0.01,
            fixed=True,
        ),
    )
    starts = ((0.1, 0.1, 0.0), (0.35, 0.03, 0.0))

    @property
    def may_need_short_steps(self) -> bool:
        """Between slack cables nothing is left of the spring, which a step takes exactly elsewhere."""
        return True

    def force(self, p: Values, view: View) -> Side:
        gap = p.gap * p.reference * view.shared["stiffness"]
        pull = view.pull
        idle = jnp.where(p.law == 1, gap, 0.0)
        taut = 2.0 * jnp.where((p.law == 2) & (gap > 0), gap, 1.0)
        toe = jnp.clip(pull, -taut, taut)
        toe = jnp.where((p.law == 2) & (gap > 0), toe - toe * jnp.abs(toe) / (2.0 * taut), 0.0)
        whole = pull - view.restoring
        beyond = whole - gap
        held = 0.5 * (beyond + root(beyond * beyond + (ROUND * gap) ** 2))
        cable = jnp.where((p.law == CABLES) & (gap > 0), held - whole, 0.0)
        return cable - clipped(pull, idle, p.corner * idle) - toe

    def reading(self, p: Values, view: View, quantity: Quantity, value: Side) -> Side:
        if quantity != "displacement":
            return value
        gap = jnp.where(p.law == 0, p.gap * p.reference, 0.0)
        return value - clipped(view.displacement, gap, p.corner * gap)
