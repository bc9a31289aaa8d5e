"""What a fitted model says of a recording it never saw: inputs in, outputs out."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence

import equinox as eqx
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float
from scipy import optimize, signal

from scpjax.errors import ModelError, ScpjaxError
from scpjax.fit.ambient import told_ambient
from scpjax.fit.data import columns, outputs_among, sigma_by_output
from scpjax.fit.gaps import bridged
from scpjax.physics.model import Model
from scpjax.physics.settled import settled
from scpjax.physics.structure import Structure
from scpjax.recordings.recording import Recording
from scpjax.simulate.drive import drive_values, recorded_effort
from scpjax.simulate.simulate import Exponential, Method, simulate
from scpjax.units import parse_column

_HALVINGS = 5  # of a step of prediction, at most
_CHANGED = 0.003  # of an output's standard deviation, by which it may change when the steps are halved,
_RESOLVED = 0.1  # and of the noise of a sample, where that is told,
_LEAST = 1e-4  # but not of less of its standard deviation, where there is hardly any noise
_CLEAR = 4.0  # standard deviations from rest beyond which a first sample says that the actuator was not at rest
_COLDER = 6.0  # of them below the room, beyond which it says that a heated actuator was colder than that


def predict(
    model: Model,
    recording: Recording,
    *,
    noise: Mapping[str, float] | None = None,
    response_columns: tuple[str, ...] = (),
    rooms: Sequence[float] = (),
    method: Method | None = None,
) -> tuple[np.ndarray, dict[str, np.ndarray]]:
    """Simulate a model over the inputs of a recording.

    The state at the start is that of the first sample where the recording gives one that is clearly not rest
    (``noise``: standard deviation per column, in the file's unit), else rest. A weight that is clearly moving while its
    drive repeats itself is taken to have been driven so before. No later output is looked at.
    A base of the user's own begins where it would stand still and show the first sample. Where the recording's clock
    skipped samples, its drive is taken to have changed along a line.

    ``response_columns`` names the columns to give, in the unit of their suffix, of which those that are no output of
    the model are left out and the first of two for one output is taken; those of the recording, else the model's own
    in degC, mm and deg, when not given.

    ``rooms`` [K] are those in which the recordings were made that the model was fitted to, where none told its own: as
    each of these was taken to have begun in its room, so is this one, if it tells none either and begins undriven about
    as warm as they did, or is driven by a temperature.

    Returns (time (n,) [s], {column: (n,)}).

    **Raises** `ModelError` when the recording's drives do not fit the model.
    """
    meta, sigma = recording.metadata, sigma_by_output(model.structure, noise or {})
    room = _room(model, recording, rooms, sigma) if meta.ambient_K is None else meta.ambient_K
    model = eqx.tree_at(lambda m: m.ambient, model, jnp.asarray(room, model.theta.dtype))
    first = first_state(model, recording, noise or {})
    driven, recorded = bridged(recording, model.structure.drive)

    def outputs_by(method: Method) -> np.ndarray:
        z0 = _in_motion(model, driven, first, method)
        return np.asarray(simulate(model, driven, initial=z0, method=method).outputs)[recorded]

    told = _columns(model, recording, response_columns)
    within = np.full(len(model.structure.outputs), np.inf)
    for j, of in sigma.items():
        within[j] = _RESOLVED * of if of > 0 else np.inf
    outputs = _resolved(model, recording, outputs_by, within) if method is None else outputs_by(method)
    if not np.all(np.isfinite(outputs)):
        raise ModelError(
            "the simulation left all bounds",
            where=meta.path,
            mend="check the drive's unit; else it leads too far from what the model was fitted to",
        )
    named = {}
    for column, j, scale, offset in told:
        named[column] = (outputs[:, j] - offset) / scale
    return np.asarray(recording.time), named


def _room(model: Model, recording: Recording, rooms: Sequence[float], sigma: Mapping[int, float]) -> float:
    """Ambient [K] of a recording that tells none: of the model; or, of those of its ``rooms`` and as far beyond as they
    differ, where it begins.
    """
    s, ambient = model.structure, float(model.ambient)
    if not rooms or s.system:
        return ambient
    if not s.thermal:
        return _counted(model, recording)
    first = _first_outputs(model, recording).get(0)
    if first is None or np.any(recording.inputs[0]):
        return ambient
    apart = max(rooms) - min(rooms)  # by less than the noise where they were of one room
    near = min(rooms) - apart <= first <= max(rooms) + apart
    return first if near and apart > _CLEAR * sigma.get(0, 0.0) else ambient


def _counted(model: Model, recording: Recording) -> float:
    """Temperature [K] from which one that drives counts: the first, or that of the model where what is read of the
    displacement then lies nearer to rest there.
    """
    ambient, first = float(model.ambient), told_ambient(recording, model.structure)
    if first is None:
        return ambient
    read = _first_outputs(model, recording).get(0)
    if read is None:
        return first

    def off(room: float) -> float:
        effort = jnp.asarray(recorded_effort(model.structure, recording, ambient=room))[0]
        return abs(read - float(model.observe(model.initial(effort=effort), effort)[0]))

    return ambient if off(ambient) < off(first) else first


def _resolved(
    model: Model, recording: Recording, outputs_by: Callable[[Exponential], np.ndarray], within: np.ndarray
) -> np.ndarray:
    """Outputs (n, outputs) by steps that are short enough: where what resists motion may saturate within one, and an
    explicit step go astray, they are halved until that changes nothing, to ``within`` (outputs,) at the most.
    """
    s = model.structure
    substeps = s.system.substeps if s.system else 1
    # of higher order, steps as long as a sample may go astray where a mechanism saturates within one
    order, substeps = (2, 4 * substeps) if recording.hold == "zero_order" else (4, 2 * substeps)
    outputs = outputs_by(Exponential(order=order, substeps=substeps))
    if not any(m.may_need_short_steps for m in s.mechanisms):
        return outputs
    for _ in range(_HALVINGS):
        substeps *= 2
        coarse, outputs = outputs, outputs_by(Exponential(order=order, substeps=substeps))
        change = np.sqrt(np.mean((outputs - coarse) ** 2, axis=0))
        size = np.std(outputs, axis=0)
        if np.all(change <= np.clip(within, _LEAST * size, _CHANGED * size)):
            break
    return outputs


def first_state(model: Model, recording: Recording, noise: Mapping[str, float]):
    """State vector (states,) at the first sample; rest where the recording does not clearly say otherwise by ``noise``,
    per column, in whatever unit.
    """
    s, sigma = model.structure, sigma_by_output(model.structure, noise)
    if s.system:
        return settled(model, _first_outputs(model, recording))
    effort0 = _first_effort(model, recording)
    rest = model.initial(effort=effort0) if not s.thermal else model.initial()
    first = _first_outputs(model, recording)
    if not first:
        return rest
    expected = np.asarray(model.observe(rest, jnp.asarray(effort0)))
    n_t = len(s.sides) if s.thermal else 0
    clear = {
        j: y - expected[j]
        for j, y in first.items()
        if abs(y - expected[j]) > (_COLDER if j < n_t and y < expected[j] else _CLEAR) * sigma.get(j, 0.0)
    }
    if s.thermal:
        warm = np.zeros(n_t)
        for j, d in clear.items():
            if j < n_t:
                warm[j] = d
        if n_t not in clear and not any(j < n_t for j in clear):
            return rest
        if n_t in clear and not any(j < n_t for j in first) and n_t == 1:
            warm[0] = _as_warm_as_moved(model, clear[n_t], first[n_t])
        both_read = all(j in first for j in range(n_t + 1))
        beside = _beside(model, warm, first, sigma) if both_read else 0.0
        return model.initial(jnp.asarray(warm), displaced=beside)
    return model.initial(displaced=clear.get(0, 0.0), effort=effort0)


def _as_warm_as_moved(model: Model, away: float, reading: float) -> float:
    """How warm [K above ambient] an actuator alone stands still at a reading of its displacement (m, or rad), ``away``
    from that of rest: by its linear balance, or by all of them where a warmth to four times that meets the reading.
    """
    slope = float(model.value("thermal_actuation.coefficient") / model.value("elastic_spring.stiffness"))
    linear = away * (model.structure.pulley_radius or 1.0) / slope

    def short(warm: float) -> float:
        return reading - _still(model, np.array([warm]))

    cold = short(0.0)
    most = next((share * linear for share in (1.0, 2.0, 4.0) if short(share * linear) * cold <= 0.0), None)
    return linear if most is None else float(optimize.root_scalar(short, bracket=(0.0, most), xtol=1e-3).root)


def _still(model: Model, warm: np.ndarray) -> float:
    """Reading of the displacement (m, or rad) of an actuator that has long been so warm (sides,) [K above ambient]."""
    n = len(model.structure.sides)
    return float(model.observe(model.initial(jnp.asarray(warm)), jnp.zeros(n))[n])


def _beside(model: Model, warm: np.ndarray, first: Mapping[int, float], sigma: Mapping[int, float]) -> float:
    """How far [m] from its equilibrium at a temperature an actuator begins; 0 where the noise, of its displacement and
    of the temperature by which its equilibrium is known, may be all of it."""
    s, n = model.structure, len(model.structure.sides)
    still, off = _still(model, warm), [sigma.get(j, 0.0) for j in range(n + 1)]
    doubt = np.hypot(off[n], sum(abs(_still(model, warm + off[j] * np.eye(n)[j]) - still) for j in range(n)))
    beside = first[n] - still
    return beside * (s.pulley_radius or 1.0) if abs(beside) > _CLEAR * doubt else 0.0


def _in_motion(model: Model, recording: Recording, z0: Array, method: Method) -> Array:
    """The start of a directly driven weight that did not begin at rest under a drive that repeats itself.

    One sample gives its position; its velocity (and what else it remembers) is that of a period later.
    """
    s = model.structure
    if s.thermal or not s.mechanical or np.allclose(z0, model.initial(effort=_first_effort(model, recording))):
        return z0
    lag = period_of(np.asarray(drive_values(s, recording))[:, 0])
    if lag is None:
        return z0
    later = simulate(model, recording, initial=z0, method=method).states[lag]
    return later.at[0].set(z0[0])


def period_of(drive: Float[np.ndarray, " n"], *, tolerance: float = 0.05) -> int | None:
    """Samples after which a drive (n,) repeats itself to its end, to ``tolerance`` of its spread; None if it does not.

    At least an eighth of the drive must lie between, and at least 3 % of it, as lively as the rest, be repeated.
    """
    u = np.asarray(drive, float) - np.mean(drive)
    n = len(u)
    overlap = n - np.arange(n)
    sums, squares = (np.concatenate([[0.0], np.cumsum(x)]) for x in (u, u**2))
    product = signal.correlate(u, u, mode="full", method="fft")[n - 1 :]
    head, tail = squares[overlap], squares[n] - squares[:n]
    apart = np.sqrt(np.maximum(head + tail - 2 * product, 0.0) / overlap)
    lively = head / overlap - (sums[overlap] / overlap) ** 2 > 0.1 * np.mean(u**2)
    fits = lively & (overlap >= max(128, 0.03 * n)) & (np.arange(n) >= n // 8) & (apart < tolerance * np.std(u))
    return int(np.argmin(np.where(fits, apart, np.inf))) if fits.any() else None


def _first_effort(model: Model, recording: Recording) -> np.ndarray:
    return np.asarray(recorded_effort(model.structure, recording, ambient=float(model.ambient)))[0]


def _first_outputs(model: Model, recording: Recording) -> dict[int, float]:
    """First value in SI by output index, where the first sample is there."""
    if not recording.output_channels:
        return {}
    out = {}
    try:
        found = columns(model.structure, recording)
    except ScpjaxError:  # the recording measures other things than the model predicts: nothing to start from
        return {}
    for j, stem in found:
        if recording.weight(stem)[0] > 0:
            out[j] = float(recording.output(stem)[0])
    return out


def _columns(model: Model, recording: Recording, wanted: tuple[str, ...]) -> list[tuple[str, int, float, float]]:
    """(column, output index, SI per file unit, SI at file zero)."""
    s = model.structure
    out: dict[int, tuple[str, int, float, float]] = {}
    parsed = [parse_column(column, allow_unknown=True) for column in wanted]
    for j, place in outputs_among(s, [stem for stem, _ in parsed]).items():
        out[j] = (wanted[place], j, parsed[place][1].scale, parsed[place][1].offset)
    channels = recording.output_channels
    for j, place in outputs_among(s, [c.stem for c in channels]).items():
        c = channels[place]
        out.setdefault(j, (c.column, j, c.unit.scale, c.unit.offset))
    return [out[j] for j in sorted(out)] or _usual_columns(s)


def _usual_columns(s: Structure) -> list[tuple[str, int, float, float]]:
    """The model's own outputs, in the units that files usually have."""
    if s.system:
        units = [unit for _, unit in s.system.channels]
        return [(s.system.outputs[j], j, unit.scale, unit.offset) for j, unit in enumerate(units)]
    usual = {
        "temperature": ("degC", 1.0, 273.15),
        "displacement": ("mm", 1e-3, 0.0),
        "angle": ("deg", np.pi / 180, 0.0),
    }
    return [(f"{stem}_{u[0]}", j, *u[1:]) for j, stem in enumerate(s.outputs) for u in [usual[stem.split("_")[0]]]]
