"""A thermal force that does not grow in proportion to the temperature."""

from typing import ClassVar

import jax.numpy as jnp

from scpjax.parameter import Parameter
from scpjax.physics.mechanism import Mechanism, Side, Values, View
from scpjax.physics.smooth import ramp

WIDTH = 0.1  # of the reference excess: how gradually the coefficient changes beyond a threshold
GLASS, SHAPED = 4, 5
ROUND = 0.02  # of the reference excess, over which the power law is rounded where its slope is not finite
TINY = 1e-8  # added to the square of the temperature, as a share of the reference: a power of it has a slope at 0
LEAST = 0.05  # of what saturates, where it would rather grow beyond any bounds


class NonlinearThermalForce(Mechanism):
    name = "nonlinear_thermal_force"
    title = "Force is not proportional to temperature"
    subsystem = "thermomechanical"
    equation = (
        "law quadratic: F = C T (1 + a T/T_ref);  law saturating: F = C T / sqrt(1 + a (T/T_ref)^2);  "
        "law saturating, shaped: F = C T (1 + a |T/T_ref|^n)^(-1/n);  law threshold: "
        "F = C (T + a ramp(T - T_g T_ref)), the ramp's corner rounded over T_ref/10, law glass transition: over "
        "w T_ref;  law power: F = C T |T/T_ref|^a, rounded within T_ref/50 of ambient"
    )
    source = (
        "expansion of drawn nylon grows with temperature, with a change at the glass transition: "
        "Haines et al., Science 343 (2014) 868; Choy, Chen, Young, J. Polym. Sci. B 19 (1981) 335; a bend of any "
        "abruptness into a limit: Churchill, Usagi, AIChE J. 18 (1972) 1121"
    )
    says = "Each further degree pulls harder (or less hard) than the one before."
    needs = ("mechanical",)
    excited_by = "steady states at several voltages"
    laws = ("quadratic", "saturating", "threshold", "power", "glass transition", "saturating, shaped")
    only_under: ClassVar[dict[str, tuple[int, ...]]] = {
        "transition": (2, GLASS),
        "width": (GLASS,),
        "abruptness": (SHAPED,),
    }
    parameters = (
        Parameter(
            name="growth",
            symbol="a",
            unit="1",
            description="relative change of the coefficient: at the reference excess (quadratic), of its inverse "
            "square (saturating) or n-th power (saturating, shaped) there, beyond the transition (threshold, glass "
            "transition); one less than the exponent (power)",
            typical=0.0,
            bounds=(-0.95, 10.0),
            null=0.0,
            scale="linear",
            spread=1.0,
        ),
        Parameter(
            name="transition",
            symbol="T_g",
            unit="1",
            description="temperature excess of the transition, as a share of the reference (laws threshold, glass "
            "transition)",
            typical=0.4,
            bounds=(0.02, 1.5),
            null=0.4,
            spread=0.7,
        ),
        Parameter(
            name="width",
            symbol="w",
            unit="1",
            description="temperature excess over which the corner is rounded, half of the change within 0.58 of it to "
            "either side, as a share of the reference (law glass transition)",
            typical=0.2,
            bounds=(0.02, 2.0),
            null=0.2,
            spread=0.7,
        ),
        Parameter(
            name="abruptness",
            symbol="n",
            unit="1",
            description="how abruptly it bends towards its limit (law saturating, shaped)",
            typical=2.0,
            bounds=(0.5, 10.0),
            null=2.0,
            spread=0.7,
        ),
        Parameter(
            name="reference",
            symbol="T_ref",
            unit="K",
            description="temperature excess at which the relative change is stated",
            typical=50.0,
            bounds=(1e-6, 1e9),
            null=50.0,
            fixed=True,
        ),
    )
    starts = ((0.4, 0.4, 0.2, 2.0, 0.0), (-0.3, 0.5, 0.2, 2.0, 0.0))

    def pull(self, p: Values, view: View) -> Side:
        t = view.actuating / p.reference
        quadratic = p.growth * t * t
        saturating = t / jnp.sqrt(jnp.maximum(1.0 + p.growth * t * t, LEAST)) - t
        shaped = jnp.maximum(1.0 + p.growth * (t * t + TINY) ** (0.5 * p.abruptness), LEAST)
        threshold = p.growth * ramp(t, p.transition, jnp.where(p.law == GLASS, p.width, WIDTH))
        power = t * ((t * t + ROUND**2) ** (0.5 * p.growth) - 1.0)
        which = [p.law == 0, p.law == 1, p.law == 3, p.law == SHAPED]
        more = jnp.select(which, [quadratic, saturating, power, t * shaped ** (-1.0 / p.abruptness) - t], threshold)
        return view.shared["coefficient"] * p.reference * more
