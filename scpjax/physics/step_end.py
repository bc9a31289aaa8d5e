"""A step's end, for what resists motion so firmly that an explicit step would overshoot: dry friction and dampers."""

import jax.numpy as jnp
from jaxtyping import Array, Float

from scpjax.physics.mechanism import Side, View


def ahead(view: View, force: Side) -> tuple[Float[Array, ""], Side]:
    """(a, G), both times the step, of ``a u = G + resistance(u)`` for the velocity u that a step ends with.

    From ``m (u - v)/step = force - damping (u - v)/2 + resistance(u)``: a = m/step + damping/2 and G = force + a v;
    for a step of 0, u = v. Over a long step a load that is held has already followed its pull when the step is looked
    at again: a >= k step takes it back.
    """
    step, still = view.step, jnp.ones_like(view.velocity)
    damping, stiffness = (jnp.sum(view.shared[name] * still) for name in ("damping", "stiffness"))
    a = jnp.maximum(view.mass + 0.5 * step * damping, step * step * stiffness)
    return a, step * force + a * view.velocity


def dampened(view: View, force: Side, steady: Side, growing: Side) -> Side:
    """``-(b + c |u|) u`` [N] of dampers b [N s/m] and c [N s^2/m^2], neither below 0, given the sum of all other
    forces: a quadratic equation for |u|, as of `ahead`.
    """
    a, wanted = ahead(view, force)
    still = jnp.ones_like(view.velocity)
    firm, bent = a + view.step * jnp.sum(steady * still), view.step * jnp.sum(growing * still)
    u = 2.0 * wanted / (firm + jnp.sqrt(firm**2 + 4.0 * bent * jnp.abs(wanted)))
    return -(steady + growing * jnp.abs(u)) * u
