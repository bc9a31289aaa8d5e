"""The dead zone of a driver: what passes it, and what is to be asked for through it."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from sim_cases import PLANT, extended, with_active
from written_out import C_TH, LAM, WARM, R

from scpjax.physics.catalogue import mechanism
from scpjax.physics.mechanism import Values


@pytest.mark.parametrize("warm", [WARM, WARM / 30])
@pytest.mark.parametrize("law", [0, 1, 2, 3])
def test_what_a_dead_time_brings_over_is_what_a_dead_zone_must_be_asked_for(law, warm):
    model = with_active(extended(PLANT.structure, "drive_dead_zone"), "drive_dead_zone", law)
    z = list(model.initial(warm))
    asked = model.balances().holding(z, jnp.zeros(1))
    assert np.sqrt(asked) > np.sqrt(LAM * warm * R) * (1 + 1e-6)
    rates = model.rates(jnp.stack(z), asked)
    assert abs(float(rates[0])) < 1e-4 * LAM * warm / C_TH  # a drive of 0 is none to a millionth of the greatest only


def zone_of(law, single=False):
    """What passes a dead zone, and what is to be asked for through it, of a threshold and an effort."""
    zone, kind = mechanism("drive_dead_zone"), np.float32 if single else np.float64
    others = {p.name: jnp.asarray(kind(p.typical)) for p in zone.parameters} | {"law": jnp.asarray(law)}
    return [
        lambda threshold, effort, hook=hook: hook(Values(others | {"threshold": threshold}), None, effort)
        for hook in (zone.effort, zone.effort_for)
    ]


@pytest.mark.parametrize("law", [0, 1, 2, 3])
def test_a_dead_zone_left_out_has_derivatives_in_single_precision(law):
    one = jnp.float32(1.0)
    for through in zone_of(law, single=True):
        for effort in (0.0, 5.0):
            at = 0.0 * one, effort * one
            slopes = jax.grad(through, (0, 1))(*at)
            assert np.all(np.isfinite(slopes))
            np.testing.assert_allclose(jax.jvp(through, at, (one, one))[1], sum(slopes), rtol=1e-5)


@pytest.mark.parametrize("law", [0, 1, 2, 3])
@pytest.mark.parametrize("effort", [0.2, 0.8, 5.0])
def test_what_is_asked_for_through_a_dead_zone_has_the_inverse_derivatives(law, effort):
    passes, asked = zone_of(law)
    threshold, h = jnp.asarray(0.25), 1e-5
    there = asked(threshold, jnp.asarray(effort))
    np.testing.assert_allclose(passes(threshold, there), effort, rtol=1e-3)
    for k in (0, 1):
        step = h * np.eye(2)[k]
        ahead, behind = (asked(threshold + s * step[0], effort + s * step[1]) for s in (1, -1))
        np.testing.assert_allclose(jax.grad(asked, k)(threshold, effort), (ahead - behind) / (2 * h), rtol=1e-6)


def test_small_drives_do_not_pass_a_dead_zone():
    for law in (0, 1, 2, 3):
        model = with_active(extended(PLANT.structure, "drive_dead_zone"), "drive_dead_zone", law)
        model = model.replace({"drive_dead_zone.sharpness": 8.0})
        passed = [float(model.rates(model.initial(), jnp.array([v**2]))[0]) * C_TH * R for v in (0.0, 1.5, 2.2, 9.0)]
        np.testing.assert_allclose(passed[:3], 0.0, atol=5e-2)
        np.testing.assert_allclose(passed[3], (36.0, 81.0, 81.0, 81.0)[law], rtol=5e-3)
