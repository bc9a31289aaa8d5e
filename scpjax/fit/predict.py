"""What a fitted model says of a recording it never saw: inputs in, outputs out."""

from __future__ import annotations

from collections.abc import Mapping

import equinox as eqx
import jax.numpy as jnp
import numpy as np

from scpjax.errors import ModelError, ScpjaxError
from scpjax.fit.problem import columns
from scpjax.physics.model import Model
from scpjax.recordings.recording import Recording
from scpjax.simulate.simulate import Exponential, Method, simulate
from scpjax.units import parse_column

_CLEAR = 4.0  # standard deviations from rest beyond which a first sample says that the actuator was not at rest


def predict(
    model: Model,
    recording: Recording,
    *,
    noise: Mapping[str, float] | None = None,
    response_columns: tuple[str, ...] = (),
    method: Method | None = None,
) -> tuple[np.ndarray, dict[str, np.ndarray]]:
    """Simulate a model over the inputs of a recording.

    The state at the start is that of the first sample where the recording gives one that is clearly not rest
    (``noise``: standard deviation per column, in the file's unit), else rest. No later output is looked at.
    ``response_columns`` names the columns to give, in the unit of their suffix; those of the recording, else the
    model's own in SI, when not given.

    Returns (time (n,) [s], {column: (n,)}).

    **Raises** `ModelError` when the recording's drives do not fit the model.
    """
    meta = recording.metadata
    if meta.ambient_K is not None:
        model = eqx.tree_at(lambda m: m.ambient, model, jnp.asarray(meta.ambient_K, model.theta.dtype))
    z0 = first_state(model, recording, noise or {})
    method = method or Exponential(order=4, substeps=2 if recording.hold != "zero_order" else 1)
    outputs = np.asarray(simulate(model, recording, initial=z0, method=method).outputs)
    if not np.all(np.isfinite(outputs)):
        raise ModelError(
            "the simulation left all bounds",
            where=meta.path,
            mend="check the drive's unit: the model was fitted on far smaller inputs",
        )
    named = {}
    for column, j, scale, offset in _columns(model, recording, response_columns):
        named[column] = (outputs[:, j] - offset) / scale
    return np.asarray(recording.time), named


def first_state(model: Model, recording: Recording, noise: Mapping[str, float]):
    """State vector (states,) at the first sample; rest where the recording does not clearly say otherwise."""
    s = model.structure
    effort0 = _first_effort(model, recording)
    rest = model.initial(effort=effort0) if not s.thermal else model.initial()
    first = _first_outputs(model, recording)
    if not first:
        return rest
    expected = np.asarray(model.observe(rest, jnp.asarray(effort0)))
    clear = {
        j: y - expected[j]
        for j, (y, column, scale) in first.items()
        if abs(y - expected[j]) > _CLEAR * noise.get(column, 0.0) * scale
    }
    n_t = len(s.sides) if s.thermal else 0
    if s.thermal:
        warm = np.zeros(n_t)
        for j, d in clear.items():
            if j < n_t:
                warm[j] = d
        if n_t not in clear and not any(j < n_t for j in clear):
            return rest
        if n_t in clear and not any(j < n_t for j in first) and n_t == 1:
            slope = float(model.value("thermal_actuation.coefficient") / model.value("elastic_spring.stiffness"))
            warm[0] = clear[n_t] * (s.pulley_radius or 1.0) / slope
        return model.initial(jnp.asarray(warm))
    return model.initial(displaced=clear.get(0, 0.0), effort=effort0)


def _first_effort(model: Model, recording: Recording) -> np.ndarray:
    from scpjax.simulate.drive import drive_values, effort

    values = np.asarray(drive_values(model.structure, recording))[:1]
    supply = recording.metadata.supply_V or 3.7
    return np.asarray(effort(model.structure.drive, values, ambient=float(model.ambient), supply=supply))[0]


def _first_outputs(model: Model, recording: Recording) -> dict[int, tuple[float, str, float]]:
    """By output index: (first value in SI, column, SI per file unit) where the first sample is there."""
    if not recording.output_channels:
        return {}
    out = {}
    try:
        found = columns(model.structure, recording)
    except ScpjaxError:  # the recording measures other things than the model predicts: nothing to start from
        return {}
    for j, stem in found:
        channel = next(c for c in recording.output_channels if c.stem == stem)
        if recording.weight(stem)[0] > 0:
            out[j] = (float(recording.output(stem)[0]), channel.column, channel.unit.scale)
    return out


def _columns(model: Model, recording: Recording, wanted: tuple[str, ...]) -> list[tuple[str, int, float, float]]:
    """(column, output index, SI per file unit, SI at file zero)."""
    s = model.structure
    out: dict[int, tuple[str, int, float, float]] = {}
    names = {stem: j for j, stem in enumerate(s.outputs)}
    for column in wanted:
        stem, unit = parse_column(column, allow_unknown=True)
        j = names.get(stem, len(s.outputs) - 1)
        out[j] = (column, j, unit.scale, unit.offset)
    if recording.output_channels:
        for j, stem in columns(s, recording):
            c = next(c for c in recording.output_channels if c.stem == stem)
            out.setdefault(j, (c.column, j, c.unit.scale, c.unit.offset))
    if not out:
        units = {
            "temperature": ("degC", 1.0, 273.15),
            "displacement": ("mm", 1e-3, 0.0),
            "angle": ("deg", np.pi / 180, 0.0),
        }
        for j, stem in enumerate(s.outputs):
            suffix, scale, offset = units[stem.split("_")[0]]
            out[j] = (f"{stem}_{suffix}", j, scale, offset)
    return [out[j] for j in sorted(out)]
