"""What a program does and a library does not: double precision, a cache, progress, files put in place."""

from __future__ import annotations

import contextlib
import os
import shutil
import sys
import tempfile
from argparse import Namespace
from collections.abc import Callable, Iterator
from importlib.metadata import version
from pathlib import Path

from scpjax.errors import ScpjaxError

Progress = Callable[[str, float], None]

LOOPS = (
    "--xla_backend_extra_options=xla_cpu_small_while_loop_byte_threshold=100000000 "
    "--xla_disable_hlo_passes=cpu-parallel-task-assigner"
)
"""Scans over arrays of up to 100 MB in all run as one function, not operation by operation (``python
benchmarks/scans.py``), and none of their operations is shared out among threads: such functions would wait for each
other's threads, for ever. XLA reads it once, when a process computes first."""


def one_thread_for_blas() -> None:
    """Have BLAS compute where it is called, before NumPy reads it: threads of its own would wait by spinning on the
    cores that fits share (`scpjax.abreast`). Whoever has set it knows what for.
    """
    os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")


class OutputError(ScpjaxError):
    """What was asked for cannot be written where it was asked for."""


def start() -> None:
    """Double precision on the processor, and compiled functions kept between calls (``SCPJAX_CACHE``: where; empty:
    not). A few fits at a time, thousands of steps one after the other, are slower on an accelerator: whoever wants one
    says so by ``JAX_PLATFORMS`` (or the old ``JAX_PLATFORM_NAME``).
    """
    flags = os.environ.get("XLA_FLAGS", "")
    told = any(option in flags for option in ("xla_backend_extra_options", "xla_disable_hlo_passes"))
    if knows_options() and not told:  # whoever has set some knows what they are for
        os.environ["XLA_FLAGS"] = f"{flags} {LOOPS}".strip()
    import jax

    from scpjax.kept import keep_in

    jax.config.update("jax_enable_x64", True)
    if getattr(jax.config, "jax_platforms", None) is None and not os.environ.get("JAX_PLATFORM_NAME"):
        jax.config.update("jax_platforms", "cpu")
    folder = cache_folder()
    keep_in(folder)
    if folder is None or getattr(jax.config, "jax_compilation_cache_dir", None):
        return
    with contextlib.suppress(OSError):
        folder.mkdir(parents=True, exist_ok=True)
        jax.config.update("jax_compilation_cache_dir", str(folder))
        jax.config.update("jax_persistent_cache_min_compile_time_secs", 0.5)


def knows_options() -> bool:
    """Whether this XLA is known to know the options asked of it here: one that it does not ends the process."""
    return (0, 7) <= tuple(int(n) for n in version("jaxlib").split(".")[:2]) <= (0, 11)


def cache_folder() -> Path | None:
    """Where compiled functions are kept: ``SCPJAX_CACHE``, else the user's cache folder; None for nowhere."""
    told = os.environ.get("SCPJAX_CACHE")
    if told is not None:
        return Path(told).expanduser() if told else None
    if sys.platform == "win32":
        base = os.environ.get("LOCALAPPDATA") or "~/AppData/Local"
    elif sys.platform == "darwin":
        base = "~/Library/Caches"
    else:
        base = os.environ.get("XDG_CACHE_HOME") or "~/.cache"
    return Path(base).expanduser() / "scpjax"


@contextlib.contextmanager
def progress(arguments: Namespace) -> Iterator[Progress | None]:
    """A bar on stderr, in a terminal or when asked for; None where there is to be none."""
    if arguments.quiet or not (arguments.progress or sys.stderr.isatty()):
        yield None
        return
    from tqdm import tqdm

    form = "{percentage:3.0f}% |{bar:24}| {elapsed}  {desc}"
    with tqdm(total=1.0, bar_format=form, file=sys.stderr, leave=False) as bar:

        def show(text: str, fraction: float) -> None:
            bar.set_description_str(text, refresh=False)
            bar.n = min(max(fraction, bar.n), 1.0)
            bar.refresh()

        yield show


def say(arguments: Namespace, text: str = "") -> None:
    """Print for the user, unless quiet. Where nobody reads on (``| head``) what is being done is done all the same."""
    if arguments.quiet:
        return
    try:
        print(text, flush=True)
    except BrokenPipeError:
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())


def check_folder(out: str) -> Path:
    """``out`` as a folder that can be written, before any work is done; nothing is made yet."""
    path = Path(out)
    if path.exists() and not path.is_dir():
        raise OutputError("is a file, not a folder", where=f"--out {out}", mend="name a folder")
    _check_parents(path, out)
    return path


def check_file(out: str, *inputs: str, bench: str | None = None) -> Path:
    """``out`` as a CSV file that can be written and is none of ``inputs``; nor its TOML the ``bench``."""
    path = Path(out)
    if path.is_dir():
        raise OutputError("is a folder, not a file", where=f"--out {out}", mend="name a CSV file in it")
    if path.suffix.lower() != ".csv":
        raise OutputError("is no CSV file name", where=f"--out {out}", mend="end it in .csv")
    for given in inputs:
        if path.exists() and Path(given).exists() and path.samefile(given):
            raise OutputError("is also an input", where=f"--out {out}", mend="choose another name")
    if bench and path.with_suffix(".toml").resolve() == Path(bench).resolve():
        raise OutputError(f"its TOML is {bench}, the bench", where=f"--out {out}", mend="choose another name")
    _check_parents(path.parent, out)
    return path


def _check_parents(path: Path, out: str) -> None:
    for parent in (path, *path.absolute().parents):
        if parent.exists():
            if not parent.is_dir():
                raise OutputError(f"{parent} is a file", where=f"--out {out}", mend="choose another place")
            if not os.access(parent, os.W_OK | os.X_OK):
                raise OutputError(f"{parent} may not be written", where=f"--out {out}", mend="choose another place")
            return


@contextlib.contextmanager
def staged(out: Path) -> Iterator[Path]:
    """A folder to write in; what is in it at the end moves to ``out``, and on failure nothing does.

    Other files in ``out`` stay.
    """
    made: list[Path] = []
    try:
        for parent in reversed((out.absolute().parent, *out.absolute().parent.parents)):
            if not parent.exists():
                parent.mkdir()
                made.append(parent)
        beside = out if out.is_dir() else out.absolute().parent  # on the disk, and with the rights, of what is to be
        folder = Path(tempfile.mkdtemp(prefix=f".{out.name}.", dir=beside))
    except OSError as error:
        _remove(made)
        raise OutputError(f"cannot be made ({error.strerror})", where=f"--out {out}", mend="check it") from error
    try:
        yield folder
        _move(folder, out)
    except OSError as error:
        _remove(made)
        problem = f"cannot be written ({error.strerror})"
        raise OutputError(problem, where=f"--out {out}", mend="check the folder and the disk") from error
    except BaseException:
        shutil.rmtree(folder, ignore_errors=True)
        _remove(made)
        raise
    finally:
        shutil.rmtree(folder, ignore_errors=True)


def _move(folder: Path, out: Path) -> None:
    if not out.exists():
        os.chmod(folder, 0o755)
        os.replace(folder, out)
        return
    for source in sorted(folder.rglob("*")):
        target = out / source.relative_to(folder)
        if source.is_dir():
            target.mkdir(exist_ok=True)
        else:
            os.replace(source, target)


def _remove(made: list[Path]) -> None:
    for path in reversed(made):
        with contextlib.suppress(OSError):
            path.rmdir()
