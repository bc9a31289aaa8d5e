"""What a fit may move, and what it leaves as it is: fixed parameters of this package, and of a user's own."""

import numpy as np
import pytest

from scpjax.fit.guess import Guess, Scales
from scpjax.fit.problem import Locals
from scpjax.fit.space import null_values, starts_of
from scpjax.parameter import Parameter
from scpjax.physics.catalogue import mechanism
from scpjax.physics.mechanism import Mechanism
from scpjax.physics.presets import structure, system_structure
from scpjax.physics.system import System

SCALES = Scales(response=7.0, duration=60.0, temperature=30.0, displacement=3e-3, drive=9.0)


def held(name: str, unit: str, value: float, null: float | None) -> Parameter:
    return Parameter(
        name=name, symbol=name, unit=unit, description=name, typical=value, bounds=(1e-6, 1e6), null=null, fixed=True
    )


class Tendon(Mechanism):
    name = "tendon"
    subsystem = "thermomechanical"
    parameters = (held("reference_force", "N", 2.0, 2.0), held("reference", "K", 12.0, 12.0))


class Tank(System):
    name = "tank"
    states, outputs = ("level",), ("level_V",)
    parameters = (held("reference_level", "V", 4.0, None),)


class Slower(type(mechanism("creep"))):
    name = "slower"


def test_what_a_user_fixed_keeps_its_value_whatever_its_name_and_unit():
    s = structure("plant").with_mechanisms(Tendon(), mechanism("creep"))
    values = dict(zip(s.index, null_values(s, SCALES), strict=True))
    assert values["tendon.reference_force"] == 2.0
    assert values["tendon.reference"] == 12.0
    assert values["creep.reference"] == SCALES.displacement


def test_a_mechanism_that_inherits_the_parameters_of_a_shipped_one_is_relative_to_the_data():
    s = structure("plant").with_mechanisms(Slower())
    values = dict(zip(s.index, null_values(s, SCALES), strict=True))
    assert values["slower.reference"] == SCALES.displacement
    assert values["slower.reference_temperature"] == SCALES.temperature


@pytest.mark.parametrize(("known", "wanted"), [({}, 4.0), ({"tank.reference_level": 5.0}, 5.0)])
def test_what_a_base_of_ones_own_fixed_is_not_the_scale_of_the_drive(known, wanted):
    s = system_structure(Tank())
    locals_ = Locals(temperature=False, displaced=False, moving=False, own=True)
    (start,), free = starts_of(s, [Guess({}, 0.0)], known, SCALES, [], locals_, [])
    np.testing.assert_array_equal(start, [wanted])
    assert not free.any()
