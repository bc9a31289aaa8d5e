"""Mechanisms beside one another: what warmth pulls is weakened and taken up as a whole, what the spring answers too."""

import numpy as np
import pytest

from scpjax.physics.catalogue import mechanism
from scpjax.physics.model import Model
from scpjax.physics.presets import structure

BASE = {
    "joule_heating.gain": 0.8,
    "newton_cooling.conductance": 0.08,
    "newton_cooling.thermal_mass": 1.2,
    "thermal_actuation.coefficient": 0.03,
    "elastic_spring.stiffness": 200.0,
    "viscous_damping.damping": 4.0,
}
CURVED = {"nonlinear_thermal_force.growth": 0.5}
WEARY = {"fatigue.loss": 0.8, "fatigue.most": 0.6}
BEHIND = {"hysteresis.strength": 0.2, "hysteresis.width": 0.3}
SOFT = {"thermal_softening.softening": 0.4}
STIFFER = {"nonlinear_stiffness.quadratic": 0.3, "nonlinear_stiffness.cubic": 0.2}
SLACK = {"slack.gap": 0.3}
OWN = {"fatigue": [0.7], "hysteresis": [0.5, 0.4, -0.2, 0.1]}  # states, away from where they begin
LAWS = {"slack": "pull", "hysteresis": "thermal plays"}


def force(*parts: dict[str, float], temperature: float = 40.0, x: float = 0.003, **laws: str) -> float:
    """Net force [N] at rest, of a plant in which there are some mechanisms."""
    values = {key: value for part in parts for key, value in part.items()}
    names = list(dict.fromkeys(key.split(".")[0] for key in values))
    built = structure("plant").with_mechanisms(*(mechanism(n) for n in names))
    model = Model(built, laws=[m.laws.index((LAWS | laws).get(m.name, m.laws[0])) for m in built.mechanisms])
    model = model.replace({**BASE, **values})
    own = [z for n in names for z in OWN.get(n, [0.0] * len(mechanism(n).states))]
    balances = model.balances()
    z = np.array([temperature, x, 0.0, *own, *([0.0] if built.timed else [])])
    return float(balances.rates(z, np.array([4.0]))[2]) * float(balances.moving_mass)


@pytest.mark.parametrize(
    ("part", "laws"),
    [(CURVED, {}), (BEHIND, {}), (CURVED | BEHIND, {}), (BEHIND, {"hysteresis": "thermal Preisach"})],
)
def test_fatigue_weakens_all_that_warmth_pulls(part, laws):
    left = force(WEARY, x=0.0) / force(x=0.0)
    assert 0.3 < left < 0.9
    whole = force(part, x=0.0, **laws)
    assert abs(whole / force(x=0.0) - 1.0) > 0.01
    assert force(part, WEARY, x=0.0, **laws) == pytest.approx(left * whole, rel=1e-12)
    assert force(WEARY, part, x=0.0, **laws) == pytest.approx(left * whole, rel=1e-12)


def test_fatigue_weakens_no_element_that_the_displacement_moves():
    element = force(BEHIND, x=0.0, hysteresis="plays") - force(x=0.0)
    assert force(BEHIND, WEARY, x=0.0, hysteresis="plays") == pytest.approx(force(WEARY, x=0.0) + element, rel=1e-12)


@pytest.mark.parametrize("law", mechanism("thermal_softening").laws)
def test_softening_softens_all_with_which_the_spring_answers(law):
    cold = {"temperature": 0.0}
    left = (force(SOFT, thermal_softening=law) - force(x=0.0)) / (force() - force(x=0.0))
    assert left < 0.95
    stiffer = force(STIFFER, **cold)
    assert stiffer / force(**cold) > 1.01
    both = force(SOFT, STIFFER, thermal_softening=law) - force(x=0.0)
    assert both == pytest.approx(left * stiffer, rel=1e-12)


def test_slack_takes_up_what_all_others_let_warmth_pull():
    """Far beyond its corner it takes the same from whatever pulls, short of it all."""
    taken = force(x=0.0, temperature=80.0) - force(SLACK, x=0.0, temperature=80.0)
    assert taken == pytest.approx(0.3 * 0.01 * 200.0, rel=1e-2)
    pulled = force(CURVED, WEARY, x=0.0, temperature=80.0)
    assert force(SLACK, CURVED, WEARY, x=0.0, temperature=80.0) == pytest.approx(pulled - taken, rel=1e-2)
    assert abs(force(SLACK, WEARY, x=0.0, temperature=15.0)) < 0.02 * force(WEARY, x=0.0, temperature=15.0)
