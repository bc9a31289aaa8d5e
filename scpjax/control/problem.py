"""What a tuning is for: a loop, references and an objective; and a controller's gains by name."""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jax.core import Tracer
from jaxtyping import Array, Float

from scpjax.control.controller import Controller, Scalar, check_number, known, scalar
from scpjax.control.errors import ControlError
from scpjax.control.loop import Disturbance, Loop, Response, checked, run
from scpjax.control.objective import Objective, StepSpecification
from scpjax.control.pid import DEGREE, PID, Pair
from scpjax.control.plant import Difference, Plant, check_dead_times
from scpjax.control.strategies import FeedforwardPair

BOUNDS: Mapping[str, tuple[float, float]] = {
    "Kp": (math.exp(-4), math.exp(4)),
    "Ki": (math.exp(-9), math.exp(3)),
    "Kd": (math.exp(-4), math.exp(4)),
    "N": (math.exp(-2), math.exp(3.9)),
}
"""Gains per degree (V^2) and filter coefficient [rad/s] between which a tuning searches."""

EXTRA: Mapping[str, tuple[float, float]] = {
    "tracking": (1e-2, 1e2),
    "reference_weight": (1e-2, 1.0),
    "feedforward": (1e-2, 2.0),
}
"""What else can be tuned: the rate of back-calculation [1/s], the P term's share of the reference, and the share of
the feedforward where the controller has one."""


class Problem(eqx.Module):
    """What is tuned for: a loop, references (r, n) [rad], an objective, and plants where they are many.

    ``plants`` has the loop's plant with a leading axis: the objective is gathered over plants and references.
    """

    loop: Loop
    references: Float[Array, "r n"]
    dt: Array
    objective: Objective
    disturbance: Disturbance | None
    plants: Plant | None

    def __init__(
        self,
        loop: Loop,
        references: Any,
        *,
        dt: float = 0.02,
        objective: Objective | None = None,
        disturbance: Disturbance | None = None,
        plants: Plant | None = None,
    ):
        """**Raises** `ControlError` for references that are no finite vectors of one length, and a dead time of more
        than 63 samples.
        """
        if isinstance(references, Tracer):
            rows = jnp.atleast_2d(references)
        else:
            given = np.atleast_2d(np.asarray(references, float))
            rows = jnp.stack([checked(r, "the reference") for r in given])
        if known(dt) is not None:
            check_dead_times(loop.plant, float(dt), compiled=True)
        self.loop, self.references = loop, rows
        self.dt, self.disturbance, self.plants = jnp.asarray(dt, float), disturbance, plants
        self.objective = Objective() if objective is None else objective

    @property
    def loops(self) -> int:
        """Loops that one evaluation runs."""
        count = 1 if self.plants is None else len(jax.tree.leaves(eqx.filter(self.plants, eqx.is_array))[0])
        return count * self.references.shape[0]

    def responses(self, controller: Controller) -> Response:
        """All responses, leading axis plants x references."""

        def one(plant: Plant, reference: Array) -> Response:
            loop = eqx.tree_at(lambda m: (m.plant, m.controller), self.loop, (plant, controller))
            return run(loop, reference, dt=self.dt, disturbance=self.disturbance)

        if self.plants is None and self.references.shape[0] == 1:  # one axis less to carry through the scan
            return jax.tree.map(lambda x: x[None], one(self.loop.plant, self.references[0]))
        over = jax.vmap(one, in_axes=(None, 0))
        if self.plants is None:
            return over(self.loop.plant, self.references)
        found = jax.vmap(over, in_axes=(0, None))(self.plants, self.references)
        return jax.tree.map(lambda x: x.reshape(-1, *x.shape[2:]), found)

    def worth(self, controller: Controller, responses: Response) -> Scalar:
        """The objective of given responses."""
        return self.objective.gather(self.values(controller, responses))

    def values(self, controller: Controller, responses: Response) -> Float[Array, " s"]:
        """The objective of each response."""
        if self.plants is None:
            loop = eqx.tree_at(lambda m: m.controller, self.loop, controller)
            return jax.vmap(lambda r: self.objective.value(loop, r))(responses)
        count = self.references.shape[0]
        plants = jax.tree.map(lambda x: jnp.repeat(x, count, axis=0) if eqx.is_array(x) else x, self.plants)

        def one(plant: Plant, response: Response) -> Scalar:
            loop = eqx.tree_at(lambda m: (m.plant, m.controller), self.loop, (plant, controller))
            return self.objective.value(loop, response)

        return jax.vmap(one)(plants, responses)

    def value(self, controller: Controller) -> Scalar:
        """The objective of a controller."""
        return self.worth(controller, self.responses(controller))


# -- gains as a vector -----------------------------------------------------------------------------------------------


def gains_of(controller: Controller) -> dict[str, float]:
    """Kp, Ki, Kd (V^2 per degree), N and what else can be tuned, of a PID or of a pair's agonist."""
    pid = _agonist(controller)
    extra = {"tracking": pid.tracking, "reference_weight": pid.reference_weight}
    if isinstance(controller, FeedforwardPair):
        extra["feedforward"] = controller.share
    return {k: float(v) for k, v in (*pid.gains.items(), *extra.items())}


def with_gains(controller: Controller, values: Mapping[str, Any]) -> Controller:
    """The controller with other gains, by the names of `gains_of`; a pair's antagonist gets the opposite.

    **Raises** `ControlError` for an unknown name or a controller without gains.
    """
    pid = _agonist(controller)
    for name, value in values.items():
        if name == "feedforward" and isinstance(controller, FeedforwardPair):
            controller = eqx.tree_at(lambda c: c.share, controller, jnp.asarray(value))
            continue
        if name not in _FIELDS:
            raise ControlError(f"no gain {name!r}", mend=f"use {', '.join(_FIELDS)}")
        place, unit = _FIELDS[name]
        pid = eqx.tree_at(lambda p, place=place: getattr(p, place), pid, jnp.asarray(value) / unit)
    if isinstance(controller, PID):
        return pid
    if isinstance(controller, Pair):
        return Pair(pid)
    return eqx.tree_at(lambda c: c.pair, controller, Pair(pid))


_FIELDS = {
    "Kp": ("kp", DEGREE),
    "Ki": ("ki", DEGREE),
    "Kd": ("kd", DEGREE),
    "N": ("n", 1.0),
    "tracking": ("tracking", 1.0),
    "reference_weight": ("reference_weight", 1.0),
}


def _agonist(controller: Controller) -> PID:
    inner = getattr(controller, "pair", controller)
    if isinstance(inner, Pair):
        return inner.agonist
    if isinstance(inner, PID):
        return inner
    raise ControlError(f"{type(controller).__name__} has no gains to tune", mend="use a PID or a Pair")


def specification(
    plant: Plant,
    controller: Controller,
    *,
    rise: float = 2.0,
    settling: float = 13.0,
    overshoot: float = 0.06,
    duration: float = 60.0,
    dt: float = 0.02,
) -> Problem:
    """The thesis's design: one actuator with its controller, unlimited, to meet step figures (section 3.4.1).

    With the gains of Table 3.7 this loop rises in 2.07 s, settles in 12.9 s and overshoots by 5.9 %: the thesis says
    about 2 s, 13 s and 6 %.

    **Raises** `ControlError` for a plant that is not made of single actuators.
    """
    if not isinstance(plant, Difference):
        raise ControlError("a specification is met by one actuator alone", mend="give a Difference")
    for name, value in (("rise", rise), ("settling", settling), ("overshoot", overshoot)):
        check_number(value, f"the {name}", positive=True)
    alone = Difference(plant.agonist, radius=plant.radius, substeps=plant.substeps)
    pid = eqx.tree_at(lambda p: (p.low, p.high), _agonist(controller), (scalar(-1e12), scalar(1e12)))
    target = StepSpecification(rise=rise, settling=settling, overshoot=overshoot)
    step = np.ones(round(duration / dt) + 1)
    return Problem(Loop(alone, pid), step, dt=dt, objective=Objective(target))
