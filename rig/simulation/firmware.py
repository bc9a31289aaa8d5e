"""The compiled firmware in simavr as a device of `scpjax.bench`; ``make`` here builds what it needs."""

from __future__ import annotations

import ctypes
import shutil
import subprocess
from pathlib import Path

from scpjax.bench.device import BoardDevice, Duty
from scpjax.bench.errors import BenchError
from scpjax.bench.parameters import TICK_S, BoardConfig
from scpjax.bench.world import World

HERE = Path(__file__).resolve().parent
CLOCK_HZ = 16_000_000
_TICK_CYCLES = round(CLOCK_HZ * TICK_S)
_MEND = "run: rig/simulation/install.sh"


def missing() -> str:
    """What this machine lacks to build and run the firmware; empty where it lacks nothing."""
    tools = [t for t in ("make", "cc", "avr-g++") if shutil.which(t) is None]
    if not Path("/usr/include/simavr/sim_avr.h").is_file():
        tools.append("libsimavr")
    return ", ".join(tools)


def build(folder: Path, config: BoardConfig | None = None) -> tuple[Path, Path]:
    """Build the board (``board.so``) and the firmware (``rig.elf``) with a configuration into a folder.

    **Raises** `BenchError` with the compiler's words where that fails.
    """
    lacking = missing()
    if lacking:
        raise BenchError(f"not installed: {lacking}", where="simulated firmware", mend=_MEND)
    flags = [] if config is None else [f"CONFIG={config.flags()}"]
    for where, target, options in ((HERE, "board.so", []), (HERE.parent / "firmware", "rig.elf", flags)):
        call = ["make", "-C", str(where), f"BUILD={folder}", str(folder / target), *options]
        done = subprocess.run(call, capture_output=True, text=True)
        if done.returncode:
            raise BenchError(f"{target} does not build: {done.stderr[-400:]}", where=str(where), mend=_MEND)
    return folder / "board.so", folder / "rig.elf"


class SimulatedDevice(BoardDevice):
    """An Arduino Uno in simavr that runs the compiled firmware before a `World`.

    Lock-step unless ``real_time``. `resets` counts those by the watchdog and by `open`.

    **Raises** `BenchError` where the firmware cannot be loaded, and when it crashes.
    """

    name = "simulated firmware"

    def __init__(
        self, board: Path, firmware: Path, world: World | None = None, *, real_time: bool = False, seed: int = 1
    ):
        super().__init__(world, real_time=real_time)
        self._lib = _library(board)
        handle = self._lib.board_open(str(firmware).encode(), seed)
        if not handle:
            raise BenchError("cannot be loaded", where=str(firmware), mend="build it: make -C rig/firmware")
        self._board = ctypes.c_void_p(handle)
        self._mean = (ctypes.c_double * 2)()
        self._volts = (ctypes.c_double * 6)()
        self._buffer = ctypes.create_string_buffer(4096)
        self._lib.board_noise(self._board, 1e3 * self.world.noise_V)

    def __del__(self) -> None:
        board = getattr(self, "_board", None)
        if board:
            self._lib.board_close(board)
            self._board = None

    def _tick(self) -> bytes:
        world, lib = self.world, self._lib
        self._volts[:] = world.volts().tolist()
        lib.board_inputs(self._board, self._volts)
        lib.board_echo(self._board, world.echo_s())
        lib.board_encoder(self._board, world.encoder())
        state = lib.board_run(self._board, (self.ticks + 1) * _TICK_CYCLES, self._mean)
        if state:
            raise BenchError(f"the firmware stopped (simavr's state {state})", where=self.name, mend="report it")
        world.advance((self._mean[0], self._mean[1]), TICK_S)
        n = lib.board_read(self._board, self._buffer, len(self._buffer))
        return self._buffer.raw[:n]

    def run_on(self, cycles: int) -> None:
        """Into the coming tick, by so many cycles of the processor: what happens next happens there."""
        self._lib.board_run(self._board, self.ticks * _TICK_CYCLES + cycles, self._mean)

    def _take(self, data: bytes) -> None:
        self._lib.board_write(self._board, data, len(data))

    def reset(self) -> None:
        self._lib.board_reset(self._board)

    @property
    def resets(self) -> int:
        """Resets since power came."""
        return int(self._lib.board_resets(self._board))

    def duty(self) -> Duty:
        found = (ctypes.c_double * 2)()
        self._lib.board_duty(self._board, found)
        return found[0], found[1]


def _library(path: Path) -> ctypes.CDLL:
    try:
        lib = ctypes.CDLL(str(path))
    except OSError as error:
        raise BenchError(f"cannot be loaded ({error})", where=str(path), mend=_MEND) from error
    p, d, u32, u64 = ctypes.c_void_p, ctypes.c_double, ctypes.c_uint32, ctypes.c_uint64
    doubles = ctypes.POINTER(d)
    for name, result, arguments in (
        ("board_open", p, [ctypes.c_char_p, u64]),
        ("board_close", None, [p]),
        ("board_reset", None, [p]),
        ("board_run", ctypes.c_int, [p, u64, doubles]),
        ("board_resets", u64, [p]),
        ("board_duty", None, [p, doubles]),
        ("board_noise", None, [p, d]),
        ("board_echo", None, [p, d]),
        ("board_encoder", None, [p, ctypes.c_int32]),
        ("board_inputs", None, [p, doubles]),
        ("board_write", u32, [p, ctypes.c_char_p, u32]),
        ("board_read", u32, [p, ctypes.c_char_p, u32]),
    ):
        function = getattr(lib, name)
        function.restype, function.argtypes = result, arguments
    return lib
