"""Models by name with the numbers of the thesis: where a simulation starts before anything is fitted."""

from __future__ import annotations

from dataclasses import replace

import equinox as eqx

from scpjax.errors import ModelError
from scpjax.physics import presets
from scpjax.physics.model import Model
from scpjax.physics.structure import DriveKind
from scpjax.recordings.thesis import TABLE_3_5, TABLE_4_14

KNOWN_MODELS = ("te", "tm", "plant", "aaa", "thesis")
"""``te tm plant aaa`` with the parameters of actuator 2 (Table 4.14); ``thesis`` is the plant (4.4)."""

_ACTUATOR = next(row for row in TABLE_4_14 if row.code == "2")
_PULLEY_RADIUS = 0.015  # m, section 4.4


def known_model(
    name: str,
    *,
    drive: DriveKind = "voltage",
    pulley_radius: float | None = None,
    pulley_mass: float | None = None,
    ambient: float | None = None,
) -> Model:
    """The model of that name, driven by that kind of column; SI.

    The stiffness of Table 4.14 and the coefficients of (4.4) describe two different systems, so ``thesis`` is
    made from (4.4) alone, with mass, resistance and thermal mass of the same actuator to set the scales.

    **Raises** `ModelError` for an unknown name, or a drive whose gain the thesis does not give.
    """
    if name not in KNOWN_MODELS:
        raise ModelError(f"no model named {name!r}", mend=f"use one of {', '.join(KNOWN_MODELS)}")
    if name == "tm":
        return _mechanical(drive)
    gains = {
        "voltage": 1 / _ACTUATOR.resistance_ohm,
        "pwm": 1 / _ACTUATOR.resistance_ohm,
        "current": _ACTUATOR.resistance_ohm,
        "power": 1.0,
    }
    if drive not in gains:
        raise ModelError(
            f"the preset {name} has no gain for this drive",
            mend="give voltage_V, pwm, current_A or power_W, or fit a model first",
        )
    model = _driven(name, 293.15 if ambient is None else ambient)
    if name == "aaa":
        model = presets.aaa(model, pulley_radius=pulley_radius or _PULLEY_RADIUS, pulley_mass=pulley_mass or 0.0)
    return with_drive(model, drive).replace({"joule_heating.gain": gains[drive]})


def _mechanical(drive: DriveKind) -> Model:
    """The thermomechanical model (3.4)-(3.5) of Table 4.14."""
    if drive != "temperature":
        raise ModelError(
            "the preset tm is driven by a temperature",
            mend="give a temperature_degC column, or use plant",
        )
    a = _ACTUATOR
    coefficient, stiffness, damping = (_given(v) for v in (a.force_N_per_K, a.stiffness_N_per_m, a.damping_Ns_per_m))
    return presets.tm(coefficient=coefficient, stiffness=stiffness, damping=damping, mass=a.mass_kg)


def _driven(name: str, ambient: float) -> Model:
    """One heated actuator: ``te`` and ``plant`` of Table 4.14 (also of a joint's), ``thesis`` of (4.4)."""
    a = _ACTUATOR
    heat = {"resistance": a.resistance_ohm, "conductance": _given(a.conductance_W_per_K)}
    heat |= {"thermal_mass": a.heat_capacity_J_per_K, "ambient": ambient}
    if name == "te":
        return presets.te(**heat)
    if name != "thesis":
        return presets.plant(
            **heat,
            coefficient=_given(a.force_N_per_K),
            stiffness=_given(a.stiffness_N_per_m),
            damping=_given(a.damping_Ns_per_m),
            mass=a.mass_kg,
        )
    (row,) = TABLE_3_5.rows
    compact = presets.Compact(b0=row.b0, a2=row.a2, a1=row.a1, a0=row.a0)
    model = presets.from_compact(
        compact, mass=a.mass_kg, resistance=a.resistance_ohm, thermal_mass=a.heat_capacity_J_per_K
    )
    return eqx.tree_at(lambda m: m.ambient, model, model.ambient * 0 + ambient)


def with_drive(model: Model, drive: DriveKind) -> Model:
    """The same numbers, driven by another kind of column."""
    return Model(replace(model.structure, drive=drive), model.theta, model.laws, float(model.ambient))


def _given(value: float | None) -> float:
    assert value is not None, "Table 4.14 has it for actuator 2"
    return value
