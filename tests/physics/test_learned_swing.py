"""A learned swing adds what its law says to its balance, and to no other."""

import numpy as np
import pytest

from scpjax.physics import presets
from scpjax.physics.catalogue import catalogue
from scpjax.physics.known import known_model
from scpjax.physics.mechanisms.learned_swing import FORMS, HARMONICS, law_of
from scpjax.physics.model import Model

CONDUCTANCE, THERMAL_MASS, STIFFNESS, MASS, GAIN = 0.2, 1.5, 180.0, 0.2, 0.1
PLANT = presets.plant(
    resistance=1 / GAIN,
    conductance=CONDUCTANCE,
    thermal_mass=THERMAL_MASS,
    coefficient=0.02,
    stiffness=STIFFNESS,
    damping=5.0,
    mass=MASS,
)
PERIOD, PITCH, T_REF, X_REF = 7.0, 1.7e-3, 40.0, 5e-3
WEIGHTS = {"cos1": 0.1, "sin1": -0.2, "cos2": 0.05, "sin2": 0.07, "sin4": 0.3}
TEMPERATURE, DISPLACEMENT, EFFORT, TIME = 30.0, 1e-3, 50.0, 2.3  # [K], [m], [V^2], [s]


def model(law: float, weights: dict[str, float]) -> Model:
    structure = PLANT.structure.with_mechanisms(catalogue()["learned_swing"])
    own = {"period": PERIOD, "pitch": PITCH, "reference_temperature": T_REF, "reference": X_REF, **weights}
    laws = [law if m.name == "learned_swing" else 0.0 for m in structure.mechanisms]
    values = PLANT.values() | {f"learned_swing.{k}": v for k, v in own.items()}
    return Model(structure, laws=laws, ambient=PLANT.ambient).replace(values)


@pytest.mark.parametrize("harmonics", HARMONICS)
@pytest.mark.parametrize("form", FORMS, ids=lambda f: f"{f.what} {f.name}")
def test_it_adds_its_term(form, harmonics):
    weights = {w: v for w, v in WEIGHTS.items() if int(w[3:]) <= harmonics}
    swings, still = (model(law_of(form, harmonics), w) for w in (weights, {}))
    z = np.array([TEMPERATURE, DISPLACEMENT, 2e-3, TIME])
    effort = np.array([EFFORT])
    more_rates, more_read = (np.asarray(getattr(swings, f)(z, effort) - getattr(still, f)(z, effort))
                             for f in ("rates", "observe"))  # fmt: skip
    wave = {"cos": np.cos, "sin": np.sin}
    turns = TIME / PERIOD if form.variable == "time" else DISPLACEMENT / PITCH
    s = sum(v * wave[w[:3]](2 * np.pi * int(w[3:]) * turns) for w, v in weights.items())
    f = TEMPERATURE / T_REF if form.factor else 1.0
    rates, read = np.zeros(4), np.zeros(2)
    if form.what == "drive":
        rates[0] = GAIN * EFFORT * s / THERMAL_MASS
    elif form.what == "heat":
        rates[0] = -CONDUCTANCE * T_REF * f * s / THERMAL_MASS
    elif form.what == "force":
        rates[2] = -STIFFNESS * X_REF * f * s / MASS
    else:
        read[0 if form.what == "temperature reading" else 1] = (T_REF if "temp" in form.what else X_REF) * f * s
    np.testing.assert_allclose(more_rates, rates, rtol=1e-9, atol=1e-12)
    np.testing.assert_allclose(more_read, read, rtol=1e-9, atol=1e-12)


@pytest.mark.parametrize("form", [f for f in FORMS if f.what == "force" and not f.factor], ids=lambda f: f.variable)
def test_a_force_on_a_joint_does_not_cancel(form):
    joint = known_model("aaa")
    structure = joint.structure.with_mechanisms(catalogue()["learned_swing"])
    own = {"period": PERIOD, "pitch": PITCH, "reference_temperature": T_REF, "reference": X_REF, "cos1": 0.1}
    laws = [law_of(form, 1) if m.name == "learned_swing" else 0.0 for m in structure.mechanisms]
    swings = Model(structure, laws=laws, ambient=joint.ambient).replace(
        joint.values() | {f"learned_swing.{k}": v for k, v in own.items()}
    )
    still = swings.replace({"learned_swing.cos1": 0.0})
    z = np.zeros(structure.n_states)
    z[structure.state_names.index("displacement")] = DISPLACEMENT
    more = np.asarray(swings.rates(z, np.zeros(2)) - still.rates(z, np.zeros(2)))
    angle = 2 * np.pi * (DISPLACEMENT / PITCH if form.variable == "displacement" else 0.0)
    force = -joint.values()["elastic_spring.stiffness"] * X_REF * 0.1 * np.cos(angle)
    expected = np.zeros(structure.n_states)
    expected[structure.state_names.index("velocity")] = force / float(swings.balances().moving_mass)
    np.testing.assert_allclose(more, expected, rtol=1e-9, atol=1e-12)
