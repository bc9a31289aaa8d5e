"""Heat between the two actuators of a joint against its equations, written out here: the linear laws by the exponential
of their whole system, radiation by scipy.
"""

import jax.numpy as jnp
import numpy as np
import pytest
import scipy.integrate
import scipy.linalg
from sim_cases import PLANT, extended, recorded
from written_out import C_TH, LAM, R

from scpjax.physics import presets
from scpjax.physics.catalogue import catalogue
from scpjax.physics.model import Model
from scpjax.simulate.simulate import energy_balance, simulate

STEP = 0.05  # s
TIME = np.arange(0, 20, STEP)
VOLTS = np.where(TIME < 12, 8.0, 0.0)[:, None] * np.array([1.0, 0.3])  # agonist, antagonist
JOINT = presets.aaa(PLANT, pulley_radius=0.015)
RECORDING = recorded(TIME, {"voltage_agonist_V": VOLTS[:, 0], "voltage_antagonist_V": VOLTS[:, 1]})
PACE = LAM / C_TH


def joint(law: str, *, conductance: float = LAM, **own: float) -> Model:
    structure = extended(JOINT.structure, "thermal_crosstalk")
    index = catalogue()["thermal_crosstalk"].laws.index(law)
    laws = [float(index) * (m.name == "thermal_crosstalk") for m in structure.mechanisms]
    values = {"newton_cooling.conductance": conductance} | {f"thermal_crosstalk.{k}": v for k, v in own.items()}
    return Model(structure, laws=laws).replace(JOINT.values() | values)


def temperatures(model: Model) -> np.ndarray:
    """Both actuators', then what the mechanism holds itself."""
    mine = [i for i, name in enumerate(model.structure.state_names) if "temperature" in name]
    return np.asarray(simulate(model, RECORDING).states)[:, mine]


def exactly(a: np.ndarray) -> np.ndarray:
    """dz/dt = a z + what the wires heat the first two, from rest, for drives held between samples."""
    z = np.zeros(len(a))
    out = [z]
    for volts in VOLTS[:-1]:
        heated = np.zeros(len(a))
        heated[:2] = volts**2 / R / C_TH
        rest = np.linalg.solve(a, -heated)
        z = rest + scipy.linalg.expm(a * STEP) @ (z - rest)
        out.append(z)
    return np.array(out)


def test_direct_exchange_is_its_equation_and_conserves_heat():
    model = joint("direct", exchange=0.4)
    found = temperatures(model)[:, :2]
    np.testing.assert_allclose(found, exactly(PACE * np.array([[-1.4, 0.4], [0.4, -1.4]])), rtol=1e-9, atol=1e-12)
    balance = energy_balance(model, RECORDING)
    np.testing.assert_allclose(balance["lost"] + balance["stored"], balance["supplied"], rtol=1e-9)
    np.testing.assert_allclose(balance["stored"], C_TH * found[-1].sum(), rtol=1e-2)


@pytest.mark.parametrize(
    ("law", "toward"), [("delayed", [[0.0, 1.0], [1.0, 0.0]]), ("frame", [[0.5, 0.5], [0.5, 0.5]])]
)
def test_exchange_through_what_is_between_is_its_equation(law, toward):
    """The air about each takes on the other's temperature, what both are clamped to (told twice) the mean of both."""
    model = joint(law, exchange=0.4, time_constant=2.0)
    one, toward = np.eye(2), np.array(toward)
    a = np.block([[-1.4 * PACE * one, 0.4 * PACE * one], [toward / 2.0, -one / 2.0]])
    np.testing.assert_allclose(temperatures(model), exactly(a), rtol=1e-9, atol=1e-12)
    balance = energy_balance(model, RECORDING)
    np.testing.assert_allclose(balance["lost"] + balance["stored"], balance["supplied"], rtol=1e-9)
    start = np.asarray(model.initial(temperature=jnp.array([4.0, 1.0])))
    mine = [i for i, name in enumerate(model.structure.state_names) if "temperature" in name]
    np.testing.assert_allclose(start[mine], [4.0, 1.0, *(toward @ [4.0, 1.0])])


def test_a_frame_that_loses_heat_itself_is_one_that_does_not():
    """C_f dT_f/dt = G (T_1 - T_f) + G (T_2 - T_f) - L T_f, taking G (T_i - T_f) from each: with the exchange
    G 2G/(2G + L), the time constant C_f/(2G + L) and the rest of the loss the actuators' own, it is the law frame.
    """
    g, lost, capacity = 0.3 * LAM, 0.2 * LAM, 0.7 * C_TH
    whole = 2 * g + lost
    own = LAM + g * lost / whole
    model = joint("frame", conductance=own, exchange=g * 2 * g / whole / own, time_constant=capacity / whole)
    a = np.array([[-LAM - g, 0, g], [0, -LAM - g, g], [g, g, -whole]]) / np.array([[C_TH], [C_TH], [capacity]])
    np.testing.assert_allclose(temperatures(model)[:, :2], exactly(a)[:, :2], rtol=1e-8, atol=1e-10)


@pytest.mark.parametrize("lean", [1.0, -0.4])
def test_a_plume_warms_one_and_cools_none(lean):
    a = PACE * np.array([[-1.0, 0.4 * (1 - lean)], [0.4 * (1 + lean), -1.0]])
    found = temperatures(joint("plume", exchange=0.4, lean=lean))[:, :2]
    np.testing.assert_allclose(found, exactly(a), rtol=1e-9, atol=1e-12)


def by_scipy(rates) -> np.ndarray:
    """Both temperatures from rest, of ``rates(t, z, volts)``."""
    z = np.zeros(2)
    wanted = [z]
    for i, volts in enumerate(VOLTS[:-1]):
        z = scipy.integrate.solve_ivp(rates, TIME[i : i + 2], z, args=(volts,), rtol=1e-10, atol=1e-12).y[:, -1]
        wanted.append(z)
    return np.array(wanted)


def test_exchange_by_radiation_is_its_equation():
    model = joint("radiation", exchange=0.4)
    room = float(model.ambient)

    def rates(_t, z, volts):
        shone = 0.4 * LAM * ((room + z[1]) ** 4 - (room + z[0]) ** 4) / (4 * room**3)
        return (volts**2 / R - LAM * z + np.array([shone, -shone])) / C_TH

    np.testing.assert_allclose(temperatures(model)[:, :2], by_scipy(rates), rtol=1e-5, atol=1e-6)
    balance = energy_balance(model, RECORDING)
    np.testing.assert_allclose(balance["lost"] + balance["stored"], balance["supplied"], rtol=1e-5)


@pytest.mark.parametrize(("law", "power"), [("free convection", 5 / 4), ("power", 2 / 3)])
def test_a_plume_may_go_with_a_power_of_the_temperature(law, power):
    def rates(_t, z, volts):
        carried = z * (np.hypot(z, 1.0) / 50.0) ** (power - 1)
        return (volts**2 / R - LAM * z + 0.4 * LAM * np.array([0.3 * carried[1], 1.7 * carried[0]])) / C_TH

    own = {"exponent": power} if law == "power" else {}
    found = temperatures(joint(law, exchange=0.4, lean=0.7, **own))[:, :2]
    np.testing.assert_allclose(found, by_scipy(rates), rtol=1e-5, atol=1e-6)
