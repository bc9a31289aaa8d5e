"""Models, recordings and yardsticks of the simulation tests."""

from __future__ import annotations

import numpy as np

from scpjax.physics import presets
from scpjax.physics.catalogue import catalogue, left_out
from scpjax.physics.model import Model
from scpjax.physics.structure import Structure
from scpjax.recordings.excitation import multilevel_random
from scpjax.recordings.recording import Recording

PARAMETERS = {
    "resistance": 10.0,
    "conductance": 0.2,
    "thermal_mass": 1.5,
    "coefficient": 0.02,
    "stiffness": 180.0,
    "damping": 5.0,
    "mass": 0.2,
}
PLANT = presets.plant(**PARAMETERS)
ACTUATOR = {**PARAMETERS, "resistance": 1.2, "conductance": 0.14, "thermal_mass": 1.2, "coefficient": 0.022}  # slower
ACTUATOR |= {"damping": 8.0, "mass": 0.3}

# a value far from null for each left-out mechanism; one not listed here takes its first start value
ACTIVE = {
    "ambient_drift": {
        "drift": 0.4,
        "time_constant": 1.5,
        "quadrature": -0.2,
        "begin": 1.25,
        "end": 3.5,
        "reference": 20.0,
        "reference_time": 6.0,
    },
    "antagonist_load": {"strength": 0.7, "onset": 0.4, "length": 0.5, "reference": 0.0025},
    "creep": {
        "compliance": 0.3,
        "time_constant": 2.0,
        "slow_compliance": 0.2,
        "slow_ratio": 4.0,
        "activation": 0.1,
        "shift": 15.0,
        "hardening": 0.2,
        "exponent": 0.4,
        "reference": 0.0025,
        "reference_temperature": 20.0,
    },
    "drive_dead_zone": {"threshold": 0.3, "sharpness": 5.0, "corner": 0.2, "shoulder": 3.0, "reference": 10.0},
    "fatigue": {
        "loss": 0.8,
        "most": 0.6,
        "acceleration": 1.7,
        "onset": 0.5,
        "width": 0.2,
        "activation": 4000.0,
        "reference": 0.0005,
        "reference_temperature": 20.0,
        "reference_time": 6.0,
    },
    "friction": {
        "strength": 0.2,
        "velocity_time": 10.0,
        "static": 0.5,
        "faster": 4.0,
        "presliding": 0.1,
        "reference": 0.0025,
    },
    "hysteresis": {
        **{"strength": 0.4, "width": 0.15, "middle": 1.4, "inner": 0.7, "centre": 0.2, "span": 0.3},
        **{"fourth": 1.2, "middle_width": 0.8, "inner_width": 0.3, "fourth_width": 0.6},
    },
    "input_delay": {"time": 0.125, "share": 0.6},
    "nonlinear_heat_loss": {"strength": 0.8, "exponent": 0.6},
    "nonlinear_thermal_force": {
        **{"growth": 0.6, "transition": 0.5, "width": 0.3, "abruptness": 1.3, "reference": 20.0},
    },
    "nonlinear_stiffness": {
        "quadratic": 0.3,
        "cubic": 0.4,
        "strength": 5.0,
        "exponent": 3.0,
        "engaged": 0.5,
        "knee": 0.1,
        "steepness": 2.0,
        "nearness": 0.9,
        "abruptness": 1.5,
    },
    "resistance_temperature": {"coefficient": 0.004, "curvature": 0.3},
    "sensor_drift": {
        "drift": 0.5,
        "time_constant": 2.0,
        "exponent": 1.6,
        "reference": 0.0025,
        "reference_temperature": 20.0,
        "reference_time": 6.0,
    },
    "sensor_lag": {"time_constant": 0.3, "share": 0.6, "stage_ratio": 0.25},
    "slack": {"gap": 0.2, "corner": 0.05, "reference": 0.0025},
    "supply_sag": {
        "sag": 0.4,
        "time_constant": 2.0,
        "capacity": 1.6,
        "at_once": 0.25,
        "slow_share": 0.4,
        "slow_ratio": 5.0,
        "reference": 10.0,
        "reference_time": 6.0,
    },
    "thermal_softening": {"softening": 0.4, "transition": 0.5, "width": 0.2, "reference": 20.0},
    "two_node_thermal": {"share": 0.4, "time_constant": 0.3, "slow_part": 0.3, "slow_ratio": 7.0},
}
# their equations have kinks even where the mechanism is at null, so each gets a structure of its own
KINKED = ("antagonist_load", "drive_dead_zone", "fatigue", "friction", "hysteresis", "slack", "supply_sag")

ALONE = [m for m in left_out() if "joint" not in m.needs]  # what one actuator can have
LEFT_OUT = [m.name for m in ALONE]
CASES = [(m.name, law) for m in ALONE for law in range(len(m.laws)) if "joint" not in m.law_needs.get(law, ())]


def case_id(case: tuple[str, int]) -> str:
    """Name of a case in pytest's output: ``two_node_thermal-wire``."""
    law = catalogue()[case[0]].laws[case[1]]
    return f"{case[0]}-{law}" if law else case[0]


def extended(structure: Structure, *names: str) -> Structure:
    """A structure with those left-out mechanisms."""
    return structure.with_mechanisms(*(catalogue()[n] for n in names))


def smooth() -> Structure:
    """The plant with every left-out mechanism that is smooth at its null: one compilation for all."""
    return extended(PLANT.structure, *(n for n in LEFT_OUT if n not in KINKED))


def at_null(structure: Structure, base: Model = PLANT) -> Model:
    """The base's values, every left-out mechanism at its null."""
    return Model(structure, ambient=base.ambient).replace(base.values())


def active_values(name: str) -> dict[str, float]:
    """Representative values of a mechanism, by key."""
    m = catalogue()[name]
    start = m.starts[0] if m.starts else tuple(p.typical for p in m.parameters)
    known = ACTIVE.get(name, {p.name: v for p, v in zip(m.parameters, start, strict=True) if not p.fixed})
    return {f"{name}.{p}": v for p, v in known.items()}


def with_active(structure: Structure, name: str, law: int = 0) -> Model:
    """One mechanism at its representative value and law, the others at null."""
    laws = [float(law) if m.name == name else 0.0 for m in structure.mechanisms]
    model = Model(structure, laws=laws, ambient=PLANT.ambient)
    return model.replace(PLANT.values() | active_values(name))


def recorded(time, columns: dict, *, hold="zero_order") -> Recording:
    """A recording of those drives; its output plays no part."""
    return Recording.from_arrays(time, columns, {"displacement_mm": np.zeros(len(time))}, hold=hold)


def multilevel(*, duration=6.0, period=0.05, hold_s=0.5, hold="zero_order", column="voltage_V", high=10.0) -> Recording:
    """Random levels, some of them zero."""
    time, volts = multilevel_random(duration_s=duration, period_s=period, low=0.0, high=high, hold_s=hold_s, seed=3)
    return recorded(time, {column: volts}, hold=hold)


def worst(found, wanted) -> float:
    """Greatest difference of any state or output, relative to the greatest value it takes."""
    found, wanted = np.asarray(found), np.asarray(wanted)
    scale = np.max(np.abs(wanted), axis=0)
    return float(np.max(np.abs(found - wanted) / np.where(scale > 0, scale, 1.0)))


def driven_by_power() -> Model:
    """The plant driven by power, every watt of it turned into heat."""
    structure = presets.structure("plant", drive="power")
    return Model(structure).replace(PLANT.values() | {"joule_heating.gain": 1.0})


def case_of(name: str, law: int):
    """A mechanism at its representative values, and a start away from rest."""
    structure = extended(PLANT.structure, name) if name in KINKED else smooth()
    model = with_active(structure, name, law)
    return model, model.initial(temperature=10.0)
