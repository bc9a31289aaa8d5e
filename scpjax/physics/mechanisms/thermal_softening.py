"""A coil that is softer when it is hot."""

from typing import ClassVar

import jax.numpy as jnp

from scpjax.parameter import Parameter
from scpjax.physics.mechanism import Mechanism, Side, Values, View
from scpjax.physics.smooth import rise

WLF = 3
_COLDEST = 0.05  # of the reference excess above where the shift has no end


class ThermalSoftening(Mechanism):
    name = "thermal_softening"
    title = "The hot coil is softer"
    subsystem = "thermomechanical"
    equation = (
        "law linear: F = -S (1 - a T/T_ref), S all with which the spring answers;  law glass transition: "
        "F = -S (1 - a s(T)), s = (1 + tanh((r - T_g)/w))/2 less what that is at T = 0;  law exponential: "
        "F = -S exp(-a r);  law WLF: F = -S exp(-a r (1 + T_g)/max(T_g + r, 1/20));  r = T/T_ref"
    )
    source = (
        "modulus of nylon against temperature, halved through its glass transition at 40 to 60 degC: "
        "Ward, Sweeney, Mechanical Properties of Solid Polymers, ch. 5 and 7; hyperbolic tangent through a transition: "
        "Gibson, Wu, Evans, Mouritz, J. Compos. Mater. 40 (2006) 639; a power of the shift factor that falls as "
        "Williams, Landel and Ferry say: J. Am. Chem. Soc. 77 (1955) 3701"
    )
    says = "Warm polymer is softer than cold polymer, so the coil's stiffness falls as it heats."
    needs = ("mechanical",)
    excited_by = "the same load at several temperatures"
    laws = ("linear", "glass transition", "exponential", "WLF")
    only_under: ClassVar[dict[str, tuple[int, ...]]] = {"transition": (1, WLF), "width": (1,)}
    parameters = (
        Parameter(
            name="softening",
            symbol="a",
            unit="1",
            description="share of the stiffness that is lost: at the reference excess (linear; exponential, WLF: "
            "its logarithm), far beyond the transition (glass transition)",
            typical=0.3,
            bounds=(0.003, 0.95),
            null=0.0,
            spread=1.5,
        ),
        Parameter(
            name="transition",
            symbol="T_g",
            unit="1",
            description="temperature excess of the transition, or by which half of what WLF's shift can reach is "
            "there, as a share of the reference",
            typical=0.4,
            bounds=(0.1, 1.5),
            null=0.4,
            spread=0.7,
        ),
        Parameter(
            name="width",
            symbol="w",
            unit="1",
            description="width of the transition, as a share of the reference excess",
            typical=0.15,
            bounds=(0.05, 1.0),
            null=0.15,
            spread=0.8,
        ),
        Parameter(
            name="reference",
            symbol="T_ref",
            unit="K",
            description="temperature excess at which the softening is stated",
            typical=50.0,
            bounds=(1e-6, 1e9),
            null=50.0,
            fixed=True,
        ),
    )
    starts = ((0.3, 0.4, 0.15, 0.0),)

    def restoring_factor(self, p: Values, view: View) -> Side:
        t = view.actuating / p.reference
        lost = p.softening * jnp.where(p.law == 0, t, rise(t, p.transition, p.width))
        shift = jnp.where(p.law == WLF, t * (1.0 + p.transition) / jnp.maximum(p.transition + t, _COLDEST), t)
        lost = jnp.where(p.law >= 2, -jnp.expm1(-p.softening * shift), lost)
        return 1.0 - jnp.minimum(lost, 0.98)
