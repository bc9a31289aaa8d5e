"""A spring whose stiffness changes with how far it is stretched."""

from typing import ClassVar

import jax.numpy as jnp

from scpjax.parameter import Parameter
from scpjax.physics.mechanism import Mechanism, Side, Values, View
from scpjax.physics.smooth import ramp

BILINEAR, EXPONENTIAL, LIMITED = 2, 3, 4
ROUND = 0.02  # of the reference displacement, over which the knee of law bilinear is rounded
_LEAST = 0.05  # of what law limited divides by
_FLAT = 1e-3  # of that exponent, below which a series has all digits that matter
_NONE = 1e-6  # of a nearness, where it is none: its power has a derivative
_MOST = 30.0  # of the exponent of law exponential


class NonlinearStiffness(Mechanism):
    name = "nonlinear_stiffness"
    title = "Stiffness changes with displacement"
    subsystem = "thermomechanical"
    equation = (
        "law polynomial: F = -k x (a (x/x_ref) + b (x/x_ref)^2);  law power: F = -k x c |x/x_ref|^n;  "
        "law bilinear: F = -k d sign(x) max(|x| - g x_ref, 0), rounded over x_ref/50;  "
        "law exponential: F = -k x_ref (exp(e x/x_ref) - 1)/e in place of -k x;  "
        "law limited: F = -k x/(1 - |h x/x_ref|^m) in place of -k x, divided by no less than 1/20"
    )
    source = (
        "Duffing spring; coil geometry: thesis 3.3.5, references 29-31 there; "
        "power: truly nonlinear oscillators, Mickens, World Scientific 2010, ch. 1; bilinear: a second spring that "
        "engages on the way, Shaw, Holmes, J. Sound Vib. 90 (1983) 129; exponential: Fung, Am. J. Physiol. 213 (1967) "
        "1532; limited: a chain near its full length, m = 2: Warner, Ind. Eng. Chem. Fundam. 11 (1972) 379"
    )
    says = "The further the coil has moved, the stiffer (or softer) it is."
    needs = ("mechanical",)
    excited_by = "large and small amplitudes"
    laws = ("polynomial", "power", "bilinear", "exponential", "limited")
    only_under: ClassVar[dict[str, tuple[int, ...]]] = {
        "quadratic": (0,),
        "cubic": (0,),
        "strength": (1,),
        "exponent": (1,),
        "engaged": (BILINEAR,),
        "knee": (BILINEAR,),
        "steepness": (EXPONENTIAL,),
        "nearness": (LIMITED,),
        "abruptness": (LIMITED,),
    }
    parameters = (
        Parameter(
            name="quadratic",
            symbol="a",
            unit="1",
            description="relative change of stiffness at the reference displacement, odd part (differs by direction)",
            typical=0.0,
            bounds=(-0.95, 10.0),
            null=0.0,
            scale="linear",
            spread=1.0,
        ),
        Parameter(
            name="cubic",
            symbol="b",
            unit="1",
            description="relative change of stiffness at the reference displacement, even part",
            typical=0.0,
            bounds=(-0.95, 10.0),
            null=0.0,
            scale="linear",
            spread=1.0,
        ),
        Parameter(
            name="strength",
            symbol="c",
            unit="1",
            description="relative change of stiffness at the reference displacement (law power)",
            typical=0.0,
            bounds=(-0.95, 10.0),
            null=0.0,
            scale="linear",
            spread=1.0,
        ),
        Parameter(
            name="exponent",
            symbol="n",
            unit="1",
            description="growth of the change of stiffness with the displacement (law power)",
            typical=4.0,
            bounds=(0.5, 12.0),
            null=4.0,
            spread=0.6,
        ),
        Parameter(
            name="engaged",
            symbol="d",
            unit="1",
            description="relative change of stiffness beyond the knee (law bilinear)",
            typical=0.0,
            bounds=(-0.95, 10.0),
            null=0.0,
            scale="linear",
            spread=1.0,
        ),
        Parameter(
            name="knee",
            symbol="g",
            unit="1",
            description="displacement from which on the stiffness is another, as a share of the reference displacement "
            "(law bilinear)",
            typical=0.4,
            bounds=(0.02, 1.5),
            null=0.4,
            spread=0.7,
        ),
        Parameter(
            name="steepness",
            symbol="e",
            unit="1",
            description="logarithm of what the stiffness grows by up to the reference displacement (law exponential)",
            typical=0.0,
            bounds=(-3.0, 6.0),
            null=0.0,
            scale="linear",
            spread=1.0,
        ),
        Parameter(
            name="nearness",
            symbol="h",
            unit="1",
            description="the reference displacement as a share of that which it cannot reach (law limited)",
            typical=0.4,
            bounds=(0.003, 0.98),
            null=0.0,
            spread=1.0,
        ),
        Parameter(
            name="abruptness",
            symbol="m",
            unit="1",
            description="how late the stiffness grows on the way there (law limited)",
            typical=2.0,
            bounds=(0.5, 12.0),
            null=2.0,
            spread=0.7,
        ),
        Parameter(
            name="reference",
            symbol="x_ref",
            unit="m",
            description="displacement at which the relative changes are stated",
            typical=0.01,
            bounds=(1e-12, 1e12),
            null=0.01,
            fixed=True,
        ),
    )
    starts = (
        (0.1, 0.1, 0.1, 4.0, 0.3, 0.4, 0.5, 0.4, 2.0, 0.0),
        (-0.1, -0.1, -0.1, 4.0, -0.3, 0.6, -0.5, 0.7, 1.0, 0.0),
    )

    @property
    def may_need_short_steps(self) -> bool:
        """Near the length that it cannot reach the spring is many times as stiff as what a step takes exactly."""
        return True

    def restoring(self, p: Values, view: View) -> Side:
        relative = view.deflection / p.reference
        # the small floor keeps the derivative of |x|^n finite at x = 0, far below any sensor's resolution
        size = jnp.sqrt(relative**2 + 1e-10)
        change = jnp.where(
            p.law == 1,
            p.strength * jnp.exp(p.exponent * jnp.log(size)),
            relative * (p.quadratic + p.cubic * relative),
        )
        beyond = p.engaged * ramp(size, p.knee, jnp.asarray(ROUND, size.dtype)) / size
        change = jnp.where(p.law == BILINEAR, beyond, change)
        rate = p.steepness * relative
        flat = jnp.abs(rate) < _FLAT
        safe = jnp.minimum(jnp.where(flat, 1.0, rate), _MOST)
        steeper = jnp.where(flat, rate * (0.5 + rate / 6.0), jnp.expm1(safe) / safe - 1.0)
        near = jnp.minimum((jnp.maximum(p.nearness, _NONE) * size) ** p.abruptness, 1.0 - _LEAST)
        change = jnp.where(p.law == EXPONENTIAL, steeper, change)
        change = jnp.where((p.law == LIMITED) & (p.nearness > 0), near / (1.0 - near), change)
        return view.shared["stiffness"] * view.deflection * change
