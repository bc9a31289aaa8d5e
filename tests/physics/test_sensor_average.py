"""A sensor that averages reads the mean over its window: of a slow signal to within its approximation."""

import numpy as np
import pytest

from scpjax.physics import presets
from scpjax.physics.catalogue import catalogue
from scpjax.physics.model import Model

WINDOW = 3.0  # s
PLANT = presets.plant(
    resistance=10.0, conductance=0.2, thermal_mass=1.5, coefficient=0.02, stiffness=180.0, damping=5.0, mass=0.2
)


def transfer(law: str, p: complex) -> complex:
    """From what is read to the reading, at a complex frequency [1/s], of the mechanism's own linear states."""
    structure = PLANT.structure.with_mechanisms(catalogue()["sensor_lag"])
    lag = structure.mechanism("sensor_lag")
    laws = [float(lag.laws.index(law)) if m is lag else 0.0 for m in structure.mechanisms]
    model = Model(structure, laws=laws, ambient=PLANT.ambient).replace(
        PLANT.values() | {"sensor_lag.time_constant": WINDOW / 2, "sensor_lag.share": 1.0}
    )
    names = structure.state_names
    mine = [i for i, n in enumerate(names) if n.startswith("sensor_lag")]
    source, output = ("displacement", 1) if "displacement" in law else ("temperature", 0)
    at = names.index(source)
    rates = lambda z: np.asarray(model.rates(z, np.zeros(1)))[mine]  # noqa: E731
    read = lambda z: float(np.asarray(model.observe(z, np.zeros(1)))[output])  # noqa: E731
    eye, zero = np.eye(len(names)), np.zeros(len(names))
    a = np.stack([rates(eye[i]) - rates(zero) for i in mine], axis=1)
    b = rates(eye[at]) - rates(zero)
    c, d = np.array([read(eye[i]) - read(zero) for i in mine]), read(eye[at]) - read(zero)
    return complex(c @ np.linalg.solve(p * np.eye(len(mine)) - a, b) + d)


@pytest.mark.parametrize("law", ["average", "displacement average"])
@pytest.mark.parametrize(("turns", "close"), [(0.1, 1e-7), (0.3, 1e-4), (0.7, 0.02)])
def test_it_is_the_mean_over_its_window(law, turns, close):
    """At a frequency of so many turns in the window."""
    p = 2j * np.pi * turns / WINDOW
    mean = (1 - np.exp(-p * WINDOW)) / (p * WINDOW)
    assert abs(transfer(law, p) - mean) < close


def test_a_thermometer_alone_is_read_late_by_its_other_laws():
    p = 2j * np.pi * 0.2 / WINDOW
    assert transfer("first order", p) == pytest.approx(1 / (1 + p * WINDOW / 2), rel=1e-6)
    assert transfer("two in series", p) == pytest.approx(1 / (1 + p * WINDOW / 2) ** 2, rel=1e-6)
