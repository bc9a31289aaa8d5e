"""The simulated bench as a port of its own: the compiled firmware in simavr, a muscle behind it, a pseudo-terminal.

    python -m rig.simulation.run [--sim muscle] [--conceal creep] [--emulator]

Prints the port's name; then, in another terminal: scpjax rig record --port THAT --excite multilevel --out a.csv
"""

from __future__ import annotations

import argparse
import signal
import tempfile
import threading
from pathlib import Path

from rig.simulation.firmware import SimulatedDevice, build
from scpjax.bench.cable import Cable
from scpjax.bench.device import BoardDevice, EmulatedDevice
from scpjax.bench.simulated import simulated
from scpjax.bench.world import Noise


def main() -> None:
    """Serve until Ctrl-C or SIGTERM."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--sim", default="muscle", help="muscle, thesis, plant, aaa or a model.json")
    parser.add_argument("--conceal", action="append", default=[], help="a mechanism in the muscle (may be repeated)")
    parser.add_argument("--actuators", type=int, choices=(1, 2))
    parser.add_argument("--noise", type=float, default=2.0, help="of every reading, mV")
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--emulator", action="store_true", help="the board in Python, without the AVR's tools")
    arguments = parser.parse_args()
    made = simulated(
        arguments.sim,
        sides=arguments.actuators,
        concealed=arguments.conceal,
        noise=Noise(volts=1e-3 * arguments.noise),
        seed=arguments.seed,
    )
    device: BoardDevice
    with tempfile.TemporaryDirectory(prefix="scpjax-firmware-") as folder:
        if arguments.emulator:
            device = EmulatedDevice(made.world, config=made.config, seed=arguments.seed)
        else:
            device = SimulatedDevice(*build(Path(folder), made.config), made.world, seed=arguments.seed + 1)
        ended = threading.Event()
        for number in (signal.SIGINT, signal.SIGTERM):
            signal.signal(number, lambda *_: ended.set())
        cable = Cable(device)
        print(cable.port, flush=True)
        ended.wait()
        cable.pull()


if __name__ == "__main__":
    main()
