"""A joint whose cables only pull, against its equation integrated by scipy."""

import numpy as np
import scipy.integrate
from sim_cases import PLANT, extended, recorded
from written_out import BETA, C_TH, LAM, PULL, K, R

from scpjax.physics import presets
from scpjax.physics.catalogue import catalogue
from scpjax.physics.model import Model
from scpjax.simulate.simulate import Exponential, simulate

RADIUS, REFERENCE, GAP = 0.015, 0.0025, 0.15
TIME = np.arange(0, 20, 0.05)
TURNS = (TIME // 4).astype(int) % 2  # the agonist is heated, then the other one
VOLTS = np.stack([8.0 * (TURNS == 0), 8.0 * (TURNS == 1)], axis=1)
JOINT = presets.aaa(PLANT, pulley_radius=RADIUS)


def test_cables_only_pull():
    structure = extended(JOINT.structure, "slack")
    index = catalogue()["slack"].laws.index("cables")
    laws = [float(index) * (m.name == "slack") for m in structure.mechanisms]
    model = Model(structure, laws=laws).replace(JOINT.values() | {"slack.gap": GAP, "slack.reference": REFERENCE})
    recording = recorded(TIME, {"voltage_agonist_V": VOLTS[:, 0], "voltage_antagonist_V": VOLTS[:, 1]})
    found = simulate(model, recording, method=Exponential(substeps=16))
    names = structure.state_names
    mine = [names.index(n) for n in ("displacement", "velocity")]
    mass = float(model.balances().moving_mass)
    gap, width = GAP * REFERENCE, 0.02 * K * GAP * REFERENCE

    def rates(_t, z, volts):
        t, x, v = z[:2], z[2], z[3]
        beyond = PULL * t - K * (np.array([x, -x]) + gap)
        taut = (beyond + np.hypot(beyond, width)) / 2
        return [*((volts**2 / R - LAM * t) / C_TH), v, (taut[0] - taut[1] - 2 * BETA * v) / mass]

    z, wanted = np.zeros(4), [np.zeros(4)]
    for i, volts in enumerate(VOLTS[:-1]):
        z = scipy.integrate.solve_ivp(rates, TIME[i : i + 2], z, args=(volts,), rtol=1e-9, atol=1e-12).y[:, -1]
        wanted.append(z)
    x = np.array(wanted)[:, 2]
    assert np.ptp(x) > 2 * gap
    np.testing.assert_allclose(np.asarray(found.states)[:, mine[0]], x, atol=2e-3 * np.ptp(x))
