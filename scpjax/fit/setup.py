"""From recordings to a least-squares problem: which model, what is known, what is free, where to start."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import jax.numpy as jnp
import numpy as np

from scpjax.errors import FitError, ModelError, ScpjaxError
from scpjax.fit.problem import Data, Locals, Space, Trial, columns, pack
from scpjax.fit.start import Linear, best_linear, thermal_mass_from_energy
from scpjax.parameter import Bounded, Parameter
from scpjax.physics.catalogue import applicable
from scpjax.physics.mechanism import Mechanism
from scpjax.physics.presets import structure as preset
from scpjax.physics.structure import Structure
from scpjax.recordings.condition import estimate_noise, resample
from scpjax.recordings.recording import Recording, check_informative
from scpjax.simulate.drive import drive_kind, drive_values, effort, held_means

KNOWN = {
    "resistance_ohm": "joule_heating.gain",
    "gain_W_per_unit": "joule_heating.gain",
    "conductance_W_per_K": "newton_cooling.conductance",
    "thermal_mass_J_per_K": "newton_cooling.thermal_mass",
    "coefficient_N_per_K": "thermal_actuation.coefficient",
    "stiffness_N_per_m": "elastic_spring.stiffness",
    "damping_Ns_per_m": "viscous_damping.damping",
    "moving_mass_kg": "inertia.mass",
}
"""Keys of ``[actuator]`` in a recording's TOML file and the parameter each one fixes."""


@dataclass(frozen=True)
class Scales:
    """What is small and large in these recordings; SI."""

    response: float  # s, the time constant that governs the outputs
    duration: float  # s
    temperature: float  # K, greatest excess (of the model's start)
    displacement: float  # m, greatest travel


@dataclass(frozen=True)
class Setup:
    """A problem ready to solve: ``starts`` are physical values of all parameters, best guess first."""

    structure: Structure
    recordings: tuple[Recording, ...]
    data: Data
    space: Space
    fixed: np.ndarray  # physical values of everything that does not move (null where a mechanism is out)
    base_active: np.ndarray  # which entries a base fit moves
    starts: tuple[np.ndarray, ...]
    scales: Scales
    known: tuple[str, ...]
    notes: tuple[str, ...]

    def trial(self, value: np.ndarray, active: np.ndarray, laws: np.ndarray | None = None, width: int = 0) -> Trial:
        """Trial that moves ``active`` entries from physical ``value``; padded to ``width`` moving places."""
        size = self.space.size
        index = np.flatnonzero(active)
        index = np.concatenate([index, np.full(max(width - len(index), 0), size)])
        moved = np.where(active, value, np.where(np.isfinite(self.fixed), self.fixed, 1.0))
        free = np.concatenate([np.asarray(self.space.bounds.to_free(moved)), [0.0]])
        laws = np.zeros(len(self.structure.mechanisms)) if laws is None else laws
        return Trial(
            jnp.asarray(index),
            jnp.asarray(free),
            jnp.asarray(self.fixed),
            jnp.asarray(active),
            jnp.asarray(laws),
        )


def choose_model(recordings: Sequence[Recording], model: str | None = None) -> str:
    """The preset for these recordings: as told, as their files say, or as their columns suggest.

    **Raises** `FitError` when the recordings do not agree.
    """
    told = {m for m in ([model] if model else [r.metadata.model for r in recordings]) if m}
    if len(told) > 1:
        raise FitError(f"the recordings name different models {sorted(told)}", mend="choose one with --model")
    if told:
        return told.pop()
    stems = {c.stem for r in recordings for c in r.output_channels}
    inputs = {c.stem for r in recordings for c in r.input_channels}
    if any(s.endswith("agonist") for s in inputs) or any(s.startswith("angle") for s in stems):
        return "aaa"
    if any(s.startswith("temperature") for s in inputs):
        return "tm"
    if not any(s.startswith("temperature") for s in stems):
        return "plant"
    return "te" if all(s.startswith("temperature") for s in stems) else "plant"


def structure_for(recordings: Sequence[Recording], model: str | None, extra: Sequence[Mechanism] = ()) -> Structure:
    """Structure of the preset for these recordings, with ``extra`` mechanisms in it.

    **Raises** `FitError` when the recordings are driven by different columns or a joint lacks its pulley.
    """
    name = choose_model(recordings, model)
    kinds = {drive_kind(c.stem, name) for r in recordings for c in r.input_channels}
    if len(kinds) != 1:
        raise FitError(f"drives of different kinds: {sorted(kinds)}", mend="fit recordings with one kind of drive")
    meta = recordings[0].metadata
    try:
        base = preset(
            name,
            drive=kinds.pop(),
            pulley_radius=meta.pulley_radius_m,
            pulley_mass=meta.pulley_mass_kg or 0.0,
        )
    except ModelError as error:
        raise FitError(error.problem, where=meta.path, mend=error.mend) from error
    return base.with_mechanisms(*extra)


def noise_of(recordings: Sequence[Recording], structure: Structure) -> np.ndarray:
    """Noise standard deviation of every output of the model, SI; the smaller of two estimates, pooled.

    Third differences suit slow signals; for fast ones the quietest high band of the spectrum is nearer the truth.
    """
    squares: list[list[float]] = [[] for _ in structure.outputs]
    for r in recordings:
        for j, stem in columns(structure, r):
            seen = np.flatnonzero(r.weight(stem) > 0)
            inner = slice(seen[0], seen[-1] + 1) if seen.size else slice(None)
            squares[j].append(noise_floor(r.output(stem)[inner], r.weight(stem)[inner], uniform=r.is_uniform) ** 2)
    sigma = np.array([np.sqrt(np.mean(s)) if s else 1.0 for s in squares])
    return np.where(sigma > 0, sigma, 1e-9)


def noise_floor(signal: np.ndarray, weights: np.ndarray | None = None, *, uniform: bool = True) -> float:
    """Standard deviation of white noise on a signal (n,): least of third differences and the top of the spectrum."""
    third = estimate_noise(signal, weights)
    n = len(signal)
    if not uniform or n < 512 or (weights is not None and np.any(weights == 0)):
        return third
    window = np.hanning(n)
    ramp = np.linspace(signal[: n // 50].mean(), signal[-n // 50 :].mean(), n)
    power = np.abs(np.fft.rfft((signal - ramp) * window)) ** 2 / np.sum(window**2)
    top = power[int(0.85 * len(power)) : -1]
    spectral = float(np.sqrt(np.median(top) / np.log(2.0)))  # |noise|^2 is exponential: median = mean ln 2
    return min(third, spectral) if spectral > 0 else third


def prepare(
    recordings: Sequence[Recording],
    *,
    model: str | None = None,
    extra: Sequence[Mechanism] = (),
    fixed: Mapping[str, float] | None = None,
    bin: int | None = None,
    order: int = 2,
    substeps: int | None = None,
    prior_strength: float = 1.0,
    max_bins: int = 800,
    pad_to: int = 256,
    release: bool = False,
) -> Setup:
    """Everything a fit or a diagnosis of one actuator needs.

    ``fixed`` holds physical values by parameter key; ``prior_strength`` divides the spread of the base priors;
    ``release`` says that the weight may be moving when a recording begins.

    **Raises** `FitError` or `RecordingError` for recordings that cannot be fitted, with the mend.
    """
    recordings = tuple(recordings)
    if not recordings:
        raise FitError("no recording to fit", mend="give at least one CSV file")
    for r in recordings:
        check_informative(r)
    s = structure_for(recordings, model)
    s = s.with_mechanisms(*(m for m in extra if _can_act(m, s, recordings)))
    recordings, cut_notes = cut_long(recordings, s)
    if substeps is None:  # a band-limited drive bends within a sampling period
        substeps = 2 if any(r.hold == "band_limited" for r in recordings) else 1
    ambient, notes = _ambients(recordings, s)
    known, known_notes = _known(recordings, s, fixed or {})
    sigma = noise_of(recordings, s)
    guesses, scales, guess_notes = _guess(recordings, s, ambient, known)
    bin = bin or _bin(recordings, scales, max_bins)
    data = pack(s, recordings, sigma, ambient=ambient, bin=bin, order=order, substeps=substeps, pad_to=pad_to)
    locals_ = Locals(temperature=s.thermal, displaced=s.mechanical and (release or not s.thermal) and not cut_notes)
    starts, free_base = _starts(s, guesses, known, scales, recordings, locals_, ambient, sigma)
    space = _space(
        s, locals_, len(recordings), starts[0], scales, sigma, _measured(s, recordings), known, prior_strength
    )
    fixed_values = _null_values(s, scales)
    size = space.size
    all_fixed = np.concatenate([fixed_values, np.zeros(size - len(fixed_values))])
    for key, value in known.items():
        all_fixed[s.index[key]] = value
    for i, slot in enumerate(s.slots):
        if slot.parameter.null is None and not free_base[i]:
            all_fixed[i] = starts[0][i]
    active = np.concatenate([free_base, np.ones(size - len(free_base), bool)])
    return Setup(
        s,
        recordings,
        data,
        space,
        all_fixed,
        active,
        tuple(starts),
        scales,
        tuple(known),
        cut_notes + notes + known_notes + guess_notes,
    )


def _can_act(m: Mechanism, s: Structure, recordings: Sequence[Recording]) -> bool:
    """Whether a mechanism can act in this model and be seen by the sensors of these recordings."""
    temperature, displacement = _measured(s, recordings)
    return applicable(
        m,
        electric=s.drive in ("voltage", "pwm", "current"),
        thermal=s.thermal,
        mechanical=s.mechanical and displacement,
        temperature_output=temperature,
    )


_LONG, _SEGMENT, _SEGMENTS, _EDGE = 16384, 2048, 3, 16


def cut_long(recordings: Sequence[Recording], s: Structure) -> tuple[tuple[Recording, ...], tuple[str, ...]]:
    """Long recordings of quick, directly driven actuators as segments that run abreast.

    Each segment begins with a lead, from rest and without weight, in which its unknown start dies away; a few samples
    at its end, where a band-limited hold cannot know what follows, have no weight either. Of very long recordings
    evenly spread segments are taken. Slow (thermal) and short recordings stay whole.
    """
    if s.thermal or max(r.n for r in recordings) <= _LONG or not all(r.is_uniform for r in recordings):
        return tuple(recordings), ()
    out, used = [], 0
    for r in recordings:
        poles = best_linear(
            np.asarray(effort(s.drive, drive_values(s, r)))[:6000, 0],
            r.outputs[:6000, 0],
            r.period,
            2,
            held=r.hold == "zero_order",
        )
        slowest = min((float(np.min(np.abs(m.poles.real))) for m in poles[:1]), default=1e-9)
        lead = int(np.clip(16.0 / slowest / r.period, 64, _SEGMENT))
        starts = np.arange(0, max(r.n - lead - _SEGMENT - _EDGE, 1), _SEGMENT)
        if len(starts) > _SEGMENTS:
            starts = starts[np.linspace(0, len(starts) - 1, _SEGMENTS).round().astype(int)]
        for a in starts:
            b = min(a + lead + _SEGMENT + _EDGE, r.n)
            part = r.slice(r.time[a], r.time[b] if b < r.n else None)
            weights = np.array(part.weights)
            weights[:lead] = 0.0
            weights[-_EDGE:] = 0.0
            name = f"{r.metadata.name} {r.time[a]:.4g}-{part.time[-1]:.4g} s"
            out.append(part.with_weights(weights).with_metadata(replace(r.metadata, name=name)))
            used += part.n - lead - _EDGE
    total = sum(r.n for r in recordings)
    return tuple(out), (f"long recordings were cut into {len(out)} segments; {used} of {total} samples were used",)


def _measured(s: Structure, recordings: Sequence[Recording]) -> tuple[bool, bool]:
    """(temperature is recorded, displacement or angle is recorded)."""
    seen = {j for r in recordings for j, _ in columns(s, r)}
    n_t = len(s.sides) if s.thermal else 0
    return any(j < n_t for j in seen), any(j >= n_t for j in seen)


def _ambients(recordings: Sequence[Recording], s: Structure) -> tuple[list[float], tuple[str, ...]]:
    """Ambient of each recording [K]: as told, else the first reading of a thermometer, else 293.15 K."""
    out, notes = [], []
    for r in recordings:
        told = r.metadata.ambient_K
        if told is None and s.thermal:
            thermometers = [c.stem for c in r.output_channels if c.stem.startswith("temperature")]
            if thermometers:
                told = float(np.median(r.output(thermometers[0])[:5]))
                notes.append(
                    f"{r.metadata.name}: ambient not given; taken as the first reading, {told - 273.15:.2f} degC"
                )
        if told is None and s.drive == "temperature":
            told = float(r.inputs[0, 0])
        out.append(293.15 if told is None else told)
    return out, tuple(notes)


def _known(
    recordings: Sequence[Recording], s: Structure, fixed: Mapping[str, float]
) -> tuple[dict[str, float], tuple[str, ...]]:
    """Physical values that are held, by parameter key, and what to tell the user about them."""
    known: dict[str, float] = {}
    for name, value in recordings[0].metadata.known:
        key = KNOWN.get(name)
        if key is None or key not in s.index:
            continue
        if name == "resistance_ohm":
            if s.drive not in ("voltage", "pwm", "current"):
                continue
            value = value if s.drive == "current" else 1.0 / value
        known[key] = value
    for r in recordings[1:]:
        if dict(r.metadata.known) != dict(recordings[0].metadata.known):
            raise FitError(
                "the [actuator] values differ between recordings",
                where=r.metadata.path,
                mend="fit recordings of one actuator together, others with scpjax fleet",
            )
    for key, value in fixed.items():
        if key not in s.index:
            raise ModelError(f"no parameter {key!r}", mend=f"the model has {sorted(s.index)}")
        known[key] = float(value)
    notes = []
    if s.thermal and "joule_heating.gain" not in known:
        top = max(float(np.max(np.abs(np.asarray(effort(s.drive, drive_values(s, r)))))) for r in recordings)
        gain = 1.0 if s.drive == "power" else 1.0 / top
        known["joule_heating.gain"] = gain
        if s.drive != "power":
            notes.append(
                f"the power that the drive makes is not known: full drive is called 1 W (gain {gain:.4g}), "
                "so conductance and thermal mass are known only up to that factor"
            )
    return known, tuple(notes)


@dataclass(frozen=True)
class _Guess:
    values: dict[str, float]
    score: float


def _uniform(r: Recording, structure: Structure, ambient: float) -> tuple[float, np.ndarray, dict[int, np.ndarray]]:
    """(period, effort (n, sides), outputs by index) on a uniform grid of at most a few thousand samples."""
    even = r if r.is_uniform else resample(r)
    n, period = even.n, even.period
    step = max(n // 6000, 1)
    e = np.asarray(
        effort(
            structure.drive,
            drive_values(structure, even),
            ambient=ambient,
            supply=even.metadata.supply_V or 3.7,
        )
    )
    outputs = {j: even.output(stem) for j, stem in columns(structure, even)}
    if step == 1 or not structure.thermal:  # a mechanical signal would alias
        keep = min(n, 12000)
        return period, e[:keep], {j: y[:keep] for j, y in outputs.items()}
    m = n // step * step
    fold = lambda x: x[:m].reshape(m // step, step, *x.shape[1:]).mean(axis=1)  # noqa: E731
    return period * step, fold(e), {j: fold(y) for j, y in outputs.items()}


def _guess(
    recordings: Sequence[Recording], s: Structure, ambient: Sequence[float], known: Mapping[str, float]
) -> tuple[list[_Guess], Scales, tuple[str, ...]]:
    """Base parameter values from the data, several where the data leave a choice; best first."""
    longest = int(np.argmax([np.ptp(np.asarray(drive_values(s, r)), axis=0).sum() * r.duration for r in recordings]))
    r = recordings[longest]
    period, e, outputs = _uniform(r, s, ambient[longest])
    notes: list[str] = []
    thermal = {}
    side = int(np.argmax(np.ptp(e, axis=0)))
    gain = known.get("joule_heating.gain", 1.0)
    if s.thermal:
        thermal, thermal_notes = _thermal_guess(s, period, e[:, side], outputs.get(side), gain, ambient[longest], known)
        notes += thermal_notes
    guesses, response, peak = _mechanical_guess(
        s, period, e, outputs, thermal, gain, known, side, held=r.hold == "zero_order"
    )
    if s.thermal:
        decay = thermal.get("newton_cooling.conductance", 1.0) / thermal.get("newton_cooling.thermal_mass", 1.0)
        response = 1 / decay if thermal else response
        v = guesses[0].values
        peak = _first_order(gain * e[:, side] / v["newton_cooling.thermal_mass"], response, period).max()
    travel = 1.0
    if s.mechanical:
        last = len(s.outputs) - 1
        if last in outputs:
            x = outputs[last] * (s.pulley_radius or 1.0)
            travel = float(np.max(np.abs(x - np.median(x[: max(len(x) // 200, 1)])))) or 1.0
    scales = Scales(response, max(q.duration for q in recordings), float(max(peak, 1e-9)), travel)
    return guesses, scales, tuple(notes)


def _thermal_guess(s, period, e, temperature, gain, ambient, known):
    """Conductance and thermal mass from a thermometer, if there is one."""
    if temperature is None:
        return {}, []
    excess = temperature - ambient
    values, notes = {}, []
    found = best_linear(e, temperature, period, 1)
    try:
        lam, mass = thermal_mass_from_energy(gain * e, excess, period)
    except ScpjaxError:
        lam = mass = float("nan")
    if found and found[0].b0 > 0 and (not np.isfinite(lam) or found[0].nrmse > 20):
        mass_iv = gain / found[0].b0
        lam_iv = found[0].a[0] * mass_iv
        if not np.isfinite(lam) or not 0.5 < mass / mass_iv < 2:
            lam, mass = lam_iv, mass_iv
    if not (np.isfinite(lam) and lam > 0 and mass > 0):
        raise FitError(
            "the temperature does not follow the drive",
            mend="check that drive and temperature columns are the right ones and that the drive changes",
        )
    values["newton_cooling.conductance"], values["newton_cooling.thermal_mass"] = lam, mass
    return {k: known.get(k, v) for k, v in values.items()}, notes


def _mechanical_guess(s, period, e, outputs, thermal, gain, known, side, *, held):
    """Guesses for the force balance (with the energy balance where no thermometer told it)."""
    last = len(s.outputs) - 1
    typical = {slot.key: slot.parameter.typical for slot in s.slots if slot.parameter.null is None} | dict(known)
    if not s.mechanical or last not in outputs:
        return [_Guess(typical | thermal, 0.0)], 1.0, 1.0
    sign = 1.0 if side == 0 else -1.0
    x = outputs[last] * (s.pulley_radius or 1.0) * sign
    sides = len(s.sides)
    mass = typical["inertia.mass"] * sides + 0.5 * s.pulley_mass
    guesses: list[_Guess] = []
    if not s.thermal:  # driven directly: a second-order system
        if "inertia.mass" not in known:
            mass = 1.0 if s.drive == "gain" else mass
        for m in best_linear(e[:, 0], x, period, 2, held=held)[:2]:
            guesses += _second_order(typical | {"inertia.mass": mass}, m, mass)
        if not guesses or max(g.score for g in guesses) < 50.0:  # no resonance seen: follow the drive, stiffly or less
            slope = float(np.polyfit(e[:, 0], x, 1)[0])
            for omega in (0.3 / period, 0.03 / period):
                guesses.append(_quasi_static(typical | {"inertia.mass": mass}, slope, omega, mass, 1))
        return (
            guesses,
            1.0 / np.sqrt(guesses[0].values["elastic_spring.stiffness"] / mass),
            float(np.max(np.abs(e))),
        )
    drive = e[:, 0] - e[:, 1] if sides == 2 else e[:, 0]
    drive = drive * sign if sides == 2 else drive
    if not thermal:
        first = best_linear(drive, x, period, 1, held=held)
        decay = float(first[0].a[0]) if first and first[0].a[0] > 0 else 1.0 / (len(x) * period / 10)
        mass_th = known.get("newton_cooling.thermal_mass", typical["newton_cooling.thermal_mass"])
        thermal = {"newton_cooling.thermal_mass": mass_th, "newton_cooling.conductance": decay * mass_th}
    response = thermal["newton_cooling.thermal_mass"] / thermal["newton_cooling.conductance"]
    warm = _first_order(gain * drive / thermal["newton_cooling.thermal_mass"], response, period)
    basis = np.column_stack([warm, np.ones_like(warm), np.exp(-np.arange(len(x)) * period / response)])
    slope = float(np.linalg.lstsq(basis, x, rcond=None)[0][0])
    start = typical | thermal
    found = [m for m in best_linear(warm, x, period, 2, held=False)[:1] if m.nrmse > 0]
    for omega in (float(np.sqrt(typical["elastic_spring.stiffness"] * sides / mass)),):
        guesses.append(_quasi_static(start, slope, omega, mass, sides))
    for m in found:
        omega = float(np.sqrt(abs(m.a[1])))
        if 1.0 < omega < 0.7 * np.pi / period:
            guesses += [_quasi_static(start, slope, omega, mass, sides, float(abs(m.a[0])) / (2 * omega))]
    return guesses, response, float(np.max(warm))


def _second_order(start: dict[str, float], m: Linear, mass: float) -> list[_Guess]:
    damping, stiffness = m.a
    if damping <= 0 or stiffness <= 0:
        return []
    v = {
        "inertia.mass": mass,
        "elastic_spring.stiffness": float(stiffness) * mass,
        "viscous_damping.damping": float(damping) * mass,
        "thermal_actuation.coefficient": m.b0 * mass,
    }
    return [_Guess(start | v, m.nrmse)]


def _quasi_static(
    start: dict[str, float], slope: float, omega: float, mass: float, sides: int, ratio: float = 0.7
) -> _Guess:
    """Displacement that follows the temperature by ``slope`` [m/K], with a resonance at ``omega`` [rad/s]."""
    stiffness = omega**2 * mass / sides
    v = {
        "elastic_spring.stiffness": stiffness,
        "viscous_damping.damping": 2 * ratio * omega * mass / sides,
        "thermal_actuation.coefficient": slope * stiffness * sides,
    }
    return _Guess(start | v, 0.0)


def _first_order(u: np.ndarray, tau: float, period: float) -> np.ndarray:
    """Response of tau y' + y = tau u from rest, held input."""
    decay = np.exp(-period / tau)
    from scipy.signal import lfilter

    return lfilter([0.0, tau * (1 - decay)], [1.0, -decay], u)


def _bin(recordings: Sequence[Recording], scales: Scales, max_bins: int) -> int:
    """Samples per bin: few enough bins to be quick, each far shorter than the response."""
    period = min(r.period for r in recordings)
    widest = max(int(scales.response / 25 / period), 1)
    wanted = max(-(-max(r.n for r in recordings) // max_bins), 1)
    return min(widest, wanted)


def _null_values(s: Structure, scales: Scales) -> np.ndarray:
    """Values at which every left-out mechanism vanishes, references set to the scale of the data."""
    out = []
    for slot in s.slots:
        p = slot.parameter
        if p.fixed and p.name == "reference":
            out.append(scales.temperature if p.unit == "K" else scales.displacement)
        elif p.null is None:
            out.append(np.nan)
        else:
            out.append(p.null)
    return np.array(out)


def _starts(s, guesses, known, scales, recordings, locals_, ambient, sigma):
    """Physical start vectors (parameters and locals) and which parameters a base fit moves."""
    free = np.array(
        [slot.parameter.null is None and not slot.parameter.fixed and slot.key not in known for slot in s.slots]
    )
    n_t, n_s = (len(s.sides) if s.thermal else 0), len(s.sides)
    seen_t, seen_x = _measured(s, recordings)
    for slot in s.slots:
        if slot.key.startswith("sensor_offset"):
            free[slot.index] &= seen_t if slot.parameter.name == "temperature" else seen_x
        if not seen_x and s.mechanical and slot.mechanism in ("thermal_actuation", "elastic_spring", "viscous_damping"):
            free[slot.index] = False
    starts = []
    for guess in guesses:
        theta = _null_values(s, scales)
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


def _initial_guess(s, r, ambient, theta, locals_, n_t, n_s) -> list[float]:
    first = {j: float(np.median(r.output(stem)[:3])) for j, stem in columns(s, r)}
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
        pull = slope * float(np.asarray(effort(s.drive, drive_values(s, r)[:1], ambient=ambient))[0, 0])
    return [*out, x - pull, 0.0] if locals_.displaced else out


def _space(s, locals_, n_rec, start, scales, sigma, measured, known, strength) -> Space:
    """Bounds, scales and priors of everything that may move."""
    low, high, log, scale, mean, spread = [], [], [], [], [], []
    seen_t, _seen_x = measured
    for slot in s.slots:
        p = slot.parameter
        unit = {"response": scales.response, "duration": scales.duration}.get(p.time, 1.0)
        low.append(p.bounds[0] * unit)
        high.append(p.bounds[1] * unit)
        log.append(p.scale == "log")
        value = start[slot.index]
        scale.append(_linear_scale(p, slot.mechanism, value, scales))
        centre, wide = _prior(p, slot.mechanism, value, unit, seen_t, scales, s, strength)
        mean.append(centre)
        spread.append(wide)
    travel = scales.displacement
    for _ in range(n_rec):
        if locals_.temperature:
            n = len(s.sides)
            low, high, log = low + [-np.inf] * n, high + [np.inf] * n, log + [False] * n
            scale, mean, spread = (
                scale + [5.0] * n,
                mean + [0.0] * n,
                spread + [np.inf if seen_t else 20.0] * n,
            )
        if locals_.displaced:
            low, high, log = low + [-np.inf] * 2, high + [np.inf] * 2, log + [False] * 2
            quick = np.sqrt(start[s.index["elastic_spring.stiffness"]] / start[s.index["inertia.mass"]])
            scale += [0.1 * travel, 0.1 * travel * quick]
            mean, spread = [*mean, 0.0, 0.0], [*spread, 3 * travel, 3 * travel * quick]
    bounds = Bounded(np.array(low), np.array(high), np.array(log), np.array(scale))
    return Space(s, locals_, n_rec, bounds, jnp.asarray(np.array(mean)), jnp.asarray(np.array(spread)))


def _linear_scale(p: Parameter, mechanism: str, value: float, scales: Scales) -> float:
    if mechanism == "sensor_offset":
        return 1.0 if p.name == "temperature" else 0.05 * scales.displacement
    return abs(value) if np.isfinite(value) and value != 0 else 1.0


def _prior(p, mechanism, value, unit, seen_t, scales, s, strength) -> tuple[float, float]:
    """(mean, spread) on the inner scale. Weak, and only where data alone may leave a direction open."""
    if p.null is not None:
        centre = p.typical * unit
        return (np.log(centre) if p.scale == "log" else p.typical), p.spread
    if p.scale != "log" or not value > 0:
        return 0.0, np.inf
    direct = not s.thermal
    spread = {"elastic_spring": 2.0 if direct else 1.2, "viscous_damping": 2.0, "inertia": 0.7}.get(mechanism, np.inf)
    if mechanism == "newton_cooling" and not seen_t:
        spread = 1.0 if p.name == "thermal_mass" else 3.0
    return float(np.log(value)), spread / strength


def widen(setup: Setup, factor: float) -> Setup:
    """The same problem with base priors ``factor`` times as wide."""
    spread = np.array(setup.space.prior_spread)
    for slot in setup.structure.slots:
        if slot.parameter.null is None:
            spread[slot.index] *= factor
    space = Space(
        setup.space.structure,
        setup.space.locals,
        setup.space.n_recordings,
        setup.space.bounds,
        setup.space.prior_mean,
        jnp.asarray(spread),
    )
    return replace(setup, space=space)


__all__ = [
    "KNOWN",
    "Scales",
    "Setup",
    "choose_model",
    "held_means",
    "noise_floor",
    "noise_of",
    "prepare",
    "structure_for",
    "widen",
]
