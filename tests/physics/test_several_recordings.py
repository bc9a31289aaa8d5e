"""One model of several recordings, of which some parameters differ by recording."""

import numpy as np
import pytest

from scpjax.errors import ModelError
from scpjax.physics import presets
from scpjax.physics.model import Model

LOSS = "newton_cooling.conductance"
BASE = presets.te(resistance=1.2, conductance=0.14, thermal_mass=1.2)
SEVERAL = BASE.structure.with_own(("monday", "tuesday"), LOSS)


def several() -> Model:
    values = BASE.values()
    shared = {k: v for k, v in values.items() if k != LOSS}
    return Model(SEVERAL).replace(shared | {f"{LOSS}@monday": 0.1, f"{LOSS}@tuesday": 0.4})


def test_each_recording_has_its_values_and_shares_the_rest():
    for i, loss in enumerate((0.1, 0.4)):
        found = several().of_recording(i)
        assert found.structure == BASE.structure
        np.testing.assert_allclose(found.theta, BASE.replace({LOSS: loss}).theta)


def test_another_recording_has_the_mean_on_the_scale_of_the_parameter():
    np.testing.assert_allclose(several().on_average().theta, BASE.replace({LOSS: 0.2}).theta)
    assert BASE.on_average() is BASE is BASE.of_recording(1)


def test_of_no_recording_there_are_no_balances():
    with pytest.raises(ModelError, match=r"newton_cooling.conductance differ by recording.*of_recording"):
        several().balances()


def test_recordings_need_names_of_their_own():
    with pytest.raises(ModelError, match="names of their own"):
        BASE.structure.with_own(("monday", "monday"), LOSS)


def test_without_a_mechanism_its_values_by_recording_are_gone():
    assert SEVERAL.without("newton_cooling").own == ()
    assert SEVERAL.without("joule_heating").own == (LOSS,)
    assert SEVERAL.count_free("newton_cooling", 0) == 3
