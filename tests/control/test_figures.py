"""Figures 4.12, 4.13, 4.16 and 4.17 of the thesis, passive antagonists, and the metrics on made signals."""

import control
import jax
import jax.numpy as jnp
import numpy as np
import pytest
from loop_cases import DEG, PLANT, run_jit, signal, thesis_loop

from scpjax.control.analysis import figures, loop_response, open_loop, sensitivity_peak
from scpjax.control.errors import ControlError
from scpjax.control.loop import Disturbance, Loop, Response, play
from scpjax.control.metrics import energy, measure, peak_of, section_error, step_figures
from scpjax.control.pid import PID, Pair, thesis_pair
from scpjax.control.plant import Difference, Joint, against_spring
from scpjax.physics.catalogue import mechanism
from scpjax.physics.known import known_model
from scpjax.physics.model import Model
from scpjax.physics.presets import aaa, plant
from scpjax.recordings.thesis import TABLE_4_10, TABLE_4_14

DT = 0.02
TIME = DT * np.arange(3001)
play_jit = jax.jit(lambda p, u: play(p, u, dt=DT))


def test_figure_4_12_a_joint_comes_back_sooner_than_one_actuator():
    reference = np.where(TIME < 25.0, 15.0 * DEG, 0.0)
    joint = np.asarray(run_jit(thesis_loop(), reference, DT).angle)[TIME >= 25.0] / DEG
    single = Loop(Difference(PLANT), thesis_pair().agonist)
    one = np.asarray(run_jit(single, reference, DT).angle)[TIME >= 25.0] / DEG
    assert DT * np.argmax(joint <= 0) == pytest.approx(3.0, abs=0.5)
    assert DT * np.argmax(one <= 0.5) == pytest.approx(20.0, abs=2.0)
    assert one.min() > 0  # it cannot push


def test_figure_4_13_recovery_from_steps_on_the_angle():
    reference = signal("sine")
    output = np.where(TIME >= 15.0, -10.0 * DEG, 0.0) + np.where(TIME >= 45.0, 10.0 * DEG, 0.0)
    quiet = run_jit(thesis_loop(), reference, DT).angle
    found = run_jit(thesis_loop(), reference, DT, Disturbance(output=jnp.asarray(output)))
    moved = np.asarray(found.angle - quiet)
    for at in (15.0, 45.0):
        part = moved[at <= TIME]
        assert abs(part[0]) == pytest.approx(10 * DEG, rel=0.01)
        assert DT * np.argmax(part * part[0] < 0) == pytest.approx(2.5, abs=0.1)
    assert float(found.voltage.max()) == pytest.approx(3.7)


def test_figure_4_16_more_opposing_force_less_angle_and_a_dead_zone():
    effort = run_jit(thesis_loop(), signal("sine"), DT).effort
    stiffness = next(r for r in TABLE_4_14 if r.code == "2").stiffness_N_per_m
    turned, dead = [], []
    for force in (0.0, 0.1, 0.4, 0.6, 0.8):
        joint = Difference(PLANT, PLANT, opposing=force, stiffness=stiffness)
        angle = np.asarray(play_jit(joint, effort)[0]) / DEG
        turned.append(np.ptp(angle[1000:]))
        dead.append(DT * np.argmax(np.abs(angle) > 0.05))
    assert turned[1] == pytest.approx(turned[0])  # too low a force changes nothing
    assert turned[1] > turned[2] > turned[3] > turned[4] > 0
    assert np.all(np.diff(dead) > 0)


def actuator(code, mass, factor):
    row = next(r for r in TABLE_4_14 if r.code == code)
    return plant(resistance=row.resistance_ohm, conductance=row.conductance_W_per_K,
                 thermal_mass=row.heat_capacity_J_per_K, coefficient=factor * row.force_N_per_K,
                 stiffness=row.stiffness_N_per_m, damping=factor * row.damping_Ns_per_m, mass=mass)  # fmt: skip


def test_figure_4_17_with_the_joint_model():
    """Force and damping six and three times those of Table 4.14, as section 4.4.5 has it."""
    joint = Joint(aaa(actuator("1", 0.040, 6.0), actuator("1", 0.0404, 6.0), pulley_radius=0.015, pulley_mass=0.002))
    effort = np.zeros((1501, 2))
    effort[:500, 0] = effort[500:1000, 1] = effort[1000:, 0] = 3.26**2
    angle = np.asarray(play_jit(joint, effort)[0]) / DEG
    assert angle[1500] - angle[1000] == pytest.approx(17.0, rel=0.02)  # across the 20 and 30 s marks
    weights = Joint(aaa(*[actuator("2", 0.0872, 3.0)] * 2, pulley_radius=0.015, pulley_mass=0.002))
    voltages = run_jit(thesis_loop(), signal("sine"), DT).effort
    angle = np.asarray(play_jit(weights, voltages)[0])[1000:] / DEG
    assert 5.0 < np.ptp(angle) < 8.0  # about 6, where the plants by themselves turn by 50
    # at rest theta = C dT / (2 k r), thesis (3.7)
    held = np.zeros((5000, 2))
    held[:, 0] = 3.26**2
    end = float(play_jit(joint, held)[0][-1])
    assert end == pytest.approx(6 * 1.7e-3 * 3.26**2 / (0.96 * 0.36) / (2 * 54.49 * 0.015), rel=1e-6)


def test_springs_stand_in_for_the_antagonist():
    base = known_model("plant")
    held = np.full((6000, 1), 9.0)
    free = float(play_jit(Difference(base), held)[0][-1])
    k = float(base.value("elastic_spring.stiffness"))
    for passive in TABLE_4_10:
        joint = against_spring(base, stiffness=passive.stiffness_N_per_m, radius=0.015, pulley_mass=0.002, mass=0.04)
        end = float(play_jit(joint, held)[0][-1])
        assert end == pytest.approx(free * k / (k + passive.stiffness_N_per_m), rel=1e-4)
    with pytest.raises(ControlError, match="stiffness is -1"):
        against_spring(base, stiffness=-1.0, radius=0.015)


def test_play_refuses_wrong_shapes():
    with pytest.raises(ControlError, match="for 2 sides"):
        play(thesis_loop().plant, np.zeros(10))


def made(reference, angle, dt=0.01):
    n = len(reference)
    zero = jnp.zeros((n, 2))
    return Response(
        dt * jnp.arange(n), jnp.asarray(reference), jnp.asarray(angle), jnp.asarray(angle), zero, zero, zero
    )


def test_metrics_of_a_late_and_small_sine():
    time = 0.01 * np.arange(4001)
    reference, angle = np.sin(2 * np.pi * 0.1 * time), 0.8 * np.sin(2 * np.pi * 0.1 * (time - 0.7))
    found = measure(made(reference, angle), section=5.0)
    assert found.delay == pytest.approx(-0.7, abs=0.0101)
    assert found.phase == pytest.approx(-0.07 * 2 * np.pi, abs=0.01)
    assert found.peak_error == pytest.approx(0.2, abs=1e-4)
    assert found.section_error == pytest.approx(0.2, abs=1e-4)
    assert found.rmse == pytest.approx(np.sqrt(np.mean((reference - angle) ** 2)))
    assert found.mae == pytest.approx(np.mean(np.abs(reference - angle)))
    assert found.max_error == pytest.approx(np.max(np.abs(reference - angle)))


def test_sections_of_a_stair_compare_the_overshoot():
    time = 0.01 * np.arange(4000)
    levels = np.array([1.0, 3.0, 2.0, 0.0])[(time / 10 + 1e-9).astype(int)]
    angle = levels + np.where(
        np.mod(time, 10.0) < 1.0, np.array([0.1, 0.3, -0.2, -0.25])[(time / 10 + 1e-9).astype(int)], 0
    )
    assert section_error(time, levels, angle, 10.0) == pytest.approx(0.3)
    assert peak_of(time, levels, angle, 20.0)[0] == pytest.approx(-0.3)


def test_a_section_that_the_end_cuts_off_counts_once_its_extreme_is_past():
    time = 0.01 * np.arange(2401)
    levels = np.array([1.0, 3.0, 2.0])[np.minimum((time / 10 + 1e-9).astype(int), 2)]
    angle = levels - 0.1 - 0.5 * (time > 20) * (np.mod(time, 10.0) > 2.0)
    assert section_error(time, levels, angle, 10.0) == pytest.approx(0.1)  # still at its least: not over
    back = np.where(time > 23.5, angle + 0.3, angle)
    assert section_error(time, levels, back, 10.0) == pytest.approx(0.6)


def test_step_figures_are_those_of_python_control():
    system = control.tf([1.0], [1.0, 0.8, 1.0])
    time, values = control.step_response(system, np.arange(0, 30, 0.01))
    info = control.step_info(system, T=time)
    found = step_figures(time, values, final=1.0)
    assert found.rise == pytest.approx(info["RiseTime"], abs=0.02)
    assert found.settling == pytest.approx(info["SettlingTime"], abs=0.05)
    assert found.overshoot == pytest.approx(np.exp(-np.pi * 0.4 / np.sqrt(1 - 0.16)), rel=1e-3)
    with pytest.raises(ControlError, match="does not settle"):
        step_figures(time, np.exp(time), final=1.0)


def test_energy_is_the_heat_that_reaches_the_wires():
    """V^2 / R over time, by hand."""
    response = run_jit(thesis_loop(), signal("sine", duration=10.0), DT)
    resistance = next(r for r in TABLE_4_14 if r.code == "2").resistance_ohm
    wanted = float(jnp.sum(response.effort)) / resistance * DT
    assert float(energy(thesis_loop(), response)) == pytest.approx(wanted, rel=1e-9)
    single = Loop(Difference(PLANT), thesis_pair().agonist)
    response = run_jit(single, signal("sine", duration=10.0), DT)
    assert measure(response, loop=single).energy == pytest.approx(float(response.effort.sum()) / resistance * DT)


def test_a_dead_time_takes_its_phase_from_the_margin():
    """w T at the crossover; exact in the frequency response, by Pade in python-control's systems."""
    base = known_model("thesis")
    delay = 0.3
    late = Model(base.structure.with_mechanisms(mechanism("input_delay")), ambient=base.ambient)
    late = late.replace(base.values() | {"input_delay.time": delay})
    gains = PID.per_degree(0.05, 0.01, 0.02, 5.84)
    there, quick = (Loop(Difference(m, m, radius=0.015), Pair(gains)) for m in (late, base))
    omega = jnp.geomspace(0.01, 10.0, 400)
    exact, plain = loop_response(there, omega), loop_response(quick, omega)
    np.testing.assert_allclose(exact, plain * np.exp(-1j * np.asarray(omega) * delay), rtol=1e-9)
    by_pade = np.squeeze(open_loop(there)(1j * np.asarray(omega)))
    np.testing.assert_allclose(by_pade, exact, rtol=1e-3, atol=1e-6)
    crossover = float(omega[int(jnp.argmin(jnp.abs(jnp.abs(plain) - 1)))])
    assert figures(quick).phase_margin - figures(there).phase_margin == pytest.approx(crossover * delay, rel=0.05)
    assert float(sensitivity_peak(there)) > float(sensitivity_peak(quick)) + 0.01
