"""The bench that a command line names: a board on a port, or a simulated one."""

from __future__ import annotations

import contextlib
import math
import select
import sys
from argparse import Namespace
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

from scpjax.bench.device import AbstractDevice, EmulatedDevice, PortDevice, find_port
from scpjax.bench.errors import BenchError
from scpjax.bench.live import Live
from scpjax.bench.messages import FAULTS, Sample
from scpjax.bench.parameters import TICK_S
from scpjax.bench.play import Watch
from scpjax.bench.rig import Rig, RigOptions
from scpjax.bench.simulated import Simulated, simulated
from scpjax.bench.wiring import Wiring, load_wiring
from scpjax.bench.world import Noise
from scpjax.cli.program import Progress, say

_KEPT = 1 << 18


@dataclass(frozen=True)
class Bench:
    """An open rig; ``behind`` it the simulated muscle, if it is one."""

    rig: Rig
    behind: Simulated | None


@contextlib.contextmanager
def bench(arguments: Namespace, *, period: float = 0.1, sides: int | None = None) -> Iterator[Bench]:
    """Open the bench of a command line; the power is off when it ends.

    **Raises** `BenchError` for options that do not go together, and as `Rig` does.
    """
    every = ticks_of(period, "--period")
    device, wiring, behind = _device(arguments, sides)
    try:
        with Rig(device, wiring, options=RigOptions(every=every, keep=_KEPT)) as rig:
            say(arguments, f"{device.name}: firmware {rig.banner.version if rig.banner else '?'}")
            _clear(arguments, rig)
            if arguments.max_temperature is not None:
                rig.set("max_temperature", arguments.max_temperature)
            with _live(arguments, rig):
                yield Bench(rig, behind)
    except KeyboardInterrupt as stop:
        raise KeyboardInterrupt("the power is off; what was being recorded is kept") from stop
    q = rig.quality
    say(arguments, f"  {q.samples} samples, {q.lost} frames lost, {q.damaged} damaged")


def _clear(arguments: Namespace, rig: Rig) -> None:
    """Clear a fault of an earlier run, if what it was has recovered."""
    fault = rig.ask("H") >> 8 & 0xFF
    if not fault:
        return
    try:
        rig.clear_fault()
    except BenchError as error:
        mend = "let it cool and try again, or press the board's reset"
        raise BenchError(f"the power stays off: {FAULTS[fault]}", where=rig.device.name, mend=mend) from error
    say(arguments, f"  cleared: {FAULTS[fault]}")


def ticks_of(period: float, where: str) -> int:
    """Whole ticks of 5 ms in a period. **Raises** `BenchError` where it is not that."""
    ticks = round(period / TICK_S) if math.isfinite(period) else 0
    if not (1 <= ticks <= 255 and abs(ticks * TICK_S - period) < 1e-6):
        raise BenchError(f"a sample every {period:g} s", where=where, mend="give whole 5 ms, from 0.005 to 1.275")
    return ticks


def _device(arguments: Namespace, sides: int | None) -> tuple[AbstractDevice, Wiring, Simulated | None]:
    wiring = load_wiring(arguments.bench) if arguments.bench else None
    if arguments.port != "sim":
        for option, value in (("--sim", arguments.sim), ("--conceal", arguments.conceal)):
            if value:
                raise BenchError("only means something on a simulated bench", where=option, mend="add --port sim")
        return PortDevice(arguments.port or find_port()), wiring or Wiring(), None
    if not (math.isfinite(arguments.noise) and arguments.noise >= 0):
        raise BenchError(f"is {arguments.noise:g} mV", where="--noise", mend="give millivolts, 0 or more")
    made = simulated(
        arguments.sim or "muscle",
        sides=arguments.actuators or sides,
        concealed=arguments.conceal,
        noise=Noise(volts=1e-3 * arguments.noise),
        seed=arguments.seed,
        wiring=wiring,
    )
    device = EmulatedDevice(made.world, config=made.config, real_time=arguments.real_time, seed=arguments.seed)
    return device, made.wiring, made


@contextlib.contextmanager
def _live(arguments: Namespace, rig: Rig) -> Iterator[None]:
    if not arguments.live:
        yield
        return
    with Live(("time_s", *rig.wiring.drives, *rig.wiring.responses)) as live:

        def tell(time: float, sample: Sample) -> None:
            live.add(time, rig.wiring.row(sample))

        rig.listener = tell
        say(arguments, f"live plot: {live.url}")
        import webbrowser

        webbrowser.open(live.url)
        try:
            yield
        finally:
            rig.listener = None


def watcher(rig: Rig, show: Progress | None, text: str, duration: float) -> Watch:
    """Shows the progress of what takes ``duration`` [s], and takes lines typed meanwhile as remarks (not on Windows,
    where nothing tells whether a line has been typed).
    """
    typed = sys.platform != "win32" and sys.stdin is not None and not sys.stdin.closed and sys.stdin.isatty()

    def watch(time: float) -> None:
        if show:
            show(text, min(time / max(duration, 1e-9), 1.0))
        if typed:
            while select.select([sys.stdin], [], [], 0)[0]:
                line = sys.stdin.readline()
                if not line:
                    break
                rig.mark(line.strip() or "mark")

    return watch


def existing(path: str, where: str) -> Path:
    """A file that is there. **Raises** `BenchError`."""
    found = Path(path)
    if not found.is_file():
        raise BenchError("no such file", where=f"{where} {path}", mend="check the name")
    return found
