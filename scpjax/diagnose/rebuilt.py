"""The hypothesis that a diagnosis ended with, fitted again to its recordings from what its JSON says."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from scpjax.diagnose.final import resolved
from scpjax.diagnose.holdout import Split, split
from scpjax.diagnose.hypothesis import State, grown, residual_on, trial_at
from scpjax.diagnose.own import with_own
from scpjax.diagnose.result import FREE
from scpjax.errors import FitError
from scpjax.fit.fit import refine, scores, settle
from scpjax.fit.setup import Setup, prepare, usual_substeps
from scpjax.physics.catalogue import mechanism
from scpjax.recordings.recording import Recording

_AGAIN = "delete its folder and diagnose it again"
_REPRODUCED = 1.1  # ratio of RMS errors, up to which a fit is the one that its diagnosis tells of


@dataclass(frozen=True, eq=False)
class Actuator:
    """One of a fleet: its recordings, and the hypothesis that its diagnosis ended with. ``stand_ins``: by mechanism
    named, those that could stand in for it."""

    name: str
    parts: Split
    state: State
    stand_ins: Mapping[str, tuple[str, ...]]


def rebuilt(name: str, content: Mapping[str, Any], recordings: Sequence[Recording]) -> Actuator:
    """The actuator of a diagnosis in the form ``scpjax.diagnosis/1`` of these recordings, its model fitted to their
    training part again from the values told.

    **Raises** `FitError` where the model holds more than mechanisms, or does not fit as well as it is told to.
    """
    told = content["mechanisms"]
    if content["closure"] is not None or any(m["law"] == FREE for m in told):
        raise FitError("its model holds what was learned, not mechanisms alone")
    model, settings = content["base"]["model"], content["settings"]
    substeps = settings["substeps"] or usual_substeps(recordings, model)
    samples = settings["bin"] // substeps  # in a bin
    setup = prepare(recordings, model=model, bin=samples, order=settings["order"], substeps=substeps)
    setup = _problem(setup, told)
    structure = setup.structure
    law = {m["name"]: m["law"] for m in told}
    laws = np.array([float(m.laws.index(law[m.name])) if m.name in law else 0.0 for m in structure.mechanisms])
    values = {**content["parameters"], **{f"{m['name']}.{k}": e for m in told for k, e in m["parameters"].items()}}
    value = np.array(setup.starts[0])
    for key, estimate in values.items():
        if key not in structure.index:
            raise FitError(f"no parameter {key!r} in its model", mend=_AGAIN)
        value[structure.index[key]] = estimate["value"]
    trial, data, _ = settle(setup, trial_at(setup, value, laws), setup.data)
    parts = split(data)
    trial, _, cost = refine(setup, parts.train, trial)
    state = State(setup, trial, residual_on(trial, parts.whole, setup), cost)
    parts, state, _ = resolved(state, parts)
    _check(content, parts, state)
    return Actuator(name, parts, state, {m["name"]: tuple(m["equivalents"]) for m in told})


def _problem(setup: Setup, told: Sequence[Mapping[str, Any]]) -> Setup:
    """The problem with the mechanisms of a diagnosis, and what differs by recording in them."""
    setup = grown(setup, *(mechanism(m["name"]) for m in told))
    own = [f"{m['name']}.{p}" for m in told for p in m["by_recording"]]
    return with_own(setup, *own) if own else setup


def _check(content: Mapping[str, Any], parts: Split, state: State) -> None:
    found = scores(state.setup, parts.whole, state.trial, np.asarray(parts.train.weights))
    for column, before in content["extended"]["train"].items():
        told, now = before["rmse"], found[column]["rmse"]
        if told is None or not now <= _REPRODUCED * told:
            was = "what was no number" if told is None else f"{told:.3g}"
            raise FitError(
                f"fitted again from the values told, it misses {column} by {now:.3g}, not {was}", mend=_AGAIN
            )
