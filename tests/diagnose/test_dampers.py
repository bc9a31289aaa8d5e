"""Dampers that an actuator feels hundreds of times its own damping by, which no catalogue has: a grease that thins as
it warms (of much creep beside a stiff spring only a dashpot is left, which is no creep), and one with a small hole.
"""

from dataclasses import replace

import numpy as np
import pytest
from scipy.integrate import solve_ivp

from scpjax.diagnose import doubtful
from scpjax.diagnose.closure import learn
from scpjax.diagnose.curve import bend
from scpjax.diagnose.diagnose import _base
from scpjax.diagnose.doubtful import asking_for_more
from scpjax.diagnose.evidence import Evidence
from scpjax.diagnose.hypothesis import State, trial_at
from scpjax.diagnose.remainder import AT_NOISE, level
from scpjax.diagnose.rivals import by_law
from scpjax.diagnose.trials import afresh
from scpjax.fit.setup import prepare
from scpjax.physics.catalogue import mechanism
from scpjax.physics.curves import Form, basis
from scpjax.physics.mechanisms.creep import MOST_CREPT
from scpjax.recordings import Metadata, Recording

NOISE_MM, NOISE_K, PERIOD = 0.01, 0.05, 0.1
R, LAM, C_TH, C, K, M = 1.2, 0.15, 1.0, 0.03, 150.0, 0.3
ORIFICE = 3e5  # N s^2/m^2


def recording(
    seed: int, *, cold: float = 8.0, thins: float = np.inf, creeps: float = 0.0, orifice: float = 0.0
) -> Recording:
    """Steps; the damping is cold exp(-T/thins) N s/m and orifice |v|, or 8 and the spring gives way by ``creeps``
    times, 6 s late.
    """
    rng = np.random.default_rng(seed)
    volts = np.repeat(rng.choice([0.0, 1.5, 2.5, 3.3], size=40), 20)
    volts[:20] = 0.0

    def rates(_t, s, power):
        warm, x, v, late = s
        damping = 8.0 if creeps else cold * np.exp(-warm / thins) + orifice * abs(v)
        force = C * warm - K * (x - late) - damping * v
        return [(power - LAM * warm) / C_TH, v, force / M, (creeps * (x - late) - late) / 6.0]

    states, z = [], np.zeros(4)
    for v in volts:
        states.append(z)
        z = solve_ivp(rates, (0, PERIOD), z, "LSODA", args=(v**2 / R,), rtol=1e-8, atol=1e-11).y[:, -1]
    warm, x = np.array(states)[:, :2].T
    columns = {
        "temperature_degC": 22.0 + warm + NOISE_K * rng.standard_normal(len(x)),
        "displacement_mm": 1e3 * x + NOISE_MM * rng.standard_normal(len(x)),
    }
    meta = Metadata(name=f"steps_{seed}", known=(("resistance_ohm", R), ("moving_mass_kg", M)), ambient_K=295.15)
    return Recording.from_arrays(PERIOD * np.arange(len(x)), {"voltage_V": volts}, columns, metadata=meta)


@pytest.mark.parametrize(("effect", "is_creep"), [({"thins": 20.0, "cold": 1200.0}, False), ({"creeps": 1.5}, True)])
def test_creep_beyond_what_a_polymer_does_is_something_else(monkeypatch, effect, is_creep):
    """Law thermal would explain the grease with ten times the immediate displacement or more."""
    given = [recording(seed, **effect) for seed in (1, 2)]
    parts, base, _ = _base(prepare(given))
    assert level(base, parts) > 5.0
    found = by_law(base, "creep", parts, close=np.inf).values()
    best = min((afresh(s, parts) for s in found if s.laws["creep"] in ("one branch", "thermal")), key=lambda s: s.cost)
    compliance = best.values[best.setup.structure.where["creep.compliance"]][0]
    assert compliance == pytest.approx(1.5, rel=0.1) if is_creep else 0.75 * MOST_CREPT < compliance < MOST_CREPT
    assert (level(best, parts) < AT_NOISE) == is_creep
    assert asking_for_more(best, parts) == {}
    monkeypatch.setattr(doubtful, "held_back", lambda *_: ("creep.compliance",))  # as where both ends are determined
    assert asking_for_more(standing_at(best, MOST_CREPT), parts) == {"creep": ("compliance",)}
    assert asking_for_more(standing_at(best, LEAST), parts) == {}


LEAST = next(p.bounds[0] for p in mechanism("creep").parameters if p.name == "compliance")


def standing_at(state: State, compliance: float) -> State:
    """The hypothesis with another compliance of creep."""
    value = state.values
    value[state.setup.structure.where["creep.compliance"]] = compliance
    return replace(state, trial=trial_at(state.setup, value, np.asarray(state.trial.laws)))


def test_grease_is_learned_as_a_damping_that_goes_with_the_temperature():
    """c(T) = 1200 exp(-T/20 K) N s/m, of which a whole step is a hundred times what stops the load."""
    given = [recording(seed, cold=1200.0, thins=20.0) for seed in (1, 2)]
    parts, base, _ = _base(prepare(given))
    curve = bend(base, parts, Evidence(), ("thermomechanical",))
    assert curve is not None
    assert curve.form == Form("velocity", "temperature")
    assert level(curve.state, parts) < AT_NOISE
    of = lambda key: curve.state.values[curve.state.setup.structure.index[key]]  # noqa: E731
    at = np.array([20.0, 35.0])
    pieces = basis((at - curve.ends[0]) / np.ptp(curve.ends), curve.zero, curve.pieces)
    scale = curve.reference("displacement_high") / curve.reference("velocity_high")
    thinner = scale * pieces @ [of(k) for k in curve.keys]
    # so slowly it moves that only the ratios of its forces are told
    damping = of("viscous_damping.damping") / of("elastic_spring.stiffness") + thinner
    np.testing.assert_allclose(damping, 1200.0 * np.exp(-at / 20.0) / K, rtol=0.1)


def test_a_damper_that_goes_with_the_square_of_the_velocity_is_found():
    parts, base, _ = _base(prepare([recording(seed, orifice=ORIFICE) for seed in (1, 2)]))
    assert level(base, parts) > 3.0
    learned = learn(base, parts, Evidence())
    assert learned is not None
    assert learned.terms == ("learned_force.v_speed",)
    assert level(learned.state, parts) < AT_NOISE
    of = lambda key: learned.state.values[learned.state.setup.structure.index[key]]  # noqa: E731
    square = of("learned_force.v_speed") * of("learned_force.reference") / of("learned_force.velocity_scale") ** 2
    # so slowly it moves that only the ratios of its forces are told, and by steps of a sample it is felt a step ahead
    assert square == pytest.approx(ORIFICE / K, rel=0.05)
