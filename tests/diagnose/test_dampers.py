"""A damper with a small hole, of which an actuator feels hundreds of times its own damping: learned as what it is."""

import numpy as np
import pytest
from scipy.integrate import solve_ivp

from scpjax.diagnose.closure import learn
from scpjax.diagnose.diagnose import _base
from scpjax.diagnose.evidence import Evidence
from scpjax.diagnose.remainder import AT_NOISE, level
from scpjax.fit.setup import prepare
from scpjax.recordings import Metadata, Recording

R, LAM, C_TH, C, K, DAMPING, M, ORIFICE = 1.2, 0.15, 1.0, 0.03, 150.0, 8.0, 0.3, 3e5  # N s^2/m^2
NOISE_MM, NOISE_K, PERIOD = 0.02, 0.05, 0.1


def recording(seed: int) -> Recording:
    rng = np.random.default_rng(seed)
    volts = np.repeat(rng.choice([0.0, 1.5, 2.5, 3.3], size=40), 20)
    volts[:20] = 0.0

    def rates(_t, s, power):
        warm, x, v = s
        force = C * warm - K * x - DAMPING * v - ORIFICE * v * abs(v)
        return [(power - LAM * warm) / C_TH, v, force / M]

    states, z = [], np.zeros(3)
    for v in volts:
        states.append(z)
        z = solve_ivp(rates, (0, PERIOD), z, "Radau", args=(v**2 / R,), rtol=1e-8, atol=1e-11).y[:, -1]
    warm, x = np.array(states)[:, :2].T
    columns = {
        "temperature_degC": 22.0 + warm + NOISE_K * rng.standard_normal(len(x)),
        "displacement_mm": 1e3 * x + NOISE_MM * rng.standard_normal(len(x)),
    }
    meta = Metadata(name=f"steps_{seed}", known=(("resistance_ohm", R), ("moving_mass_kg", M)), ambient_K=295.15)
    return Recording.from_arrays(PERIOD * np.arange(len(x)), {"voltage_V": volts}, columns, metadata=meta)


def test_a_damper_that_goes_with_the_square_of_the_velocity_is_found():
    parts, base, _ = _base(prepare([recording(seed) for seed in (1, 2)]))
    assert level(base, parts) > 3.0
    learned = learn(base, parts, Evidence())
    assert learned is not None
    assert learned.terms == ("learned_force.v_speed",)
    assert level(learned.state, parts) < AT_NOISE
    values = learned.state.setup.structure
    of = lambda key: learned.state.values[values.index[key]]  # noqa: E731
    square = of("learned_force.v_speed") * of("learned_force.reference") / of("learned_force.velocity_scale") ** 2
    # so slowly it moves that only the ratios of its forces are told, and by steps of a sample it is felt a step ahead
    assert square == pytest.approx(ORIFICE / K, rel=0.05)
