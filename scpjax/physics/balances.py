"""The balances of a model, evaluated scalar by scalar.

States are kept apart: batched over trials and sensitivities, an integrator that does so compiles to long vector loops.
Everything that does not change along a trajectory (parameter values, masses) is worked out when `Balances` is made. A
step of a simulation makes it anew (`scpjax.simulate.simulate.stepper`): of what does not change XLA takes out of the
loop what is worth it.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from scpjax.physics.mechanism import Mechanism, Values, View
from scpjax.physics.structure import Structure

_SWEEPS = 3  # over what looks a step ahead, where there are several
States = Sequence[Array] | Array
Number = Array | np.ndarray | float


class Balances:
    """Energy and force balances and sensors of one model, with its numbers put in.

    One actuator sees scalars, a joint arrays (2,) of agonist and antagonist. ``step`` [s] is that of the integrator
    that will ask, if it looks ahead; ``core`` leaves out what `Mechanism.resistance` keeps out of the linear core.
    """

    def __init__(
        self,
        structure: Structure,
        theta: Array,
        laws: Array,
        ambient: Array,
        step: Array | float = 0.0,
        core: bool = False,
    ):
        self.structure, self.ambient, self.dtype = structure, ambient, theta.dtype
        self.step, self.core = step, core
        self.sides = len(structure.sides)
        self.values: list[Values] = []
        self.shared: dict[str, Array] = {}  # base parameters that mechanisms refer to: stiffness, thermal_mass
        apart = jax.lax.split(theta, (1,) * theta.shape[0]) if theta.shape[0] else []
        for i, (m, places) in enumerate(zip(structure.mechanisms, structure.places, strict=True)):
            mine = {n: apart[at[0]].reshape(()) if len(at) == 1 else theta[jnp.array(at)] for n, at in places}
            if len(m.laws) > 1:
                mine["law"] = laws[i]
            self.values.append(Values(mine))
            if m.is_base:
                self.shared |= mine
        self.thermal_mass = jnp.zeros(self._shape, self.dtype)
        moving = jnp.zeros((), self.dtype)
        for m, p in zip(structure.mechanisms, self.values, strict=True):
            if _has(m, "thermal_mass"):
                self.thermal_mass = m.thermal_mass(p, self.thermal_mass)
            if _has(m, "inertia"):
                moving = moving + jnp.sum(jnp.broadcast_to(jnp.asarray(m.inertia(p)), self._shape))
        self.moving_mass = moving + 0.5 * structure.pulley_mass  # thesis (3.7), (C.4)

    # -- states to what mechanisms see ---------------------------------------------------------------------------

    @property
    def _shape(self) -> tuple[int, ...]:
        return () if self.sides == 1 else (self.sides,)

    def _join(self, parts: States) -> Array:
        return parts[0] if self.sides == 1 else jnp.stack(list(parts))

    def _each(self, values: Array) -> list[Array]:
        if self.sides == 1:
            return [jnp.reshape(values, ())]
        values = jnp.broadcast_to(values, (self.sides,))
        return [values[i] for i in range(self.sides)]

    def _signed(self, x: Array) -> Array:
        """Of the coordinate, the share of each side: its antagonist lengthens as the agonist contracts."""
        return x if self.sides == 1 else jnp.stack([x, -x])

    def _net(self, forces: Array) -> Array:
        return forces if self.sides == 1 else forces[0] - forces[1]

    def _view(self, z: States, effort: Array, reaching: bool = False) -> tuple[View, list[tuple[Array, ...]]]:
        """What mechanisms see, and their own states; ``reaching``: the effort given is that which reaches the wire."""
        s, at = self.sides, 0
        effort = jnp.reshape(effort, self._shape)
        if self.structure.thermal:
            temperature, at = self._join(z[:s]), s
        else:
            temperature = effort
        still = jnp.zeros(self._shape, self.dtype)
        x = v = still
        if self.structure.mechanical:
            x, v = self._signed(z[at]), self._signed(z[at + 1])
            at += 2
        owns = []
        for m in self.structure.mechanisms:
            owns.append(tuple(self._join(z[at + i * s : at + (i + 1) * s]) for i in range(len(m.states))))
            at += s * len(m.states)
        view = View(self.ambient, effort, temperature, x, v, shared=self.shared, mass=self.moving_mass, step=self.step)
        if s == 2:
            view.radius = self.structure.pulley_radius or 0.0
        if self.structure.timed:
            view.time = z[at]
        if self.structure.system:
            which = self.structure.mechanisms.index(self.structure.system)
            view.states = dict(zip(self.structure.system.states, owns[which], strict=True))
        view.asked = effort
        if not reaching:
            view.effort = self._fold("effort", effort, view, owns)
        view.felt = view.actuating = temperature
        view.deflection = x
        return view, owns

    def _fold(self, hook: str, start: Array, view: View, owns: list, *extra: str) -> Array:
        for m, p, own in zip(self.structure.mechanisms, self.values, owns, strict=True):
            if _has(m, hook):
                view.own = own
                start = getattr(m, hook)(p, view, *extra, start)
        return start

    def _sum(self, hook: str, view: View, owns: list, *extra: Array) -> Array:
        total = None
        for m, p, own in zip(self.structure.mechanisms, self.values, owns, strict=True):
            if _has(m, hook):
                view.own = own
                term = jnp.asarray(getattr(m, hook)(p, view, *extra))
                total = term if total is None else total + term
        return jnp.zeros(self._shape, self.dtype) if total is None else total

    def _scaled(self, hook: str, view: View, owns: list) -> Array:
        """The sum over a hook, times all factors of it."""
        whole = self._sum(hook, view, owns)
        for m, p, own in zip(self.structure.mechanisms, self.values, owns, strict=True):
            if _has(m, f"{hook}_factor"):
                view.own = own
                whole = whole * getattr(m, f"{hook}_factor")(p, view)
        return whole

    def _heat(self, view: View, owns: list) -> None:
        view.power = self._fold("power", jnp.zeros(self._shape, self.dtype), view, owns)
        view.heat = view.power + self._sum("heat", view, owns)

    def _force(self, view: View, owns: list) -> Array:
        view.actuating = self._fold("actuating_temperature", view.temperature, view, owns)
        view.deflection = self._fold("deflection", view.displacement, view, owns)
        view.pull = self._scaled("pull", view, owns)
        view.restoring = self._scaled("restoring", view, owns)
        force = self._net(view.pull - view.restoring + self._sum("force", view, owns))
        return force if self.core else force + self._resisting(view, owns, force)

    def _resisting(self, view: View, owns: list, force: Array) -> Array:
        """Force [N] of what looks a step ahead, each given all the others: what can hold the load last, as that takes
        up what they leave, and all again where there are several, as what holds it keeps it from going where they look.
        """
        every = zip(self.structure.mechanisms, self.values, owns, strict=True)
        those = sorted((e for e in every if _has(e[0], "resistance")), key=lambda e: _has(e[0], "holds"))
        each = [jnp.zeros((), self.dtype) for _ in those]
        for i in list(range(len(those))) * (1 if len(those) == 1 else _SWEEPS):
            m, p, view.own = those[i]
            others = sum((r for j, r in enumerate(each) if j != i), force)
            each[i] = self._net(jnp.broadcast_to(m.resistance(p, view, self._signed(others)), self._shape))
        return sum(each, jnp.zeros((), self.dtype))

    def _own_rates(self, m: Mechanism, p: Values, view: View, owns: list) -> list[Array]:
        """Rates of a mechanism's states; of a system, with what flows beside (which the linear core leaves out)."""
        rates = [jnp.asarray(rate) for rate in m.rates(p, view)]
        if m is not self.structure.system or self.core:
            return rates
        total = dict(zip(m.states, rates, strict=True))
        for other, values, own in zip(self.structure.mechanisms, self.values, owns, strict=True):
            if _has(other, "flows"):
                view.own = own
                for state, flow in other.flows(values, view).items():
                    total[state] = total[state] + flow
        return list(total.values())

    # -- evaluation ----------------------------------------------------------------------------------------------

    def rates(self, z: States, effort: Float[Array, " sides"]) -> list[Array]:
        """Time derivative of every state under an effort (V^2, W, ... per side): thesis (3.2), (3.4), (3.7)."""
        view, owns = self._view(z, effort)
        parts: list[Array] = []
        if self.structure.thermal:
            self._heat(view, owns)
            view.warming = view.heat / (self.thermal_mass + self._sum("capacity", view, owns))
            parts += self._each(view.warming)
        if self.structure.mechanical:
            force = self._force(view, owns)
            parts += [z[len(parts) + 1], force / self.moving_mass]
        if self.structure.thermal and any(m.states for m in self.structure.mechanisms):
            view.felt = self._fold("felt_temperature", view.temperature, view, owns)
        for m, p, own in zip(self.structure.mechanisms, self.values, owns, strict=True):
            view.own = own
            for rate in self._own_rates(m, p, view, owns) if m.states else ():
                parts += self._each(rate)
        if self.structure.timed:
            parts.append(jnp.ones((), self.dtype))
        return parts

    @property
    def carries(self) -> bool:
        """Whether some mechanism knows better than an integrator where a step takes its states."""
        return any(_has(m, "carried") for m in self.structure.mechanisms)

    def carried(self, z: States, after: States, effort: Float[Array, " sides"], step: Array) -> list[Array]:
        """The states ``after`` a step [s] from ``z``, with those of mechanisms that know better."""
        (begins, owns), (ends, ended) = (self._view(at, effort, reaching=True) for at in (z, after))
        parts = list(after[: len(after) - sum(self.sides * len(own) for own in owns) - self.structure.timed])
        for m, p, own, end in zip(self.structure.mechanisms, self.values, owns, ended, strict=True):
            begins.own, ends.own = own, end
            for state in m.carried(p, begins, ends, step) if _has(m, "carried") else end:
                parts += self._each(state)
        return [*parts, *after[len(parts) :]]

    def observe(self, z: States, effort: Float[Array, " sides"]) -> list[Array]:
        """Sensor readings in SI: temperatures [K], then displacement [m] or angle [rad]."""
        view, owns = self._view(z, effort)
        parts: list[Array] = []
        if self.structure.thermal:
            view.felt = self._fold("felt_temperature", view.temperature, view, owns)
            parts += self._each(self.ambient + self._fold("reading", view.felt, view, owns, "temperature"))
        if self.structure.mechanical:
            moved = self._each(self._fold("reading", view.displacement, view, owns, "displacement"))[0]
            parts.append(moved / (self.structure.pulley_radius or 1.0) if self.sides == 2 else moved)
        if self.structure.system:
            which = self.structure.mechanisms.index(self.structure.system)
            view.own = owns[which]
            true = self.structure.system.observe(self.values[which], view)
            for stem, value in zip(self.structure.outputs, true, strict=True):
                parts += self._each(self._fold("reading", jnp.asarray(value), view, owns, stem))
        return parts

    def heat_flows(self, z: States, effort: Float[Array, " sides"]) -> tuple[Array, Array, Array]:
        """(power in [W], power lost to the surroundings [W], heat stored [J]), summed over sides."""
        view, owns = self._view(z, effort)
        self._heat(view, owns)
        lost = stored = jnp.zeros(self._shape, self.dtype)
        for m, p, own in zip(self.structure.mechanisms, self.values, owns, strict=True):
            view.own = own
            if _has(m, "heat") or _has(m, "lost"):
                lost = lost + m.lost(p, view)
            if _has(m, "stored"):
                stored = stored + m.stored(p, view)
        return jnp.sum(view.power), jnp.sum(lost), jnp.sum(stored + self.thermal_mass * view.temperature)

    def delay(self) -> Array:
        """Dead time [s] of the drive."""
        total = jnp.zeros((), self.dtype)
        for m, p in zip(self.structure.mechanisms, self.values, strict=True):
            if _has(m, "delay"):
                total = total + m.delay(p)
        return total

    def holding(self, z: States, first: Float[Array, " sides"]) -> Float[Array, " sides"]:
        """Effort that keeps the heated nodes of a state as warm as they are, as if it had long been so.

        Of a model without an energy balance: the ``first`` one recorded. Power is linear in the effort that reaches
        the wire.
        """
        if not self.structure.thermal:
            return first
        found = self._keeping(z)
        asked, (view, owns) = jnp.reshape(found, self._shape), self._view(z, found, reaching=True)
        for m, p, own in reversed(list(zip(self.structure.mechanisms, self.values, owns, strict=True))):
            view.own = own
            asked = m.effort_for(p, view, asked)
        return jnp.reshape(asked, (self.sides,))

    def _keeping(self, z: States) -> Float[Array, " sides"]:
        """Effort at the wire that keeps the heated nodes of a state as warm as they are."""
        flows = []
        for effort in (jnp.zeros(self.sides, self.dtype), jnp.ones(self.sides, self.dtype)):
            view, owns = self._view(z, effort, reaching=True)
            self._heat(view, owns)
            flows.append(jnp.broadcast_to(view.heat, (self.sides,)))
        found = -flows[0] / (flows[1] - flows[0])
        return found if self.structure.drive == "gain" else jnp.maximum(found, 0.0)

    def _unheld(self) -> Array | float:
        """1 where nothing holds an actuator that begins beside its equilibrium, and it is no weight that is let go."""
        if not self.structure.thermal:
            return 0.0
        every = zip(self.structure.mechanisms, self.values, strict=True)
        held = jnp.array([False, *(jnp.any(jnp.asarray(m.holds(p))) for m, p in every)])
        return jnp.where(jnp.any(held), 0.0, 1.0)

    def _begun(self, own: Array | None) -> list[Array]:
        """States that a system begins in, zero where none are given; none without a system."""
        if self.structure.system is None:
            return []
        n = len(self.structure.system.states)
        return list(jnp.zeros(n, self.dtype) if own is None else jnp.asarray(own, self.dtype))

    def initial(
        self,
        temperature: Number = 0.0,
        displaced: Number = 0.0,
        velocity: Number = 0.0,
        effort: Number = 0.0,
        own: Array | None = None,
    ) -> Float[Array, " n"]:
        """See `Model.initial`."""
        warm = jnp.broadcast_to(jnp.asarray(temperature, self.dtype), (self.sides,))
        effort = jnp.broadcast_to(jnp.asarray(effort, self.dtype), (self.sides,))
        n_own = sum(self.sides * len(m.states) for m in self.structure.mechanisms)
        begun = self._begun(own)
        heat = [warm[i] for i in range(self.sides)] if self.structure.thermal else []
        zero = jnp.zeros((), self.dtype)
        clock = [zero] if self.structure.timed else []

        def at(x: Array, v: Array, beside: Number = 0.0) -> list[Array]:
            """State at a coordinate ``beside`` the equilibrium, own states as after a long time there."""
            moving = [x, v] if self.structure.mechanical else []
            states: dict[str, list[Array]] = {}

            def seen(parts: States, effort: Array, reaching: bool = False) -> View:
                view, owns = self._view([*heat, *moving, *parts, *clock], effort, reaching)
                view.felt = self._fold("felt_temperature", view.temperature, view, owns)
                return view

            def begin(view: View, among: Callable[[Mechanism], bool]) -> list[Array]:
                for m, p in zip(self.structure.mechanisms, self.values, strict=True):
                    if m.states and among(m):
                        share = self._unheld() if m.last_to_hold else 1.0
                        view.displaced = self._signed(jnp.asarray(beside * share, self.dtype))
                        given = begun if m is self.structure.system else m.initial(p, view)
                        states[m.name] = [part for start in given for part in self._each(jnp.asarray(start))]
                return [part for mine in states.values() for part in mine]

            parts = begin(seen([*begun, *[zero] * (n_own - len(begun))], effort), lambda m: True)
            if self.structure.thermal and any(m.states and _has(m, "effort") for m in self.structure.mechanisms):
                # what remembers the drive remembers what has kept it so warm
                kept = self._keeping([*heat, *moving, *parts, *clock])
                parts = begin(seen(parts, kept, reaching=True), lambda m: _has(m, "effort"))
            return [*heat, *moving, *parts, *clock]

        x = v = zero
        if self.structure.mechanical:

            def net(x: Array) -> Array:
                return self._force(*self._view(at(x, zero), effort))

            # one Newton step from the linear spring's answer: exact for linear forces and creep, good for the rest
            pull = self.shared["coefficient"] * jnp.reshape(warm if self.structure.thermal else effort, self._shape)
            stiff = jnp.sum(jnp.broadcast_to(self.shared["stiffness"], (self.sides,)))
            x = self._net(jnp.broadcast_to(pull, self._shape)) / stiff
            force, slope = jax.jvp(net, (x,), (jnp.ones((), self.dtype),))
            x = x - force / slope
            x, v = x + displaced, jnp.asarray(velocity, self.dtype)
        return jnp.stack([jnp.reshape(z, ()) for z in at(x, v, displaced)])


def _has(m: Mechanism, hook: str) -> bool:
    """Does the mechanism do anything there?"""
    return getattr(type(m), hook) is not getattr(Mechanism, hook)
