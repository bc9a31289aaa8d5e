"""The joint of thesis 4.2.2 and 4.4.5: Figure 4.17 by (3.11), and all of Table 4.9 by (3.11) with friction.

Table 4.9 was measured, angles read by eye. The thesis simulates one of its rows, 40/40.4 g for 10 s, in Figure 4.17
(a), with C and damping six times those of Table 4.14, chosen for that row. The sketch for the microcontroller of this
experiment (github.com/GabrielSilva96/Dissertation-s-codes, AAA_2SCP) heats agonist and antagonist in turn; an angle is
read here as the turn from the end of one drive to the end of the next, the third of them from rest.

(3.11) has no term for the load that hangs on both sides but inertia, so all loads turn alike in it. The joint turned
less under more. What an axle does under load is dry friction in proportion to it; with that in the model two numbers,
one factor of C and one ratio of friction to weight, are fitted to the twelve angles, and to nine of them to predict
the three of the load left out. Other mechanisms that grow with the load would serve, too: twelve angles read to a
degree cannot tell.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from scipy.optimize import least_squares

from scpjax.control.loop import play
from scpjax.control.plant import Joint
from scpjax.physics.mechanisms.friction import Friction
from scpjax.physics.model import Model
from scpjax.physics.presets import aaa, plant
from scpjax.recordings.thesis import TABLE_4_9, TABLE_4_14, JointTrial

DT, RADIUS, PULLEY_MASS = 0.02, 0.015, 0.002
GRAVITY = 9.81
SMALL = 3000.0  # s for the reference displacement: friction is dry down to 3 micrometres a second
Line = tuple[str, str, float, float]  # where, what, printed, ours


def actuator(code: str, mass: float, factor: float) -> Model:
    """An actuator of Table 4.14 with its force and damping raised, as section 4.4.5 does."""
    row = next(r for r in TABLE_4_14 if r.code == code)
    values = (row.conductance_W_per_K, row.force_N_per_K, row.stiffness_N_per_m, row.damping_Ns_per_m)
    conductance, force, stiffness, damping = (float(v) for v in values if v is not None)
    return plant(
        resistance=row.resistance_ohm,
        conductance=conductance,
        thermal_mass=row.heat_capacity_J_per_K,
        coefficient=factor * force,
        stiffness=stiffness,
        damping=factor * damping,
        mass=mass,
    )


def joint(code: str, masses: tuple[float, float], factor: float) -> Model:
    """Two actuators of a code over the thesis's pulley, each with its moving mass [kg]."""
    return aaa(*[actuator(code, m, factor) for m in masses], pulley_radius=RADIUS, pulley_mass=PULLEY_MASS)


def rubbed(trial: JointTrial) -> Model:
    """The joint of a trial with friction in it, not yet of any strength."""
    base = joint("1", (trial.agonist_mass_kg, trial.antagonist_mass_kg), 1.0)
    dry = Model(base.structure.with_mechanisms(Friction()), ambient=base.ambient)
    return dry.replace({**base.values(), "friction.velocity_time": SMALL})


@eqx.filter_jit
def turn(model: Model, effort: jax.Array, factor: jax.Array, ratio: jax.Array, weight: jax.Array) -> jax.Array:
    """Angle [rad] of the third drive under ``effort`` (3 n + 1, 2): C times ``factor``, friction ``ratio weight``."""
    stiffness = sum(model.value(f"elastic_spring.stiffness@{side}") for side in ("agonist", "antagonist"))
    share = ratio * weight / (stiffness * model.value("friction.reference"))
    scaled = [f"{key}@{side}" for key in _RAISED for side in ("agonist", "antagonist")]
    raised = {key: factor * model.value(key) for key in scaled}
    angle, _ = play(Joint(model.replace({**raised, "friction.strength": share})), effort, dt=DT)
    return angle[-1] - angle[2 * (effort.shape[0] - 1) // 3]


_RAISED = ("thermal_actuation.coefficient", "viscous_damping.damping")


def in_turn(trial: JointTrial) -> np.ndarray:
    """Efforts [V^2] of agonist, antagonist, agonist, each for the trial's time."""
    steps = round(trial.on_s / DT)
    effort = np.zeros((3 * steps + 1, 2))
    effort[:steps, 0] = effort[2 * steps :, 0] = effort[steps : 2 * steps, 1] = trial.voltage_V**2
    return effort


def turned(trials: Sequence[JointTrial], factor: float, ratio: float) -> np.ndarray:
    """Angles [rad] of trials; friction is ``ratio`` times the weight on both sides."""
    found = []
    for t in trials:
        weight = GRAVITY * (t.agonist_mass_kg + t.antagonist_mass_kg)
        given = (jnp.asarray(v) for v in (in_turn(t), factor, ratio, weight))
        found.append(float(turn(rubbed(t), *given)))
    return np.array(found)


def fitted(trials: Sequence[JointTrial]) -> tuple[float, float]:
    """Factor of C and ratio of friction to weight, by least squares in the angle."""
    measured = np.array([t.angle_rad for t in trials])
    start, least = [6.0, 0.03], [1.0, 0.0]
    x = least_squares(lambda x: turned(trials, *x) - measured, start, bounds=(least, [20.0, 0.3]), diff_step=1e-3).x
    return float(x[0]), float(x[1])


def figure(effort: jax.Array) -> Iterator[Line]:
    """Figure 4.17: (a) "17 degrees across the 20 and 30 s marks", (b) the voltages of the 25 degree sine."""
    trial = next(t for t in TABLE_4_9 if t.on_s == 10.0 and t.agonist_mass_kg == 0.040)
    swing = math.degrees(turned([trial], 6.0, 0.0)[0])
    yield "Figure 4.17 (a), C x 6", "40.0/40.4 g, 10 s (deg)", 17.0, swing
    angle = np.degrees(np.asarray(play(Joint(joint("2", (0.0872, 0.0872), 3.0)), effort, dt=DT)[0]))
    yield "Figure 4.17 (b), C x 3", "sine voltages, from end to end (deg)", 6.0, float(np.ptp(angle[1000:]))


def table() -> tuple[list[Line], str]:
    """Table 4.9 by (3.11) as in Figure 4.17 (a), with friction, and with friction fitted to the other loads."""
    trials = list(TABLE_4_9)
    both = fitted(trials)
    loads = sorted({t.agonist_mass_kg for t in trials})
    unseen = np.zeros(len(trials))
    for load in loads:
        out = [t.agonist_mass_kg == load for t in trials]
        kept = [t for t, gone in zip(trials, out, strict=True) if not gone]
        unseen[out] = turned([t for t, gone in zip(trials, out, strict=True) if gone], *fitted(kept))
    columns = {
        "(3.11), C x 6": turned(trials, 6.0, 0.0),
        "with friction": turned(trials, *both),
        "with friction, load left out": unseen,
    }
    lines, off = [], {}
    for name, angles in columns.items():
        for t, angle in zip(trials, angles, strict=True):
            grams = f"{1e3 * t.agonist_mass_kg:.1f}/{1e3 * t.antagonist_mass_kg:.1f} g, {t.on_s:.0f} s"
            where, measured = f"Table 4.9 (measured), {name}", math.degrees(t.angle_rad)
            lines.append((where, f"{grams} (deg)", measured, math.degrees(angle)))
        miss = np.degrees(angles - np.array([t.angle_rad for t in trials]))
        off[name] = f"{name}: {np.sqrt(np.mean(miss**2)):.2f} (largest {np.max(np.abs(miss)):.2f})"
    said = f"Table 4.9, RMSE in degrees of twelve angles: {'; '.join(off.values())}"
    return lines, f"{said}\nfitted to it: C x {both[0]:.2f}, friction {both[1]:.4f} of the weight on both sides"
