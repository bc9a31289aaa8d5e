"""Names that do not reach the noise by steps as long as the samples are looked at again by shorter ones."""

import itertools

import numpy as np
import pytest
from scipy.integrate import solve_ivp

from scpjax.diagnose.choice import Choice
from scpjax.diagnose.diagnose import _base
from scpjax.diagnose.evidence import Evidence
from scpjax.diagnose.naming import Found, _by_shorter_steps, _rings, _Seeker, _shorter
from scpjax.diagnose.patience import Patience
from scpjax.diagnose.remainder import AT_NOISE, level
from scpjax.diagnose.rivals import added
from scpjax.diagnose.trials import under_every_law
from scpjax.fit.setup import prepare
from scpjax.fit.solve import outputs_of
from scpjax.recordings import Metadata, Recording

PERIOD, NOISE_MM = 0.1, 0.01
C, K, BETA, M = 0.012, 180.0, 2.2, 1.6
DRY, EXTRA, FAST, GIVES = 0.06, 0.3, 7e-4, 6e-5  # N, 1, m/s, m


def rubbed(warm: np.ndarray) -> np.ndarray:
    """Displacement [m] of a load held by LuGre's friction under a temperature excess that goes along lines."""
    time, z, out = PERIOD * np.arange(len(warm)), np.zeros(3), [0.0]

    def rates(t, z):
        x, v, bristle = z
        most = DRY * (1 + EXTRA * np.exp(-((v / FAST) ** 2)))
        force = C * np.interp(t, time, warm) - K * x - BETA * v - DRY / GIVES * bristle
        return [v, force / M, v - abs(v) * bristle * DRY / GIVES / most]

    for a, b in itertools.pairwise(time):
        z = solve_ivp(rates, (a, b), z, "LSODA", rtol=1e-7, atol=1e-11, max_step=0.02).y[:, -1]
        out.append(z[0])
    return np.array(out)


@pytest.fixture(scope="module")
def rubbing():
    recordings = []
    for seed in (1, 2):
        rng = np.random.default_rng(seed)
        levels = np.repeat(rng.choice([0.0, 15.0, 30.0, 45.0, 60.0], 40), 40)
        warm = np.convolve(levels, np.exp(-np.arange(200) / 60.0) / 60.5)[: len(levels)]
        x = 1e3 * rubbed(warm) + NOISE_MM * rng.standard_normal(len(warm))
        meta = Metadata(name=f"{seed}", ambient_K=295.15, known=(("moving_mass_kg", M),), model="tm")
        time = PERIOD * np.arange(len(warm))
        columns = {"displacement_mm": x}
        recordings.append(
            Recording.from_arrays(time, {"temperature_degC": 22.0 + warm}, columns, hold="linear", metadata=meta)
        )
    setup = prepare(recordings)
    return setup, *_base(setup)[:2]


def test_a_drive_along_lines_is_the_same_by_shorter_steps(rubbing):
    setup, parts, base = rubbing
    finer, packed = parts.whole.finer(2), prepare(setup.recordings, bin=parts.whole.bin, substeps=2).data
    steps = 2 * (setup.recordings[0].n - 1)
    given = np.asarray(packed.grids.effort)[:, :steps]
    np.testing.assert_allclose(np.asarray(finer.grids.effort)[:, :steps], given, atol=1e-3 * np.ptp(given))
    seen = np.asarray(parts.whole.weights) > 0
    one, other = (np.asarray(outputs_of(base.trial, d, setup.space)) for d in (finer, packed))
    n = min(one.shape[1], other.shape[1])
    np.testing.assert_allclose(one[:, :n][seen[:, :n]], other[:, :n][seen[:, :n]], atol=1e-7)


def test_friction_that_misses_the_noise_by_long_steps_reaches_it_by_short_ones(rubbing):
    setup, parts, base = rubbing
    state = under_every_law(added(base, "friction", parts), "friction", parts)
    assert level(state, parts) > AT_NOISE
    found = Found(parts, base, Choice(state, (), {"friction": 1.0}, {"friction": ()}))
    again = _by_shorter_steps(found, _Seeker(setup, Evidence(), 40, Patience(), lambda text, share: None))
    assert again.parts.whole.bin > parts.whole.bin
    assert again.choice.state.names == ("friction",)
    assert level(again.choice.state, again.parts) <= AT_NOISE < level(again.base, again.parts)
    out_of_time = _Seeker(setup, Evidence(), 40, Patience(0.0), lambda text, share: None)
    assert _by_shorter_steps(found, out_of_time) is found


def ringing(seed: int, k: float = K, m: float = 0.15) -> Recording:
    """A light load that rings within a sample, held by Dahl's friction; its temperature goes in steps. By scipy."""
    rng = np.random.default_rng(seed)
    warm = np.repeat(rng.choice([0.0, 15.0, 30.0, 45.0, 60.0], 40), 25)
    z, out = np.zeros(3), [0.0]
    for hot in warm[:-1]:

        def rates(_t, z, hot=hot):
            x, v, contact = z
            return [v, (C * hot - k * x - BETA * v - DRY * contact) / m, (v - abs(v) * contact) / GIVES]

        z = solve_ivp(rates, (0.0, PERIOD), z, "LSODA", rtol=1e-7, atol=1e-11, max_step=0.02).y[:, -1]
        out.append(z[0])
    x = 1e3 * np.array(out) + NOISE_MM * rng.standard_normal(len(warm))
    meta = Metadata(name=f"ringing {seed}", ambient_K=295.15, known=(("moving_mass_kg", m),), model="tm")
    time = PERIOD * np.arange(len(warm))
    return Recording.from_arrays(time, {"temperature_degC": 22.0 + warm}, {"displacement_mm": x}, metadata=meta)


def test_where_a_load_rings_within_a_sample_a_higher_order_comes_first():
    setup = prepare([ringing(1), ringing(2)])
    parts, base, _ = _base(setup)
    state = added(base, "friction", parts)
    assert _rings(state, parts)
    assert level(state, parts) > 1.5 * AT_NOISE
    search = _Seeker(setup, Evidence(), 40, Patience(), lambda text, share: None)
    found = _shorter(state, parts, search)
    assert found is not None
    fine, again = found
    assert fine.whole.order == 4
    assert level(again, fine) <= AT_NOISE
    of = dict(zip([s.key for s in again.setup.structure.slots], again.values, strict=False))
    held = of["friction.strength"] * of["elastic_spring.stiffness"] * of["friction.reference"]
    assert held / of["elastic_spring.stiffness"] == pytest.approx(DRY / K, rel=0.1)  # only their ratio is seen at rest
    assert _shorter(state, parts, _Seeker(setup, Evidence(), 40, Patience(0.0), lambda text, share: None)) is None


def test_a_heavy_load_does_not_ring_within_a_sample():
    setup = prepare([ringing(1, k=20.0, m=4.0)])
    parts, base, _ = _base(setup)
    assert not _rings(base, parts)
