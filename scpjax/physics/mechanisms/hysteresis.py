"""Hysteresis: heating and cooling take different paths through the same displacement."""

import math
from typing import ClassVar

import jax.numpy as jnp
from jaxtyping import Array

from scpjax.parameter import Parameter
from scpjax.physics.mechanism import Mechanism, Side, Values, View

OVER = 1.05  # |z| stays below 1 but for the integrator's overshoot, which is cut off here

DECAY = 0.5  # how much less the wider plays weigh


def _falling(shares: tuple[float, ...]) -> tuple[float, ...]:
    """Weights of plays, by their widths as shares of the widest."""
    each = [math.exp(-DECAY * share) for share in shares]
    return tuple(one / sum(each) for one in each)


SHARES, FOUR = (1.0, 0.6, 0.25), (1.0, 0.75, 0.25, 0.5)  # widths of three plays, of four: as shares of the widest
WEIGHTS, WEIGHTS_OF_FOUR = _falling(SHARES), _falling(FOUR)
SHARP = 8.0  # sharpness of the corners of three plays; of four, twice that
PREISACH, OF_FOUR, THERMAL_OF_FOUR = 5, 6, 7


class Hysteresis(Mechanism):
    name = "hysteresis"
    title = "Hysteresis"
    subsystem = "thermomechanical"
    equation = (
        "F = -h k w x_ref z;  law Bouc-Wen: dz/dt = v/(w x_ref) (1 - |z|^n (1 + sign(v z))/2);  law Duhem: "
        "dz/dt = (v - |v| z)/(w x_ref);  law plays: three plays, F = -h k x_ref sum m_i p_i w_i z_i, "
        "w_i = w, 0.6 w and 0.25 w, p_i = exp(-w_i/2w)/sum, "
        "m_1 = 1, m_2 and m_3 estimated, z_i as Bouc-Wen with n = 8 and w_i;  law four plays: four of any widths, "
        "w_i = s_i w, s_1 = 1, p_i those of w, 0.75 w, 0.25 w and 0.5 w, n = 16;  laws thermal, part of what warmth "
        "pulls: plays, Duhem moved by dT/dt x_ref/T_ref in place of v;  law thermal Preisach: "
        "F = h k x_ref sum m_i p_i (g - g(0) - w_i (z_i + 1)), plays moved by dg/dt x_ref, "
        "g = b tanh((T/T_ref - a)/b), z_i = -1 at first"
    )
    source = (
        "Bouc-Wen, rate independent: Ismail, Ikhouane, Rodellar, Arch. Comput. Methods Eng. 16 (2009) 161; Duhem and "
        "plays: Visintin, Differential Models of Hysteresis (1994), ch. III, V; weights falling "
        "exponentially, and plays of a sigmoid of the input, which are a Preisach operator whose density lies about "
        "a temperature: Al Janaideh, Rakheja, Su, IEEE/ASME Trans. Mechatronics 16 (2011) 734; Mayergoyz, "
        "Mathematical Models of Hysteresis (1991), ch. 1"
    )
    says = "The way back is not the way there: after a reversal the displacement stays behind."
    needs = ("mechanical",)
    excited_by = "reversals of different size"
    laws = (
        *("Bouc-Wen", "Duhem", "plays", "thermal plays", "thermal Duhem", "thermal Preisach"),
        *("four plays", "thermal four plays"),
    )
    law_needs: ClassVar[dict[int, tuple[str, ...]]] = dict.fromkeys((3, 4, PREISACH, THERMAL_OF_FOUR), ("thermal",))
    refines: ClassVar[dict[int, int]] = {OF_FOUR: 2, THERMAL_OF_FOUR: 3}
    only_under: ClassVar[dict[str, tuple[int, ...]]] = {
        "sharpness": (0,),
        **dict.fromkeys(("middle", "inner"), (2, 3, PREISACH, OF_FOUR, THERMAL_OF_FOUR)),
        **dict.fromkeys(("fourth", "middle_width", "inner_width", "fourth_width"), (OF_FOUR, THERMAL_OF_FOUR)),
        "centre": (PREISACH,),
        "span": (PREISACH,),
    }
    states = ("internal_stretch", "second_stretch", "third_stretch", "fourth_stretch")
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
            description="displacement over which the element, or the widest play, slips, as a share of the reference "
            "displacement",
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
            name="middle",
            symbol="m_2",
            unit="1",
            description="weight of the second play, of 0.6 w among three, as a multiple of p_2 (laws plays)",
            typical=1.0,
            bounds=(0.01, 100.0),
            null=1.0,
            spread=1.0,
        ),
        Parameter(
            name="inner",
            symbol="m_3",
            unit="1",
            description="weight of the third play, of 0.25 w among three, as a multiple of p_3 (laws plays)",
            typical=1.0,
            bounds=(0.01, 100.0),
            null=1.0,
            spread=1.0,
        ),
        Parameter(
            name="fourth",
            symbol="m_4",
            unit="1",
            description="weight of the fourth play, as a multiple of p_4 (laws of four plays)",
            typical=1.0,
            bounds=(0.01, 100.0),
            null=1.0,
            spread=1.0,
        ),
        Parameter(
            name="middle_width",
            symbol="s_2",
            unit="1",
            description="width of the second play, as a share of w (laws of four plays)",
            typical=0.75,
            bounds=(0.01, 2.0),
            null=0.75,
            spread=0.7,
        ),
        Parameter(
            name="inner_width",
            symbol="s_3",
            unit="1",
            description="width of the third play, as a share of w (laws of four plays)",
            typical=0.25,
            bounds=(0.01, 2.0),
            null=0.25,
            spread=0.7,
        ),
        Parameter(
            name="fourth_width",
            symbol="s_4",
            unit="1",
            description="width of the fourth play, as a share of w (laws of four plays)",
            typical=0.5,
            bounds=(0.01, 2.0),
            null=0.5,
            spread=0.7,
        ),
        Parameter(
            name="centre",
            symbol="a",
            unit="1",
            description="temperature excess about which most of it happens, as a share of the reference temperature "
            "(law thermal Preisach)",
            typical=0.5,
            bounds=(0.02, 3.0),
            null=0.5,
            spread=0.7,
        ),
        Parameter(
            name="span",
            symbol="b",
            unit="1",
            description="temperature excess to either side within which three quarters of it happen, as a share of the "
            "reference temperature (law thermal Preisach)",
            typical=0.5,
            bounds=(0.03, 30.0),
            null=0.5,
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
            description="temperature excess at which the width is stated (laws thermal)",
            typical=50.0,
            bounds=(1e-6, 1e9),
            null=50.0,
            fixed=True,
        ),
    )
    starts = (
        (0.3, 0.15, 3.0, 1.0, 1.0, 1.0, 0.75, 0.25, 0.5, 0.6, 0.5, 0.0, 0.0),
        (2.0, 0.02, 2.0, 1.0, 1.0, 1.0, 0.75, 0.25, 0.5, 0.4, 0.25, 0.0, 0.0),
    )

    def _sigmoid(self, p: Values, view: View) -> tuple[Side, Side]:
        """How far law Preisach is moved at a temperature, as a share of x_ref, and its slope in T/T_ref."""
        at = jnp.tanh((view.temperature / p.reference_temperature - p.centre) / p.span)
        return p.span * (at + jnp.tanh(p.centre / p.span)), 1.0 - at**2

    def pull(self, p: Values, view: View) -> Side:
        return jnp.where(_is_thermal(p), self._held(p, view), 0.0)

    def force(self, p: Values, view: View) -> Side:
        return jnp.where(_is_thermal(p), 0.0, self._held(p, view))

    def _held(self, p: Values, view: View) -> Side:
        """Force [N] of the element."""
        stretches = [jnp.clip(z, -OVER, OVER) for z in view.own]
        held = _most_held(p)
        played = sum(most * z for most, z in zip(held, stretches, strict=True))
        begun = sum(held)  # as of plays that cooling has left behind: z = -1
        drawn = sum(most / share for most, share in zip(held[:3], SHARES, strict=True)) * self._sigmoid(p, view)[0]
        stretch = jnp.where(_plays(p), played, stretches[0])
        # one law is a play, which follows its input, the others are stops, which hold against it
        stretch = jnp.where(p.law == PREISACH, played + begun - drawn / p.width, stretch)
        return -p.strength * view.shared["stiffness"] * p.width * p.reference * stretch

    def rates(self, p: Values, view: View) -> tuple[Side, ...]:
        warming = view.warming / p.reference_temperature
        moved = jnp.where(_is_thermal(p), warming, view.velocity / p.reference)
        moved = jnp.where(p.law == PREISACH, self._sigmoid(p, view)[1] * warming, moved)
        first, *others = (jnp.clip(z, -OVER, OVER) for z in view.own)
        rate = moved / p.width
        plays, four = _plays(p), _of_four(p)
        sharpness = jnp.where(four, 2.0 * SHARP, jnp.where(plays, SHARP, p.sharpness))
        fill = jnp.exp(sharpness * jnp.log(jnp.sqrt(first**2 + 1e-12)))
        slip = rate * (1.0 - fill * jnp.where(rate * first > 0, 1.0, 0.0))
        slip = jnp.where((p.law == 1) | (p.law == 4), rate - jnp.abs(rate) * first, slip)
        # left out (strength 0), the element rests: its state could not matter and a step might be too long for it
        there = p.strength > 0
        out = [jnp.where(there, slip, 0.0)]
        for z, share, used in zip(others, _widths(p)[1:], (plays, plays, four), strict=True):
            eighth = ((z * z) ** 2) ** 2
            fill = jnp.where(four, eighth * eighth, eighth)
            other = rate / share * (1.0 - fill * jnp.where(rate * z > 0, 1.0, 0.0))
            out.append(jnp.where(there & used, other, 0.0))
        return tuple(out)

    def holds(self, p: Values) -> Side:
        return (p.strength > 0) & (p.law != PREISACH)

    def initial(self, p: Values, view: View) -> tuple[Side, ...]:
        """What holds it beside its equilibrium, if it begins there: F = k displaced."""
        whole = jnp.where(_plays(p), sum(_most_held(p)), 1.0)
        most = jnp.maximum(p.strength * p.width * whole, 1e-9) * p.reference  # m, that it could hold
        held = jnp.clip(-view.displaced / most, -1.0, 1.0)
        # under law Preisach it has cooled before, and nothing is held beside what that leaves
        return (jnp.where(p.law == PREISACH, -1.0, held) * jnp.ones_like(view.displacement),) * len(self.states)


def _is_thermal(p: Values) -> Array:
    """Whether its law is part of what warmth pulls."""
    return (p.law >= 3) & (p.law != OF_FOUR)


def _of_four(p: Values) -> Array:
    """Whether it is one of the laws with four plays."""
    return (p.law == OF_FOUR) | (p.law == THERMAL_OF_FOUR)


def _plays(p: Values) -> Array:
    """Whether it is one of the laws with plays."""
    return (p.law == 2) | (p.law == 3) | (p.law == PREISACH) | _of_four(p)


def _widths(p: Values) -> tuple[Array, ...]:
    """Width of each play, as a share of w."""
    own = (1.0, p.middle_width, p.inner_width, p.fourth_width)
    return tuple(jnp.where(_of_four(p), mine, share) for mine, share in zip(own, (*SHARES, 1.0), strict=True))


def _most_held(p: Values) -> tuple[Array, ...]:
    """Force of each play when it slips, as a share of h k w x_ref."""
    of_three, of_four = (*WEIGHTS, 0.0), WEIGHTS_OF_FOUR
    weights = [jnp.where(_of_four(p), four, three) for four, three in zip(of_four, of_three, strict=True)]
    multiples = (1.0, p.middle, p.inner, p.fourth)
    return tuple(m * weight * width for m, weight, width in zip(multiples, weights, _widths(p), strict=True))
