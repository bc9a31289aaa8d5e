"""A learned mode is a second mass on a spring and a damper: against the two equations of motion in scipy's hands."""

import numpy as np
import pytest
import scipy.integrate
import scipy.linalg
from loaded import COEFFICIENT, CONDUCTANCE, DAMPING, GAIN, MASS, PLANT, STIFFNESS, THERMAL_MASS

from scpjax.physics import presets
from scpjax.physics.catalogue import catalogue
from scpjax.physics.model import Model
from scpjax.recordings.recording import Recording
from scpjax.simulate.simulate import Exponential, simulate

SECOND, PERIOD, ZETA, SHARE = 0.4, 2.5, 0.07, 0.6  # [kg], [s], [1], [1]
OMEGA = 2 * np.pi / PERIOD


def model(base: Model = PLANT, share: float = SHARE, second: float = SECOND) -> Model:
    own = {"stiffness": second * OMEGA**2 / STIFFNESS, "share": share, "period": PERIOD, "damping": ZETA}
    structure = base.structure.with_mechanisms(catalogue()["learned_mode"])
    return Model(structure, ambient=base.ambient).replace(
        base.values() | {f"learned_mode.{k}": v for k, v in own.items()}
    )


def two_masses(effort: float):
    """d/dt of (T, x, v, q, q') of an actuator that carries a mass on a spring and a damper."""

    def rates(_t, z):
        temperature, x, v, q, swing = z
        between = SECOND * (OMEGA**2 * (x - q) + 2 * ZETA * OMEGA * (v - swing))  # N, on the second
        own = COEFFICIENT * temperature - STIFFNESS * x - DAMPING * v
        heat = GAIN * effort - CONDUCTANCE * temperature
        return [heat / THERMAL_MASS, v, (own - between) / MASS, swing, between / SECOND]

    return rates


def test_it_is_a_second_mass():
    time = np.arange(0.0, 30.0, 0.05)
    volts = np.where(time < 9.0, 3.0, np.where(time < 17.0, 0.0, 2.0))
    still = Recording.from_arrays(
        time, {"voltage_V": volts}, {"displacement_mm": np.zeros_like(time)}
    )  # only its drive is looked at
    read = np.asarray(simulate(model(), still, method=Exponential(order=2)).outputs)[:, -1]
    z, there = np.zeros(5), [np.zeros(5)]
    for i, gap in enumerate(np.diff(time)):
        z = scipy.integrate.solve_ivp(two_masses(volts[i] ** 2), (0.0, gap), z, rtol=1e-9, atol=1e-12).y[:, -1]
        there.append(z)
    x, q = np.array(there)[:, 1], np.array(there)[:, 3]
    assert np.std(q - x) > 0.1 * np.std(x)  # it does swing
    np.testing.assert_allclose(read, x + SHARE * (q - x), atol=1e-6 * np.ptp(x))


def test_its_swing_is_a_mode_of_the_model():
    """Eigenvalues of the linearised model are those of the two equations of motion."""
    a, _ = (np.asarray(m) for m in model().linearise())
    columns = [(np.array(two_masses(0.0)(0.0, e)) - np.array(two_masses(0.0)(0.0, np.zeros(5)))) for e in np.eye(5)]
    ours, theirs = (np.sort_complex(scipy.linalg.eigvals(m)) for m in (a, np.array(columns).T))
    np.testing.assert_allclose(ours, theirs, rtol=1e-8, atol=1e-10)


def test_without_weights_nothing_changes():
    z, effort = np.array([30.0, 2e-3, 1e-3, 4e-3, -2e-3]), np.array([20.0])
    none = model(share=0.0, second=0.0)
    np.testing.assert_array_equal(np.asarray(none.rates(z, effort))[:3], np.asarray(PLANT.rates(z[:3], effort)))
    np.testing.assert_array_equal(none.observe(z, effort), PLANT.observe(z[:3], effort))


def test_of_a_joint_both_sides_swing_as_one():
    """Masses that lag by as much on both sides, one up and one down, turn it together, and are read together."""
    joint = presets.aaa(PLANT, pulley_radius=0.01)
    swings = model(joint)
    names, effort = list(swings.structure.state_names), np.zeros(2)
    mine = [i for i, n in enumerate(names) if n.startswith("learned_mode.place")]
    turning = next(i for i, n in enumerate(names) if "velocity" in n and "learned" not in n)
    angle = list(swings.structure.outputs).index("angle")

    def of(*places: float) -> tuple[float, float]:
        z = np.zeros(len(names))
        z[mine] = places
        return float(np.asarray(swings.rates(z, effort))[turning]), float(np.asarray(swings.observe(z, effort))[angle])

    together, alone = of(1e-3, -1e-3), of(1e-3, 0.0)
    assert together[0] > 0.0
    assert together[0] == pytest.approx(2 * alone[0], rel=1e-9)
    assert together[1] == pytest.approx(SHARE * 1e-3 / 0.01, rel=1e-9)
