"""Hysteresis: heating and cooling take different paths through the same displacement."""

from typing import ClassVar

import jax.numpy as jnp

from scpjax.parameter import Parameter
from scpjax.physics.mechanism import Mechanism, Side, Values, View

OVER = 1.05  # |z| stays below 1 but for the integrator's overshoot, which is cut off here

NARROWER = 3.0  # the second play's width goes into that of the first so many times
SHARP = 8.0  # sharpness of the corners of plays


class Hysteresis(Mechanism):
    name = "hysteresis"
    title = "Hysteresis"
    subsystem = "thermomechanical"
    equation = (
        "F = -h k w z;  law Bouc-Wen: dz/dt = (v/w) (1 - |z|^n (1 + sign(v z))/2);  law Duhem: dz/dt = (v - |v| z)/w;  "
        "law plays: two plays of widths w and w/3, F = -h k w (z + z_2/3)/2, each as Bouc-Wen with n = 8;  "
        "law thermal plays: the same, moved by dT/dt x_ref/T_ref in place of v"
    )
    source = (
        "Bouc-Wen, rate independent: Ismail, Ikhouane, Rodellar, Arch. Comput. Methods Eng. 16 (2009) 161; Duhem and "
        "plays: Visintin, Differential Models of Hysteresis (1994), ch. III, V"
    )
    says = "The way back is not the way there: after a reversal the displacement stays behind."
    needs = ("mechanical",)
    excited_by = "reversals of different size"
    laws = ("Bouc-Wen", "Duhem", "plays", "thermal plays")
    law_needs: ClassVar[dict[int, tuple[str, ...]]] = {3: ("thermal",)}
    only_under: ClassVar[dict[str, tuple[int, ...]]] = {"sharpness": (0,)}
    states = ("internal_stretch", "second_stretch")
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
            description="how abruptly it slips (law Bouc-Wen)",
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
        Parameter(
            name="reference_temperature",
            symbol="T_ref",
            unit="K",
            description="temperature excess at which the width is stated (law thermal plays)",
            typical=50.0,
            bounds=(1e-6, 1e9),
            null=50.0,
            fixed=True,
        ),
    )
    starts = ((0.3, 0.15, 3.0, 0.0, 0.0), (2.0, 0.02, 2.0, 0.0, 0.0))

    def force(self, p: Values, view: View) -> Side:
        first, second = (jnp.clip(z, -OVER, OVER) for z in view.own)
        stretch = jnp.where(p.law >= 2, 0.5 * (first + second / NARROWER), first)
        return -p.strength * view.shared["stiffness"] * p.width * p.reference * stretch

    def rates(self, p: Values, view: View) -> tuple[Side, ...]:
        first, second = (jnp.clip(z, -OVER, OVER) for z in view.own)
        moved = jnp.where(p.law == 3, view.warming / p.reference_temperature, view.velocity / p.reference)
        rate = moved / p.width
        sharpness = jnp.where(p.law >= 2, SHARP, p.sharpness)
        fill = jnp.exp(sharpness * jnp.log(jnp.sqrt(first**2 + 1e-12)))
        slip = rate * (1.0 - fill * jnp.where(rate * first > 0, 1.0, 0.0))
        slip = jnp.where(p.law == 1, rate - jnp.abs(rate) * first, slip)
        eighth = ((second * second) ** 2) ** 2
        other = NARROWER * rate * (1.0 - eighth * jnp.where(rate * second > 0, 1.0, 0.0))
        # left out (strength 0), the element rests: its state could not matter and a step might be too long for it
        there = p.strength > 0
        return (jnp.where(there, slip, 0.0), jnp.where(there & (p.law >= 2), other, 0.0))

    def initial(self, p: Values, view: View) -> tuple[Side, ...]:
        rest = jnp.zeros_like(view.displacement)
        return (rest, rest)
