"""Hysteresis: heating and cooling take different paths through the same displacement."""

import jax.numpy as jnp

from scpjax.parameter import Parameter
from scpjax.physics.mechanism import Mechanism, Side, Values, View

OVER = 1.05  # |z| stays below 1 but for the integrator's overshoot, which is cut off here


class Hysteresis(Mechanism):
    name = "hysteresis"
    title = "Hysteresis"
    subsystem = "thermomechanical"
    equation = "F = -h k w z,  dz/dt = (v/w) (1 - |z|^n (1 + sign(v z))/2)"
    source = "Bouc-Wen, rate independent: Ismail, Ikhouane, Rodellar, Arch. Comput. Methods Eng. 16 (2009) 161"
    says = "The way back is not the way there: after a reversal the displacement stays behind."
    needs = ("mechanical",)
    excited_by = "reversals of different size"
    states = ("internal_stretch",)
    parameters = (
        Parameter(
            name="strength",
            symbol="h",
            unit="1",
            description="stiffness of the hysteretic element, as a share of k",
            typical=0.3,
            bounds=(0.003, 300.0),
            null=0.0,
            spread=1.5,
        ),
        Parameter(
            name="width",
            symbol="w",
            unit="1",
            description="displacement over which the element slips, as a share of the reference displacement",
            typical=0.1,
            bounds=(0.001, 2.0),
            null=0.1,
            spread=1.5,
        ),
        Parameter(
            name="sharpness",
            symbol="n",
            unit="1",
            description="how abruptly it slips",
            typical=3.0,
            bounds=(1.0, 30.0),
            null=3.0,
            spread=1.0,
        ),
        Parameter(
            name="reference",
            symbol="x_ref",
            unit="m",
            description="displacement at which the width is stated",
            typical=0.01,
            bounds=(1e-12, 1e12),
            null=0.01,
            fixed=True,
        ),
    )
    starts = ((0.3, 0.15, 3.0, 0.0), (2.0, 0.02, 2.0, 0.0))

    def force(self, p: Values, view: View) -> Side:
        return -p.strength * view.shared["stiffness"] * p.width * p.reference * jnp.clip(view.own[0], -OVER, OVER)

    def rates(self, p: Values, view: View) -> tuple[Side, ...]:
        z = jnp.clip(view.own[0], -OVER, OVER)
        rate = view.velocity / (p.width * p.reference)
        fill = jnp.exp(p.sharpness * jnp.log(jnp.sqrt(z**2 + 1e-12)))
        # left out (strength 0), the element rests: its state could not matter and a step might be too long for it
        return (jnp.where(p.strength > 0, rate * (1.0 - fill * jnp.where(rate * z > 0, 1.0, 0.0)), 0.0),)

    def initial(self, p: Values, view: View) -> tuple[Side, ...]:
        return (jnp.zeros_like(view.displacement),)
