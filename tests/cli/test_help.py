"""The program answers at once where nothing is to be computed."""

import os
import subprocess
import sys
import time

import pytest

import scpjax
from scpjax.cli import main

COMMANDS = ("simulate", "fit", "diagnose", "predict", "fleet", "loop", "tune", "rig", "demo")


def test_help_is_quick():
    took = []
    for _ in range(3):
        began = time.perf_counter()
        found = subprocess.run([sys.executable, "-m", "scpjax.cli", "--help"], capture_output=True, text=True)
        took.append(time.perf_counter() - began)
        assert found.returncode == 0
        assert all(name in found.stdout for name in COMMANDS)
    assert min(took) < 0.5


def test_help_imports_nothing_heavy():
    code = (
        "import sys, scpjax.cli\n"
        "try: scpjax.cli.main(['diagnose', '--help'])\n"
        "except SystemExit as e: assert e.code == 0\n"
        "print(sorted({'jax', 'numpy', 'scipy', 'matplotlib', 'tqdm'} & set(sys.modules)))"
    )
    found = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert found.stdout.strip().endswith("[]")


def test_it_runs_as_a_module_too():
    told = subprocess.run([sys.executable, "-m", "scpjax", "--version"], capture_output=True, text=True, check=True)
    assert told.stdout == f"scpjax {scpjax.__version__}\n"


def test_version(capsys):
    with pytest.raises(SystemExit) as left:
        main(["--version"])
    assert left.value.code == 0
    assert capsys.readouterr().out == f"scpjax {scpjax.__version__}\n"


@pytest.mark.parametrize("name", COMMANDS)
def test_every_command_has_help(name, capsys):
    with pytest.raises(SystemExit) as left:
        main([name, "--help"])
    assert left.value.code == 0
    assert "--out" in capsys.readouterr().out


def test_cache_follows_the_environment(monkeypatch, tmp_path):
    from scpjax.cli.program import cache_folder

    monkeypatch.setenv("SCPJAX_CACHE", str(tmp_path))
    assert cache_folder() == tmp_path
    monkeypatch.setenv("SCPJAX_CACHE", "")
    assert cache_folder() is None
    monkeypatch.delenv("SCPJAX_CACHE")
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path))
    if sys.platform.startswith("linux"):
        assert cache_folder() == tmp_path / "scpjax"


def test_what_the_user_told_the_compiler_is_left(monkeypatch):
    from scpjax.cli.program import LOOPS, start

    for mine in ("--xla_backend_extra_options=mine=1", "--xla_disable_hlo_passes=mine"):
        monkeypatch.setenv("XLA_FLAGS", mine)
        start()
        assert os.environ["XLA_FLAGS"] == mine
    monkeypatch.setenv("XLA_FLAGS", "--xla_cpu_enable_fast_math=false")
    start()
    start()
    assert os.environ["XLA_FLAGS"] == f"--xla_cpu_enable_fast_math=false {LOOPS}"


@pytest.mark.parametrize(
    ("told", "taken"),
    [({}, "cpu"), ({"JAX_PLATFORMS": "cuda"}, "cuda"), ({"JAX_PLATFORM_NAME": "gpu"}, "None")],
)
def test_runs_on_the_processor_unless_told_otherwise(told, taken):
    """Also where a command's module has imported JAX, which reads what it is told as it is imported."""
    others = {k: v for k, v in os.environ.items() if not k.startswith("JAX_PLATFORM")}
    asked = "import jax; from scpjax.cli.program import start; start(); print(jax.config.jax_platforms)"
    found = subprocess.run(
        [sys.executable, "-c", asked],
        env=others | told,
        capture_output=True,
        text=True,
        check=True,
    )
    assert found.stdout.strip() == taken


def test_goes_on_where_nobody_reads_what_it_says():
    """As behind ``| head``: what a command says after that is lost, what it does is not."""
    lines = "[say(told, 'x' * 1000) for _ in range(200)]"
    asked = (
        f"from argparse import Namespace; from scpjax.cli.program import say; told = Namespace(quiet=False); {lines}"
    )
    done = f"{asked}; import sys; print('done', file=sys.stderr)"
    process = subprocess.Popen([sys.executable, "-c", done], stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True)
    assert process.stdout is not None
    assert process.stderr is not None
    process.stdout.close()
    assert process.stderr.read().strip() == "done"
    assert process.wait() == 0
