"""A mechanism is one piece of physics: terms in the balances of a model, with parameters and states of its own."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import ClassVar, Literal

import equinox as eqx
import jax.numpy as jnp
from jaxtyping import Array, Float

from scpjax.parameter import Parameter

Subsystem = Literal["drive", "thermoelectric", "thermomechanical", "sensor", "balance"]
"""Where physics acts; "balance" is one of a base of one's own (`scpjax.physics.system.System`), or any by its law."""
Quantity = str
"""What a sensor reads: "temperature", "displacement", or the stem of an output of a base of one's own."""
Side = Float[Array, "sides"]


class Values:
    """A mechanism's parameter values by name: ``p.stiffness``. Each is a scalar or has one entry per side."""

    def __init__(self, values: dict[str, Array]):
        self.__dict__.update(values)

    def __getattr__(self, name: str) -> Array:  # only reached when the name is missing
        raise AttributeError(f"no parameter {name!r}; there are {sorted(self.__dict__)}")


@dataclass
class View:
    """What a mechanism sees of the actuator at one instant; every array has shape (sides,).

    Filled in the order of the balances: ``power`` is there when heats are asked for, ``actuating`` and
    ``deflection`` when pulls are, these when forces are.
    """

    ambient: Array  # K, scalar
    effort: Array  # what the drive applies: V^2, W, A^2 or the drive column itself
    temperature: Array  # K above ambient, of the heated node (or the driven temperature itself)
    displacement: Array  # m, contraction positive
    velocity: Array  # m/s
    own: tuple[Array, ...] = ()  # this mechanism's states
    power: Array = field(default_factory=lambda: jnp.zeros(()))  # W, into the heated node
    heat: Array = field(default_factory=lambda: jnp.zeros(()))  # W, net
    warming: Array = field(default_factory=lambda: jnp.zeros(()))  # K/s, of the heated node; in rates() only
    felt: Array = field(default_factory=lambda: jnp.zeros(()))  # K above ambient, where the sensor touches
    actuating: Array = field(default_factory=lambda: jnp.zeros(()))  # K above ambient, that pulls
    deflection: Array = field(default_factory=lambda: jnp.zeros(()))  # m, that stretches the spring
    pull: Array = field(default_factory=lambda: jnp.zeros(()))  # N, of warmth
    restoring: Array = field(default_factory=lambda: jnp.zeros(()))  # N, of the spring
    displaced: Array | float = 0.0  # m, by which it begins beside its equilibrium; in initial() only
    time: Array | float = 0.0  # s since the recording began; for mechanisms with ``timed``
    mass: Array | float = 0.0  # kg, all that moves, scalar
    radius: float = 0.0  # m, of a joint's pulley: its angle is the displacement over it; 0 where there is none
    asked: Array = field(default_factory=lambda: jnp.zeros(()))  # as effort, before any mechanism changed it
    step: Array | float = 0.0  # s, of the integrator; 0 where there is none (see `Mechanism.resistance`)
    shared: dict[str, Array] = field(default_factory=dict)  # base parameters others refer to: stiffness, thermal_mass
    states: dict[str, Array] = field(default_factory=dict)  # of a base of one's own, by name


class Mechanism(eqx.Module):
    """One piece of physics. Every method has a default that changes nothing, so a mechanism writes only what it is.

    Balances (thesis equations (3.2), (3.4)), for each actuator::

        drive       effort = effort()(what the recording says)
        electric    power = effort * ... [W]
        energy      (thermal_mass + sum of capacity()) dT/dt = power + sum of heat()  [W]
        force       mass d2x/dt2       = pull - restoring + sum of force() + resistance()  [N]
                    pull = (sum of pull()) product of pull_factor();  restoring likewise
        sensors     reading = reading()(states)
        own base    d(state)/dt = its rates() + sum of flows()       (`scpjax.physics.system.System`)
    """

    name: ClassVar[str]
    title: ClassVar[str]
    subsystem: ClassVar[Subsystem]
    equation: ClassVar[str]
    source: ClassVar[str]
    says: ClassVar[str]
    parameters: ClassVar[tuple[Parameter, ...]] = ()
    states: ClassVar[tuple[str, ...]] = ()
    timed: ClassVar[bool] = False  # whether it looks at ``view.time``
    last_to_hold: ClassVar[bool] = False  # whether it answers for a start beside rest only where nothing `holds` that
    laws: ClassVar[tuple[str, ...]] = ("",)
    only_under: ClassVar[dict[str, tuple[int, ...]]] = {}  # laws that a parameter belongs to, where not to all
    needs: ClassVar[tuple[str, ...]] = ()  # of `scpjax.physics.catalogue.NEEDS`
    law_needs: ClassVar[dict[int, tuple[str, ...]]] = {}  # what a law needs beyond that
    refines: ClassVar[dict[int, int]] = {}  # laws that are sought only from a fit under another, by that one
    excited_by: ClassVar[str] = ""
    starts: ClassVar[tuple[tuple[float, ...], ...]] = ()  # physical (or time-relative) start values, per parameter
    impossible: ClassVar[str] = ""  # what parameters that are `beyond_physics` ask for; empty: none are
    learned: ClassVar[bool] = False  # a closure: no physics with a name, and never a candidate for one

    @property
    def is_base(self) -> bool:
        """Base mechanisms have no null value: a model is not one without them."""
        return all(p.null is None for p in self.parameters)

    @property
    def may_need_short_steps(self) -> bool:
        """Whether a step as long as a sample may be too long for it, as it may be for a force that is remembered."""
        return bool(self.states) and self.subsystem == "thermomechanical" and not self.is_base

    def free_parameters(self, law: int) -> tuple[Parameter, ...]:
        """What is estimated under a law (its index among ``laws``)."""
        only = self.only_under  # not by `serves`: a call of a module's method takes longer than all else here
        return tuple(p for p in self.parameters if not p.fixed and law in only.get(p.name, (law,)))

    def sought_from(self, law: int | None) -> set[int]:
        """Laws that a fit may go on to from one under ``law``; from none (None) those that refine no other."""
        there = {law, self.refines.get(law)} if law is not None else set()
        return {i for i in range(len(self.laws)) if i not in self.refines or not there.isdisjoint((i, self.refines[i]))}

    def serves(self, p: Parameter, law: int) -> bool:
        """Whether a law has any use for a parameter, fixed or estimated."""
        return law in self.only_under.get(p.name, (law,))

    def effort(self, p: Values, view: View, effort: Side) -> Side:
        """Effort that reaches the wire, given what the mechanisms before made of it."""
        return effort

    def effort_for(self, p: Values, view: View, effort: Side) -> Side:
        """Effort asked of the drive so that ``effort`` reaches the wire: the inverse of `effort`."""
        return effort

    def power(self, p: Values, view: View, power: Side) -> Side:
        """Electric power [W] into the heated node, given what the mechanisms before made of it."""
        return power

    def thermal_mass(self, p: Values, mass: Side) -> Side:
        """Thermal mass [J/K] of the heated node, given what the mechanisms before made of it."""
        return mass

    def capacity(self, p: Values, view: View) -> Side | float:
        """Thermal mass [J/K] of the heated node beyond `thermal_mass`, where that depends on its state."""
        return 0.0

    def heat(self, p: Values, view: View) -> Side | float:
        """Heat [W] flowing into the heated node; losses are negative."""
        return 0.0

    def actuating_temperature(self, p: Values, view: View, temperature: Side) -> Side:
        """Temperature [K above ambient] that makes the force."""
        return temperature

    def felt_temperature(self, p: Values, view: View, temperature: Side) -> Side:
        """Temperature [K above ambient] at the place where the sensor touches."""
        return temperature

    def deflection(self, p: Values, view: View, deflection: Side) -> Side:
        """Displacement [m] that the spring feels."""
        return deflection

    def pull(self, p: Values, view: View) -> Side | float:
        """Force [N] in the direction of contraction that warmth makes."""
        return 0.0

    def pull_factor(self, p: Values, view: View) -> Side | float:
        """What is left of all that warmth pulls, as a factor."""
        return 1.0

    def restoring(self, p: Values, view: View) -> Side | float:
        """Force [N] against contraction with which the spring that is stretched by ``view.deflection`` answers."""
        return 0.0

    def restoring_factor(self, p: Values, view: View) -> Side | float:
        """What is left of all with which the spring answers, as a factor."""
        return 1.0

    def force(self, p: Values, view: View) -> Side | float:
        """Any other force [N] in the direction of contraction."""
        return 0.0

    def resistance(self, p: Values, view: View, force: Side) -> Side | float:
        """Force [N] that opposes motion so abruptly that a step must look ahead, given the sum of all others.

        It is kept out of the linear core. An integrator that steps by ``view.step`` takes it at the velocity that
        the end of the step would have; with a step of 0 it is a force at ``view.velocity``.
        """
        return 0.0

    def inertia(self, p: Values) -> Side | float:
        """Moving mass [kg] that this mechanism adds."""
        return 0.0

    def rates(self, p: Values, view: View) -> tuple[Side, ...]:
        """Time derivatives of this mechanism's own states."""
        return ()

    def carried(self, p: Values, before: View, after: View, step: Array) -> tuple[Side, ...]:
        """Own states at the end of a step [s] in which the actuator went from ``before`` to ``after``.

        For states that follow a motion so closely that they saturate within a step: their equation solved for a
        steady motion, in place of what the integrator made of `rates` (``after.own``, which other laws give back).
        """
        return after.own

    def flows(self, p: Values, view: View) -> dict[str, Side]:
        """What it adds to the rates of the states of a base of one's own, by state: ``view.states`` has them."""
        return {}

    def initial(self, p: Values, view: View) -> tuple[Side, ...]:
        """Own states of an actuator that has long been as ``view`` shows it."""
        return ()

    def holds(self, p: Values) -> Side | bool:
        """Whether it can hold an actuator beside its equilibrium."""
        return False

    def delay(self, p: Values) -> Array | float:
        """Dead time [s] between the recorded drive and what reaches the wire."""
        return 0.0

    def reading(self, p: Values, view: View, quantity: Quantity, value: Side) -> Side:
        """What the sensor of ``quantity`` shows [K above ambient, or m], given what the stages before made of it."""
        return value

    def stored(self, p: Values, view: View) -> Side | float:
        """Heat [J] stored in this mechanism's own states, or by its `capacity`."""
        return 0.0

    def beyond_physics(self, p: Values, ambient: float | Array) -> Array | float:
        """How much more than nature allows its parameters ask for together in a room of ``ambient`` [K]: above 0, more.
        One number, also where they have a value per side; asked only where `impossible` says what it
        then is.
        """
        return -1.0

    def lost(self, p: Values, view: View) -> Side | float:
        """Heat flow [W] that leaves the actuator through this mechanism (exchange between its own nodes is not one)."""
        return -jnp.asarray(self.heat(p, view))
