"""What all tests share: double precision, a cache of compiled functions, and where the recordings lie."""

import os
import tempfile
from pathlib import Path

import jax
import pytest

jax.config.update("jax_enable_x64", True)
jax.config.update(
    "jax_compilation_cache_dir",
    os.environ.get("JAX_COMPILATION_CACHE_DIR", str(Path(tempfile.gettempdir()) / f"scpjax-tests-{os.getuid()}")),
)
jax.config.update("jax_persistent_cache_min_compile_time_secs", 0.1)

ROOT = Path(__file__).resolve().parents[1]


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


@pytest.fixture(scope="module", autouse=True)
def _few_programs_at_a_time():
    """Compiled programs are dropped after each module: a process may map only so many pieces of memory (65530)."""
    yield
    jax.clear_caches()
