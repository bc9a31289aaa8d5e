"""A model: mechanisms put together into balances, with the values of their parameters.

``Structure`` is what a model is made of (hashable, fixed when compiled); ``Model`` adds the numbers (a pytree).
The state vector is ``[temperature of each side, x, dx/dt, own states of the mechanisms (each per side)]`` with the
first part there in thermal models and the second in mechanical ones.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cache, cached_property
from typing import Literal

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from scpjax.errors import ModelError
from scpjax.parameter import Parameter
from scpjax.physics.mechanism import Mechanism, Values, View

DriveKind = Literal["voltage", "pwm", "current", "power", "temperature", "gain"]


@dataclass(frozen=True)
class Slot:
    """Where one parameter of one mechanism (on one side, where sides differ) lies in the parameter vector."""

    mechanism: str
    parameter: Parameter
    index: int
    side: str = ""

    @property
    def key(self) -> str:
        """Name in files and reports: ``elastic_spring.stiffness``, ``elastic_spring.stiffness@agonist``."""
        return f"{self.mechanism}.{self.parameter.name}" + (f"@{self.side}" if self.side else "")


@dataclass(frozen=True)
class Structure:
    """What a model is made of.

    ``sides`` is ``("",)`` for one actuator or ``("agonist", "antagonist")`` for a joint, whose coordinate is the
    agonist's contraction ``x = r theta``. ``distinct`` names parameters ("mechanism.parameter") that differ by side.
    """

    name: str
    mechanisms: tuple[Mechanism, ...]
    sides: tuple[str, ...] = ("",)
    thermal: bool = True
    mechanical: bool = True
    drive: DriveKind = "voltage"
    pulley_radius: float | None = None
    pulley_mass: float = 0.0
    distinct: tuple[str, ...] = ()
    base: tuple[str, ...] = ()

    def __post_init__(self) -> None:
        names = [m.name for m in self.mechanisms]
        if len(set(names)) != len(names):
            raise ModelError(f"a mechanism appears twice in {names}", mend="name each one once")
        if not (self.thermal or self.mechanical):
            raise ModelError("a model needs an energy or a force balance", mend="use te, tm, plant or aaa")
        if len(self.sides) == 2 and self.mechanical and not (self.pulley_radius or 0) > 0:
            raise ModelError("a joint needs its pulley radius", mend="give [pulley] radius_m")

    @cached_property
    def slots(self) -> tuple[Slot, ...]:
        """Every parameter, in the order of the parameter vector."""
        slots: list[Slot] = []
        for m in self.mechanisms:
            for p in m.parameters:
                sides = self.sides if f"{m.name}.{p.name}" in self.distinct else ("",)
                slots += [Slot(m.name, p, len(slots) + i, s) for i, s in enumerate(sides)]
        return tuple(slots)

    @cached_property
    def index(self) -> dict[str, int]:
        """Position of each parameter key in the parameter vector."""
        return {s.key: s.index for s in self.slots}

    @cached_property
    def _places(self) -> tuple[tuple[tuple[str, tuple[int, ...]], ...], ...]:
        places = []
        for m in self.mechanisms:
            mine = [s for s in self.slots if s.mechanism == m.name]
            places.append(tuple((p.name, tuple(s.index for s in mine if s.parameter is p)) for p in m.parameters))
        return tuple(places)

    @property
    def outputs(self) -> tuple[str, ...]:
        """Stems of the output columns: temperature (per side), then displacement or angle."""
        joined = [f"temperature_{s}" if s else "temperature" for s in self.sides] if self.thermal else []
        if self.mechanical:
            joined.append("angle" if len(self.sides) == 2 else "displacement")
        return tuple(joined)

    @property
    def inputs(self) -> tuple[str, ...]:
        """Names of the drives, one per side."""
        return tuple(f"drive_{s}" if s else "drive" for s in self.sides)

    @cached_property
    def state_names(self) -> tuple[str, ...]:
        """Name of every entry of the state vector."""
        tail = [f"_{s}" if s else "" for s in self.sides]
        names = [f"temperature{t}" for t in tail] if self.thermal else []
        names += ["displacement", "velocity"] if self.mechanical else []
        for m in self.mechanisms:
            names += [f"{m.name}.{state}{t}" for state in m.states for t in tail]
        return tuple(names)

    @property
    def n_states(self) -> int:
        return len(self.state_names)

    @property
    def is_linear(self) -> bool:
        """Only base mechanisms, which are linear in the states and in the effort."""
        return all(m.is_base for m in self.mechanisms)

    def mechanism(self, name: str) -> Mechanism:
        """The mechanism of that name."""
        for m in self.mechanisms:
            if m.name == name:
                return m
        raise ModelError(f"no mechanism {name!r} in this model", mend=f"it has {[m.name for m in self.mechanisms]}")

    def with_mechanisms(self, *mechanisms: Mechanism) -> Structure:
        """The same structure with more mechanisms in it."""
        present = {m.name for m in self.mechanisms}
        return replace(self, mechanisms=self.mechanisms + tuple(m for m in mechanisms if m.name not in present))

    def typical(self) -> np.ndarray:
        """Typical values for base parameters and null values for all others."""
        return np.array([s.parameter.typical if s.parameter.null is None else s.parameter.null for s in self.slots])


class Model(eqx.Module):
    """A structure and its numbers: ``theta`` (parameters,), ``laws`` (mechanisms,), ``ambient`` [K]."""

    structure: Structure = eqx.field(static=True)
    theta: Float[Array, " parameters"]
    laws: Float[Array, " mechanisms"]
    ambient: Float[Array, ""]

    def __init__(self, structure: Structure, theta=None, laws=None, ambient=293.15):
        self.structure = structure
        self.theta = jnp.asarray(structure.typical() if theta is None else theta, dtype=float)
        self.laws = jnp.asarray(np.zeros(len(structure.mechanisms)) if laws is None else laws, dtype=self.theta.dtype)
        self.ambient = jnp.asarray(ambient, dtype=self.theta.dtype)

    def __check_init__(self) -> None:
        if self.theta.ndim == 1 and self.theta.shape[0] != len(self.structure.slots):
            raise ModelError(
                f"{self.theta.shape[0]} parameter values for {len(self.structure.slots)} parameters",
                mend="give one value per slot of the structure",
            )

    # -- values by name ------------------------------------------------------------------------------------------

    def value(self, key: str) -> Array:
        """Value of a parameter, ``model.value("elastic_spring.stiffness")``."""
        return self.theta[self._index(key)]

    def values(self) -> dict[str, float]:
        """All parameter values by key."""
        return {s.key: float(self.theta[s.index]) for s in self.structure.slots}

    def replace(self, values: Mapping[str, float | Array]) -> Model:
        """The same model with other values of the parameters named."""
        theta = self.theta
        for key, value in values.items():
            theta = theta.at[self._index(key)].set(value)
        return eqx.tree_at(lambda m: m.theta, self, theta)

    def _index(self, key: str) -> int:
        if key not in self.structure.index:
            raise ModelError(f"no parameter {key!r}", mend=f"the model has {sorted(self.structure.index)}")
        return self.structure.index[key]

    def _values(self) -> list[Values]:
        out = []
        for i, places in enumerate(self.structure._places):
            mine = {n: self.theta[at[0]] if len(at) == 1 else self.theta[jnp.array(at)] for n, at in places}
            out.append(Values(mine | {"law": self.laws[i]}))
        return out

    # -- the balances --------------------------------------------------------------------------------------------

    @property
    def signs(self) -> np.ndarray:
        """+1 for the side that contracts with the coordinate, -1 for its antagonist."""
        return np.array([1.0, -1.0][: len(self.structure.sides)])

    def _view(self, z: Sequence[Array], effort: Float[Array, " sides"]) -> tuple[View, list[tuple[Array, ...]]]:
        s, at = len(self.structure.sides), 0
        if self.structure.thermal:
            temperature, at = jnp.stack(z[:s]), s
        else:
            temperature = jnp.asarray(effort)
        still = jnp.zeros((s,), self.theta.dtype)
        x, v = (z[at] * self.signs, z[at + 1] * self.signs) if self.structure.mechanical else (still, still)
        at += 2 * self.structure.mechanical
        owns = []
        for m in self.structure.mechanisms:
            owns.append(tuple(jnp.stack(z[at + i * s : at + (i + 1) * s]) for i in range(len(m.states))))
            at += s * len(m.states)
        view = View(self.ambient, jnp.asarray(effort), temperature, x, v)
        for m, p in zip(self.structure.mechanisms, self._values(), strict=True):
            if m.is_base:
                view.shared |= {q.name: getattr(p, q.name) for q in m.parameters}
        return view, owns

    def _fold(self, hook: str, start, view: View, values: list[Values], owns: list, *extra):
        for m, p, own in zip(self.structure.mechanisms, values, owns, strict=True):
            if getattr(type(m), hook) is not getattr(Mechanism, hook):
                view.own = own
                start = getattr(m, hook)(p, view, *extra, start)
        return start

    def _sum(self, hook: str, view: View, values: list[Values], owns: list):
        total = jnp.zeros_like(view.temperature)
        for m, p, own in zip(self.structure.mechanisms, values, owns, strict=True):
            if getattr(type(m), hook) is not getattr(Mechanism, hook):
                view.own = own
                total = total + getattr(m, hook)(p, view)
        return total

    def _balance(self, z: Sequence[Array], effort: Float[Array, " sides"]) -> tuple[View, list, list[Values]]:
        """View with power, heat, actuating and felt temperature and deflection filled in."""
        view, owns = self._view(z, effort)
        values = self._values()
        zero = jnp.zeros_like(view.temperature)
        if self.structure.thermal:
            view.power = self._fold("power", zero, view, values, owns)
            view.heat = view.power + self._sum("heat", view, values, owns)
        view.actuating = self._fold("actuating_temperature", view.temperature, view, values, owns)
        view.felt = self._fold("felt_temperature", view.temperature, view, values, owns)
        view.deflection = self._fold("deflection", view.displacement, view, values, owns)
        return view, owns, values

    def rates(self, z: Float[Array, " n"], effort: Float[Array, " sides"]) -> Float[Array, " n"]:
        """Time derivative of the state under an effort (V^2, W, ... per side): thesis (3.2), (3.4), (3.7)."""
        return jnp.stack(self.rates_list([z[i] for i in range(self.structure.n_states)], effort))

    def rates_list(self, z: Sequence[Array], effort: Float[Array, " sides"]) -> list[Array]:
        """The same, scalar by scalar: an integrator that keeps the states apart compiles to long vector loops."""
        view, owns, values = self._balance(z, effort)
        parts: list[Array] = []
        if self.structure.thermal:
            mass = jnp.zeros_like(view.temperature)
            for m, p in zip(self.structure.mechanisms, values, strict=True):
                mass = m.thermal_mass(p, mass)
            parts += self._each(view.heat / mass)
        if self.structure.mechanical:
            force = jnp.sum(self.signs * self._sum("force", view, values, owns))
            parts += [view.velocity[0] * self.signs[0], force / self._moving_mass(values)]
        for m, p, own in zip(self.structure.mechanisms, values, owns, strict=True):
            view.own = own
            for rate in m.rates(p, view) if m.states else ():
                parts += self._each(rate)
        return parts

    def _each(self, values: Array) -> list[Array]:
        sides = len(self.structure.sides)
        values = jnp.broadcast_to(values, (sides,))
        return [values[i] for i in range(sides)]

    def _moving_mass(self, values: list[Values]) -> Array:
        mass = jnp.zeros(len(self.structure.sides), self.theta.dtype)
        for m, p in zip(self.structure.mechanisms, values, strict=True):
            mass = mass + m.inertia(p)
        return jnp.sum(mass) + 0.5 * self.structure.pulley_mass  # thesis (3.7), (C.4)

    def observe(self, z: Float[Array, " n"], effort: Float[Array, " sides"]) -> Float[Array, " outputs"]:
        """Sensor readings in SI: temperatures [K], then displacement [m] or angle [rad]."""
        return jnp.stack(self.observe_list(_apart(z), effort))

    def observe_list(self, z: Sequence[Array], effort: Float[Array, " sides"]) -> list[Array]:
        """The same, scalar by scalar."""
        view, owns, values = self._balance(z, effort)
        parts: list[Array] = []
        if self.structure.thermal:
            felt = self._fold("reading", view.felt, view, values, owns, "temperature")
            parts += self._each(self.ambient + felt)
        if self.structure.mechanical:
            moved = self._fold("reading", view.displacement, view, values, owns, "displacement")[0]
            parts.append(moved / self.structure.pulley_radius if len(self.structure.sides) == 2 else moved)
        return parts

    def heat_flows(self, z, effort) -> tuple[Array, Array, Array]:
        """(power in [W], power lost to the surroundings [W], heat stored [J]), summed over sides."""
        view, owns, values = self._balance(_apart(z), effort)
        lost, stored = jnp.zeros_like(view.power), jnp.zeros_like(view.power)
        mass = jnp.zeros_like(view.temperature)
        for m, p, own in zip(self.structure.mechanisms, values, owns, strict=True):
            mass = m.thermal_mass(p, mass)
            view.own = own
            lost = lost + m.lost(p, view)
            if type(m).stored is not Mechanism.stored:
                stored = stored + m.stored(p, view)
        return jnp.sum(view.power), jnp.sum(lost), jnp.sum(stored + mass * view.temperature)

    # -- start, delay, linear core -------------------------------------------------------------------------------

    def initial(self, temperature=0.0, displaced=0.0, velocity=0.0, effort=0.0) -> Float[Array, " n"]:
        """State of an actuator that has long been ``temperature`` [K above ambient, per side] warm.

        ``displaced`` [m] is added to the coordinate's equilibrium at that temperature (at that ``effort`` where the
        drive pulls directly), long creep included, and ``velocity`` [m/s] set.
        """
        s, dtype = len(self.structure.sides), self.theta.dtype
        warm = jnp.broadcast_to(jnp.asarray(temperature, dtype), (s,))
        effort = jnp.broadcast_to(jnp.asarray(effort, dtype), (s,))
        n_own = sum(s * len(m.states) for m in self.structure.mechanisms)
        heat = self._each(warm) if self.structure.thermal else []

        def at(x: Array, v: Array) -> tuple[list[Array], View, list[Values]]:
            """State at a coordinate, own states as after a long time there."""
            moving = [x, v] if self.structure.mechanical else []
            blank = [*heat, *moving, *[jnp.zeros((), dtype)] * n_own]
            view, _, values = self._balance(blank, effort)
            own: list[Array] = []
            for m, p in zip(self.structure.mechanisms, values, strict=True):
                for start in m.initial(p, view) if m.states else ():
                    own += self._each(start)
            return [*heat, *moving, *own], view, values

        x = v = jnp.zeros((), dtype)
        if self.structure.mechanical:

            def net(x: Array) -> Array:
                view, owns, values = self._balance(at(x, v)[0], effort)
                return jnp.sum(self.signs * self._sum("force", view, values, owns))

            # one Newton step from the linear spring's answer: exact for linear forces and creep, good for the rest
            shared = self._view([*heat, x, v, *[x] * n_own], effort)[0].shared
            pull = shared["coefficient"] * (warm if self.structure.thermal else effort)
            stiff = jnp.sum(jnp.broadcast_to(shared["stiffness"], (s,)))
            x = jnp.sum(self.signs * pull) / stiff
            force, slope = jax.jvp(net, (x,), (jnp.ones((), dtype),))
            x = x - force / slope
            x, v = x + displaced, jnp.asarray(velocity, dtype)
        return jnp.stack([jnp.reshape(z, ()) for z in at(x, v)[0]])

    def delay(self) -> Array:
        """Dead time [s] of the drive."""
        total = jnp.zeros((), self.theta.dtype)
        for m, p in zip(self.structure.mechanisms, self._values(), strict=True):
            total = total + m.delay(p)
        return total

    def linearise(self, z=None, effort=None) -> tuple[Float[Array, "n n"], Float[Array, "n sides"]]:
        """(A, B) of the balances about a state and an effort; rest when none is given."""
        n, s = self.structure.n_states, len(self.structure.sides)
        z = jnp.zeros(n, self.theta.dtype) if z is None else z
        effort = jnp.zeros(s, self.theta.dtype) if effort is None else effort
        return jax.jacfwd(self.rates, argnums=(0, 1))(z, effort)

    def __repr__(self) -> str:
        extra = [m.name for m in self.structure.mechanisms if not m.is_base]
        return f"Model({self.structure.name}{''.join(' + ' + e for e in extra)})"


def _apart(z: Float[Array, " n"] | Sequence[Array]) -> list[Array]:
    return [z[i] for i in range(len(z))]


@cache
def coupling(structure: Structure) -> tuple[tuple[bool, ...], ...]:
    """Which state can influence which at all, in the linear core and so in its exponential: (to, from).

    Found by differentiating the balances at random parameter values under every law, closed under composition.
    """
    rng = np.random.default_rng(0)
    n = structure.n_states
    reach = np.eye(n, dtype=bool)
    with jax.ensure_compile_time_eval():
        for law in range(max(len(m.laws) for m in structure.mechanisms)):
            theta = structure.typical() * rng.uniform(0.7, 1.3, len(structure.slots))
            for slot in structure.slots:
                if not slot.parameter.fixed and slot.parameter.null is not None:
                    theta[slot.index] = (slot.parameter.typical or 0.1) * rng.uniform(0.7, 1.3)
            laws = np.full(len(structure.mechanisms), float(law))
            a, _ = Model(structure, theta, laws).linearise()
            reach |= np.asarray(a) != 0
    for _ in range(n):
        reach = reach | ((reach.astype(int) @ reach.astype(int)) > 0)
    return tuple(tuple(bool(x) for x in row) for row in reach)
