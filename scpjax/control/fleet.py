"""Many plants of one kind, for robust tuning: a spread of parameters, or the spread and covariance of a fit."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TypeVar

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Float

from scpjax.control.errors import ControlError
from scpjax.control.plant import Difference, Joint, Plant
from scpjax.physics.model import Model

P = TypeVar("P", bound=Plant)


def varied(model: Model) -> tuple[str, ...]:
    """Keys of the parameters that differ from actuator to actuator: all positive ones but a moving mass."""
    slots = model.structure.slots
    return tuple(
        s.key for s in slots if s.parameter.scale == "log" and not s.parameter.fixed and s.mechanism != "inertia"
    )


def spread_plants(
    plant: Plant, spread: float, count: int, *, seed: int = 0, keys: Sequence[str] | None = None
) -> Plant:
    """``count`` plants (leading axis) whose parameters have the standard deviation ``spread`` in ln(value).

    Each side of a `Difference` has its own. ``keys`` are by default those of `varied`.

    **Raises** `ControlError` for a spread or a count that makes no fleet.
    """
    if not (0 < spread < np.inf) or count < 1:
        raise ControlError(f"{count} plants with a spread of {spread:g}", mend="give 1 plant or more, spread above 0")
    rng = np.random.default_rng(seed)
    return _fleet(plant, [_log_normal(m, spread, count, rng, keys) for m in plant.models()])


def covariance_plants(plant: Plant, covariance: Float[np.ndarray, "k k"], keys: Sequence[str], count: int, *,
                      seed: int = 0) -> Plant:  # fmt: skip
    """``count`` plants drawn from the covariance of ln(``keys``), as a fit gives it; the same for every side.

    **Raises** `ControlError` for a covariance of another shape or that is none.
    """
    covariance = np.asarray(covariance, float)
    if covariance.shape != (len(keys), len(keys)):
        raise ControlError(f"a covariance {covariance.shape} for {len(keys)} parameters", mend="give one row for each")
    if not np.all(np.isfinite(covariance)) or np.min(np.linalg.eigvalsh(covariance)) < -1e-9 * np.max(covariance):
        raise ControlError("this is no covariance", mend="it must be finite, symmetric and positive")
    rng = np.random.default_rng(seed)
    draws = rng.multivariate_normal(np.zeros(len(keys)), covariance, size=count)
    return _fleet(plant, [_scaled(m, keys, np.exp(draws)) for m in plant.models()])


def fleet_of(plants: Sequence[P]) -> P:
    """Plants that were made one by one, with a leading axis. **Raises** `ControlError` where they are not alike."""
    if not plants:
        raise ControlError("a fleet of no plants", mend="give at least one")
    forms = {jax.tree.structure(p) for p in plants}
    if len(forms) > 1:
        raise ControlError("the plants are not of one structure", mend="fit one model to all of them")
    return jax.tree.map(lambda *x: jnp.stack(x), *plants)


def _log_normal(model: Model, spread: float, count: int, rng: np.random.Generator, keys: Sequence[str] | None) -> Model:
    keys = varied(model) if keys is None else tuple(keys)
    return _scaled(model, keys, np.exp(spread * rng.standard_normal((count, len(keys)))))


def _scaled(model: Model, keys: Sequence[str], factors: Float[np.ndarray, "n k"]) -> Model:
    one = lambda f: model.replace({k: model.value(k) * f[i] for i, k in enumerate(keys)})  # noqa: E731
    return jax.vmap(one)(jnp.asarray(factors))


def _fleet(plant: Plant, models: list[Model]) -> Plant:
    count = models[0].theta.shape[0]
    if isinstance(plant, Joint):
        return jax.vmap(lambda m: Joint(m, substeps=plant.substeps))(models[0])
    if not isinstance(plant, Difference):
        raise ControlError(f"no fleet of {type(plant).__name__}", mend="use Difference or Joint")

    def one(agonist: Model, antagonist: Model | None) -> Difference:
        same = {"radius": plant.radius, "opposing": plant.opposing, "stiffness": plant.stiffness}
        return Difference(agonist, antagonist, **same, substeps=plant.substeps)

    if len(models) == 1:
        return jax.vmap(lambda m: one(m, None), axis_size=count)(models[0])
    return jax.vmap(one)(*models)
