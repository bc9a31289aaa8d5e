"""Imports point one way, mechanisms are complete, and importing the package is light."""

import ast
import importlib
import importlib.util
import math
import subprocess
import sys
from pathlib import Path

import pytest

import scpjax
from scpjax.physics.catalogue import NEEDS, catalogue, left_out
from scpjax.physics.structure import Structure

SOURCE = Path(scpjax.__file__).parent
RANK = {
    "errors": 0,
    "kept": 0,
    "units": 1,
    "parameter": 1,
    "abreast": 0,
    "compiled": 1,
    "recordings": 2,
    "physics": 3,
    "simulate": 4,
    "fit": 5,
    "control": 5,
    "diagnose": 6,
    "report": 7,
    "bench": 8,
    "cli": 9,
    "__main__": 10,
}
FILES = sorted(p for p in SOURCE.rglob("*.py") if p != SOURCE / "__init__.py")


def room(path: Path) -> str:
    """Top-level package or module of a source file."""
    return path.relative_to(SOURCE).parts[0].removesuffix(".py")


def imported(path: Path) -> set[str]:
    """Every module that a file imports, wherever in it."""
    names = set()
    for node in ast.walk(ast.parse(path.read_text())):
        if isinstance(node, ast.Import):
            names |= {alias.name for alias in node.names}
        elif isinstance(node, ast.ImportFrom):
            assert node.level == 0, f"{path} has a relative import"
            names |= {f"{node.module}.{alias.name}" for alias in node.names}
    return names


@pytest.mark.parametrize("path", FILES, ids=lambda p: str(p.relative_to(SOURCE)))
def test_imports_point_one_way(path):
    here = room(path)
    assert here in RANK, f"room {here} has no rank: say where it stands"
    for name in imported(path):
        parts = name.split(".")
        assert parts[0] not in ("fits", "rig", "tests"), f"{path} imports {name}"
        if parts[0] == "scpjax" and len(parts) > 1 and parts[1] in RANK and parts[1] != here:
            assert RANK[parts[1]] < RANK[here], f"{here} imports {parts[1]}"


@pytest.mark.parametrize("folder", ["benchmarks", "fits", "rig"])
def test_what_programs_import_is_there(folder):
    """Most of them no other test imports."""
    where = {}
    for path in (SOURCE.parent / folder).rglob("*.py"):
        for name in imported(path):
            if name.count(".") > 1 and name.startswith("scpjax."):
                where[name] = path.name
    assert where
    for name, user in where.items():
        module, _, thing = name.rpartition(".")
        found = hasattr(importlib.import_module(module), thing) or importlib.util.find_spec(name)
        assert found, f"{user} imports {name}"


def test_an_import_that_points_back_would_be_seen(tmp_path):
    file = tmp_path / "bad.py"
    file.write_text("def f():\n    from scpjax.fit import fit\n    import scpjax.cli\n")
    assert imported(file) == {"scpjax.fit.fit", "scpjax.cli"}


@pytest.mark.parametrize("name", sorted(catalogue()))
def test_mechanism_is_complete(name):
    m = catalogue()[name]
    assert (SOURCE / "physics" / "mechanisms" / f"{name}.py").exists()
    for text in (m.title, m.equation, m.source, m.says):
        assert text.strip()
    assert m.says.strip().endswith(".")
    assert m.subsystem in ("drive", "thermoelectric", "thermomechanical", "sensor") or m.name == "learned_swing"
    assert m.parameters
    assert len({p.name for p in m.parameters}) == len(m.parameters)
    assert {p.null is None for p in m.parameters} in ({True}, {False}), "either a base mechanism or one with nulls"
    for p in m.parameters:
        assert all((p.unit, p.symbol, p.description)), p.name
        low, high = p.bounds
        assert low < high
        if p.scale == "log" and not p.fixed:
            assert low > 0
            assert math.isfinite(high)


@pytest.mark.parametrize("m", left_out(), ids=lambda m: m.name)
def test_left_out_mechanism_can_be_tried(m):
    assert set(m.needs) <= set(NEEDS)
    assert all(0 <= law < len(m.laws) and set(needs) <= set(NEEDS) for law, needs in m.law_needs.items())
    assert m.starts, "a search needs a start"
    assert len(m.laws) >= 1
    for start in m.starts:
        assert len(start) == len(m.parameters)
        for value, p in zip(start, m.parameters, strict=True):
            assert p.fixed or p.time or p.bounds[0] <= value <= p.bounds[1], p.name
    for p in m.parameters:
        inside = p.bounds[0] <= p.null <= p.bounds[1]
        assert inside or (p.scale == "log" and p.null == 0), f"{p.name}: the null lies out of reach"
        assert p.fixed or math.isfinite(p.spread), f"{p.name} needs a prior to be diagnosed"
        assert not p.symbol.endswith("_ref") or p.symbol in m.equation, f"of what {p.symbol} is the measure"


def test_names_of_the_design_are_those_of_the_files():
    for name, m in catalogue().items():
        assert m.name == name
    assert Structure(name="te", mechanisms=tuple(catalogue().values())).slots


@pytest.mark.parametrize("module", ["scpjax", "scpjax.cli", "scpjax.bench"])
def test_import_is_light(module):
    if importlib.util.find_spec(module) is None:
        pytest.skip(f"skipped: no {module} yet")
    code = f"import sys, {module}; print(sorted({{'jax', 'matplotlib', 'scipy', 'control'}} & set(sys.modules)))"
    found = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert found.stdout.strip() == "[]"
