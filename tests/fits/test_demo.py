"""The packaged example comes out of its script byte for byte, and the script knows nothing of scpjax."""

import ast
import json
import subprocess
import sys
import tomllib
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[2]
SCRIPT = ROOT / "fits/demo/make_demo.py"
PACKAGED = ROOT / "scpjax/examples/demo"


@pytest.fixture(scope="module")
def made(tmp_path_factory) -> Path:
    """What the script writes now."""
    out = tmp_path_factory.mktemp("demo")
    call = [sys.executable, str(SCRIPT), "--out", str(out / "files"), "--truth", str(out / "truth.json")]
    subprocess.run(call, check=True, capture_output=True, cwd=out)
    return out


def test_the_script_makes_the_packaged_files(made):
    packaged = {p.name: p.read_bytes() for p in PACKAGED.iterdir()}
    assert set(packaged) == {"0_step.csv", "0_step.toml", "1_multilevel.csv", "1_multilevel.toml"}
    for name, content in packaged.items():
        assert (made / "files" / name).read_bytes() == content, name
    assert (made / "truth.json").read_bytes() == (SCRIPT.parent / "truth.json").read_bytes()


def test_the_script_has_its_own_equations():
    names = set()
    for node in ast.walk(ast.parse(SCRIPT.read_text())):
        if isinstance(node, ast.Import):
            names |= {alias.name.split(".")[0] for alias in node.names}
        elif isinstance(node, ast.ImportFrom):
            names.add((node.module or "").split(".")[0])
    assert names - set(sys.stdlib_module_names) == {"numpy", "scipy"}


def test_the_packaged_files_do_not_give_the_answer_away():
    truth = json.loads((SCRIPT.parent / "truth.json").read_text())
    for path in PACKAGED.iterdir():
        assert truth["mechanism"] not in (path.name + path.read_text()).lower()
    known = tomllib.loads((PACKAGED / "0_step.toml").read_text())["actuator"]
    assert set(known) == {"resistance_ohm", "moving_mass_kg"}
