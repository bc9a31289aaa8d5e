"""From recordings to a least-squares problem: structure, known values, starts, priors."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

import equinox as eqx
import jax.numpy as jnp
import numpy as np

from scpjax.errors import FitError, ModelError, ScpjaxError
from scpjax.fit.ambient import ambients
from scpjax.fit.data import Data, columns, pack
from scpjax.fit.guess import Scales, guess_base
from scpjax.fit.noise import noise_of
from scpjax.fit.problem import Locals, Space, Trial, lanes_of
from scpjax.fit.segments import cut_long
from scpjax.fit.space import driven_before, measured, null_values, space_of, starts_of
from scpjax.physics.catalogue import applicable, systems
from scpjax.physics.mechanism import Mechanism
from scpjax.physics.presets import structure as preset
from scpjax.physics.presets import system_structure
from scpjax.physics.structure import DriveKind, Structure
from scpjax.recordings.plausible import LOOK, doubts
from scpjax.recordings.recording import Recording, check_informative, place
from scpjax.simulate.drive import drive_kind, recorded_effort

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

    def trial(
        self,
        value: np.ndarray,
        active: np.ndarray,
        laws: np.ndarray | None = None,
        width: int = 0,
        lanes: int = 0,
    ) -> Trial:
        """Trial that moves ``active`` entries from physical ``value``; padded to ``width`` moving places, of which a
        recording depends on ``lanes`` at least.
        """
        size = self.space.size
        index = np.flatnonzero(active)
        index = np.concatenate([index, np.full(max(width - len(index), 0), size)])
        moved = np.where(active, value, np.where(np.isfinite(self.fixed), self.fixed, 1.0))
        free = np.concatenate([np.asarray(self.space.bounds.to_free(moved)), [0.0]])
        laws = np.zeros(len(self.structure.mechanisms)) if laws is None else np.asarray(laws)
        places = lanes_of(index, self.space, lanes)
        host: Any = (index, places, free, np.asarray(self.fixed), np.asarray(active), laws)  # nothing is compiled
        return Trial(*host)


def carry(old: Structure, new: Structure, vector: np.ndarray, default: np.ndarray) -> np.ndarray:
    """A vector over the parameters of ``old`` (and the locals) as one over those of ``new``, ``default`` where new."""
    out = np.concatenate([default, vector[len(old.slots) :]])
    for i, slot in enumerate(new.slots):
        shared = f"{slot.mechanism}.{slot.parameter.name}"  # what all recordings had before each has its own
        key = slot.key if slot.key in old.index or not slot.recording else shared
        if key in old.index:
            out[i] = vector[old.index[key]]
    return out


def restructured(setup: Setup, structure: Structure) -> Setup:
    """The same problem with other left-out mechanisms in the model; what both have keeps its values."""
    theta, size = null_values(structure, setup.scales), len(structure.slots)
    moved = lambda old, new: carry(setup.structure, structure, np.asarray(old), np.asarray(new)[:size])  # noqa: E731
    starts = tuple(moved(start, theta) for start in setup.starts)
    n_rec, locals_ = len(setup.recordings), setup.space.locals
    seen = measured(structure, setup.recordings)[0]
    space = space_of(structure, locals_, n_rec, starts[0], setup.scales, seen, 1.0)
    priors = [
        jnp.asarray(moved(old, new))
        for old, new in (
            (setup.space.prior_mean, space.prior_mean),
            (setup.space.prior_spread, space.prior_spread),
        )
    ]
    return replace(
        setup,
        structure=structure,
        space=eqx.tree_at(lambda s: (s.prior_mean, s.prior_spread), space, tuple(priors)),
        fixed=moved(setup.fixed, theta),
        base_active=moved(setup.base_active, np.zeros(size, bool)).astype(bool),
        starts=starts,
    )


def names_of(recordings: Sequence[Recording]) -> tuple[str, ...]:
    """A name for every recording, no two alike."""
    names = [r.metadata.name or f"recording {i}" for i, r in enumerate(recordings)]
    return tuple(n if names.count(n) == 1 else f"{n} ({names[:i].count(n) + 1})" for i, n in enumerate(names))


def choose_model(recordings: Sequence[Recording], model: str | None = None) -> str:
    """The preset (or base of the user's own) for these recordings: as told, as files say, or as columns suggest.

    **Raises** `FitError` when the recordings do not agree.
    """
    told = {m for m in ([model] if model else [r.metadata.model for r in recordings]) if m}
    if len(told) > 1:
        first = {r.metadata.model: r for r in reversed(recordings)}
        of = ", ".join(f"{m} in {place(first[m].metadata)}" for m in sorted(told))
        raise FitError(f"the recordings name different models: {of}", mend="choose one with --model")
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
    if name in systems():
        return system_structure(systems()[name]).with_mechanisms(*extra)
    kinds: set[DriveKind] = {drive_kind(c.stem, name) for r in recordings for c in r.input_channels}
    if len(kinds) != 1:
        first = {drive_kind(c.stem, name): r for r in reversed(recordings) for c in r.input_channels}
        of = ", ".join(f"{kind} in {place(first[kind].metadata)}" for kind in sorted(kinds))
        raise FitError(f"drives of different kinds: {of}", mend="fit recordings with one kind of drive")
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


_DRIVEN = (
    "a recording begins warm, or away from rest: how far the actuator stood beside its equilibrium then, was estimated "
    "beside the fit"
)


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
    full_effort: float | None = None,
) -> Setup:
    """Everything a fit or a diagnosis of one actuator needs.

    ``model`` may be the name of a base of the user's own; ``fixed`` holds physical values by parameter key;
    ``prior_strength`` divides the spread of the base priors; ``release`` says that the weight may be moving when a
    recording begins; ``full_effort`` is what is called 1 W where nothing tells the power, the greatest when not given.

    **Raises** `FitError` or `RecordingError` for recordings that cannot be fitted, with the mend.
    """
    recordings = tuple(recordings)
    if not recordings:
        raise FitError("no recording to fit", mend="give at least one CSV file")
    for r in recordings:
        check_informative(r, ())
    s = structure_for(recordings, model)
    for r in recordings:
        check_informative(r, [stem for _, stem in columns(s, r)])
    s = s.with_mechanisms(*(m for m in extra if applicable(m, what_there_is(s, recordings))))
    whole = recordings if s.system is None else ()  # columns of a base of the user's own may mean anything
    recordings, cut_notes = cut_long(recordings, s)
    substeps = substeps or _usual_substeps(recordings, s)
    sigma = noise_of(recordings, s)
    ambient, notes = ambients(recordings, s, float(sigma[0]))
    known, known_notes = _known(recordings, s, fixed or {})
    told = tuple(known)
    if s.thermal and "joule_heating.gain" not in known:
        gain, gain_note = _gain_of_full_drive(full_effort or greatest_effort(recordings, s), s)
        known, known_notes = known | gain, known_notes + gain_note
        told += tuple(gain) if not gain_note else ()
    guesses, scales = guess_base(recordings, s, ambient, known)
    bin = bin or bin_of(recordings, scales, max_bins)
    data = pack(s, recordings, sigma, ambient=ambient, bin=bin, order=order, substeps=substeps, pad_to=pad_to)
    moving = s.mechanical and (release or not s.thermal)
    locals_ = Locals(
        temperature=s.thermal,
        displaced=(moving or driven_before(s, recordings, ambient, sigma)) and not cut_notes,
        moving=moving and not cut_notes,
        own=s.system is not None and not cut_notes,
    )
    starts, free_base = starts_of(s, guesses, known, scales, recordings, locals_, ambient)
    space = space_of(s, locals_, len(recordings), starts[0], scales, measured(s, recordings)[0], prior_strength)
    fixed_values = _held(s, scales, known, free_base, starts[0])
    active = np.concatenate([free_base, np.ones(space.size - len(free_base), bool)])
    driven_notes = (_DRIVEN,) if locals_.displaced and not moving else ()
    notes = cut_notes + notes + known_notes + driven_notes + _unused(whole, s)
    notes = tuple(d for r in whole for d in doubts(r)) + notes
    return Setup(s, recordings, data, space, fixed_values, active, tuple(starts), scales, told, notes)


def _held(
    s: Structure, scales: Scales, known: Mapping[str, float], free_base: np.ndarray, start: np.ndarray
) -> np.ndarray:
    """Physical values of all that does not move: what is known, nulls, and base parameters that nothing bears on."""
    values = np.concatenate([null_values(s, scales), np.zeros(len(start) - len(s.slots))])
    for key, value in known.items():
        values[s.index[key]] = value
    for i, slot in enumerate(s.slots):
        if slot.parameter.null is None and not free_base[i]:
            values[i] = start[i]
    return values


def usual_substeps(recordings: Sequence[Recording], model: str | None) -> int:
    """Steps of the integrator in a sample of these recordings, where nothing is told of it; 1 where there is no model
    for them.
    """
    try:
        return _usual_substeps(recordings, structure_for(recordings, model))
    except ScpjaxError:  # `prepare` tells of it
        return 1


def _usual_substeps(recordings: Sequence[Recording], s: Structure) -> int:
    bends = any(r.hold == "band_limited" for r in recordings)  # within a sampling period
    return (2 if bends else 1) * (s.system.substeps if s.system else 1)


def what_there_is(s: Structure, recordings: Sequence[Recording]) -> set[str]:
    """What a model and the sensors of its recordings have of what mechanisms need (`catalogue.NEEDS`)."""
    if s.system:
        return {s.system.name}
    temperature, displacement = measured(s, recordings)
    there = {
        "electric": s.drive in ("voltage", "pwm", "current"),
        "voltage": s.drive in ("voltage", "pwm"),
        "current": s.drive == "current",
        "thermal": s.thermal,
        "mechanical": s.mechanical and displacement,
        "temperature_output": temperature,
        "displacement_output": displacement,
        "joint": len(s.sides) == 2,
    }
    return {need for need, given in there.items() if given}


def laws_that_can_act(setup: Setup, m: Mechanism, now: int | None = None) -> list[int]:
    """Which laws of a mechanism can act in this model, be seen by the sensors of these recordings and be sought from
    the law that it has ``now``.
    """
    have, sought = what_there_is(setup.structure, setup.recordings), m.sought_from(now)
    return [law for law in range(len(m.laws)) if law in sought and applicable(m, have, law)]


def _known(
    recordings: Sequence[Recording], s: Structure, fixed: Mapping[str, float]
) -> tuple[dict[str, float], tuple[str, ...]]:
    """Physical values that are held, by parameter key, and what to tell the user about them."""
    known: dict[str, float] = {}
    notes: list[str] = []
    told = next((r.metadata for r in recordings if r.metadata.known), recordings[0].metadata)
    for name, value in told.known:
        key = KNOWN.get(name)
        if key is None or key not in s.index:
            continue
        if not (value > 0 or (value == 0 and name == "damping_Ns_per_m")):
            raise FitError(f"{name} is {value:g}", where=place(told), mend="give a number above 0")
        if name == "resistance_ohm":
            if s.drive not in ("voltage", "pwm", "current"):
                continue
            value = value if s.drive == "current" else 1.0 / value
        known[key] = value
    for r in recordings:
        if not r.metadata.known and told.known:
            notes.append(f"{LOOK}{r.metadata.name} has no [actuator]; that of {told.name} is taken for it, too")
        elif dict(r.metadata.known) != dict(told.known):
            raise FitError(
                "the [actuator] values differ between recordings",
                where=r.metadata.path,
                mend="write the same values of one actuator in each .toml; fit different ones with scpjax fleet",
            )
    for key, value in fixed.items():
        if key not in s.index:
            raise ModelError(f"no parameter {key!r}", mend=f"the model has {sorted(s.index)}")
        known[key] = float(value)
    return known, tuple(notes)


def greatest_effort(recordings: Sequence[Recording], s: Structure) -> float:
    """Greatest effort (`EFFORT_UNITS`) that recordings drive with."""
    return max(float(np.max(np.abs(np.asarray(recorded_effort(s, r))))) for r in recordings)


UNKNOWN_POWER = "the power that the drive makes is not known: "
"""How the note begins where it is not."""


def _gain_of_full_drive(effort: float, s: Structure) -> tuple[dict[str, float], tuple[str, ...]]:
    """The gain by which full drive is 1 W, and the note on it; a drive in watts has its own."""
    if s.drive == "power":
        return {"joule_heating.gain": 1.0}, ()
    note = (
        f"{UNKNOWN_POWER}full drive is called 1 W (gain {1.0 / effort:.4g}), so conductance and thermal mass are known "
        "only up to that factor"
    )
    return {"joule_heating.gain": 1.0 / effort}, (note,)


def _unused(recordings: Sequence[Recording], s: Structure) -> tuple[str, ...]:
    """What the recordings say that the model has no use for, in a sentence each."""
    if s.system is not None:
        return ()
    said = dict.fromkeys(key for r in recordings for key, _ in r.metadata.known if key not in KNOWN)
    notes = [f"{LOOK}{key} in [actuator] is not used; what can be held is {', '.join(KNOWN)}" for key in said]
    fitted = {stem for r in recordings for _, stem in columns(s, r)}
    left = dict.fromkeys(c.column for r in recordings for c in r.output_channels if c.stem not in fitted)
    notes += [f"{column} is not fitted: the model {s.name} gives {', '.join(s.outputs)}" for column in left]
    return tuple(notes)


def bin_of(recordings: Sequence[Recording], scales: Scales, max_bins: int) -> int:
    """Samples per bin: few enough bins to be quick, each far shorter than the response, also of what was sampled less
    often.
    """
    periods = [r.period for r in recordings]
    widest = max(int(min(scales.response / 25 / min(periods), scales.response / 8 / max(periods))), 1)
    wanted = max(-(-max(r.n for r in recordings) // max_bins), 1)
    return min(widest, wanted)
