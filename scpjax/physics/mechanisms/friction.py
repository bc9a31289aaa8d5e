"""Dry friction: a force that opposes motion, however slow."""

from typing import ClassVar

import jax.numpy as jnp

from scpjax.parameter import Parameter
from scpjax.physics.mechanism import Mechanism, Side, Values, View
from scpjax.physics.step_end import ahead

CORNER = 0.1  # makes s(u) tanh(u) to within 0.05
FASTER = 10.0  # velocity, in velocity scales, at which two thirds of the extra friction at rest are gone (law LuGre)
OVER = 1.05  # |z| stays below 1 but for the integrator's overshoot, which is cut off here


class Friction(Mechanism):
    name = "friction"
    title = "Dry friction"
    subsystem = "thermomechanical"
    equation = (
        "F = -F_c s(v/v_s), F_c = f k x_ref, v_s = x_ref/t_s, and s, nearly tanh, by u = s + 0.1 s |s|/(1 - |s|);  "
        "law Stribeck: F_c (1 + b exp(-(v/(c v_s))^2));  law Dahl: F = -F_c z, dz/dt = (v - |v| z)/(w x_ref);  "
        "law LuGre: F = -F_c z, dz/dt = (v - |v| z/(1 + b exp(-(v/(10 v_s))^2)))/(w x_ref)"
    )
    source = (
        "Coulomb and Stribeck friction: Armstrong-Helouvry, Dupont, Canudas de Wit, Automatica 30 (1994) 1083, this "
        "with the exponential of Bo, Pavelescu, Wear 82 (1982) 277; "
        "taken at the velocity of the end of a step: Kikuuwe et al., IEEE Trans. Robot. 22 (2006) 1176; a contact that "
        "gives before it slips: Dahl, Aerospace Corp. TOR-0158 (1968), which is Duhem's hysteresis; and holds faster "
        "at rest: Canudas de Wit, Olsson, Astrom, Lischinsky, IEEE Trans. Automat. Contr. 40 (1995) 419"
    )
    says = "The load sticks until the pull exceeds the friction, then slides: it always lags behind."
    needs = ("mechanical",)
    excited_by = "slow reversals"
    laws = ("Coulomb", "Stribeck", "Dahl", "LuGre")
    only_under: ClassVar[dict[str, tuple[int, ...]]] = {
        "velocity_time": (0, 1, 3),
        "static": (1, 3),
        "faster": (1,),
        "presliding": (2, 3),
    }
    states = ("presliding_stretch",)
    parameters = (
        Parameter(
            name="strength",
            symbol="f",
            unit="1",
            description="friction, as a share of the spring's force at the reference displacement",
            typical=0.05,
            bounds=(0.001, 3.0),
            null=0.0,
            spread=1.5,
        ),
        Parameter(
            name="velocity_time",
            symbol="t_s",
            unit="s",
            description="time in which the reference displacement is passed at the velocity scale v_s = x_ref/t_s",
            typical=30.0,
            bounds=(0.3, 3000.0),
            null=30.0,
            spread=2.0,
            time="response",
        ),
        Parameter(
            name="static",
            symbol="b",
            unit="1",
            description="extra friction at rest, as a share of that when sliding (laws Stribeck and LuGre)",
            typical=0.3,
            bounds=(0.01, 5.0),
            null=0.3,
            spread=1.0,
        ),
        Parameter(
            name="faster",
            symbol="c",
            unit="1",
            description="velocity at which two thirds of the extra friction at rest are gone, in velocity scales (law "
            "Stribeck)",
            typical=10.0,
            bounds=(1.0, 300.0),
            null=10.0,
            spread=1.0,
        ),
        Parameter(
            name="presliding",
            symbol="w",
            unit="1",
            description="displacement over which the contact gives before it slips, as a share of the reference "
            "displacement (laws Dahl and LuGre)",
            typical=0.03,
            bounds=(0.001, 1.0),
            null=0.03,
            spread=1.5,
        ),
        Parameter(
            name="reference",
            symbol="x_ref",
            unit="m",
            description="displacement at which friction and velocity scale are stated",
            typical=0.01,
            bounds=(1e-12, 1e12),
            null=0.01,
            fixed=True,
        ),
    )
    starts = ((0.05, 30.0, 0.3, 10.0, 0.03, 0.0), (0.2, 30.0, 0.3, 10.0, 0.1, 0.0))

    def force(self, p: Values, view: View) -> Side:
        most = OVER * self._most(p)
        given = p.strength * view.shared["stiffness"] * p.reference * jnp.clip(view.own[0], -most, most)
        return jnp.where(p.law > 1, -given, 0.0)

    def rates(self, p: Values, view: View) -> tuple[Side, ...]:
        rate, most = view.velocity / (p.presliding * p.reference), self._most(p)
        past = view.velocity * p.velocity_time / (FASTER * p.reference)
        slips = 1.0 + (most - 1.0) * jnp.exp(-jnp.square(past))
        # under other laws, and left out, the contact rests: a step might be too long for it
        gives = (p.law > 1) & (p.strength > 0)
        stretched = jnp.clip(view.own[0] / slips, -OVER * most, OVER * most)
        return (jnp.where(gives, rate - jnp.abs(rate) * stretched, 0.0),)

    def holds(self, p: Values) -> Side:
        return p.strength > 0

    def initial(self, p: Values, view: View) -> tuple[Side, ...]:
        """What holds it beside its equilibrium, if it begins there (laws Dahl and LuGre)."""
        reach, most = jnp.maximum(p.strength, 1e-9) * p.reference, self._most(p)  # m, that it could hold
        held = jnp.where(p.law > 1, jnp.clip(-view.displaced / reach, -most, most), 0.0)
        return (held * jnp.ones_like(view.displacement),)

    def _most(self, p: Values) -> Side:
        """The greatest stretch of a contact that gives, in units of that at which it slips when sliding."""
        return jnp.where(p.law == 3, 1.0 + p.static, 1.0)

    def resistance(self, p: Values, view: View, force: Side) -> Side:
        """At the velocity u of a step's end (`scpjax.physics.step_end.ahead`): ``a u + F_c s(u/v_s) = G``, for this s a
        quadratic equation.
        """
        step, still = view.step, jnp.ones_like(view.velocity)
        slow = p.reference / p.velocity_time
        dry = jnp.where(p.law > 1, 0.0, p.strength * view.shared["stiffness"] * p.reference)
        past = view.velocity / (p.faster * slow)
        dry = jnp.where(p.law == 1, dry * (1.0 + p.static * jnp.exp(-past * past)), dry)
        a, wanted = ahead(view, force)
        held, viscous = step * jnp.sum(dry * still), a * slow
        size = jnp.abs(wanted)
        left = held + viscous - size
        return -2.0 * dry * wanted / (held + viscous + size + jnp.sqrt(left * left + 4.0 * CORNER * viscous * size))
