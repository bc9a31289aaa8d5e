"""A user's mechanism or base, tried before it is used: does it vanish at its null values, can it be simulated?"""

from __future__ import annotations

import itertools
import os

import jax.numpy as jnp
import numpy as np

from scpjax.errors import ModelError
from scpjax.physics.catalogue import forget, from_file, systems
from scpjax.physics.known import known_model
from scpjax.physics.mechanism import Mechanism, View
from scpjax.physics.model import Model
from scpjax.physics.presets import system_structure
from scpjax.physics.structure import DriveKind
from scpjax.physics.system import System
from scpjax.recordings.recording import Recording
from scpjax.simulate.simulate import Exponential, Trajectory, simulate

_SAME = 1e-6  # of an output's spread
_LEAST = 1e-8  # of all that a base shows: an output that spreads by less is not moved, but rounded
_PERIODS, _SIZES = 0.5 / 10.0 ** np.arange(9), 2.0 / 10.0 ** np.arange(4)
# by how many decades shorter and weaker: gentler each time, and rather shorter than weaker
_TRIALS = sorted(itertools.product(range(len(_PERIODS)), range(len(_SIZES))), key=lambda t: (sum(t), t[1]))


def use(path: str | os.PathLike[str]) -> tuple[Mechanism, ...]:
    """The mechanisms of a user's file, in the catalogue once they have been tried.

    **Raises** `ModelError` as of `scpjax.physics.catalogue.from_file`, and for a mechanism that does not vanish at its
    null values, or it or a base that cannot be simulated.
    """
    found = from_file(path)
    try:
        for m in found:  # a base first: the others are tried in it
            if isinstance(m, System):
                try_base(m, str(path))
        for m in found:
            if not isinstance(m, System):
                try_null(m, str(path))
    except BaseException:
        forget(path)
        raise
    return found


def use_base(path: str | os.PathLike[str]) -> System:
    """The only base model of a user's file, in the catalogue with the file's mechanisms.

    **Raises** `ModelError` as of `use`, and for a file that has no base or more than one.
    """
    bases = [m for m in use(path) if isinstance(m, System)]
    if len(bases) != 1:
        forget(path)
        problem = f"defines {len(bases)} base models" if bases else "defines no base model"
        raise ModelError(
            problem, where=str(path), mend="write one class that inherits from scpjax.physics.system.System"
        )
    return bases[0]


def try_base(m: System, where: str = "") -> None:
    """Simulate a base of the user's own over steps of its drive.

    **Raises** `ModelError` where it fails, gives another number of rates or outputs than it names, or is not finite.
    """
    try:
        model = Model(system_structure(m)).replace(m.beginnings()[0])
        view, values = View(*(jnp.zeros(()),) * 5, own=(jnp.zeros(()),) * len(m.states)), model.balances().values[0]
        for hook, wanted in (("rates", len(m.states)), ("observe", len(m.outputs))):
            given = getattr(m, hook)(values, view)
            if not isinstance(given, tuple) or len(given) != wanted:
                raise ValueError(f"{hook} returns {given!r}, and ought to return a tuple of {wanted}")
        found = _stays_finite((model,))
    except Exception as error:  # whatever the user's equations do
        problem = f"{m.name} cannot be simulated: {type(error).__name__}: {error}"
        raise ModelError(problem, where=where, mend="mend its equations") from error
    if not found:
        raise ModelError(
            f"{m.name} does not stay finite from zero states under any drive of 0 and {_SIZES[-1]:g} to {_SIZES[0]:g}, "
            f"sampled every {_PERIODS[-1]:g} to {_PERIODS[0]:g} s",
            where=where,
            mend="mend its equations, or start its parameters elsewhere",
        )


def try_null(m: Mechanism, where: str = "") -> None:
    """Simulate a plant (or joint) with the mechanism at its null values, and without it, under every law.

    **Raises** `ModelError` where both are not the same, or the mechanism fails when it is simulated.
    """
    own = next((base for name, base in systems().items() if _asks(m, name)), None)
    drive: DriveKind = "gain" if own else "current" if _asks(m, "current") else "voltage"
    if own:
        base = Model(system_structure(own)).replace(own.beginnings()[0])
    else:
        base = known_model("aaa" if "joint" in m.needs else "plant", drive=drive)
    structure = base.structure.with_mechanisms(m)
    theta = structure.typical()
    theta[: len(base.structure.slots)] = np.asarray(base.theta)
    for law, name in enumerate(m.laws):
        laws = np.zeros(len(structure.mechanisms))
        laws[-1] = law
        under = f"{m.name} (law {name})" if name else m.name
        try:
            model = Model(structure, theta, laws, base.ambient)
            found = _stays_finite((base, model))
        except Exception as error:  # whatever the user's equations do
            problem = f"{under} cannot be simulated: {type(error).__name__}: {error}"
            raise ModelError(problem, where=where, mend="mend its equations") from error
        off = _apart(*found) if found else np.array([np.inf])
        if not np.all(off < _SAME):
            nulls = ", ".join(f"{p.name} = {p.null:g}" for p in m.parameters if p.null is not None and not p.fixed)
            at = f"the {base.structure.outputs[int(np.argmax(off))]} is off by {np.max(off):.2g} of its spread"
            raise ModelError(
                f"{under} does not vanish at its null values ({nulls}): {at if found else 'it does not stay finite'}",
                where=where,
                mend="at the null values the model must be as it is without the mechanism, with no NaN",
            )


def _stays_finite(models: tuple[Model, ...]) -> list[Trajectory]:
    """What models of the same drive do in the first trial in which all stay finite; nothing where there is none.

    What is quick, or runs away when driven hard, is no fault of its equations: each trial is shorter or weaker.
    """
    first = models[0].structure
    method = Exponential(order=4, substeps=first.system.substeps if first.system else 1)
    for shorter, weaker in _TRIALS:
        recording = _steps(len(first.sides), first.drive, period=_PERIODS[shorter], size=_SIZES[weaker])
        found = []
        for model in models:
            found.append(simulate(model, recording, method=method))
            if not np.all(np.isfinite(found[-1].outputs)):
                break
        else:
            return found
    return []


def _apart(plain: Trajectory, other: Trajectory) -> np.ndarray:
    """How far each output is off, as a share of its spread."""
    wanted = np.asarray(plain.outputs)
    all_of_it = max(np.max(np.abs(plain.states)), np.max(np.abs(wanted)))
    spread = np.maximum(np.ptp(wanted, axis=0), max(_LEAST * all_of_it, np.finfo(float).tiny))
    return np.max(np.abs(np.asarray(other.outputs) - wanted), axis=0) / spread


def _asks(m: Mechanism, need: str) -> bool:
    return need in m.needs or any(need in needs for needs in m.law_needs.values())


def _steps(sides: int, drive: DriveKind, *, period: float, size: float) -> Recording:
    count = np.arange(120)
    column = {"voltage": ("voltage", "V"), "current": ("current", "A"), "gain": ("drive", "V")}[drive]
    names = [f"{column[0]}_{column[1]}"]
    if sides == 2:
        names = [f"{column[0]}_{side}_{column[1]}" for side in ("agonist", "antagonist")]
    drives = {n: np.where((count + 18 * i) % 54 < 30, size * (1.0 - i / 2), 0.0) for i, n in enumerate(names)}
    return Recording.from_arrays(period * count, drives, {}, require_outputs=False)
