"""What may move in a fit: starts, bounds, scales and weak priors of parameters and initial states."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import jax.numpy as jnp
import numpy as np
from jaxtyping import Float

from scpjax.fit.data import columns
from scpjax.fit.guess import Guess, Scales
from scpjax.fit.problem import Locals, Space
from scpjax.parameter import Bounded, Parameter
from scpjax.physics.catalogue import is_shipped
from scpjax.physics.model import Model
from scpjax.physics.settled import settled
from scpjax.physics.structure import Structure
from scpjax.recordings.recording import Recording
from scpjax.simulate.drive import recorded_effort

_CLEAR = 6.0  # a first reading further from rest, in units of the noise, is not of rest
_WARM, _AWAY = 0.05, 0.01  # nor is one further, in units of the range seen, of temperature, of displacement


def null_values(s: Structure, scales: Scales) -> np.ndarray:
    """Values at which every left-out mechanism vanishes. References of this package's mechanisms (fixed, by their unit)
    are the data's scales; what a user fixed stays as given.
    """
    shipped = {m.name for m in s.mechanisms if is_shipped(m)}
    measures = {"K": scales.temperature, "m": scales.displacement, "s": scales.duration, "V": scales.drive}
    out = []
    for slot in s.slots:
        p = slot.parameter
        if p.fixed and p.name.startswith("reference") and slot.mechanism in shipped:
            out.append(measures[p.unit])
        elif p.null is None:
            out.append(np.nan)
        else:
            out.append(p.null)
    return np.array(out)


def starts_of(
    s: Structure,
    guesses: Sequence[Guess],
    known: Mapping[str, float],
    scales: Scales,
    recordings: Sequence[Recording],
    locals_: Locals,
    ambient: Sequence[float],
) -> tuple[list[np.ndarray], np.ndarray]:
    """Physical start vectors (parameters and locals) and which parameters a base fit moves."""
    free = np.array(
        [slot.parameter.null is None and not slot.parameter.fixed and slot.key not in known for slot in s.slots]
    )
    n_t, n_s = (len(s.sides) if s.thermal else 0), len(s.sides)
    seen_t, seen_x = measured(s, recordings)
    for slot in s.slots:
        if slot.key.startswith("sensor_offset"):
            free[slot.index] &= seen_t if slot.parameter.name == "temperature" else seen_x
        if not seen_x and s.mechanical and slot.mechanism in ("thermal_actuation", "elastic_spring", "viscous_damping"):
            free[slot.index] = False
    starts = []
    for guess in guesses:
        theta = null_values(s, scales)
        for slot in s.slots:
            if slot.parameter.null is None:
                theta[slot.index] = known.get(
                    slot.key, guess.values.get(slot.key.split("@")[0], slot.parameter.typical)
                )
        local: list[float] = []
        for r, a in zip(recordings, ambient, strict=True):
            local += _initial_guess(s, r, a, theta, locals_, n_t, n_s)
        starts.append(np.concatenate([theta, local]))
    return starts, free


def _initial_guess(
    s: Structure, r: Recording, ambient: float, theta: np.ndarray, locals_: Locals, n_t: int, n_s: int
) -> list[float]:
    """Local values of one recording from its first samples."""
    first = {j: float(np.median(r.output(stem)[:3])) for j, stem in columns(s, r)}
    if s.system and not locals_.own:
        return []
    if locals_.own:
        return [float(v) for v in settled(Model(s, theta), first)[: locals_.count(s)]]
    out: list[float] = []
    slope = 0.0
    if s.mechanical:
        slope = theta[s.index["thermal_actuation.coefficient"]] / theta[s.index["elastic_spring.stiffness"]]
    x = first.get(len(s.outputs) - 1, 0.0) * (s.pulley_radius or 1.0) if s.mechanical else 0.0
    pull = 0.0
    if locals_.temperature:
        if any(j < n_t for j in first):
            out = [first[j] - ambient if j in first else 0.0 for j in range(n_s)]
        else:
            out = [x / slope if slope > 0 else 0.0] if n_s == 1 else [0.0] * n_s
        pull = slope * out[0]
    elif s.mechanical:
        pull = slope * float(np.asarray(recorded_effort(s, r, ambient=ambient))[0, 0])
    return out + [x - pull] * locals_.displaced + [0.0] * locals_.moving


def space_of(
    s: Structure, locals_: Locals, n_rec: int, start: np.ndarray, scales: Scales, seen_t: bool, strength: float
) -> Space:
    """Bounds, scales and priors of everything that may move."""
    low, high, log, scale, mean, spread = [], [], [], [], [], []
    for slot in s.slots:
        p = slot.parameter
        unit = {"response": scales.response, "duration": scales.duration}.get(p.time, 1.0)
        low.append(p.bounds[0] * unit)
        high.append(p.bounds[1] * unit)
        log.append(p.scale == "log")
        value = start[slot.index]
        scale.append(_linear_scale(p, slot.mechanism, value, scales))
        centre, wide = _prior(p, slot.mechanism, value, unit, seen_t, s, strength)
        mean.append(centre)
        spread.append(wide)
    travel, n_local = scales.displacement, locals_.count(s)
    for i in range(n_rec):
        if locals_.own:
            begun = start[len(s.slots) + i * n_local :][:n_local]
            low, high, log = low + [-np.inf] * n_local, high + [np.inf] * n_local, log + [False] * n_local
            size = np.maximum(np.abs(begun), 1e-3 * max(np.max(np.abs(begun)), travel))
            scale, mean, spread = [*scale, *size], [*mean, *begun], [*spread, *(10 * np.maximum(size, travel))]
        if locals_.temperature:
            n = len(s.sides)
            low, high, log = low + [-np.inf] * n, high + [np.inf] * n, log + [False] * n
            scale, mean, spread = (
                scale + [5.0] * n,
                mean + [0.0] * n,
                spread + [np.inf if seen_t else 20.0] * n,
            )
        if locals_.displaced:
            low, high, log = [*low, -np.inf], [*high, np.inf], [*log, False]
            far = 0.3 if s.thermal else 3.0  # of the travel: what friction may hold, or a drive before the first sample
            scale, mean, spread = [*scale, 0.1 * travel], [*mean, 0.0], [*spread, far * travel]
        if locals_.moving:
            low, high, log = [*low, -np.inf], [*high, np.inf], [*log, False]
            quick = np.sqrt(start[s.index["elastic_spring.stiffness"]] / start[s.index["inertia.mass"]])
            scale, mean, spread = [*scale, 0.1 * travel * quick], [*mean, 0.0], [*spread, 3 * travel * quick]
    bounds = Bounded(np.array(low), np.array(high), np.array(log), np.array(scale))
    return Space(s, locals_, n_rec, bounds, jnp.asarray(np.array(mean)), jnp.asarray(np.array(spread)))


def _linear_scale(p: Parameter, mechanism: str, value: float, scales: Scales) -> float:
    if mechanism == "sensor_offset":
        return 1.0 if p.name == "temperature" else 0.05 * scales.displacement
    return abs(value) if np.isfinite(value) and value != 0 else 1.0


def _prior(
    p: Parameter, mechanism: str, value: float, unit: float, seen_t: bool, s: Structure, strength: float
) -> tuple[float, float]:
    """(mean, spread) on the inner scale. Weak, and only where data alone may leave a direction open."""
    if p.null is not None:
        centre = p.typical * unit
        return (float(np.log(centre)) if p.scale == "log" else p.typical), p.spread
    if p.scale != "log" or not value > 0:
        return 0.0, np.inf
    direct = not s.thermal
    spread = {"elastic_spring": 2.0 if direct else 1.2, "viscous_damping": 2.0, "inertia": 0.7}.get(mechanism, np.inf)
    if mechanism == "newton_cooling" and not seen_t:
        spread = 1.0 if p.name == "thermal_mass" else 3.0
    return float(np.log(value)), spread / strength


def driven_before(
    s: Structure, recordings: Sequence[Recording], ambient: Sequence[float], sigma: Float[np.ndarray, " y"]
) -> bool:
    """Whether a recording, of temperature and displacement, says that its actuator had been driven before it began: it
    is not at the room's temperature, or, held by what it remembers of that, not at the zero of its displacement (a
    sensor that was not zeroed looks like that too).
    """
    if not (s.thermal and s.mechanical and all(measured(s, recordings))):
        return False
    for r, room in zip(recordings, ambient, strict=True):
        for j, stem in columns(s, r):
            found, (rest, share) = r.output(stem), (room, _WARM) if j < len(s.sides) else (0.0, _AWAY)
            off = np.abs(found[:3] - rest)
            # what a drive has moved by the second sample, or one wild sample, says nothing of a displacement
            first = float(np.median(off) if j < len(s.sides) else np.min(off))
            if first > max(_CLEAR * float(sigma[j]), share * float(np.ptp(found))):
                return True
    return False


def measured(s: Structure, recordings: Sequence[Recording]) -> tuple[bool, bool]:
    """(temperature is recorded, displacement or angle is recorded)."""
    seen = {j for r in recordings for j, _ in columns(s, r)}
    n_t = len(s.sides) if s.thermal else 0
    return any(j < n_t for j in seen), any(j >= n_t for j in seen)
