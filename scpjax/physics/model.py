"""A model: a structure and its numbers (a pytree)."""

from __future__ import annotations

from collections.abc import Mapping

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from scpjax.errors import ModelError
from scpjax.physics.balances import Balances, Number
from scpjax.physics.coupling import coupling
from scpjax.physics.structure import Structure


class Model(eqx.Module):
    """A structure and its numbers: ``theta`` (parameters,), ``laws`` (mechanisms,), ``ambient`` [K]."""

    structure: Structure = eqx.field(static=True)
    theta: Float[Array, " parameters"]
    laws: Float[Array, " mechanisms"]
    ambient: Float[Array, ""]

    def __init__(
        self,
        structure: Structure,
        theta: Array | np.ndarray | None = None,
        laws: Array | np.ndarray | None = None,
        ambient: Number = 293.15,
    ):
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

    # -- of several recordings -----------------------------------------------------------------------------------

    def of_recording(self, i: Array | int) -> Model:
        """The model of recording ``i``, with its values of what differs by recording (`Structure.own`)."""
        s = self.structure
        return Model(s.plain, self.theta[jnp.asarray(s.in_recording)[i]], self.laws, self.ambient) if s.own else self

    def on_average(self) -> Model:
        """The model of a recording of which nothing is known: with the mean of what differs by recording, which is that
        of ln(value) for a parameter on log scale.
        """
        s = self.structure
        if not s.own:
            return self
        every = self.theta[jnp.asarray(s.in_recording)]
        slots = s.plain.slots
        log = np.array([slot.parameter.scale == "log" for slot in slots])
        mean = jnp.where(log, jnp.exp(jnp.mean(jnp.log(jnp.where(log, every, 1.0)), axis=0)), jnp.mean(every, axis=0))
        differs = np.array([f"{slot.mechanism}.{slot.parameter.name}" in s.own for slot in slots])
        return Model(s.plain, jnp.where(differs, mean, every[0]), self.laws, self.ambient)

    # -- the balances --------------------------------------------------------------------------------------------

    def balances(self, *, step: Number = 0.0, core: bool = False) -> Balances:
        """The balances with the values put in, to be evaluated many times; ``step`` and ``core`` as of `Balances`."""
        if self.structure.own:
            raise ModelError(
                f"{', '.join(self.structure.own)} differ by recording", mend="ask of_recording(i), or on_average()"
            )
        return Balances(self.structure, self.theta, self.laws, self.ambient, jnp.asarray(step, self.theta.dtype), core)

    def rates(self, z: Float[Array, " n"], effort: Float[Array, " sides"]) -> Float[Array, " n"]:
        """Time derivative of the state under an effort (V^2, W, ... per side): thesis (3.2), (3.4), (3.7)."""
        return jnp.stack(self.balances().rates([z[i] for i in range(self.structure.n_states)], effort))

    def observe(self, z: Float[Array, " n"], effort: Float[Array, " sides"]) -> Float[Array, " outputs"]:
        """Sensor readings in SI: temperatures [K], then displacement [m] or angle [rad]."""
        return jnp.stack(self.balances().observe([z[i] for i in range(self.structure.n_states)], effort))

    def initial(
        self,
        temperature: Number = 0.0,
        displaced: Number = 0.0,
        velocity: Number = 0.0,
        effort: Number = 0.0,
        own: Array | None = None,
    ) -> Float[Array, " n"]:
        """State of an actuator that has long been ``temperature`` [K above ambient, per side] warm.

        ``displaced`` [m] is added to the coordinate's equilibrium at that temperature (at that ``effort`` where the
        drive pulls directly), long creep included, and ``velocity`` [m/s] set. ``own`` are the states of a system.
        """
        return self.balances().initial(temperature, displaced, velocity, effort, own)

    def delay(self) -> Array:
        """Dead time [s] of the drive."""
        return self.balances().delay()

    def linearise(
        self, z: Array | None = None, effort: Array | None = None
    ) -> tuple[Float[Array, "n n"], Float[Array, "n sides"]]:
        """(A, B) of the balances about a state and an effort; rest when none is given."""
        n, s = self.structure.n_states, len(self.structure.sides)
        z = jnp.zeros(n, self.theta.dtype) if z is None else z
        effort = jnp.zeros(s, self.theta.dtype) if effort is None else effort
        return jax.jacfwd(self.rates, argnums=(0, 1))(z, effort)

    def core(self) -> Float[Array, "n n"]:
        """What integrators take exactly: A at rest without `Mechanism.resistance` and without the time."""
        n = self.structure.n_states
        still, balances = jnp.zeros(len(self.structure.sides), self.theta.dtype), self.balances(core=True)

        def rates(z: Array) -> Array:
            return jnp.stack(balances.rates([z[i] for i in range(n)], still))

        a = jax.jacfwd(rates)(jnp.zeros(n, self.theta.dtype))
        return jnp.where(np.array(coupling(self.structure)), a, 0.0)

    def __repr__(self) -> str:
        extra = [m.name for m in self.structure.mechanisms if not m.is_base]
        return f"Model({self.structure.name}{''.join(' + ' + e for e in extra)})"
