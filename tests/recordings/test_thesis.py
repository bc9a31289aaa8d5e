"""The tables hold together: relations that the thesis states between their columns."""

import math

import numpy as np
import pytest

from scpjax.recordings import thesis
from scpjax.recordings.sensors import pwm_mean_voltage, wire_resistance

COILING = (*thesis.TABLE_3_2, *thesis.TABLE_B_1)
ANNEALING = (*thesis.TABLE_3_3, *thesis.TABLE_B_2)
TRAINING = (*thesis.TABLE_3_4, *thesis.TABLE_B_3)
PWM_OF_DIAMETER = {0.23e-3: 225, 0.33e-3: 235, 0.45e-3: 245}


def test_every_actuator_is_in_every_manufacturing_table():
    for table in (COILING, ANNEALING, TRAINING):
        assert [row.code for row in table] == list(range(1, 20))


@pytest.mark.parametrize("row", COILING, ids=lambda r: str(r.code))
def test_stress_is_weight_over_section(row):
    stress = row.mass_kg * 9.81 / (math.pi * row.fiber_diameter_m**2 / 4)
    assert row.stress_Pa == pytest.approx(stress, rel=0.005)


@pytest.mark.parametrize("row", COILING, ids=lambda r: str(r.code))
def test_coiling_starts_at_about_two_thirds_of_the_turns_and_shortens_five_times(row):
    assert 0.55 < row.start_revolutions / row.total_revolutions < 0.68
    assert 0.19 < row.coiled_length_m / row.fiber_length_m < 0.23


@pytest.mark.parametrize(("coiling", "row"), list(zip(COILING, ANNEALING, strict=True)), ids=lambda r: str(r.code))
def test_framed_elongation_is_of_the_coiled_length(coiling, row):
    if row.ply == 2:
        assert row.framed_length_m is None
        assert row.oven_K is None
    else:
        assert row.elongation_pct == pytest.approx(100 * row.framed_length_m / coiling.coiled_length_m, abs=0.06)
        assert row.oven_K == 408.15


@pytest.mark.parametrize("row", TRAINING, ids=lambda r: str(r.code))
def test_wire_resistance_is_that_of_the_wire(row):
    # rho L / A by hand: 1.68e-8 * 0.45 / (pi (0.1e-3)^2 / 4) = 0.9626
    assert row.wire_resistance_ohm == pytest.approx(wire_resistance(row.wire_length_m), abs=0.006)


@pytest.mark.parametrize(
    ("coiling", "annealing", "row"),
    [t for t in zip(COILING, ANNEALING, TRAINING, strict=True) if t[2].power_W is not None],
    ids=lambda r: str(r.code),
)
def test_training_power_voltage_elongation_and_load(coiling, annealing, row):
    volt = PWM_OF_DIAMETER[round(coiling.fiber_diameter_m, 6)] / 255 * 3.7
    assert row.voltage_V == pytest.approx(volt, abs=0.0051)
    assert row.power_W == pytest.approx(volt**2 / row.wire_resistance_ohm, rel=0.002)
    elongation = 100 * row.trained_length_m / annealing.mounted_length_m
    assert row.elongation_pct == pytest.approx(elongation, abs=0.06)
    factor = 2 if annealing.ply == 1 else 5
    assert row.mass_kg == pytest.approx(factor * coiling.mass_kg, rel=0.035)


def test_table_4_4_voltages_are_those_printed():
    printed = {100: 1.45, 125: 1.81, 150: 2.18, 175: 2.54, 200: 2.90, 225: 3.26, 235: 3.41, 245: 3.55}
    for row, arrays in zip(thesis.TABLE_4_4, thesis.table_4_4_recordings(), strict=True):
        assert len(row.pwm) == len(row.displacement_m)
        assert row.voltage_V == pytest.approx([printed[p] for p in row.pwm], abs=0.0051)
        np.testing.assert_allclose(arrays.voltage_V, pwm_mean_voltage(np.array(row.pwm)))
        assert np.all(np.diff(arrays.displacement_m) > 0)
        assert np.all(arrays.displacement_m < 0.2 * row.length_m)
    assert len(thesis.TABLE_4_4) == 9


def test_table_4_5_loads_run_from_the_coiling_to_the_training_weight():
    masses = {row.code: row.mass_kg for row in TRAINING}
    for row in thesis.TABLE_4_5:
        assert list(row.mass_kg) == sorted(row.mass_kg)
        assert len(row.mass_kg) == len(row.displacement_m) == 3
        assert row.mass_kg[-1] == masses[row.code]


@pytest.mark.parametrize("row", thesis.TABLE_4_8.rows, ids=lambda r: r.code)
def test_table_4_8_is_consistent(row):
    assert row.power_W == pytest.approx(row.voltage_V * row.current_A, rel=0.015)
    assert row.voltage_V == pytest.approx(row.resistance_ohm * row.current_A, rel=0.02)
    assert row.energy_J == pytest.approx(row.power_W * row.duration_s, rel=0.001)
    assert row.repetitions == math.floor(row.battery_s / row.duration_s + 1e-9)
    assert row.battery_s == pytest.approx(3600 / row.current_A, abs=40)


def test_joint_angles():
    assert len(thesis.TABLE_4_9) == 12
    assert len(thesis.TABLE_4_11) == 9
    assert len(thesis.TABLE_4_12) == 12
    for table in (thesis.TABLE_4_9, thesis.TABLE_4_11, thesis.TABLE_4_12):
        for first, second in zip(table.rows[:-1], table.rows[1:], strict=True):
            if second.on_s > first.on_s:  # longer heating with the same weights moves further
                assert second.angle_rad > first.angle_rad
        assert max(row.angle_rad for row in table) <= math.radians(20) + 1e-12
    spring, band = thesis.TABLE_4_10
    assert {row.antagonist_stiffness_N_per_m for row in thesis.TABLE_4_11} == {spring.stiffness_N_per_m}
    assert {row.antagonist_stiffness_N_per_m for row in thesis.TABLE_4_12} == {band.stiffness_N_per_m}


def test_plant_has_the_poles_of_the_thesis():
    (plant,) = thesis.TABLE_3_5
    poles = sorted(np.roots([1, plant.a2, plant.a1, plant.a0]), key=lambda p: (p.real, p.imag))
    expected = [-0.6590 - 0.7649j, -0.6590 + 0.7649j, -0.1873]
    np.testing.assert_allclose(poles, expected, atol=2e-4)
    assert plant.b0_cm == pytest.approx(0.03)
    assert 3.7**2 * plant.b0 / plant.a0 == pytest.approx(0.0215, abs=1e-4)  # metres at full supply


def test_parameters_of_actuator_2_against_the_plant():
    (plant,) = thesis.TABLE_3_5
    row = thesis.TABLE_4_14.rows[1]
    cooling = row.conductance_W_per_K / row.heat_capacity_J_per_K
    assert row.damping_Ns_per_m / row.mass_kg + cooling == pytest.approx(plant.a2, rel=0.002)
    b0 = row.force_N_per_K / (row.heat_capacity_J_per_K * row.mass_kg * row.resistance_ohm)
    assert b0 == pytest.approx(plant.b0_cm, rel=0.02)
    # what the note says: the stiffness does not go with the identified plant
    assert row.stiffness_N_per_m / row.mass_kg > 900 * plant.a1
    assert "1179" in thesis.TABLE_4_14.note


def test_parameters_carry_over_from_manufacturing():
    wires = {str(row.code): row.wire_resistance_ohm for row in TRAINING}
    coiling = {str(row.code): row for row in COILING}
    for row in thesis.TABLE_4_14.rows[:6]:
        assert row.resistance_ohm == wires[row.code]
        assert row.fiber_diameter_m == coiling[row.code].fiber_diameter_m
        factor = 1 if row.ply == 1 else 5
        assert row.load_mass_kg == pytest.approx(factor * coiling[row.code].mass_kg, rel=0.01)


def test_sine_delays_are_phases_at_a_tenth_of_a_hertz():
    for row in (*thesis.TABLE_4_15, *thesis.TABLE_4_18):
        assert row.delay_s == pytest.approx(row.phase_rad / (2 * math.pi) / 0.10, abs=1e-6)
    for row in (*thesis.TABLE_4_16, *thesis.TABLE_4_19):
        assert row.mae_rad < row.rmse_rad
    agonist, antagonist = thesis.TABLE_3_7
    assert (agonist.Kp, agonist.Ki, agonist.Kd) == (-antagonist.Kp, -antagonist.Ki, -antagonist.Kd)


def test_every_table_is_cited():
    tables = [getattr(thesis, name) for name in thesis.__all__ if name.startswith("TABLE")]
    assert len(tables) == 21
    for table in tables:
        assert table.citation.startswith("Thesis Table")
        assert len(table) > 0
