"""What all tests share: double precision, programs compiled quickly and kept, and where the recordings lie."""

import os
import sys
import tempfile
from pathlib import Path
from typing import Any

from scpjax.cli.program import LOOPS, knows_options, one_thread_for_blas

if "numpy" not in sys.modules:  # which reads it once
    one_thread_for_blas()
if knows_options():
    # most programs here run for milliseconds: those that run longer ask for more (`scpjax.compiled`)
    quick = "backend_optimization_level=0 cpu_use_fusion_emitters=false llvm_disable_expensive_passes=true"
    os.environ.setdefault("XLA_FLAGS", " ".join([*(f"--xla_{flag}" for flag in quick.split()), LOOPS]))

import jax
import pytest

from scpjax import kept
from scpjax.compiled import forget

jax.config.update("jax_enable_x64", True)
jax.config.update(
    "jax_compilation_cache_dir",
    os.environ.get("JAX_COMPILATION_CACHE_DIR", str(Path(tempfile.gettempdir()) / f"scpjax-tests-{os.getuid()}")),
)
jax.config.update("jax_persistent_cache_min_compile_time_secs", 0.1)

ROOT = Path(__file__).resolve().parents[1]


_LONGEST = ("acceptance", "test_notebooks.py", "test_readme.py", "test_experiment.py", "test_recovery.py", "physics")
_DOCUMENTS = ("test_notebooks.py", "test_readme.py")  # they diagnose the same example, once


@pytest.hookimpl(optionalhook=True)
def pytest_xdist_make_scheduler(config: pytest.Config, log: Any) -> Any:
    """Tests of a file stay in one process, and so do those of documents."""
    from xdist.scheduler import LoadScopeScheduling

    class Files(LoadScopeScheduling):
        def _split_scope(self, nodeid: str) -> str:
            file = nodeid.split("::")[0]
            return "documents" if Path(file).name in _DOCUMENTS else file

    return Files(config, log)


def pytest_collection_modifyitems(items: list[pytest.Item]) -> None:
    """Files with the longest tests begin first."""
    items.sort(key=lambda item: next((i for i, name in enumerate(_LONGEST) if name in item.path.parts), len(_LONGEST)))


def _folder(path: Path) -> Path:
    if not path.is_dir():
        pytest.skip("skipped: no data")
    return path


@pytest.fixture(scope="session")
def data_dir() -> Path:
    """Real recordings: $SCPJAX_DATA, else shared/data beside the repository."""
    return _folder(Path(os.environ.get("SCPJAX_DATA", ROOT.parent / "shared" / "data")))


@pytest.fixture(scope="session")
def practice_dir() -> Path:
    """Made recordings with the truth beside: the sibling of the real ones."""
    data = Path(os.environ.get("SCPJAX_DATA", ROOT.parent / "shared" / "data"))
    return _folder(data.parent / "practice")


@pytest.fixture(autouse=True)
def _programs_of_a_call_are_its_own():
    """What the command line keeps between calls is not for tests that play parts of the package."""
    yield
    kept.keep_in(None)


@pytest.fixture(scope="module", autouse=True)
def _few_programs_at_a_time():
    """Compiled programs are dropped after each module: a process may map only so many pieces of memory (65530)."""
    yield
    forget()
