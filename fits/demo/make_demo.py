"""Makes the example that comes with the package: ``scpjax/examples/demo``, and ``truth.json`` here.

An actuator is simulated by equations written out below, not by scpjax, so that the example can tell whether
scpjax is right. Run ``python fits/demo/make_demo.py``; the same files come out every time.
"""

from __future__ import annotations

import argparse
import json
from collections.abc import Sequence
from pathlib import Path

import numpy as np
from scipy.integrate import solve_ivp
from scipy.special import ndtri

ROOT = Path(__file__).resolve().parents[2]
PERIOD = 0.1  # s
SEED = 20
NOISE = {"temperature_degC": 0.15, "displacement_mm": 0.05}
RESOLUTION = {"temperature_degC": 0.05, "displacement_mm": 0.002}
AMBIENT = 22.0  # degC

PLANT = {
    "resistance_ohm": 1.2,
    "conductance_W_per_K": 0.14,
    "thermal_mass_J_per_K": 1.1,
    "moving_mass_kg": 0.25,
    "stiffness_N_per_m": 180.0,
    "damping_Ns_per_m": 8.0,
    "coefficient_N_per_K": 0.024,
}
CREEP = {"compliance": 0.35, "time_constant": 15.0}

# (volts, seconds) one after another; every recording begins at rest
DRIVES = {
    "0_step": ("Step up and down", [(0.0, 5.0), (3.5, 55.0), (0.0, 50.0)]),
    "1_multilevel": (
        "Steps between several levels",
        [
            (0, 2), (2.4, 14), (3.5, 11), (1.2, 17), (3.7, 16), (0, 13),
            (2.9, 20), (3.3, 8), (1.8, 16), (3.6, 10), (0, 23),
        ],
    ),
}  # fmt: skip
TOML = """\
[recording]
title = "{title}"
hold = "zero_order"

[actuator]
resistance_ohm = {resistance_ohm:g}
moving_mass_kg = {moving_mass_kg:g}

[environment]
ambient_degC = {ambient:.1f}
"""


def rates(_: float, z: np.ndarray, volts: float) -> list[float]:
    """Excess temperature T [K], displacement x [m], velocity v [m/s], slow displacement s [m].

    A Kelvin-Voigt branch (k_s, c_s) in series with the spring k carries the same force:
    c_s ds/dt = k (x - s) - k_s s, with k_s = k / compliance and c_s = k_s * time constant.
    """
    warm, x, v, s = z
    p = PLANT
    slow_k = p["stiffness_N_per_m"] / CREEP["compliance"]
    slow_c = slow_k * CREEP["time_constant"]
    spring = p["stiffness_N_per_m"] * (x - s)
    pull = p["coefficient_N_per_K"] * warm - spring - p["damping_Ns_per_m"] * v
    return [
        (volts**2 / p["resistance_ohm"] - p["conductance_W_per_K"] * warm) / p["thermal_mass_J_per_K"],
        v,
        pull / p["moving_mass_kg"],
        (spring - slow_k * s) / slow_c,
    ]


def run(levels: Sequence[tuple[float, float]]) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """(time (n,) [s], volts (n,), states (n, 4)), level by level, so that no jump is stepped over."""
    state, volts, states = np.zeros(4), [], []
    for level, seconds in levels:
        count = round(seconds / PERIOD)
        at = np.arange(count + 1) * PERIOD
        found = solve_ivp(
            rates, (0, at[-1]), state, method="DOP853", t_eval=at, args=(float(level),), rtol=1e-9, atol=1e-12
        )
        states.append(found.y.T[:-1])
        volts += [float(level)] * count
        state = found.y[:, -1]
    return np.arange(len(volts)) * PERIOD, np.array(volts), np.concatenate(states)


def normal(bits: np.random.PCG64, n: int) -> np.ndarray:
    """Standard normal numbers from the raw stream, which is the same in every release of numpy."""
    raw = bits.random_raw(n) >> np.uint64(11)
    return ndtri((raw.astype(float) + 0.5) / 2.0**53)


def csv(levels: Sequence[tuple[float, float]], bits: np.random.PCG64) -> str:
    """A recording as text: states seen through sensors with noise and a resolution."""
    time, volts, states = run(levels)
    exact = {"temperature_degC": AMBIENT + states[:, 0], "displacement_mm": 1e3 * states[:, 1]}
    lines = ["time_s,voltage_V,temperature_degC,displacement_mm"]
    seen = {}
    for column, clean in exact.items():
        noisy = clean + NOISE[column] * normal(bits, len(clean))
        seen[column] = np.round(noisy / RESOLUTION[column]) * RESOLUTION[column] + 0.0
    for t, u, warm, x in zip(time, volts, *seen.values(), strict=True):
        lines.append(f"{t:.1f},{u:.1f},{warm:.2f},{x:.3f}")
    return "\n".join(lines) + "\n"


def make(examples: Path, truth: Path) -> None:
    """Write the recordings into ``examples`` and what they were made with into ``truth``."""
    examples.mkdir(parents=True, exist_ok=True)
    bits = np.random.PCG64(SEED)
    for name, (title, levels) in DRIVES.items():
        (examples / f"{name}.csv").write_text(csv(levels, bits), encoding="utf-8", newline="\n")
        toml = TOML.format(title=title, ambient=AMBIENT, **PLANT)
        (examples / f"{name}.toml").write_text(toml, encoding="utf-8", newline="\n")
    content = {
        "mechanism": "creep",
        "parameters": CREEP,
        "plant": PLANT,
        "ambient_degC": AMBIENT,
        "noise": NOISE,
    }
    truth.write_text(json.dumps(content, indent=1) + "\n", encoding="utf-8", newline="\n")


def main(argv: Sequence[str] | None = None) -> None:
    """Command line."""
    parser = argparse.ArgumentParser(description="Make the example recordings that come with the package.")
    parser.add_argument("--out", metavar="DIR", type=Path, default=ROOT / "scpjax/examples/demo")
    parser.add_argument("--truth", metavar="FILE", type=Path, default=Path(__file__).parent / "truth.json")
    given = parser.parse_args(argv)
    make(given.out, given.truth)
    print(f"{given.out}: {', '.join(DRIVES)}")


if __name__ == "__main__":
    main()
