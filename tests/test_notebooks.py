"""Every notebook is a notebook, holds no outputs, and runs from top to bottom."""

import json
from pathlib import Path

import matplotlib as mpl
import once
import pytest

ROOT = Path(__file__).resolve().parents[1]
NOTEBOOKS = sorted((ROOT / "notebooks").glob("*.ipynb"))
SAYS = {
    "first_diagnosis": ("EXPLAINED", "creep"),  # fits/demo/truth.json
    "thesis": ("measured 102.84 N/m", "and a dead time: off by 1 % of the spread", "a stiffness beside the springs"),
}


def cells(path: Path) -> list[dict]:
    """Cells of a notebook."""
    return json.loads(path.read_text(encoding="utf-8"))["cells"]


def test_there_is_a_notebook():
    assert [p.stem for p in NOTEBOOKS] == sorted(SAYS)


@pytest.mark.parametrize("path", NOTEBOOKS, ids=lambda p: p.stem)
def test_it_is_in_the_format_and_without_outputs(path):
    content = json.loads(path.read_text(encoding="utf-8"))
    assert content["nbformat"] == 4
    assert content["nbformat_minor"] >= 5
    assert {"kernelspec", "language_info"} <= set(content["metadata"])
    ids = [c["id"] for c in content["cells"]]
    assert len(set(ids)) == len(ids)
    for cell in content["cells"]:
        code = {"execution_count", "outputs"} if cell["cell_type"] == "code" else set()
        assert set(cell) == {"cell_type", "id", "metadata", "source"} | code
        assert not cell.get("outputs")


@pytest.mark.parametrize("path", NOTEBOOKS, ids=lambda p: p.stem)
def test_it_runs(path, tmp_path, monkeypatch, capsys):
    mpl.use("Agg")
    from matplotlib import pyplot as plt

    once.share(monkeypatch)
    monkeypatch.chdir(tmp_path)
    space: dict = {"__name__": path.stem}
    with plt.rc_context():
        for cell in cells(path):
            if cell["cell_type"] == "code":
                exec(compile("".join(cell["source"]), f"{path.name}, {cell['id']}", "exec"), space)
        assert len(plt.get_fignums()) == sum("plt.show()" in "".join(c["source"]) for c in cells(path))
        plt.close("all")
    said = capsys.readouterr().out
    for words in SAYS[path.stem]:
        assert words in said
    assert not list(tmp_path.iterdir())
