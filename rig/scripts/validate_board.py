"""Check a real board before an actuator is connected: python rig/scripts/validate_board.py --port /dev/ttyACM0

Puts a resistor of 1 ohm, 10 W (or nothing) in the actuator's place to the test of the watchdogs, the stream and the
limits, and says for each whether it held. Exit code 1 where one did not.
"""

from __future__ import annotations

import argparse
import sys
import time
from collections.abc import Callable

from scpjax.bench import messages as m
from scpjax.bench.device import PortDevice, find_port
from scpjax.bench.errors import BenchError, BoardFault, BoardReset
from scpjax.bench.rig import Rig, RigOptions

_COUNT = 40  # of 255: 2 W into 1 ohm


def stream(port: str) -> str:
    """Two hundred samples a second for 10 s, none lost."""
    with Rig(PortDevice(port), options=RigOptions(every=1)) as rig:
        rig.wait(10.0)
        q = rig.quality
    if q.lost or q.damaged > 1 or q.samples < 1900:
        raise BenchError(f"{q.samples} samples, {q.lost} lost, {q.damaged} damaged", mend="another cable or hub")
    return f"{q.samples} samples, none lost, clock {q.drift_ppm:+.0f} ppm, jitter {1e6 * q.stamp_jitter_s:.0f} us"


def host_watchdog(port: str) -> str:
    """Silence for 1.5 s: the board must have ended the drive."""
    with Rig(PortDevice(port), options=RigOptions(every=1)) as rig:
        rig.set_pwm(_COUNT, _COUNT)
        rig.wait(0.3)
        time.sleep(1.5)
        try:
            rig.wait(0.2)
        except BoardFault:
            off = [t for t, s in rig.unread() if s.mode == m.IDLE]
            return f"drive ended, {len(off)} samples show it"
    raise BenchError("the drive went on", mend="do not connect an actuator")


def hardware_watchdog(port: str) -> str:
    """A firmware that hangs: the board must begin anew."""
    try:
        with Rig(PortDevice(port)) as rig:
            rig.set_pwm(_COUNT, _COUNT)
            rig.wait(0.3)
            rig.hang()
            rig.wait(3.0)
    except BoardReset:
        return "the board began anew"
    raise BenchError("the board went on hanging", mend="does its bootloader support the watchdog?")


def limit(port: str) -> str:
    """An energy limit of 1 J: the board must cut the power and refuse to go on."""
    with Rig(PortDevice(port)) as rig:
        rig.set("max_energy", 1.0)
        rig.set("sustained_power", 0.0)
        rig.set_pwm(_COUNT, 0)
        try:
            rig.wait(5.0)
        except BoardFault as fault:
            return fault.problem
    raise BenchError("no limit was met", mend="do not connect an actuator")


CHECKS: tuple[Callable[[str], str], ...] = (stream, host_watchdog, hardware_watchdog, limit)


def main() -> int:
    """Run all checks."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--port", help="default: the only board there is")
    arguments = parser.parse_args()
    port = arguments.port or find_port()
    bad = 0
    for check in CHECKS:
        try:
            print(f"held  {check.__name__}: {check(port)}", flush=True)
        except BenchError as error:
            bad += 1
            print(f"NOT   {check.__name__}: {error}", flush=True)
    return 1 if bad else 0


if __name__ == "__main__":
    sys.exit(main())
