"""Heat is conserved: what is supplied is stored or lost, for every thermal mechanism and law."""

import numpy as np
import pytest
from sim_cases import CASES, PARAMETERS, PLANT, active_values, case_id, extended, multilevel

from scpjax.errors import ModelError
from scpjax.physics import presets
from scpjax.physics.catalogue import catalogue
from scpjax.physics.model import Model
from scpjax.simulate.simulate import Exponential, energy_balance, simulate

THERMAL = [c for c in CASES if catalogue()[c[0]].subsystem == "thermoelectric"]
HEAT = ("resistance", "conductance", "thermal_mass")
TE = presets.te(**{k: PARAMETERS[k] for k in HEAT})
STRUCTURE = extended(TE.structure, *dict(THERMAL), "input_delay", "sensor_lag")


def active(name, law=0):
    """The thermal model with one mechanism at its representative value, the others at null."""
    laws = [float(law) if m.name == name else 0.0 for m in STRUCTURE.mechanisms]
    return Model(STRUCTURE, laws=laws).replace(TE.values() | active_values(name))


def _closes(balance):
    return abs(balance["supplied"] - balance["lost"] - balance["stored"]) < 1e-6 * abs(balance["supplied"])


def test_base_model_closes_on_what_the_wire_took_in():
    recording = multilevel()
    balance = energy_balance(PLANT, recording)
    assert _closes(balance)
    supplied = np.sum(recording.inputs[:-1, 0] ** 2) * 0.05 / PARAMETERS["resistance"]
    np.testing.assert_allclose(balance["supplied"], supplied, rtol=1e-10)
    warm = float(simulate(PLANT, recording).states[-1, 0])
    np.testing.assert_allclose(balance["stored"], PARAMETERS["thermal_mass"] * warm, rtol=1e-9)


@pytest.mark.parametrize("case", THERMAL, ids=case_id)
def test_thermal_mechanism_closes(case):
    """Against heats taken from the states here, not only from the flows that the model states."""
    name, law = case
    model, recording = active(name, law), multilevel()
    z0 = model.initial(temperature=10.0)
    balance = energy_balance(model, recording, initial=z0)
    assert _closes(balance)
    share, slow = {"two_node_thermal": (0.4, {3: 0.3, 4: 0.5, 7: 0.3}.get(law, 0.0))}.get(name, (0.0, 0.0))
    if name in ("two_node_thermal", "resistance_temperature", "nonlinear_heat_loss"):
        states = np.asarray(simulate(model, recording, initial=z0, method=Exponential(substeps=8)).states)
        weights = {"second": share * (1 - slow), "third": share * slow}
        at = [model.structure.state_names.index(f"two_node_thermal.{node}_temperature") for node in weights]
        first, last = ((1 - share) * s[0] + s[at] @ np.array([*weights.values()]) for s in (states[0], states[-1]))
        np.testing.assert_allclose(balance["stored"], PARAMETERS["thermal_mass"] * (last - first), rtol=1e-5)
    if name in ("two_node_thermal", "nonlinear_heat_loss"):
        supplied = np.sum(recording.inputs[:-1, 0] ** 2) * 0.05 / PARAMETERS["resistance"]
        np.testing.assert_allclose(balance["supplied"], supplied, rtol=1e-10)


def test_hot_copper_takes_in_less_under_voltage_and_more_under_current():
    recording = multilevel()
    plain = energy_balance(TE, recording)["supplied"]
    assert energy_balance(active("resistance_temperature", 0), recording)["supplied"] < 0.99 * plain
    assert energy_balance(active("resistance_temperature", 1), recording)["supplied"] > 1.01 * plain


@pytest.mark.parametrize("name", ["sensor_lag", "input_delay"])
def test_sensor_and_delay_do_not_make_heat(name):
    assert _closes(energy_balance(active(name), multilevel()))


def test_model_without_heat_is_refused():
    model = presets.tm(coefficient=0.02, stiffness=180.0, damping=5.0, mass=0.2)
    with pytest.raises(ModelError, match="no energy balance"):
        energy_balance(model, multilevel())
