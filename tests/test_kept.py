"""Programs kept between processes: the same results, not traced again, and never one made from something else."""

import os
import subprocess
import sys

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest

from scpjax import kept
from scpjax.compiled import quickly_compiled
from scpjax.physics import presets
from scpjax.physics.catalogue import catalogue


class Line(eqx.Module):
    slope: jax.Array
    name: str = eqx.field(static=True)


@pytest.fixture
def folder(tmp_path):
    kept.keep_in(tmp_path)
    yield tmp_path
    kept.keep_in(None)


def another_process():
    """What one that begins now knows: the files."""
    kept.keep_in(kept._folder)


def traced_function():
    """(a function, how often it was traced)."""
    traces = []

    @quickly_compiled
    def function(x, options):
        traces.append(options)
        return {"scaled": x * options["by"], "said": (options["name"], None), "sum": jnp.sum(x)}

    return function, traces


def programs(folder):
    return sorted(p for p in folder.rglob("*") if p.is_file())


def test_nothing_is_traced_twice_and_the_results_are_the_same(folder):
    function, traces = traced_function()
    x = np.linspace(0.1, 2.0, 7)
    kept.keep_in(None)
    plain = function(x, {"by": 1 / 3, "name": "a"})
    assert len(traces) == 1
    kept.keep_in(folder)
    results = [function(x, {"by": 1 / 3, "name": "a"}) for _ in range(2)]
    another_process()
    results.append(function(x, {"by": 1 / 3, "name": "a"}))
    assert len(traces) == 2
    assert len(programs(folder)) == 1
    for found in results:
        assert found["said"] == ("a", None)
        for key in ("scaled", "sum"):
            assert np.asarray(found[key]).tobytes() == np.asarray(plain[key]).tobytes()


@pytest.mark.parametrize(
    ("x", "options"),
    [
        (np.ones(3), {"by": 3.0, "name": "a"}),
        (np.ones(3), {"by": 2.0, "name": "b"}),
        (np.ones(4), {"by": 2.0, "name": "a"}),
        (np.ones(3, np.float32), {"by": 2.0, "name": "a"}),
        (np.ones(3), {"name": "a", "by": 2.0, "more": 0}),
        (np.ones(3), {"name": "a", "by": 2}),
    ],
)
def test_another_constant_or_shape_is_another_program(folder, x, options):
    function, traces = traced_function()
    function(np.ones(3), {"by": 2.0, "name": "a"})
    another_process()
    found = function(x, options)
    np.testing.assert_allclose(found["scaled"], x * options["by"])
    assert found["said"][0] == options["name"]
    assert len(traces) == len(programs(folder)) == 2


def test_other_code_is_another_program(folder, monkeypatch):
    function, traces = traced_function()
    for code in (("1",), ("2",)):
        monkeypatch.setattr(kept, "_code", lambda code=code: code)
        another_process()
        function(np.ones(3), {"by": 2.0, "name": "a"})
    assert len(traces) == 2
    assert len({p.parent for p in programs(folder)}) == 2


def test_a_setting_of_jax_makes_another_program(folder):
    function, traces = traced_function()
    function(np.ones(3), {"by": 2.0, "name": "a"})
    before = jax.config.jax_default_matmul_precision
    jax.config.update("jax_default_matmul_precision", "highest")
    try:
        another_process()
        function(np.ones(3), {"by": 2.0, "name": "a"})
    finally:
        jax.config.update("jax_default_matmul_precision", before)
    assert len(traces) == len(programs(folder)) == 2


def test_a_changed_file_of_the_package_changes_the_code(tmp_path, monkeypatch):
    place = tmp_path / "scpjax"
    place.mkdir()
    (place / "kept.py").write_text("")
    monkeypatch.setattr(kept, "__file__", str(place / "kept.py"))
    seen = set()
    for name, text in (("kept.py", ""), ("kept.py", "x = 1"), ("more.py", ""), ("more.py", "y = 1")):
        (place / name).write_text(text)
        kept._code.cache_clear()
        seen.add(kept._code())
    kept._code.cache_clear()
    assert len(seen) == 4


def test_what_is_defined_elsewhere_is_not_kept(folder):
    """Its code may change, and nothing here would notice."""
    function = quickly_compiled(lambda line, x: line.slope * x)
    for _ in range(2):
        assert function(Line(jnp.asarray(2.0), "a"), np.ones(2)).tolist() == [2.0, 2.0]
        another_process()
    assert programs(folder) == []


def test_a_mechanism_of_the_package_is_kept_and_one_of_ones_own_is_not(folder):
    function = quickly_compiled(lambda m, x: x * len(m.name))
    friction = catalogue()["friction"]
    assert function(friction, np.ones(2)).tolist() == [8.0, 8.0]
    assert len(programs(folder)) == 1

    class Mine(type(friction)):
        name = "mine"

    assert function(Mine(), np.ones(2)).tolist() == [4.0, 4.0]
    assert len(programs(folder)) == 1


def test_equal_arguments_find_the_same_program_whatever_was_asked_of_them_before(folder):
    function = quickly_compiled(lambda space, x: x * len(space.structure.slots))
    for asked in (False, True):
        model = presets.te(resistance=2.0, conductance=0.3, thermal_mass=2.0)
        model = eqx.tree_at(lambda m: m.theta, model, jnp.zeros(len(model.structure.slots)))
        if asked:
            assert model.structure.index
        function(model, np.ones(2))
        another_process()
        function(jax.tree.map(lambda x: x, model), np.ones(2))
        another_process()
    assert len(programs(folder)) == 1


@pytest.mark.parametrize(
    "damage", [lambda b: b[: len(b) // 2], lambda b: b"", lambda b: b"garbage", lambda b: b[:-1] + bytes([b[-1] ^ 1])]
)
def test_a_damaged_file_is_made_anew(folder, damage):
    function, traces = traced_function()
    function(np.ones(3), {"by": 2.0, "name": "a"})
    (file,) = programs(folder)
    whole = file.read_bytes()
    file.write_bytes(damage(whole))
    another_process()
    assert function(np.ones(3), {"by": 2.0, "name": "a"})["sum"] == 3.0
    assert len(traces) == 2
    another_process()
    assert function(np.ones(3), {"by": 2.0, "name": "a"})["sum"] == 3.0
    assert len(traces) == 2


def test_a_folder_that_cannot_be_written_to_keeps_nothing(tmp_path):
    place = tmp_path / "file"
    place.write_text("no folder")
    kept.keep_in(place)
    try:
        function, _ = traced_function()
        assert function(np.ones(3), {"by": 2.0, "name": "a"})["sum"] == 3.0
    finally:
        kept.keep_in(None)


def test_programs_of_versions_long_unused_are_removed(folder, monkeypatch):
    function, _ = traced_function()

    def run(code):
        monkeypatch.setattr(kept, "_code", lambda: (code,))
        another_process()
        function(np.ones(3), {"by": 2.0, "name": "a"})
        return kept._version()

    old, recent = run("old"), run("recent")
    os.utime(folder / "programs" / old, (0, 0))
    new = run("new")
    assert {p.name for p in (folder / "programs").iterdir()} == {recent, new}


STEP = "time_s,voltage_V,temperature_degC\n" + "".join(
    f"{0.5 * i},{3.0 * (i > 4)},{22.0 + 40.0 * (1 - np.exp(-max(i - 4, 0) / 30)):.3f}\n" for i in range(160)
)


def test_two_calls_of_the_program_say_the_same_and_the_second_traces_nothing(tmp_path):
    (tmp_path / "step.csv").write_text(STEP)
    found, files = [], []
    for i in range(2):
        out = tmp_path / f"found{i}"
        subprocess.run(
            [sys.executable, "-m", "scpjax.cli", "fit", str(tmp_path / "step.csv"), "--out", str(out)],
            check=True,
            env=os.environ | {"SCPJAX_CACHE": str(tmp_path / "cache")},
            capture_output=True,
        )
        found.append((out / "model.json").read_bytes())
        files.append({p: p.stat().st_mtime_ns for p in programs(tmp_path / "cache" / "programs")})
    assert found[0] == found[1]
    assert files[0] == files[1]
    assert any("_solve-" in p.name for p in files[0])
