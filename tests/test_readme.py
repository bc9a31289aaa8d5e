"""The README's examples run, its table is the catalogue, and its first lines are those that CI runs.

``python tests/test_readme.py`` writes the table of mechanisms anew.
"""

import re
from pathlib import Path

import once
import pytest

from scpjax.cli import build_parser
from scpjax.physics.catalogue import left_out

ROOT = Path(__file__).resolve().parents[1]
README = ROOT / "README.md"
TABLE = re.compile(r"(<!-- mechanisms: .*? -->\n)(.*?)(<!-- end of mechanisms -->)", re.DOTALL)
ORDER = ("drive", "thermoelectric", "thermomechanical", "sensor")


def blocks(kind: str) -> list[str]:
    """Fenced blocks of a language."""
    return re.findall(rf"^```{kind}\n(.*?)^```", README.read_text(encoding="utf-8"), re.DOTALL | re.MULTILINE)


def table() -> str:
    """The catalogue's left-out mechanisms as a Markdown table."""
    found = sorted(left_out(), key=lambda m: (ORDER.index(m.subsystem), m.name))
    rows = [f"| `{m.name}` | {m.says} | {m.subsystem} |" for m in found]
    return "\n".join(["| name | what it is | where |", "|---|---|---|", *rows]) + "\n"


def test_the_first_block_is_the_two_lines():
    first = blocks("")[0].splitlines()
    assert [re.sub(r"\s*#.*", "", line) for line in first] == [
        "python -m pip install . && scpjax demo",
        "python -m pip install '.[test]' && python -m pytest",
    ]
    assert README.read_text(encoding="utf-8").index("```") < 60


def test_the_table_lists_the_catalogue():
    match = TABLE.search(README.read_text(encoding="utf-8"))
    assert match, "the markers of the table are gone"
    assert match[2] == table(), "run: python tests/test_readme.py"


def test_the_commands_are_those_of_the_program():
    named = set(re.findall(r"^\| `scpjax (\w+)", README.read_text(encoding="utf-8"), re.MULTILINE))
    places = next(a for a in build_parser()._actions if a.dest == "command")
    assert named == set(places.choices or ())


def test_the_toml_example_is_read(tmp_path):
    from scpjax.recordings import read_recording

    rows = "\n".join(f"{0.1 * i:.1f},{i % 3},{i % 5}" for i in range(20))
    (tmp_path / "a.csv").write_text(f"time_s,voltage_V,displacement_mm\n{rows}\n")
    (tmp_path / "a.toml").write_text(blocks("toml")[0])
    recording = read_recording(tmp_path / "a.csv")
    assert recording.metadata.model == "plant"
    assert recording.metadata.get_known("resistance_ohm") == 1.2
    assert recording.metadata.pulley_radius_m == 0.02


def test_the_examples_run(tmp_path, monkeypatch, capsys):
    once.share(monkeypatch)
    monkeypatch.chdir(tmp_path)
    examples = blocks("python")
    assert len(examples) == 5
    space: dict = {"__name__": "readme"}
    for i, code in enumerate(examples):
        exec(compile(code, f"README.md, python block {i + 1}", "exec"), space)
    said = capsys.readouterr().out
    assert space["slope"] != 0
    # the example was made with creep (fits/demo/truth.json): a share of 0.35 that takes 15 s
    assert [m.name for m in space["diagnosis"].mechanisms] == ["creep"]
    found = space["diagnosis"].mechanisms[0].parameters
    for name, truth in (("compliance", 0.35), ("time_constant", 15.0)):
        assert found[name].value == pytest.approx(truth, abs=4 * found[name].std)
    assert "creep.compliance = 0.35" in said
    assert not list(tmp_path.iterdir()), "an example left a file behind"


if __name__ == "__main__":
    text = README.read_text(encoding="utf-8")
    README.write_text(TABLE.sub(lambda m: m[1] + table() + m[3], text), encoding="utf-8")
