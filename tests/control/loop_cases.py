"""Loops that the tests of this room share."""

import functools
import math

import jax
import numpy as np

from scpjax.control.loop import Loop, run
from scpjax.control.pid import thesis_pair
from scpjax.control.plant import Difference
from scpjax.control.reference import Reference
from scpjax.physics.known import known_model

DEG = math.pi / 180
PLANT = known_model("thesis")
run_jit = jax.jit(lambda loop, reference, dt, disturbance=None, key=None: run(
    loop, reference, dt=dt, disturbance=disturbance, key=key))  # fmt: skip


@functools.cache
def thesis_loop(radius: float = 0.015) -> Loop:
    """The thesis's loop: plant (4.4) on both sides, Table 3.7."""
    return Loop(Difference(PLANT, PLANT, radius=radius), thesis_pair())


def signal(name: str, degrees: float = 25.0, **options) -> np.ndarray:
    """A reference [rad]."""
    return Reference(amplitude=degrees * DEG, **options).make(name)[1]
