"""Which of several names is told of first changes nothing but that."""

import numpy as np
import pytest
from creeping import slow

from scpjax.diagnose.holdout import Split, split
from scpjax.diagnose.hypothesis import State, grown, residual_on, trial_at
from scpjax.diagnose.trials import in_order
from scpjax.fit.setup import prepare
from scpjax.physics.catalogue import mechanism


def named(values: dict[str, float]) -> tuple[State, Split]:
    """A hypothesis that is not fitted: the first start of the base, and these values of what is named."""
    base = prepare([slow()])
    parts = split(base.data)
    setup = grown(base, *(mechanism(n) for n in dict.fromkeys(key.split(".")[0] for key in values)))
    value = np.array(setup.starts[0])
    for key, number in values.items():
        value[setup.structure.index[key]] = number
    trial = trial_at(setup, value, np.zeros(len(setup.structure.mechanisms)))
    residual = residual_on(trial, parts.whole, setup)
    return State(setup, trial, residual, float(np.sum(residual[parts.is_train] ** 2))), parts


def by_key(state: State) -> dict[str, float]:
    return {s.key: float(state.values[s.index]) for s in state.setup.structure.slots}


def test_the_first_is_told_first_with_all_as_it_was():
    values = {"creep.compliance": 0.3, "creep.time_constant": 6.0, "sensor_lag.time_constant": 2.0}
    state, parts = named(values)
    assert state.names == ("creep", "sensor_lag")
    found = in_order(state, "sensor_lag", parts)
    assert found.names == ("sensor_lag", "creep")
    assert by_key(found) == pytest.approx(by_key(state))
    assert found.laws == state.laws
    assert found.cost == pytest.approx(state.cost)
    np.testing.assert_allclose(found.residual, residual_on(found.trial, parts.whole, found.setup))
    np.testing.assert_allclose(found.residual, state.residual, atol=1e-6)
    back = in_order(found, "creep", parts)
    assert back.names == state.names


def test_where_one_takes_up_what_the_other_makes_the_order_stays():
    """A dead zone before the supply sags is not one after."""
    state, parts = named({"drive_dead_zone.threshold": 1.5, "supply_sag.sag": 0.4})
    assert state.names == ("drive_dead_zone", "supply_sag")
    assert in_order(state, "supply_sag", parts) is state
