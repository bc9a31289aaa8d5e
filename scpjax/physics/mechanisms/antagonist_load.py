"""Something that pulls back: a spring that engages on the way, a rubber band, another muscle, a weight."""

from typing import ClassVar

import jax.numpy as jnp
from jaxtyping import Array

from scpjax.parameter import Parameter
from scpjax.physics.mechanism import Mechanism, Side, Values, View
from scpjax.physics.smooth import ramp

ROUND = 0.02  # of the reference displacement: how gradually a spring engages
STRETCHED = 1.1  # stretch of the rubber band at rest: it never hangs loose
UNEVEN, LIFTED = (4, 5), 6
SHORTEST = 0.3  # least stretch that the law of rubber is used for


class AntagonistLoad(Mechanism):
    name = "antagonist_load"
    title = "Something pulls back"
    subsystem = "thermomechanical"
    equation = (
        "law one-sided spring: F = -a k (x - X) beyond X = x_0 x_ref;  law hardening: F = -a k (x - X)^2/x_ref "
        "beyond X;  law rubber band: F = -a k L x_ref (f(s) - f(s_0)), f = (s - 1/s^2)(1 + 1/s)/f'(s_0), "
        "s = s_0 + x/(L x_ref), s_0 = 1.1;  "
        "law link: F = -a k x_ref (sin(phi_0 + x/r) - sin(phi_0)) on a joint whose pulley has the radius r;  "
        "law uneven: the antagonist pulls with c (1 + g);  law uneven, one-sided spring: and, stretched beyond X, "
        "is such a spring;  law lifted weight: F = -a k x_ref (1 - exp(-x/X)) where x > 0, rounded over X/50, of "
        "the agonist of a joint"
    )
    source = (
        "unilateral spring: Shaw, Holmes, J. Sound Vib. 90 (1983) 129; Hertzian hardening: Johnson, Contact Mechanics; "
        "rubber: Mooney, J. Appl. Phys. 11 (1940) 582, with equal constants; "
        "link: the gravity torque of a pendulum, Spong, Hutchinson, Vidyasagar, Robot Modeling and Control, ch. 7; "
        "uneven: two muscles of one joint with coefficients of their own in thesis (3.7); lifted weight: what a "
        "yielding support no longer carries, unilateral contact: Johnson, Contact Mechanics"
    )
    says = (
        "A second spring, a rubber band, another muscle or the weight of what a joint raises takes up part of the "
        "pull, and not in proportion; or the two muscles of a joint do not pull alike."
    )
    needs = ("mechanical",)
    excited_by = "steady states from small to large displacements"
    laws = (
        "one-sided spring",
        "hardening",
        "rubber band",
        "link",
        "uneven",
        "uneven, one-sided spring",
        "lifted weight",
    )
    law_needs: ClassVar[dict[int, tuple[str, ...]]] = {3: ("joint",), 4: ("joint", "thermal"), 5: ("joint", "thermal")}
    only_under: ClassVar[dict[str, tuple[int, ...]]] = {
        "strength": (0, 1, 2, 3, 5, LIFTED),
        "onset": (0, 1, 5, LIFTED),
        "length": (2,),
        "angle": (3,),
        "excess": (4, 5),
    }
    parameters = (
        Parameter(
            name="strength",
            symbol="a",
            unit="1",
            description="stiffness as a share of k: engaged, at the reference displacement beyond its onset, or of the "
            "rubber band at rest; pull of a weight (of the link, held level), as a share of k x_ref",
            typical=0.5,
            bounds=(0.003, 300.0),
            null=0.0,
            spread=1.5,
        ),
        Parameter(
            name="onset",
            symbol="x_0",
            unit="1",
            description="displacement at which it engages, or at which two thirds of a weight hang, as a share of the "
            "reference displacement",
            typical=0.5,
            bounds=(0.01, 1.5),
            null=0.5,
            spread=0.7,
        ),
        Parameter(
            name="length",
            symbol="L",
            unit="1",
            description="length of the rubber band, as a multiple of the reference displacement",
            typical=1.0,
            bounds=(0.03, 30.0),
            null=1.0,
            spread=1.0,
        ),
        Parameter(
            name="angle",
            symbol="phi_0",
            unit="rad",
            description="angle of the link from hanging straight down, at rest",
            typical=0.0,
            bounds=(-1.57, 1.57),
            null=0.0,
            scale="linear",
            spread=1.0,
        ),
        Parameter(
            name="excess",
            symbol="g",
            unit="1",
            description="by how much the antagonist pulls harder for its warmth than the agonist (laws uneven)",
            typical=0.0,
            bounds=(-0.9, 3.0),
            null=0.0,
            scale="linear",
            spread=0.5,
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
    starts = ((0.7, 0.5, 1.0, 0.7, 0.3, 0.0), (2.0, 0.75, 0.2, -0.7, -0.3, 0.0))

    @property
    def may_need_short_steps(self) -> bool:
        """A rubber band near its limit, or a weight near its support, is many times as stiff as the spring."""
        return True

    def force(self, p: Values, view: View) -> Side:
        stretch = jnp.maximum(STRETCHED + view.displacement / (p.reference * p.length), SHORTEST)
        rubber = p.length * (_rubber(stretch) - _rubber(STRETCHED)) / _SLOPE
        off = jnp.maximum(view.displacement / (p.reference * p.onset), 0.0)
        hanging = -jnp.expm1(-off * off / (off + ROUND))
        pull = jnp.where(p.law == 2, rubber, 0.0)
        if view.radius:  # there is one link, and the agonist raises it
            raised = jnp.sin(p.angle + view.displacement / view.radius) - jnp.sin(p.angle)
            agonist = jnp.array([1.0, 0.0])
            pull, hanging = jnp.where(p.law == 3, raised * agonist, pull), hanging * agonist
        pull = jnp.where(p.law == LIFTED, hanging, pull)
        back = p.strength * view.shared["stiffness"] * p.reference * pull
        return jnp.where(_uneven(p), 0.0, -back)

    def pull(self, p: Values, view: View) -> Side | float:
        """Of the antagonist of a joint, that pulls harder."""
        if not view.radius:
            return jnp.zeros_like(view.displacement)
        harder = p.excess * view.shared["coefficient"] * view.actuating * jnp.array([0.0, 1.0])
        return jnp.where(_uneven(p), harder, 0.0)

    def resistance(self, p: Values, view: View, force: Side) -> Side:
        """Of the springs that engage, at the displacement that a step would end at: y beyond the onset.

        With b the displacement [m/N] by which the load, held by the base spring, yields to a force within the step,
        y + b k a y = y_free (or b k a y^2/x_ref); for a step of 0, b = 0 and y = x - x_0.
        """
        step, still = view.step, jnp.ones_like(view.displacement)
        stiffness, damping = (jnp.sum(view.shared[name] * still) for name in ("stiffness", "damping"))
        ahead = view.mass + step * damping
        yields = step * step / (ahead + step * step * stiffness)
        end = view.displacement + yields * force + step * ahead * view.velocity / (ahead + step * step * stiffness)
        free = ramp(end / p.reference, p.onset, jnp.asarray(ROUND, end.dtype))
        back = p.strength * view.shared["stiffness"]
        share = yields * back
        linear = free / (1.0 + share)
        square = 2.0 * free / (1.0 + jnp.sqrt(1.0 + 4.0 * share * jnp.maximum(free, 0.0)))
        engaged = jnp.where(p.law == 1, square * square, linear)
        if view.radius:  # under law uneven, one-sided spring, by the antagonist alone
            engaged = jnp.where((p.law == 5) & (jnp.arange(2) == 1), 0.0, engaged)
        return jnp.where((p.law < 2) | (p.law == 5), -back, 0.0) * p.reference * engaged


def _uneven(p: Values) -> Array:
    """Whether it is one of the laws under which a joint's muscles pull differently."""
    return (p.law == UNEVEN[0]) | (p.law == UNEVEN[1])


def _rubber(s: Side | float) -> Side | float:
    """(s - 1/s^2)(1 + 1/s): Mooney's law for uniaxial stretch with equal constants."""
    return (s - 1.0 / s**2) * (1.0 + 1.0 / s)


_SLOPE = 1.0 + 2.0 / STRETCHED**3 + (3.0 / STRETCHED**4)
"""Its derivative at rest: of s + 1 - 1/s^2 - 1/s^3."""
