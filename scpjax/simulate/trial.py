"""A user's mechanism or base, tried before it is used: does it vanish at its null values, can it be simulated?"""

from __future__ import annotations

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
from scpjax.simulate.simulate import Exponential, simulate

_SAME = 1e-6  # of an output's spread


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
        said = np.asarray(simulate(model, _steps(1, "gain"), method=Exponential(order=4)).outputs)
    except Exception as error:  # whatever the user's equations do
        problem = f"{m.name} cannot be simulated: {type(error).__name__}: {error}"
        raise ModelError(problem, where=where, mend="mend its equations") from error
    if not np.all(np.isfinite(said)):
        raise ModelError(
            f"{m.name} does not stay finite from zero states under a drive of 0 and 2",
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
    recording = _steps(len(base.structure.sides), drive)
    plain = np.asarray(simulate(base, recording, method=Exponential(order=4)).outputs)
    spread = np.ptp(plain, axis=0)
    structure = base.structure.with_mechanisms(m)
    theta = structure.typical()
    theta[: len(base.structure.slots)] = np.asarray(base.theta)
    for law, name in enumerate(m.laws):
        laws = np.zeros(len(structure.mechanisms))
        laws[-1] = law
        under = f"{m.name} (law {name})" if name else m.name
        try:
            model = Model(structure, theta, laws, base.ambient)
            said = np.asarray(simulate(model, recording, method=Exponential(order=4)).outputs)
        except Exception as error:  # whatever the user's equations do
            problem = f"{under} cannot be simulated: {type(error).__name__}: {error}"
            raise ModelError(problem, where=where, mend="mend its equations") from error
        off = np.max(np.abs(said - plain), axis=0) / spread
        if not np.all(off < _SAME):
            j = int(np.argmax(np.where(np.isfinite(off), off, np.inf)))
            nulls = ", ".join(f"{p.name} = {p.null:g}" for p in m.parameters if p.null is not None and not p.fixed)
            raise ModelError(
                f"{under} does not vanish at its null values ({nulls}): the {base.structure.outputs[j]} is off by "
                f"{off[j]:.2g} of its spread",
                where=where,
                mend="at the null values the model must be as it is without the mechanism, with no NaN",
            )


def _asks(m: Mechanism, need: str) -> bool:
    return need in m.needs or any(need in needs for needs in m.law_needs.values())


def _steps(sides: int, drive: DriveKind) -> Recording:
    time = 0.5 * np.arange(120)
    column = {"voltage": ("voltage", "V"), "current": ("current", "A"), "gain": ("drive", "V")}[drive]
    names = [f"{column[0]}_{column[1]}"]
    if sides == 2:
        names = [f"{column[0]}_{side}_{column[1]}" for side in ("agonist", "antagonist")]
    drives = {n: np.where((time + 9 * i) % 27 < 15, 2.0 - i, 0.0) for i, n in enumerate(names)}
    return Recording.from_arrays(time, drives, {}, require_outputs=False)
