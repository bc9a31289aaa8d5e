"""A mass that is carried along on a soft tendon: its period is found, told in its units, and not imagined."""

import numpy as np
import pytest
import scipy.integrate
from diagnose.creeping import AMBIENT, BASE
from diagnose.heated import base_of, lacking_in, recorded

from scpjax.diagnose.answer import answer
from scpjax.diagnose.beyond import closure
from scpjax.diagnose.choice import Choice
from scpjax.diagnose.evidence import Evidence
from scpjax.diagnose.mode import Mode, carried_along, likeliest_periods
from scpjax.diagnose.patience import Patience
from scpjax.diagnose.remainder import AT_NOISE, level
from scpjax.recordings import excitation
from scpjax.recordings.recording import Metadata, Recording
from scpjax.report.missing import learned as card

GAIN, LOSS, THERMAL_MASS = (
    BASE[k] for k in ("joule_heating.gain", "newton_cooling.conductance", "newton_cooling.thermal_mass")
)
PULL, STIFFNESS = BASE["thermal_actuation.coefficient"], BASE["elastic_spring.stiffness"]
DAMPING, MASS = BASE["viscous_damping.damping"], BASE["inertia.mass"]
PERIOD, ZETA, SHARE, SECOND = 4.3, 0.06, 0.3, 0.05  # [s], [1], [1], [kg]
OMEGA, NOISE = 2 * np.pi / PERIOD, 0.01  # [rad/s], [mm]


def carrying(seed: int, second: float = SECOND, share: float = SHARE) -> Recording:
    """By scipy: what the actuator lifts carries another mass on a tendon, whose place is read in part."""
    time, drive = excitation.multilevel_random(duration_s=120, period_s=0.1, hold_s=6, low=0, high=4, seed=seed)
    z, path = np.zeros(5), [np.zeros(5)]
    for i, gap in enumerate(np.diff(time)):

        def rates(t, z, i=i):
            temperature, x, v, q, swing = z
            between = OMEGA**2 * (x - q) + 2 * ZETA * OMEGA * (v - swing)  # m/s2
            force = PULL * temperature - STIFFNESS * x - DAMPING * v - second * between
            heat = GAIN * drive[i] ** 2 - LOSS * temperature
            return [heat / THERMAL_MASS, v, force / MASS, swing, between]

        z = scipy.integrate.solve_ivp(rates, (0.0, gap), z, rtol=1e-8, atol=1e-11).y[:, -1]
        path.append(z)
    x, q = np.array(path)[:, 1], np.array(path)[:, 3]
    read = 1e3 * (x + share * (q - x)) + NOISE * np.random.default_rng(seed).standard_normal(len(time))
    known = (("resistance_ohm", 1 / GAIN), ("moving_mass_kg", MASS))
    meta = Metadata(name=f"carrying {seed}", known=known, ambient_K=AMBIENT, model="plant")
    return Recording.from_arrays(time, {"voltage_V": drive}, {"displacement_mm": read}, metadata=meta)


@pytest.fixture(scope="module")
def swinging():
    return base_of(carrying(3), carrying(4))


def test_its_period_is_among_the_likeliest(swinging):
    periods = likeliest_periods(*swinging)
    assert min(abs(np.log(p / PERIOD)) for p in periods[:2]) < 0.1


def test_it_is_learned_in_its_units_and_placed_in_the_force_balance(swinging):
    base, parts = swinging
    assert level(base, parts) > 3.0
    learned = closure(base, parts, Evidence())
    assert isinstance(learned, Mode)
    assert level(learned.state, parts) < AT_NOISE
    binned, lacking = lacking_in(base, parts)
    nothing = Choice(base, (), {}, {})
    said = answer(parts, base, nothing, learned, binned, lacking, notes=(), patience=Patience(), settings={})
    assert (said.verdict, said.location.subsystem) == ("unexplained", "thermomechanical")
    found = said.closure
    assert found is not None
    stiffness, share, period, damping = found.terms.values()
    for of, true in ((share, SHARE), (period, PERIOD), (damping, ZETA)):
        assert of.value == pytest.approx(true, abs=4 * of.std)
        assert of.std < 0.2 * true
    assert stiffness.value * STIFFNESS == pytest.approx(SECOND * OMEGA**2, abs=4 * stiffness.std * STIFFNESS)
    assert " N/m (x - q" in found.expression
    assert f"something that swings along, with a period of {period.value:.3g} ± " in said.says
    assert found.expression not in said.says
    drawn = found.curve
    assert drawn is not None
    assert (drawn.variable, drawn.at_unit) == ("frequency", "Hz")
    r = drawn.at * PERIOD
    true = np.abs((1 + 2j * ZETA * r) / (1 - r**2 + 2j * ZETA * r))
    assert np.all(np.abs(drawn.value - true) < 5 * drawn.std + 1e-9 * true)
    shapes: dict[str, bytes] = {}
    assert "as a mass on a spring of its own does" in card(said, shapes)
    assert "closure" in shapes


@pytest.mark.parametrize(
    "still",
    [
        lambda: base_of(carrying(3, second=0.0, share=0.0)),
        lambda: base_of(recorded(lambda t, temperature, x: 0.5 * LOSS * abs(temperature / 40) ** 0.6 * temperature)),
    ],
    ids=["nothing", "a loss"],
)
def test_where_nothing_swings_none_is_learned(still):
    base, parts = still()
    assert carried_along(base, parts, Evidence()) is None


def test_of_a_temperature_there_is_none():
    time, drive = excitation.multilevel_random(duration_s=60, period_s=0.1, hold_s=6, low=0, high=4, seed=1)
    warm = [20.0]
    for u in drive[:-1]:
        warm.append(warm[-1] + 0.1 * (GAIN * u**2 - LOSS * (warm[-1] - 20.0)) / THERMAL_MASS)
    read = np.array(warm) + 0.1 * np.random.default_rng(1).standard_normal(len(time))
    meta = Metadata(name="warm", known=(("resistance_ohm", 1 / GAIN),), ambient_K=293.15, model="te")
    base, parts = base_of(Recording.from_arrays(time, {"voltage_V": drive}, {"temperature_degC": read}, metadata=meta))
    assert carried_along(base, parts, Evidence()) is None
