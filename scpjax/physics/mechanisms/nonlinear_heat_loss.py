"""Heat loss that grows faster than the temperature excess: natural convection and radiation."""

from typing import ClassVar

import jax.numpy as jnp
from jaxtyping import Array

from scpjax.parameter import Parameter
from scpjax.physics.mechanism import Mechanism, Side, Values, View

FORM = 0.1  # of d ln(loss/T) / d ln(T), left to the form of a law


class NonlinearHeatLoss(Mechanism):
    name = "nonlinear_heat_loss"
    title = "Heat loss grows faster than the temperature"
    subsystem = "thermoelectric"
    equation = (
        "law power: loss = lambda T (1 + a (|T|/T_ref)^n);  law radiation: loss = lambda T (1 + a r(T)/r(T_ref)), "
        "r T = (T_a + T)^4 - T_a^4 - 4 T_a^3 T"
    )
    source = (
        "natural convection n = 1/4, radiation about n = 1: "
        "Incropera, Fundamentals of Heat and Mass Transfer, ch. 9, 12"
    )
    impossible = "a loss that grows faster than those of natural convection and of a black body do"
    says = "A hot actuator loses more heat per degree than a warm one, because the air rises faster and it glows."
    needs = ("thermal",)
    excited_by = "cooling curves and steady states at several voltages"
    laws = ("power", "radiation")
    only_under: ClassVar[dict[str, tuple[int, ...]]] = {"exponent": (0,)}
    parameters = (
        Parameter(
            name="strength",
            symbol="a",
            unit="1",
            description="extra conductance, as a share of λ, at the reference excess",
            typical=0.5,
            bounds=(0.01, 20.0),
            null=0.0,
            spread=1.5,
        ),
        Parameter(
            name="exponent",
            symbol="n",
            unit="1",
            description="growth of the conductance with the temperature excess (law power)",
            typical=0.5,
            bounds=(0.15, 2.0),
            null=0.5,
            spread=0.6,
            strict=True,  # from forced convection to radiation of what is very hot
        ),
        Parameter(
            name="reference",
            symbol="T_ref",
            unit="K",
            description="temperature excess at which the strength is stated",
            typical=50.0,
            bounds=(1e-6, 1e9),
            null=50.0,
            fixed=True,
        ),
    )
    starts = ((0.3, 0.4, 0.0), (1.5, 0.8, 0.0))

    def heat(self, p: Values, view: View) -> Side:
        # the small floor keeps the derivative of |T|^n finite at T = 0, far below any thermometer's resolution
        relative = jnp.sqrt(view.temperature**2 + (1e-5 * p.reference) ** 2) / p.reference
        power = jnp.exp(p.exponent * jnp.log(relative))
        warm, hot = view.temperature / view.ambient, p.reference / view.ambient
        radiated = warm * (6.0 + warm * (4.0 + warm)) / (hot * (6.0 + hot * (4.0 + hot)))
        growth = jnp.where(p.law == 1, radiated, power)
        return -view.shared["conductance"] * p.strength * growth * view.temperature

    def beyond_physics(self, p: Values, ambient: float | Array) -> Array | float:
        """By how much d ln(loss/T) / d ln(T) at the reference excess is above that of what grows fastest once it is
        there, turbulent natural convection (1/3) or a black body in its room, and a tenth. Of flows side by side it is
        a mean. The tenth is for a law that is none of these powers, and for air that has yet to begin to move.
        """
        hot = p.reference / ambient
        black = 1.0 + hot * (6.0 + hot * (4.0 + hot)) / 4.0  # loss / T, as a multiple of that of a small excess
        fastest = hot * (6.0 + hot * (8.0 + hot * 3.0)) / 4.0 / black
        radiated = p.strength * hot * (6.0 + hot * (8.0 + hot * 3.0)) / 4.0 / (black - 1.0)
        grows = jnp.where(p.law == 1, radiated, p.strength * p.exponent) / (1.0 + p.strength)
        return jnp.max(grows - jnp.maximum(fastest, 1.0 / 3.0) - FORM)
