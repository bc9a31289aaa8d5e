"""Recordings of a plant with one more heat flow, or a spring that changes, made by scipy; and the base model's fit."""

from collections.abc import Callable
from functools import cache

import numpy as np
import scipy.integrate
from diagnose.creeping import AMBIENT, BASE

from scpjax.diagnose.holdout import Split, split
from scpjax.diagnose.hypothesis import State, residual_on
from scpjax.diagnose.latent import Misfit, missing
from scpjax.diagnose.locate import observe
from scpjax.fit.fit import best_start, refine
from scpjax.fit.setup import prepare
from scpjax.recordings import excitation
from scpjax.recordings.recording import Metadata, Recording

NOISE = {"temperature_degC": 0.1, "displacement_mm": 0.03}
LOSS, MASS = BASE["newton_cooling.conductance"], BASE["newton_cooling.thermal_mass"]
TIME, DRIVE = excitation.multilevel_random(duration_s=120, period_s=0.1, hold_s=6, low=0, high=4, seed=3)


def rubbed_by_air(_t: float, temperature: float, moved: float) -> float:
    """A loss [W] that grows with the square of the displacement: in no catalogue."""
    return 0.9 * LOSS * temperature * (moved / 5e-3) ** 2


def nothing(_t: float, _temperature: float, _moved: float) -> float:
    return 0.0


def recorded(
    heat: Callable[[float, float, float], float],
    rattle: float | np.ndarray = 0.0,
    seed: int = 0,
    stiff: Callable[[float], float] = lambda temperature: 1.0,
    quiet: float = 1.0,
    drive: np.ndarray = DRIVE,
    attraction: float = 0.0,
) -> Recording:
    """Made by scipy: a plant with one more heat flow out of the wire [W], and a spring as stiff as told, from rest;
    ``quiet`` times the noise, under ``drive`` [V], whose turns attract each other with ``attraction`` [N/V^2]."""
    k, b, m = (BASE[n] for n in ("elastic_spring.stiffness", "viscous_damping.damping", "inertia.mass"))
    z, path = np.zeros(3), [np.zeros(3)]
    for i, gap in enumerate(np.diff(TIME)):

        def rates(t, z, i=i):
            power = drive[i] ** 2 * BASE["joule_heating.gain"] - LOSS * z[0] - heat(t, z[0], z[1])
            pull = BASE["thermal_actuation.coefficient"] * z[0] - k * stiff(z[0]) * z[1] + attraction * drive[i] ** 2
            return [power / MASS, z[2], (pull - b * z[2]) / m]

        z = scipy.integrate.solve_ivp(rates, (TIME[i], TIME[i] + gap), z, rtol=1e-8, atol=1e-10).y[:, -1]
        path.append(z)
    states, rng = np.array(path), np.random.default_rng(seed)
    clean = {"temperature_degC": states[:, 0] + AMBIENT - 273.15, "displacement_mm": 1e3 * states[:, 1] + rattle}
    outputs = {c: clean[c] + quiet * s * rng.standard_normal(len(TIME)) for c, s in NOISE.items()}
    meta = Metadata(
        name="made", known=(("resistance_ohm", 1.2), ("moving_mass_kg", 0.25)), ambient_K=AMBIENT, model="plant"
    )
    return Recording.from_arrays(TIME, {"voltage_V": drive}, outputs, metadata=meta)


def base_of(*recordings: Recording) -> tuple[State, Split]:
    setup = prepare(recordings)
    parts = split(setup.data)
    trial, _, _ = best_start(setup, parts.train)
    trial, _, cost = refine(setup, parts.train, trial)
    return State(setup, trial, residual_on(trial, parts.whole, setup), float(cost)), parts


@cache
def rubbed() -> tuple[State, Split]:
    return base_of(recorded(rubbed_by_air))


def lacking_in(base: State, parts: Split):
    binned = observe(base.setup, parts.whole, base.trial, base.residual)
    return binned, missing(Misfit(base.setup, parts.whole, base.trial, binned))
