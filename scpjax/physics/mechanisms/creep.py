"""Creep: the polymer goes on moving after the force has stopped changing."""

from typing import ClassVar

import jax.numpy as jnp
from jaxtyping import Array

from scpjax.parameter import Parameter
from scpjax.physics.mechanism import Mechanism, Side, Values, View

MOST_CREPT = 5.0  # of the immediate displacement; of much more only a dashpot is left beside a spring: damping
_MOST_NEPERS = 10.0  # nepers, by which warmth or what has crept changes the retardation time
DECADE = 10.0  # between the branches of law logarithmic; their sum follows a logarithm to 4 % of a decade's creep
STEP, STEPS = 5.0, 4  # between the branches of law power, of which there are so many


class Creep(Mechanism):
    name = "creep"
    title = "Creep"
    subsystem = "thermomechanical"
    equation = (
        "tau dx_c/dt = J e - x_c, e = x - x_c - x_s;  the spring feels e;  "
        "law two branches: also r tau dx_s/dt = J_s e - x_s;  law logarithmic: J_s = J = half of J each, r = 10;  "
        "law slow recovery: r tau on the way back;  "
        "law activated: tau dx_c/dt = s x_ref sinh((J e - x_c)/(s x_ref));  "
        "law thermal: tau exp((T_ref/2 - T)/T_s) in the place of tau;  "
        "law hardening: tau exp(|x_c|/(h x_ref)) in the place of tau;  law power: four branches, tau_i = 5^i tau, "
        "i = -3/2 .. 3/2, J_i = J 5^(n i)/(sum of these), which follow e t^n from tau/11 to 11 tau"
    )
    source = (
        "Kelvin-Voigt branches in series with the spring: Findley, Lai, Onaran, Creep and Relaxation of Nonlinear "
        "Viscoelastic Materials, ch. 5; power: Findley's law, ch. 3 there, as a sum of exponentials; logarithmic: a "
        "flat spectrum of retardation times, ch. 5 there; activated: "
        "Eyring, J. Chem. Phys. 4 (1936) 283, a dashpot in a standard linear solid: Halsey, White, Eyring, Text. Res. "
        "J. 15 (1945) 295; thermal: times shift together with temperature, Williams, Landel, Ferry, J. Am. Chem. Soc. "
        "77 (1955) 3701, here straight in T; hardening: the rate falls exponentially with what has crept, Cottrell, "
        "J. Mech. Phys. Solids 1 (1952) 53"
    )
    says = "Under a steady pull the polymer keeps giving way slowly, and comes back slowly."
    needs = ("mechanical",)
    excited_by = "long holds after a step"
    laws = ("one branch", "two branches", "logarithmic", "slow recovery", "activated", "thermal", "hardening", "power")
    law_needs: ClassVar[dict[int, tuple[str, ...]]] = {5: ("thermal",)}
    only_under: ClassVar[dict[str, tuple[int, ...]]] = {
        "slow_compliance": (1,),
        "slow_ratio": (1, 3),
        "activation": (4,),
        "shift": (5,),
        "hardening": (6,),
        "exponent": (7,),
        "reference": (4, 6),
        "reference_temperature": (5,),
    }
    states = ("creep_displacement", *(f"{how}_creep_displacement" for how in ("slow", "slower", "slowest")))
    parameters = (
        Parameter(
            name="compliance",
            symbol="J",
            unit="1",
            description="slow displacement as a share of the immediate one",
            typical=0.2,
            bounds=(0.003, MOST_CREPT),
            null=0.0,
            spread=1.5,
            strict=True,
        ),
        Parameter(
            name="time_constant",
            symbol="τ",
            unit="s",
            description="retardation time; of the quicker branch (laws two branches, logarithmic), in the middle (law "
            "power), at half the reference temperature (law thermal), where nothing has crept (law hardening)",
            typical=1.0,
            bounds=(0.02, 100.0),
            null=1.0,
            spread=2.0,
            time="response",
        ),
        Parameter(
            name="slow_compliance",
            symbol="J_s",
            unit="1",
            description="displacement of the slower branch as a share of the immediate one (law two branches)",
            typical=0.2,
            bounds=(0.003, MOST_CREPT),
            null=0.0,
            spread=1.5,
            strict=True,
        ),
        Parameter(
            name="slow_ratio",
            symbol="r",
            unit="1",
            description="retardation time of the slower branch over that of the other (law two branches), of the way "
            "back over that of the way there (law slow recovery)",
            typical=5.0,
            bounds=(1.5, 100.0),
            null=5.0,
            spread=1.0,
        ),
        Parameter(
            name="activation",
            symbol="s",
            unit="1",
            description="displacement that creep may lack before it goes e times as fast, as a share of the reference "
            "displacement (law activated)",
            typical=0.1,
            bounds=(0.002, 3.0),
            null=0.1,
            spread=1.5,
        ),
        Parameter(
            name="shift",
            symbol="T_s",
            unit="K",
            description="warming with which creep goes e times as fast (law thermal)",
            typical=30.0,
            bounds=(3.0, 3000.0),
            null=30.0,
            spread=1.0,
        ),
        Parameter(
            name="hardening",
            symbol="h",
            unit="1",
            description="displacement crept with which creep goes e times as slowly, as a share of the reference "
            "displacement (law hardening)",
            typical=0.2,
            bounds=(0.005, 30.0),
            null=0.2,
            spread=1.5,
        ),
        Parameter(
            name="exponent",
            symbol="n",
            unit="1",
            description="power of the time with which creep goes on (law power)",
            typical=0.3,
            bounds=(-1.0, 1.5),
            null=0.3,
            scale="linear",
            spread=0.4,
        ),
        Parameter(
            name="reference",
            symbol="x_ref",
            unit="m",
            description="displacement at which activation and hardening are stated (laws activated, hardening)",
            typical=0.01,
            bounds=(1e-12, 1e12),
            null=0.01,
            fixed=True,
        ),
        Parameter(
            name="reference_temperature",
            symbol="T_ref",
            unit="K",
            description="twice the temperature excess at which the retardation time is stated (law thermal)",
            typical=50.0,
            bounds=(1e-6, 1e9),
            null=50.0,
            fixed=True,
        ),
    )
    last_to_hold = True
    starts = ((0.3, 1.0, 0.2, 4.0, 0.1, 30.0, 0.2, 0.3, 0.0, 0.0), (0.5, 5.0, 0.3, 4.0, 0.03, 60.0, 0.1, 0.3, 0.0, 0.0))

    def _branches(self, p: Values) -> list[tuple[Side, Side]]:
        """Compliance of every branch, and its time as a multiple of the time constant."""
        logarithmic, power = p.law == 2, p.law == 7
        weights = [jnp.exp(jnp.log(STEP) * p.exponent * i) for i in range(STEPS)]
        shares = [jnp.where(power, w / sum(weights), 0.0) for w in weights]
        shares[0] = jnp.where(power, shares[0], jnp.where(logarithmic, 0.5, 1.0))
        shares[1] = jnp.where(logarithmic, 0.5, shares[1])
        compliances = [share * p.compliance for share in shares]
        compliances[1] = jnp.where(p.law == 1, p.slow_compliance, compliances[1])
        middle = 0.5 * (STEPS - 1)
        times = [jnp.where(power, STEP ** (i - middle), 1.0) for i in range(STEPS)]
        times[1] = jnp.where(logarithmic, DECADE, jnp.where(power, times[1], p.slow_ratio))
        return list(zip(compliances, times, strict=True))

    def deflection(self, p: Values, view: View, deflection: Side) -> Side:
        return deflection - self._crept(p, view)

    def rates(self, p: Values, view: View) -> tuple[Side, ...]:
        quick, *slow = view.own
        immediate = view.displacement - quick - sum(slow)
        (compliance, first), *slower_branches = self._branches(p)
        ahead = compliance * immediate - quick
        slower = jnp.where((p.law == 3) & (ahead * quick < 0), p.slow_ratio, 1.0)
        colder = jnp.where(p.law == 5, (0.5 * p.reference_temperature - view.temperature) / p.shift, 0.0)
        harder = jnp.where(p.law == 6, jnp.abs(quick) / (p.hardening * p.reference), 0.0)
        time = first * p.time_constant * slower * jnp.exp(jnp.clip(colder + harder, -_MOST_NEPERS, _MOST_NEPERS))
        lacking = _within(quick)
        pushed = (1.0 - lacking**2) * p.compliance * view.velocity / (2.0 * p.activation * p.reference)
        activated = pushed - (1.0 + p.compliance) * quick / p.time_constant
        return (
            jnp.where(p.law == 4, activated, ahead / time),
            *(
                (j * immediate - crept) / (ratio * p.time_constant)
                for (j, ratio), crept in zip(slower_branches, slow, strict=True)
            ),
        )

    def carried(self, p: Values, before: View, after: View, step: Array) -> tuple[Side, ...]:
        """Law activated, solved for a steady velocity: dw/dt = a (1 - w^2) - b w, a Riccati equation."""
        w = _within(before.own[0])
        moved = after.displacement - before.displacement
        a = p.compliance * moved / (2.0 * p.activation * p.reference)
        b = (1.0 + p.compliance) * step / p.time_constant
        d = jnp.sqrt(b * b + 4.0 * a * a + 1e-30)
        t = jnp.tanh(0.5 * d)
        solved = (w * (d - b * t) + 2.0 * a * t) / (d + (b + 2.0 * a * w) * t)
        return jnp.where(p.law == 4, solved, after.own[0]), *after.own[1:]

    def initial(self, p: Values, view: View) -> tuple[Side, ...]:
        """Crept as far as it does at rest; and where it begins beside its equilibrium, that it has crept farther, or
        less far, up to what the greatest displacement makes it creep: the spring then holds still.
        """
        compliances = [compliance for compliance, _ in self._branches(p)]
        whole = sum(compliances)
        most = whole * p.reference
        beside = jnp.clip(view.displaced, -most, most)
        immediate = (view.displacement - beside) / (1 + whole)
        quick, *slow = (j * (immediate + beside / jnp.maximum(whole, 1e-12)) for j in compliances)
        return (jnp.where(p.law == 4, -jnp.tanh(0.5 * beside / (p.activation * p.reference)), quick), *slow)

    def _crept(self, p: Values, view: View) -> Side:
        """Displacement [m] that came late.

        Under law activated the first state is w = tanh(y/2), y = (J e - x_c)/(s x_ref): dy/dt = J/(s x_ref) de/dt -
        sinh(y)/tau then has no term that grows without bound, and x_c follows from w and x.
        """
        quick, *slow = view.own
        lacking = 2.0 * p.activation * p.reference * jnp.arctanh(_within(quick))
        activated = (p.compliance * view.displacement - lacking) / (1.0 + p.compliance)
        return jnp.where(p.law == 4, activated, quick + sum(slow))


def _within(w: Side) -> Side:
    """tanh(y/2) as far as it can be told from 1; the integrator may overshoot."""
    return jnp.clip(w, -1.0 + 1e-9, 1.0 - 1e-9)
