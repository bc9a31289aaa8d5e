"""A learned reaction takes its heat once, against a closed form at a steady temperature and scipy's own integration."""

import numpy as np
import scipy.integrate

from scpjax.physics import presets
from scpjax.physics.catalogue import catalogue
from scpjax.physics.model import Model
from scpjax.recordings.recording import Recording
from scpjax.simulate.simulate import Exponential, simulate

CONDUCTANCE, THERMAL_MASS, GAIN = 0.2, 1.5, 0.1
TE = presets.te(resistance=1 / GAIN, conductance=CONDUCTANCE, thermal_mass=THERMAL_MASS)
HEAT, TAU, STEEP, T_REF, T_TIME = 0.02, 20.0, 3.0, 40.0, 100.0
BOUND = HEAT * CONDUCTANCE * T_REF * T_TIME  # J


def model(heat: float = HEAT) -> Model:
    structure = TE.structure.with_mechanisms(catalogue()["learned_reaction"])
    own = {
        "heat": heat,
        "time": TAU,
        "acceleration": STEEP,
        "reference_temperature": T_REF,
        "reference_time": T_TIME,
    }
    return Model(structure, ambient=TE.ambient).replace(
        TE.values() | {f"learned_reaction.{k}": v for k, v in own.items()}
    )


def test_all_of_its_heat_is_taken_once():
    """Followed by scipy at the model's own rates: the energy that has gone beside the losses is that which was bound
    and is used up, and what is left falls as the exponential of its integrated rate."""
    m, effort = model(), np.array([90.0])
    z0 = np.array([0.0, 1.0])
    rates = lambda t, z: [*np.asarray(m.rates(z[:2], effort)), np.exp(STEEP * (z[0] / T_REF - 1)) / TAU, z[0]]  # noqa: E731
    found = scipy.integrate.solve_ivp(rates, (0.0, 60.0), [*z0, 0.0, 0.0], rtol=1e-10, atol=1e-12)
    temperature, left, rated, warm = found.y[:, -1]
    assert 0.001 < left < 0.9
    np.testing.assert_allclose(left, np.exp(-rated), rtol=1e-6)
    taken = GAIN * 90.0 * 60.0 - CONDUCTANCE * warm - THERMAL_MASS * temperature
    np.testing.assert_allclose(taken, BOUND * (1 - left), rtol=1e-5)


def test_a_reaction_may_give_heat():
    z, effort = np.array([25.0, 0.6]), np.array([0.0])
    rate = np.exp(STEEP * (25.0 / T_REF - 1)) / TAU
    for heat in (HEAT, -HEAT):
        more = np.asarray(model(heat).rates(z, effort)) - np.asarray(model(0.0).rates(z, effort))
        expected = -heat * CONDUCTANCE * T_REF * T_TIME * rate * 0.6 / THERMAL_MASS
        np.testing.assert_allclose(more, [expected, 0.0], rtol=1e-12)


def test_far_above_its_reference_it_is_used_up_and_no_more():
    """In steps of a sample, at the rate that it is kept to: nothing of it is left, and nothing less."""
    time = np.arange(0.0, 120.0, 0.1)
    volts = np.sqrt(np.where(time < 60, 2.5, 0.5) * CONDUCTANCE * T_REF / GAIN)
    hot = Recording.from_arrays(time, {"voltage_V": volts}, {"temperature_degC": np.zeros_like(time)})
    states = np.asarray(simulate(model(), hot, method=Exponential(order=2)).states)
    temperature, left = states.T
    assert temperature.max() > 2 * T_REF
    assert np.all(np.diff(left) <= 1e-12)
    assert 0.0 <= left[-1] < 1e-3
