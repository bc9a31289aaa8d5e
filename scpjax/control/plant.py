"""What is controlled: models behind a pulley, one sample at a time.

Two forms (thesis 3.4.1 and 3.3.1): `Difference`, two actuators on their own whose displacements differ by the turn of
the pulley (Figure 3.12), and `Joint`, one model with both actuators on one coordinate, (3.7)-(3.12). Linear models
are propagated exactly under the held effort, others by second-order exponential steps.
"""

from __future__ import annotations

import abc
import math
from collections.abc import Callable
from typing import Any, NamedTuple

import equinox as eqx
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array

from scpjax.control.controller import check_number, known, scalar
from scpjax.control.errors import ControlError
from scpjax.physics.coupling import coupling
from scpjax.physics.mechanism import Mechanism
from scpjax.physics.model import Model
from scpjax.simulate.exponential import etd2, phi_functions

States = list[Array]
Advance = Callable[[States, tuple[Array, ...], Array | float], States]


class Reading(NamedTuple):
    """What a plant shows: ``position`` [rad] (or m), ``temperature`` [K] of each heated side as its thermometer has it,
    ``heated`` [K] as it is.
    """

    position: Array
    temperature: tuple[Array, ...]
    heated: tuple[Array, ...]


class Prepared(NamedTuple):
    """A plant with its step worked out: pure functions of its state, a pytree of scalars."""

    initial: Any
    advance: Callable[[Any, tuple[Array, ...], Array | float], Any]
    read: Callable[[Any], Reading]


class Plant(eqx.Module):
    """Base of all plants."""

    @property
    @abc.abstractmethod
    def sides(self) -> int:
        """Number of efforts it takes."""

    @abc.abstractmethod
    def prepare(self, dt: Array | float) -> Prepared:
        """Work out what does not change along a trajectory of steps ``dt`` [s]."""

    @abc.abstractmethod
    def models(self) -> tuple[Model, ...]:
        """The models it is made of."""

    @abc.abstractmethod
    def scale(self) -> Array:
        """Position [rad] per metre of the models' coordinate."""


class Difference(Plant):
    """Angle = (agonist's - antagonist's contraction) / radius, thesis Figure 3.12; without antagonist one alone.

    ``opposing`` [N] is the constant force of section 4.4.4 that extends each actuator by ``opposing / stiffness``:
    contraction counts from there on, so that small drives move nothing. ``stiffness`` [N/m] is that under a hung
    weight (Figure 4.8), the model's own when not given. ``radius = None`` gives displacement in m.
    A load [N] pulls at the agonist, against its contraction when negative.

    **Raises** `ControlError` for models with two sides or without a displacement and for a radius that is not positive.
    """

    agonist: Model
    antagonist: Model | None
    radius: Array | None
    opposing: Array | None
    stiffness: Array | None
    substeps: int = eqx.field(static=True)

    def __init__(
        self,
        agonist: Model,
        antagonist: Model | None = None,
        *,
        radius: Any = 0.015,
        opposing: Any = None,
        stiffness: Any = None,
        substeps: int = 1,
    ):
        self.agonist, self.antagonist = agonist, antagonist
        self.radius = None if radius is None else scalar(radius)
        self.opposing = None if opposing is None else scalar(opposing)
        self.stiffness = None if stiffness is None else scalar(stiffness)
        self.substeps = substeps

    def __check_init__(self) -> None:
        for model in self.models():
            if len(model.structure.sides) != 1 or not model.structure.mechanical:
                raise ControlError(f"{model!r} has no displacement of one actuator", mend="use plants, or Joint")
        if self.radius is not None:
            check_number(self.radius, "the pulley radius", positive=True)
        if self.opposing is not None:
            check_number(self.opposing, "the opposing force", not_negative=True)
        if self.stiffness is not None:
            check_number(self.stiffness, "the stiffness", positive=True)
        _check_substeps(self.substeps)

    @property
    def sides(self) -> int:
        return len(self.models())

    def models(self) -> tuple[Model, ...]:
        return (self.agonist,) if self.antagonist is None else (self.agonist, self.antagonist)

    def scale(self) -> Array:
        return scalar(1.0) if self.radius is None else 1 / self.radius

    def slack(self, model: Model) -> Array | None:
        """Extension [m] of one actuator by the opposing force, None without one."""
        if self.opposing is None:
            return None
        return self.opposing / (model.value("elastic_spring.stiffness") if self.stiffness is None else self.stiffness)

    def prepare(self, dt: Array | float) -> Prepared:
        models = self.models()
        scale = self.scale()
        steps = [model_step(m, dt, self.substeps) for m in models]
        reads = [_reader(m, self.slack(m)) for m in models]

        def advance(z: Any, effort: tuple[Array, ...], load: Array | float) -> Any:
            loads = (load, 0.0)
            return tuple(s.advance(zi, (u,), f) for s, zi, u, f in zip(steps, z, effort, loads, strict=False))

        def read(z: Any) -> Reading:
            seen = [r(s.states(zi)) for r, s, zi in zip(reads, steps, z, strict=True)]
            moved = seen[0].position - seen[1].position if len(seen) == 2 else seen[0].position
            warm = tuple(t for s in seen for t in s.temperature)
            return Reading(moved * scale, warm, tuple(t for s in seen for t in s.heated))

        return Prepared(tuple(s.initial for s in steps), advance, read)


class Joint(Plant):
    """A model with both actuators on the pulley, the preset ``aaa``: thesis (3.7)-(3.12).

    The antagonist's stiffness and damping oppose the agonist. A load [N] pulls at the agonist's end.

    **Raises** `ControlError` for a model without two sides.
    """

    model: Model
    substeps: int = eqx.field(static=True)

    def __init__(self, model: Model, *, substeps: int = 1):
        self.model, self.substeps = model, substeps

    def __check_init__(self) -> None:
        if len(self.model.structure.sides) != 2 or not self.model.structure.mechanical:
            raise ControlError(f"{self.model!r} is no joint", mend="use the preset aaa, or Difference of two plants")
        _check_substeps(self.substeps)

    @property
    def sides(self) -> int:
        return 2

    def models(self) -> tuple[Model, ...]:
        return (self.model,)

    def scale(self) -> Array:
        return scalar(1 / (self.model.structure.pulley_radius or 1.0))

    def prepare(self, dt: Array | float) -> Prepared:
        step = model_step(self.model, dt, self.substeps)
        observe = _reader(self.model, None)
        return Prepared(step.initial, step.advance, lambda z: observe(step.states(z)))


def against_spring(
    actuator: Model, *, stiffness: float, radius: float, pulley_mass: float = 0.0, mass: float = 0.0
) -> Difference:
    """One actuator that a spring or rubber band of ``stiffness`` [N/m] pulls back (thesis 3.2.2, Table 4.10).

    The passive antagonist adds its stiffness, its hanging ``mass`` [kg] and half of the pulley's to the force balance,
    as the terms with index 2 in (3.7).

    **Raises** `ControlError` for values that are not finite or negative.
    """
    for name, value in (("stiffness", stiffness), ("pulley_mass", pulley_mass), ("mass", mass)):
        check_number(value, name, not_negative=True)
    k, m = "elastic_spring.stiffness", "inertia.mass"
    stiffer = actuator.replace(
        {k: actuator.value(k) + stiffness, m: actuator.value(m) + mass + 0.5 * pulley_mass},
    )
    return Difference(stiffer, radius=radius)


# -- one model -------------------------------------------------------------------------------------------------------


class ModelStep(NamedTuple):
    """Step of one model; its state is the model's, and what is on its way where the drive has a dead time."""

    initial: Any
    advance: Advance
    states: Callable[[Any], States]


_MOST_DELAY = 64  # samples that a drive's dead time may span, where neither it nor the step is known yet


def model_step(model: Model, dt: Array | float, substeps: int = 1) -> ModelStep:
    """Step of one model under efforts held over ``dt`` [s] and a load [N] on its coordinate.

    Exact for linear models; ``substeps`` second-order exponential steps for others (`etd2`).
    """
    s = model.structure
    advance = _linear(model, dt) if s.is_linear else _exponential(model, dt, substeps)
    start = model.initial()
    rest = [start[i] for i in range(s.n_states)]
    if all(type(m).delay is Mechanism.delay for m in s.mechanisms):
        return ModelStep(rest, advance, lambda z: z)
    share = model.delay() / dt
    length = _delay_line(model, share, dt)

    def later(z: Any, effort: tuple[Array, ...], load: Array | float) -> Any:
        states, line = z
        line = tuple(jnp.concatenate([u[None], past[:-1]]) for u, past in zip(effort, line, strict=True))
        weight = jnp.maximum(1.0 - jnp.abs(jnp.arange(length) - share), 0.0)  # mean of the held effort over dt
        return advance(states, tuple(jnp.sum(weight * u) for u in line), load), line

    empty = tuple(jnp.zeros(length, model.theta.dtype) for _ in s.sides)
    return ModelStep((rest, empty), later, lambda z: z[0])


def _delay_line(model: Model, share: Array | float, dt: Array | float) -> int:
    """Samples that a dead time of ``share`` steps may span: known, or as its bounds and the step allow."""
    seen, step = known(share), known(dt)
    if seen is not None and np.all(np.isfinite(seen)):
        return math.ceil(float(np.max(seen))) + 2
    if step is None:
        return _MOST_DELAY
    late = [m for m in model.structure.mechanisms if type(m).delay is not Mechanism.delay]
    longest = sum(max((p.bounds[1] for p in m.parameters if p.unit == "s"), default=0.0) for m in late)
    return max(math.ceil(longest / float(np.min(step))) + 2, _MOST_DELAY)


def check_dead_times(plant: Plant, dt: float, *, compiled: bool = False) -> None:
    """Refuse a dead time that is longer than what a step remembers inside a transformation; ``compiled``: where the
    step is not known there either. **Raises** `ControlError`.
    """
    for model in plant.models():
        seen = known(model.delay())
        length = _MOST_DELAY if compiled else _delay_line(model, jnp.inf, dt)
        if seen is not None and float(np.max(seen)) / dt > length - 1:
            raise ControlError(
                f"a dead time of {float(np.max(seen)):g} s is more than {length - 1} samples of {dt:g} s",
                mend=f"take a dt of {float(np.max(seen)) / (length - 2):.2g} s or more",
            )


def _linear(model: Model, dt: Array | float) -> Advance:
    """z' = exp(A dt) z + dt phi_1(A dt) B u, entry by entry (see `scpjax.simulate.exponential`)."""
    a, b = model.linearise()
    n, at = model.structure.n_states, _velocity(model)
    p0, p1, *_ = phi_functions(a * dt)
    gain = p1 * dt @ b
    push = dt * p1[:, at] / model.balances().moving_mass if at is not None else jnp.zeros(n)
    reach = coupling(model.structure)
    rows = [[(j, p0[i, j]) for j in range(n) if i == j or reach[i][j]] for i in range(n)]
    gains = [[gain[i, j] for j in range(gain.shape[1])] for i in range(n)]
    pushes = [push[i] for i in range(n)]

    def advance(z: States, effort: tuple[Array, ...], load: Array | float) -> States:
        new = []
        for row, given, pushed in zip(rows, gains, pushes, strict=True):
            total = sum((g * u for g, u in zip(given[1:], effort[1:], strict=True)), start=given[0] * effort[0])
            total = sum((p * z[j] for j, p in row), start=total)
            new.append(total if isinstance(load, float) and load == 0.0 else total + pushed * load)
        return new

    return advance


def _exponential(model: Model, dt: Array | float, substeps: int) -> Advance:
    step = jnp.asarray(dt / substeps)
    balances, at = model.balances(step=step), _velocity(model)

    def rates(z: States, drive: Any) -> States:
        effort, load = drive
        found = list(balances.rates(z, effort))
        if at is not None:
            found[at] = found[at] + load / balances.moving_mass
        return found

    def carried(before: States, after: States, drive: Any, step: Array) -> States:
        return balances.carried(before, after, drive[0], step)

    carry = carried if balances.carries else None
    take = etd2(rates, model.core(), step, pattern=coupling(model.structure), carried=carry)

    def advance(z: States, effort: tuple[Array, ...], load: Array | float) -> States:
        drive: Any = (jnp.stack(effort), load)
        for _ in range(substeps):
            z = take(z, drive)
        return z

    return advance


def _reader(model: Model, slack: Array | None) -> Callable[[States], Reading]:
    balances, s = model.balances(), model.structure
    still = jnp.zeros(len(s.sides), model.theta.dtype)

    def read(z: States) -> Reading:
        parts = balances.observe(z, still)
        position = parts[-1] if slack is None else jnp.maximum(parts[-1] - slack, 0.0)
        heated = tuple(z[i] + model.ambient for i in range(len(s.sides))) if s.thermal else ()
        return Reading(position, tuple(parts[:-1]), heated)

    return read


def _velocity(model: Model) -> int | None:
    names = model.structure.state_names
    return names.index("velocity") if "velocity" in names else None


def _check_substeps(substeps: int) -> None:
    if substeps < 1:
        raise ControlError(f"{substeps} substeps", mend="take at least 1")
