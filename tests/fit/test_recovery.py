"""200 random plants, 1 % noise, starts from the data alone, all fitted in one compiled call."""

from __future__ import annotations

import numpy as np
import pytest
from scipy import signal

from scpjax.fit.fit import FitOptions
from scpjax.fit.fleet import fit_fleet
from scpjax.recordings.excitation import multilevel_random
from scpjax.recordings.recording import Metadata, Recording

N = 200
PERIOD = 0.02
AMBIENT = 295.15
KEYS = {
    "newton_cooling.conductance": "lam",
    "newton_cooling.thermal_mass": "cth",
    "thermal_actuation.coefficient": "c",
    "elastic_spring.stiffness": "k",
    "viscous_damping.damping": "beta",
}


def random_plant(rng):
    """Muscles like those of thesis Table 4.14 and of a lighter, quicker kind; underdamped as the thesis finds them."""
    k, m = rng.uniform(60, 300), rng.uniform(0.1, 0.6)
    return {
        "r": rng.uniform(0.8, 1.6),
        "lam": np.exp(rng.uniform(np.log(0.08), np.log(0.4))),
        "cth": np.exp(rng.uniform(np.log(0.5), np.log(3.0))),
        "m": m,
        "k": k,
        "beta": 2 * rng.uniform(0.03, 0.3) * np.sqrt(k * m),
        "c": np.exp(rng.uniform(np.log(0.005), np.log(0.05))),
    }


def record(plant, seed):
    """Voltage levels, and the plucked weight's free ringing at the start, by scipy's own exact discretisation."""
    rng = np.random.default_rng(seed)
    time, volts = multilevel_random(duration_s=24.0, period_s=PERIOD, low=0.0, high=3.7, hold_s=1.5, seed=seed)
    a = np.array(
        [
            [-plant["lam"] / plant["cth"], 0, 0],
            [0, 0, 1],
            [plant["c"] / plant["m"], -plant["k"] / plant["m"], -plant["beta"] / plant["m"]],
        ]
    )
    b = np.array([[1 / plant["r"] / plant["cth"]], [0], [0]])
    ad, bd, *_ = signal.cont2discrete((a, b, np.eye(3), np.zeros((3, 1))), PERIOD)
    z = np.array([0.0, 0.3 * plant["c"] * 40 / plant["k"], 0.0])
    states = np.empty((len(time), 3))
    for i, v in enumerate(volts):
        states[i] = z
        z = ad @ z + bd[:, 0] * v**2
    clean = states[:, :2]
    noise = 0.01 * clean.std(axis=0)
    noisy = clean + noise * rng.standard_normal(clean.shape)
    meta = Metadata(
        name=f"plant {seed}",
        known=(("resistance_ohm", plant["r"]), ("moving_mass_kg", plant["m"])),
        ambient_K=AMBIENT,
    )
    recording = Recording.from_arrays(
        time,
        {"voltage_V": volts},
        {"temperature_K": noisy[:, 0] + AMBIENT, "displacement_m": noisy[:, 1]},
        metadata=meta,
    )
    return recording, noise


@pytest.fixture(scope="module")
def recovered():
    rng = np.random.default_rng(2026)
    plants = [random_plant(rng) for _ in range(N)]
    made = [record(p, i) for i, p in enumerate(plants)]
    fleet = fit_fleet([[r] for r, _ in made], model="plant", options=FitOptions(bin=1, release=True, max_steps=30))
    return plants, [n for _, n in made], fleet


def test_converges_to_the_noise_floor(recovered):
    _, noises, fleet = recovered
    assert not any(isinstance(f, str) for f in fleet.fits), [f for f in fleet.fits if isinstance(f, str)]
    at_floor = [
        f.scores["temperature_K"]["rmse"] < 1.05 * n[0] and f.scores["displacement_m"]["rmse"] < 1.05 * n[1]
        for f, n in zip(fleet.fits, noises, strict=True)
    ]
    print(f"{np.mean(at_floor):.1%} at the noise floor; {fleet.seconds:.1f} s for {N} actuators")
    assert np.mean(at_floor) >= 0.99


def test_intervals_cover(recovered):
    plants, _noises, fleet = recovered
    inside = []
    for plant, fit in zip(plants, fleet.fits, strict=True):
        for key, name in KEYS.items():
            e = fit.parameters[key]
            inside.append(e.low <= plant[name] <= e.high)
    print(f"95 % intervals hold the truth in {np.mean(inside):.1%} of {len(inside)}")
    assert 0.93 <= np.mean(inside) <= 0.97
