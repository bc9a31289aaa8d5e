"""How often does the self-driving bench find what is concealed in a simulated muscle?

    python rig/scripts/self_driving.py --out DIR [--seeds 10] [--mechanism creep --mechanism two_node_thermal] [--poor]

For each seed a muscle is drawn (every parameter within 15 %, the mechanism's strength and time within the range below).
The emulated board stands before it with noise on every reading, and the bench is left alone: a first recording of 60
s, then experiments of its own choice until one hypothesis is left, three at the most. What is done is not done again.
With --poor the first recording is a slow triangle and the readings are six times as noisy, which leaves hypotheses
close.
"""

from __future__ import annotations

import argparse
import json
import time
from pathlib import Path

import numpy as np

from scpjax.bench.device import EmulatedDevice
from scpjax.bench.rig import Rig, RigOptions
from scpjax.bench.self_driving import SelfDriving, hottest_of, until_explained
from scpjax.bench.sessions import Excite, record_profile
from scpjax.bench.simulated import muscle, simulated
from scpjax.bench.world import Noise
from scpjax.cli.program import start
from scpjax.compiled import forget
from scpjax.physics.storage import save_model

RANGES = {
    "creep": {"compliance": (0.15, 0.5), "time_constant": (4.0, 20.0)},
    "two_node_thermal": {"share": (0.25, 0.6), "time_constant": (0.8, 4.0)},
}
FIRST = Excite(duration=60.0, period=0.1, high=3.0, hold=10.0)
NOISE_V, POOR_V = 3e-3, 18e-3


def one(name: str, seed: int, folder: Path, poor: bool) -> dict[str, object]:
    """One seed: what was concealed, what was named, after how many experiments, and how hot it became."""
    rng = np.random.default_rng([seed, len(name)])
    base = muscle()
    keys = [k for k in base.values() if not k.startswith(("sensor_offset", "inertia"))]
    drawn = base.replace({k: float(base.value(k)) * rng.uniform(0.85, 1.15) for k in keys})
    folder.mkdir(parents=True, exist_ok=True)
    model = save_model(drawn, folder / "muscle.json")
    truth = {k: round(float(np.exp(rng.uniform(*np.log(r)))), 4) for k, r in RANGES[name].items()}
    concealed = f"{name}:{','.join(f'{k}={v}' for k, v in truth.items())}"
    made = simulated(str(model), concealed=[concealed], noise=Noise(volts=POOR_V if poor else NOISE_V), seed=seed)
    began = time.monotonic()
    device = EmulatedDevice(made.world, config=made.config, seed=seed)
    with Rig(device, made.wiring, options=RigOptions(every=20)) as rig:
        limit = rig.get("max_temperature") + 273.15
        options = SelfDriving(high=3.5, hottest=hottest_of(rig), duration=90.0)
        t, volts = FIRST.make("triangle" if poor else "multilevel")
        first = record_profile(rig, folder / "0_first.csv", t, volts)
        driven = until_explained(rig, folder, options, recordings=[first])
    return {
        "concealed": name,
        "truth": truth,
        "seed": seed,
        "named": list(driven.names),
        "right": driven.names == (name,),
        "experiments": driven.played,
        "why": driven.why,
        "verdict": driven.last.verdict,
        "hottest_degC": round(made.world.hottest - 273.15, 2),
        "limit_degC": round(limit - 273.15, 2),
        "below_limit": bool(made.world.hottest <= limit),
        "seconds": round(time.monotonic() - began, 1),
    }


def main() -> None:
    """Run what is missing, then print the table."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--out", type=Path, required=True)
    parser.add_argument("--seeds", type=int, default=10)
    parser.add_argument("--mechanism", action="append", choices=sorted(RANGES))
    parser.add_argument("--poor", action="store_true")
    arguments = parser.parse_args()
    start()
    for seed in range(arguments.seeds):
        for name in arguments.mechanism or sorted(RANGES):
            folder = arguments.out / f"{name}_{seed}"
            if not (folder / "result.json").is_file():
                found = one(name, seed, folder, arguments.poor)
                (folder / "result.json").write_text(json.dumps(found, indent=1) + "\n")
                print(json.dumps(found), flush=True)
                forget()
    results = [json.loads(p.read_text()) for p in sorted(arguments.out.glob("*/result.json"))]
    for name in sorted({r["concealed"] for r in results}):
        mine = [r for r in results if r["concealed"] == name]
        right = sum(r["right"] for r in mine)
        cool = sum(r["below_limit"] for r in mine)
        mean = np.mean([r["experiments"] for r in mine])
        said = f"right in {right} of {len(mine)} seeds, {mean:.1f} experiments on average, {cool} below the limit"
        print(f"{name}: {said}")


if __name__ == "__main__":
    main()
