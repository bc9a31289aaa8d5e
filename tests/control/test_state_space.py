"""python-control systems of the models against python-control, the thesis's matrices and hand-made ones."""

import control
import numpy as np
import pytest

from scpjax.control.state_space import (
    canonical,
    controllability,
    observability,
    poles,
    state_space,
    transfer_function,
)
from scpjax.errors import ModelError
from scpjax.physics import presets
from scpjax.physics.catalogue import mechanism
from scpjax.physics.model import Model
from scpjax.recordings.recording import Recording
from scpjax.simulate.simulate import simulate

PLANT = presets.plant(
    resistance=10.0,
    conductance=0.2,
    thermal_mass=1.5,
    coefficient=0.02,
    stiffness=180.0,
    damping=5.0,
    mass=0.2,
)
THESIS = presets.Compact(b0=0.0300, a2=1.5053, a1=1.2661, a0=0.1909)  # cm, as in Table 3.5
TIME = np.arange(200) * 0.05


def driven(model, *volts):
    names = ["voltage_V"] if len(volts) == 1 else ["voltage_agonist_V", "voltage_antagonist_V"]
    drives = dict(zip(names, volts, strict=True))
    return simulate(model, Recording.from_arrays(TIME, drives, {"displacement_mm": 0 * TIME})).outputs


def test_plant_responds_as_in_python_control():
    system = state_space(PLANT)
    response = control.step_response(system, TIME)
    found = np.asarray(driven(PLANT, np.ones(TIME.size)))
    np.testing.assert_allclose(response.outputs[0, 0], found[:, 0] - 293.15, atol=1e-9)
    np.testing.assert_allclose(response.outputs[1, 0], found[:, 1], atol=1e-11 * np.max(np.abs(found[:, 1])) + 1e-14)
    assert system.input_labels == ["drive_V2"]
    assert system.output_labels == ["temperature_K", "displacement_m"]
    assert system.state_labels == ["temperature", "displacement", "velocity"]


def test_plant_transfer_function_is_3_6():
    system = transfer_function(PLANT)
    decay, m = 0.2 / 1.5, 0.2
    wanted = [1, 5 / m + decay, 180 / m + decay * 5 / m, decay * 180 / m]
    np.testing.assert_allclose(system.den[0][0], wanted, rtol=1e-12)
    np.testing.assert_allclose(system.num[0][0], [0.02 / (1.5 * m * 10)], rtol=1e-12)
    assert system.output_labels == ["displacement_m"]


def test_temperature_transfer_function_is_3_3():
    system = transfer_function(PLANT, output="temperature")
    np.testing.assert_allclose(system.den[0][0], [1, 0.2 / 1.5], rtol=1e-12)
    np.testing.assert_allclose(system.num[0][0], [1 / 15], rtol=1e-12)


def test_tm_transfer_function_is_3_5():
    system = transfer_function(presets.tm(coefficient=0.02, stiffness=180.0, damping=5.0, mass=0.2))
    np.testing.assert_allclose(system.den[0][0], [1, 25, 900], rtol=1e-12)
    np.testing.assert_allclose(system.num[0][0], [0.1], rtol=1e-12)
    assert system.input_labels == ["drive_K"]


def test_joint_transfer_function_is_3_11_from_each_side():
    second = PLANT.replace({"newton_cooling.conductance": 0.3, "elastic_spring.stiffness": 100.0})
    model = presets.aaa(PLANT, second, pulley_radius=0.015, pulley_mass=0.004)
    system = transfer_function(model)
    inertia = 0.2 + 0.2 + 0.002
    for column, (sign, decay) in enumerate([(1, 0.2 / 1.5), (-1, 0.3 / 1.5)]):
        wanted = np.polymul([1, decay], [1, 10 / inertia, 280 / inertia])
        np.testing.assert_allclose(system.den[0][column], wanted, rtol=1e-11)
        gain = sign * 0.02 / (10 * 1.5 * inertia * 0.015)
        np.testing.assert_allclose(system.num[0][column], [gain], rtol=1e-11)
    volts = np.full(TIME.size, 5.0)
    response = control.forced_response(state_space(model), TIME, np.vstack([volts**2, 4 * volts**2]))
    found = np.asarray(driven(model, volts, 2 * volts)[:, 2])
    np.testing.assert_allclose(response.outputs[2], found, atol=1e-10 * np.max(np.abs(found)))


def test_two_node_transfer_function_has_the_node_exchange_as_zero():
    structure = PLANT.structure.with_mechanisms(mechanism("two_node_thermal"))
    model = Model(structure, laws=[0.0] * len(PLANT.structure.mechanisms) + [2.0]).replace(
        PLANT.values() | {"two_node_thermal.share": 0.4, "two_node_thermal.time_constant": 0.3}
    )
    system = transfer_function(model, output="temperature")
    exchange = 0.4 * 0.6 * 1.5 / 0.3
    np.testing.assert_allclose(system.zeros(), [-exchange / (0.4 * 1.5)], rtol=1e-10)
    np.testing.assert_allclose(system.dcgain(), 1 / (10 * 0.2), rtol=1e-10)


def test_poles_of_table_3_5_are_4_5():
    model = presets.from_compact(THESIS, mass=0.05, resistance=4.0, thermal_mass=1.3)
    np.testing.assert_allclose(poles(model), [-0.1873, -0.6590 - 0.7649j, -0.6590 + 0.7649j], atol=1e-4)
    np.testing.assert_allclose(
        np.sort_complex(control.poles(canonical(THESIS))), np.sort_complex(poles(model)), rtol=1e-9
    )


def test_canonical_form_is_4_4_with_the_ranks_4_10_and_4_11():
    system = canonical(THESIS)
    np.testing.assert_array_equal(system.A, [[-1.5053, -1.2661, -0.1909], [1, 0, 0], [0, 1, 0]])
    np.testing.assert_array_equal(system.C, [[0, 0, 0.03]])
    matrix, rank = controllability(system)
    np.testing.assert_allclose(matrix, [[1, -1.5053, 0.9997], [0, 1, -1.5053], [0, 0, 1]], atol=1.5e-4)  # 0.99983
    np.testing.assert_allclose(matrix, control.ctrb(system.A, system.B), rtol=1e-14)
    assert rank == 3
    matrix, rank = observability(system)
    np.testing.assert_allclose(matrix, [[0, 0, 0.03], [0, 0.03, 0], [0.03, 0, 0]], atol=1e-15)
    np.testing.assert_allclose(matrix, control.obsv(system.A, system.C), rtol=1e-14)
    assert rank == 3


def test_canonical_form_responds_as_the_plant():
    compact = presets.to_compact(PLANT)
    wanted = control.frequency_response(transfer_function(PLANT), [0.01, 1.0, 30.0]).frdata[0, 0]
    found = control.frequency_response(canonical(compact), [0.01, 1.0, 30.0]).frdata[0, 0]
    np.testing.assert_allclose(found, wanted, rtol=1e-10)


def test_ranks_of_the_plant_by_output():
    assert controllability(PLANT)[1] == 3
    assert observability(PLANT)[1] == 3
    assert observability(PLANT, ("displacement",))[1] == 3
    assert observability(PLANT, ("temperature",))[1] == 1


def test_rank_survives_units_that_are_decades_apart():
    """A weak pull, a fast spring and heat that takes hours: the plain rank of (4.7) gives up here."""
    model = PLANT.replace(
        {
            "newton_cooling.conductance": 1e-4,
            "thermal_actuation.coefficient": 1e-16,
            "elastic_spring.stiffness": 1e6,
            "inertia.mass": 0.01,
        }
    )
    matrix, rank = controllability(model)
    assert np.linalg.matrix_rank(matrix) < 3 == np.linalg.matrix_rank(controllability(PLANT)[0])
    assert rank == 3
    assert observability(model, ("displacement",))[1] == 3


def test_joint_of_equals_shows_the_angle_only_the_difference_of_its_temperatures():
    model = presets.aaa(PLANT, pulley_radius=0.015)
    assert controllability(model)[1] == 4
    assert observability(model)[1] == 4
    assert observability(model, ("angle",))[1] == 3
    unequal = presets.aaa(PLANT, PLANT.replace({"newton_cooling.conductance": 0.3}), pulley_radius=0.015)
    assert observability(unequal, ("angle",))[1] == 4


def test_what_the_input_does_not_reach_is_not_controllable():
    system = control.ss([[-1.0, 0.0], [0.0, -2.0]], [[1.0], [0.0]], [[1.0, 1.0]], [[0.0]])
    assert controllability(system)[1] == 1
    twins = control.ss([[-1.0, 0.0], [0.0, -1.0]], [[1.0], [3.0]], [[1.0, 1.0]], [[0.0]])
    assert controllability(twins)[1] == 1
    assert observability(twins)[1] == 1


def test_unknown_output_is_refused():
    with pytest.raises(ModelError, match="no output 'angle'"):
        transfer_function(PLANT, output="angle")
