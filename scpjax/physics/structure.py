"""What a model is made of: mechanisms, sides, drive; hashable, fixed when compiled.

The state vector is ``[temperature of each side, x, dx/dt, own states of the mechanisms (each per side)]`` with the
first part there in thermal models and the second in mechanical ones. Where a mechanism looks at the time, it is the
last state.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Literal

import numpy as np

from scpjax.errors import ModelError
from scpjax.parameter import Parameter
from scpjax.physics.mechanism import Mechanism
from scpjax.physics.system import System

DriveKind = Literal["voltage", "pwm", "current", "power", "temperature", "gain"]
EFFORT_UNITS: dict[DriveKind, str] = {
    "voltage": "V²",
    "pwm": "V²",
    "current": "A²",
    "power": "W",
    "temperature": "K",
    "gain": "drive",
}
"""Unit of what a drive applies (`scpjax.simulate.drive.effort`); a gain's is that of its column."""


@dataclass(frozen=True)
class Slot:
    """Where one parameter of one mechanism (on one side, or in one recording, where these differ) lies in the parameter
    vector.
    """

    mechanism: str
    parameter: Parameter
    index: int
    side: str = ""
    recording: str = ""

    @property
    def key(self) -> str:
        """Name in files and reports: ``elastic_spring.stiffness``, ``elastic_spring.stiffness@agonist``,
        ``ambient_drift.drift@monday``.
        """
        where = self.side or self.recording
        return f"{self.mechanism}.{self.parameter.name}" + (f"@{where}" if where else "")


@dataclass(frozen=True)
class Structure:
    """What a model is made of.

    ``sides`` is ``("",)`` for one actuator or ``("agonist", "antagonist")`` for a joint, whose coordinate is the
    agonist's contraction ``x = r theta``. ``distinct`` names parameters ("mechanism.parameter") that differ by side,
    ``own`` those that differ by recording, of which there are ``recordings``. A model of several recordings is that of
    one of them (`plain`) in every simulation: `scpjax.physics.model.Model.of_recording`.
    """

    name: str
    mechanisms: tuple[Mechanism, ...]
    sides: tuple[str, ...] = ("",)
    thermal: bool = True
    mechanical: bool = True
    drive: DriveKind = "voltage"
    pulley_radius: float | None = None
    pulley_mass: float = 0.0
    distinct: tuple[str, ...] = ()
    base: tuple[str, ...] = ()
    own: tuple[str, ...] = ()
    recordings: tuple[str, ...] = ()

    def __post_init__(self) -> None:
        names = [m.name for m in self.mechanisms]
        if len(set(names)) != len(names):
            raise ModelError(f"a mechanism appears twice in {names}", mend="name each one once")
        if not (self.thermal or self.mechanical or self.system):
            raise ModelError("a model needs an energy or a force balance", mend="use te, tm, plant or aaa")
        if self.system and (self.thermal or self.mechanical or self.sides != ("",)):
            raise ModelError(f"{self.system.name} is a whole base model", mend="use it alone, for one actuator")
        if len(self.sides) == 2 and self.mechanical and not (self.pulley_radius or 0) > 0:
            raise ModelError("a joint needs its pulley radius", mend="give [pulley] radius_m")
        if len(set(self.recordings)) != len(self.recordings) or (self.own and not self.recordings):
            raise ModelError(f"recordings {self.recordings} have no names of their own", mend="name each one once")

    @cached_property
    def system(self) -> System | None:
        """The base of the user's own, where it is one."""
        return next((m for m in self.mechanisms if isinstance(m, System)), None)

    @cached_property
    def slots(self) -> tuple[Slot, ...]:
        """Every parameter, in the order of the parameter vector."""
        slots: list[Slot] = []
        for m in self.mechanisms:
            for p in m.parameters:
                key, n = f"{m.name}.{p.name}", len(slots)
                if key in self.own:
                    slots += [Slot(m.name, p, n + i, recording=r) for i, r in enumerate(self.recordings)]
                else:
                    sides = self.sides if key in self.distinct else ("",)
                    slots += [Slot(m.name, p, n + i, s) for i, s in enumerate(sides)]
        return tuple(slots)

    def unit_of(self, p: Parameter) -> str:
        """Unit of a parameter here: what is by the kelvin is by the unit of the drive where that pulls directly."""
        direct = not (self.thermal or self.system is not None or self.drive == "temperature")
        return p.unit[:-1] + EFFORT_UNITS[self.drive] if direct and p.unit.endswith("/K") else p.unit

    @cached_property
    def index(self) -> dict[str, int]:
        """Position of each parameter key in the parameter vector."""
        return {s.key: s.index for s in self.slots}

    @cached_property
    def plain(self) -> Structure:
        """The structure of one recording."""
        return replace(self, own=(), recordings=()) if self.own else self

    @cached_property
    def in_recording(self) -> np.ndarray:
        """Where the parameters of `plain` lie in the parameter vector, by recording (recordings, plain parameters)."""
        at, plain = self.index, self.plain.slots
        own = [f"{s.mechanism}.{s.parameter.name}" in self.own for s in plain]
        return np.array(
            [[at[f"{s.key}@{r}" if o else s.key] for s, o in zip(plain, own, strict=True)] for r in self.recordings]
        )

    @cached_property
    def where(self) -> dict[str, np.ndarray]:
        """Positions of each parameter ("mechanism.parameter") in the parameter vector, by side or recording if these
        differ.
        """
        out: dict[str, list[int]] = {}
        for s in self.slots:
            out.setdefault(f"{s.mechanism}.{s.parameter.name}", []).append(s.index)
        return {key: np.array(at) for key, at in out.items()}

    def count_free(self, name: str, law: int) -> int:
        """How many values of a mechanism are estimated under a law."""
        return sum(len(self.where[f"{name}.{p.name}"]) for p in self.mechanism(name).free_parameters(law))

    @cached_property
    def places(self) -> tuple[tuple[tuple[str, tuple[int, ...]], ...], ...]:
        """For each mechanism, where each of its parameters lies in the parameter vector, side by side."""
        places = []
        for m in self.mechanisms:
            mine = [s for s in self.slots if s.mechanism == m.name]
            places.append(tuple((p.name, tuple(s.index for s in mine if s.parameter is p)) for p in m.parameters))
        return tuple(places)

    @property
    def outputs(self) -> tuple[str, ...]:
        """Stems of the output columns: temperature (per side), then displacement or angle; or those of a system."""
        if self.system:
            return tuple(stem for stem, _ in self.system.channels)
        joined = [f"temperature_{s}" if s else "temperature" for s in self.sides] if self.thermal else []
        if self.mechanical:
            joined.append("angle" if len(self.sides) == 2 else "displacement")
        return tuple(joined)

    @property
    def inputs(self) -> tuple[str, ...]:
        """Names of the drives, one per side."""
        return tuple(f"drive_{s}" if s else "drive" for s in self.sides)

    @cached_property
    def state_names(self) -> tuple[str, ...]:
        """Name of every entry of the state vector."""
        tail = [f"_{s}" if s else "" for s in self.sides]
        names = [f"temperature{t}" for t in tail] if self.thermal else []
        names += ["displacement", "velocity"] if self.mechanical else []
        for m in self.mechanisms:
            names += [f"{m.name}.{state}{t}" for state in m.states for t in tail]
        return (*names, "time") if self.timed else tuple(names)

    @property
    def timed(self) -> bool:
        """Whether the time since the recording began is a state."""
        return any(m.timed for m in self.mechanisms)

    @property
    def n_states(self) -> int:
        return len(self.state_names)

    @property
    def is_linear(self) -> bool:
        """Only base mechanisms, which are linear in the states and in the effort."""
        return self.system is None and all(m.is_base for m in self.mechanisms)

    def mechanism(self, name: str) -> Mechanism:
        """The mechanism of that name."""
        for m in self.mechanisms:
            if m.name == name:
                return m
        raise ModelError(f"no mechanism {name!r} in this model", mend=f"it has {[m.name for m in self.mechanisms]}")

    def with_mechanisms(self, *mechanisms: Mechanism) -> Structure:
        """The same structure with more mechanisms in it."""
        present = {m.name for m in self.mechanisms}
        return replace(self, mechanisms=self.mechanisms + tuple(m for m in mechanisms if m.name not in present))

    def with_own(self, recordings: Sequence[str], *own: str) -> Structure:
        """The same structure with parameters ("mechanism.parameter") that differ by recording."""
        return replace(self, own=tuple(dict.fromkeys((*self.own, *own))), recordings=tuple(recordings))

    def without(self, name: str) -> Structure:
        """The same structure without one mechanism."""
        kept = tuple(m for m in self.mechanisms if m.name != name)
        own = tuple(key for key in self.own if key.split(".")[0] != name)
        return replace(self, mechanisms=kept, own=own, recordings=self.recordings if own else ())

    def typical(self) -> np.ndarray:
        """Typical values for base parameters and null values for all others."""
        return np.array([s.parameter.typical if s.parameter.null is None else s.parameter.null for s in self.slots])
