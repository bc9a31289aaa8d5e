"""The thesis's models as short tuples of mechanisms, and its compact form (3.14)-(3.15) both ways."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from scpjax.errors import ModelError
from scpjax.physics.catalogue import mechanism
from scpjax.physics.model import Model
from scpjax.physics.structure import DriveKind, Structure
from scpjax.physics.system import System

_THERMAL = ("joule_heating", "newton_cooling")
_MECHANICAL = ("thermal_actuation", "elastic_spring", "viscous_damping", "inertia")


def structure(
    name: str,
    *,
    drive: DriveKind = "voltage",
    pulley_radius: float | None = None,
    pulley_mass: float = 0.0,
    distinct: tuple[str, ...] = (),
) -> Structure:
    """Structure of a preset: ``te`` (3.1)-(3.3), ``tm`` (3.4)-(3.5), ``plant`` (3.6), ``aaa`` (3.7)-(3.12).

    **Raises** `ModelError` for an unknown name or a joint without a pulley radius.
    """
    if name not in ("te", "tm", "plant", "aaa"):
        raise ModelError(f"no model named {name!r}", mend="use te, tm, plant or aaa")
    thermal, mechanical = name != "tm", name != "te"
    names = (_THERMAL if thermal else ()) + (_MECHANICAL if mechanical else ()) + ("sensor_offset",)
    return Structure(
        name=name,
        mechanisms=tuple(mechanism(n) for n in names),
        sides=("agonist", "antagonist") if name == "aaa" else ("",),
        thermal=thermal,
        mechanical=mechanical,
        drive=drive,
        pulley_radius=pulley_radius,
        pulley_mass=pulley_mass,
        distinct=distinct,
        base=names,
    )


def system_structure(system: System) -> Structure:
    """Structure of a base of the user's own; its drive is the drive column itself."""
    return Structure(
        name=system.name, mechanisms=(system,), thermal=False, mechanical=False, drive="gain", base=(system.name,)
    )


def te(*, resistance: float, conductance: float, thermal_mass: float, ambient: float = 293.15) -> Model:
    """Thermoelectric model (3.2): volts to temperature. SI units."""
    return Model(structure("te"), ambient=ambient).replace(
        {
            "joule_heating.gain": 1 / resistance,
            "newton_cooling.conductance": conductance,
            "newton_cooling.thermal_mass": thermal_mass,
        }
    )


def tm(*, coefficient: float, stiffness: float, damping: float, mass: float, drive: DriveKind = "temperature") -> Model:
    """Thermomechanical model (3.4): temperature (or any column that pulls directly) to displacement. SI units."""
    return Model(structure("tm", drive=drive)).replace(_mechanics(coefficient, stiffness, damping, mass))


def plant(
    *,
    resistance: float,
    conductance: float,
    thermal_mass: float,
    coefficient: float,
    stiffness: float,
    damping: float,
    mass: float,
    ambient: float = 293.15,
) -> Model:
    """Plant (3.6): volts to temperature and displacement of one actuator. SI units."""
    thermal = {
        "joule_heating.gain": 1 / resistance,
        "newton_cooling.conductance": conductance,
        "newton_cooling.thermal_mass": thermal_mass,
    }
    mechanics = _mechanics(coefficient, stiffness, damping, mass)
    return Model(structure("plant"), ambient=ambient).replace(thermal | mechanics)


def aaa(agonist: Model, antagonist: Model | None = None, *, pulley_radius: float, pulley_mass: float = 0.0) -> Model:
    """Joint (3.7)-(3.12) of two plants over a pulley; the second is like the first when not given."""
    keys = [s.key for s in agonist.structure.slots]
    distinct = () if antagonist is None else tuple(keys)
    joint = structure("aaa", pulley_radius=pulley_radius, pulley_mass=pulley_mass, distinct=distinct)
    values = {}
    for key in keys:
        if antagonist is None:
            values[key] = agonist.value(key)
        else:
            values[f"{key}@agonist"] = agonist.value(key)
            values[f"{key}@antagonist"] = antagonist.value(key)
    return Model(joint, ambient=agonist.ambient).replace(values)


def _mechanics(coefficient: float, stiffness: float, damping: float, mass: float) -> dict[str, float]:
    return {
        "thermal_actuation.coefficient": coefficient,
        "elastic_spring.stiffness": stiffness,
        "viscous_damping.damping": damping,
        "inertia.mass": mass,
    }


@dataclass(frozen=True)
class Compact:
    """Coefficients of X/V^2 = b0 / (s^3 + a2 s^2 + a1 s + a0), thesis (3.14), SI units (displacement in m)."""

    b0: float
    a2: float
    a1: float
    a0: float


def to_compact(model: Model) -> Compact:
    """Compact form of a plant, thesis (3.15)."""
    v = {s.parameter.name: float(model.theta[s.index]) for s in model.structure.slots}
    decay, mass = v["conductance"] / v["thermal_mass"], v["mass"]
    return Compact(
        b0=v["coefficient"] * v["gain"] / (v["thermal_mass"] * mass),
        a2=v["damping"] / mass + decay,
        a1=v["stiffness"] / mass + decay * v["damping"] / mass,
        a0=decay * v["stiffness"] / mass,
    )


def from_compact(
    compact: Compact,
    *,
    mass: float,
    resistance: float,
    thermal_mass: float,
    thermal_pole: float | None = None,
) -> Model:
    """Plant with the coefficients (3.14): inverts (3.15), given what it leaves open.

    The three poles belong to one thermal and one mechanical pair; ``thermal_pole`` [1/s, positive] says which real
    pole is the thermal one, the slowest real one when not given. (3.15) fixes conductance/thermal_mass, damping/mass,
    stiffness/mass and coefficient/(thermal_mass mass resistance); mass, resistance and thermal_mass set the scales.

    **Raises** `ModelError` when no real pole leaves a positive stiffness and damping.
    """
    poles = np.roots([1.0, compact.a2, compact.a1, compact.a0])
    real = np.sort(-poles[np.abs(poles.imag) < 1e-9 * np.abs(poles)].real)
    if thermal_pole is None:
        if real.size == 0 or real[0] <= 0:
            raise ModelError(
                "no stable real pole that could be thermal", mend="check the coefficients' units and signs"
            )
        decay = float(real[0])
    else:
        decay = float(thermal_pole)
    damping, stiffness = mass * (compact.a2 - decay), mass * compact.a0 / decay
    if damping <= 0 or stiffness <= 0:
        raise ModelError(
            f"the pole {decay:.4g} 1/s leaves damping {damping:.4g} N s/m and stiffness {stiffness:.4g} N/m",
            mend="choose another thermal pole",
        )
    return plant(
        resistance=resistance,
        conductance=decay * thermal_mass,
        thermal_mass=thermal_mass,
        coefficient=compact.b0 * thermal_mass * mass * resistance,
        stiffness=stiffness,
        damping=damping,
        mass=mass,
    )
