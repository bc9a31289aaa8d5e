"""Dampers that a step must look ahead for, as they would stop what they hold within a hundredth of it."""

import jax.numpy as jnp

from scpjax.physics.mechanism import Side, View


def at_the_end(view: View, force: Side, steady: Side, growing: Side) -> Side:
    """``-(b + c |u|) u`` [N] of dampers b [N s/m] and c [N s^2/m^2], not below 0, given the sum of all other forces.

    At the velocity u that a step ends with: ``m (u - v)/step = force - damping (u - v)/2 - (b + c |u|) u``, with
    a = m/step + damping/2 and G = force + a v a quadratic equation for |u|; for a step of 0, u = v. Over a long step
    what they hold has already followed its pull when the step is looked at again: a >= k step takes that back.
    """
    step, still = view.step, jnp.ones_like(view.velocity)
    damping, stiffness, b, c = (
        jnp.sum(each * still) for each in (view.shared["damping"], view.shared["stiffness"], steady, growing)
    )
    ahead = jnp.maximum(view.mass + 0.5 * step * damping, step * step * stiffness)  # a, times the step
    wanted = step * force + ahead * view.velocity
    firm = ahead + step * b
    u = 2.0 * wanted / (firm + jnp.sqrt(firm**2 + 4.0 * step * c * jnp.abs(wanted)))
    return -(steady + growing * jnp.abs(u)) * u
