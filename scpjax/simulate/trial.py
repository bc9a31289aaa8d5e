"""A user's mechanism, tried before it is used: does it vanish at its null values, and can it be simulated?"""

from __future__ import annotations

import os

import numpy as np

from scpjax.errors import ModelError
from scpjax.physics.catalogue import forget, from_file
from scpjax.physics.known import known_model
from scpjax.physics.mechanism import Mechanism
from scpjax.physics.model import Model
from scpjax.physics.structure import DriveKind
from scpjax.recordings.recording import Recording
from scpjax.simulate.simulate import Exponential, simulate

_SAME = 1e-6  # of an output's spread


def use(path: str | os.PathLike[str]) -> tuple[Mechanism, ...]:
    """The mechanisms of a user's file, in the catalogue once they have been tried.

    **Raises** `ModelError` as of `scpjax.physics.catalogue.from_file`, and for a mechanism that does not vanish at its
    null values or cannot be simulated.
    """
    found = from_file(path)
    try:
        for m in found:
            try_null(m, str(path))
    except ModelError:
        forget(path)
        raise
    return found


def try_null(m: Mechanism, where: str = "") -> None:
    """Simulate a plant (or joint) with the mechanism at its null values, and without it, under every law.

    **Raises** `ModelError` where both are not the same, or the mechanism fails when it is simulated.
    """
    drive: DriveKind = "current" if _asks(m, "current") else "voltage"
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
    column = {"voltage": ("voltage", "V"), "current": ("current", "A")}[drive]
    names = [f"{column[0]}_{column[1]}"]
    if sides == 2:
        names = [f"{column[0]}_{side}_{column[1]}" for side in ("agonist", "antagonist")]
    drives = {n: np.where((time + 9 * i) % 27 < 15, 2.0 - i, 0.0) for i, n in enumerate(names)}
    return Recording.from_arrays(time, drives, {}, require_outputs=False)
