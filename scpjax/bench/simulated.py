"""A simulated bench: a muscle of any model, with mechanisms concealed in it, behind the emulated board."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Literal

import numpy as np

from scpjax.bench.errors import BenchError
from scpjax.bench.parameters import BoardConfig
from scpjax.bench.wiring import Position, Wiring
from scpjax.bench.world import Muscle, Noise
from scpjax.control.plant import Difference, Joint, Plant
from scpjax.errors import ModelError
from scpjax.physics import presets
from scpjax.physics.catalogue import mechanism
from scpjax.physics.known import KNOWN_MODELS, known_model
from scpjax.physics.model import Model
from scpjax.physics.storage import load_model

RADIUS_M = 0.015  # thesis 3.4.1
_DURATION_S = 60.0
_WARM = 0.05  # by how much the board's thermal model is taken hotter than the actuator's


@dataclass(frozen=True)
class Simulated:
    """``world`` behind the pins, ``wiring`` before them, ``config`` of a board that suits the muscle."""

    world: Muscle
    wiring: Wiring
    config: BoardConfig
    plant: Plant


def muscle() -> Model:
    """An actuator of the size of the thesis's: 95 K and 13 mm at full drive, 8 s."""
    return presets.plant(
        resistance=1.07,
        conductance=0.14,
        thermal_mass=1.1,
        coefficient=0.024,
        stiffness=180.0,
        damping=8.0,
        mass=0.25,
        ambient=295.15,
    )


def named_muscle(name: str) -> Model:
    """``muscle``, a preset (``thesis``, ``plant``, ``aaa``) or a model.json.

    **Raises** `BenchError` for an unknown name, and as `load_model`.
    """
    if name == "muscle":
        return muscle()
    if name in KNOWN_MODELS and name not in ("te", "tm"):
        return known_model(name, ambient=295.15)
    path = Path(name)
    if not (path.exists() or name.endswith(".json")):
        raise BenchError(
            f"no muscle named {name!r}", where="--sim", mend="use muscle, thesis, plant, aaa or a model.json"
        )
    return load_model(path / "model.json" if path.is_dir() else path)[0]


def with_concealed(model: Model, concealed: Sequence[str]) -> Model:
    """The model with mechanisms in it: ``creep``, or ``creep:compliance=0.3,time_constant=9`` in SI.

    Parameters that are not given have the values from which the diagnosis would begin to look.

    **Raises** `BenchError` for a name or parameter that is not there, or what this model cannot have.
    """
    for text in concealed:
        name, _, given = text.partition(":")
        try:
            m = mechanism(name)
        except ModelError as error:
            raise BenchError(error.problem, where=f"--conceal {text}", mend=error.mend) from error
        if not m.starts:
            raise BenchError(f"{name} is in every model", where=f"--conceal {text}", mend="conceal one of the others")
        scale = {"response": _settling(model), "duration": _DURATION_S}
        values = {p.name: x * scale.get(p.time, 1.0) for p, x in zip(m.parameters, m.starts[0], strict=True)}
        for part in filter(None, given.split(",")):
            key, _, number = part.partition("=")
            if key not in values:
                raise BenchError(f"{name} has no {key!r}", where=f"--conceal {text}", mend=f"use {', '.join(values)}")
            try:
                values[key] = float(number)
            except ValueError as error:
                raise BenchError(f"{number!r} is no number", where=f"--conceal {text}", mend="KEY=1.5") from error
        grown = model.structure.with_mechanisms(m)
        theta = grown.typical()
        theta[: len(model.structure.slots)] = np.asarray(model.theta)
        laws = np.zeros(len(grown.mechanisms))
        laws[: len(model.structure.mechanisms)] = np.asarray(model.laws)
        model = Model(grown, theta, laws, float(model.ambient)).replace({f"{name}.{k}": v for k, v in values.items()})
    return model


def simulated(
    name: str = "muscle",
    *,
    sides: int | None = None,
    concealed: Sequence[str] = (),
    noise: Noise | None = None,
    seed: int = 0,
    wiring: Wiring | None = None,
) -> Simulated:
    """A simulated bench of one actuator, or of two that pull at a pulley (``aaa`` and other joints always are two).

    The board's thermal model is that of the muscle without what is concealed, 5 % hotter. With a ``wiring`` the
    sensors are that one's.

    **Raises** `BenchError` where the muscle does not fit.
    """
    base = named_muscle(name)
    model = with_concealed(base, concealed)
    two = len(model.structure.sides) == 2
    if not (model.structure.thermal and model.structure.mechanical):
        raise BenchError("does not lead from volts to a displacement", where=f"--sim {name}", mend="use a plant")
    count: Literal[1, 2] = 2 if two or (wiring.sides if wiring else sides) == 2 else 1
    if two and sides == 1:
        raise BenchError("is a joint of two actuators", where=f"--sim {name}", mend="leave --actuators out")
    made = wiring or _wiring(base, count)
    plant: Plant
    if two:
        plant = Joint(model)
    else:
        radius = None if count == 1 else made.pulley_radius_m
        plant = Difference(model, None if count == 1 else model, radius=radius)
    config = replace(BoardConfig(supply_V=made.supply_V), ntc_fixed_ohm=made.thermistors.fixed_ohm)
    return Simulated(Muscle(plant, made, noise=noise, seed=seed), made, config.suited_to(base, _WARM), plant)


def _settling(model: Model) -> float:
    values = model.values()
    mass, loss = (values[f"newton_cooling.{k}"] for k in ("thermal_mass", "conductance"))
    return mass / loss


def _wiring(model: Model, sides: Literal[1, 2]) -> Wiring:
    radius = model.structure.pulley_radius or RADIUS_M
    values = model.values()
    known = (
        ("resistance_ohm", round(1 / next(v for k, v in values.items() if k.startswith("joule_heating.gain")), 6)),
        ("moving_mass_kg", round(next(v for k, v in values.items() if k.startswith("inertia.mass")), 6)),
    )
    zero = 800.0 if sides == 1 else 2048.0
    return Wiring(
        sides=sides,
        position=Position(zero=zero),
        pulley_radius_m=radius,
        pulley_mass_kg=model.structure.pulley_mass,
        ambient_K=float(model.ambient),
        known=known,
    )
