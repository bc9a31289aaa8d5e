"""Mechanisms of other packages, by entry point."""

import sys
from importlib.metadata import EntryPoint
from pathlib import Path

import pytest

from scpjax.errors import ModelError
from scpjax.physics import catalogue as room
from scpjax.physics.catalogue import catalogue, is_shipped, mechanism

EXAMPLE = Path(__file__).resolve().parents[2] / "examples" / "evaporation.py"


@pytest.fixture
def offered(tmp_path, monkeypatch):
    """Installs a package whose ``__init__`` is the text given, beside a module that defines evaporation."""
    monkeypatch.syspath_prepend(tmp_path)

    def offer(init: str) -> None:
        package = tmp_path / "wetwires"
        package.mkdir()
        (package / "__init__.py").write_text(init)
        (package / "drying.py").write_text(EXAMPLE.read_text())
        point = EntryPoint("wet", "wetwires", room.GROUP)
        monkeypatch.setattr(room, "entry_points", lambda group: [point] if group == room.GROUP else [])
        room._installed.cache_clear()

    yield offer
    monkeypatch.undo()
    room._installed.cache_clear()
    for name in ("wetwires", "wetwires.drying"):
        sys.modules.pop(name, None)


def test_a_package_may_gather_its_classes_from_modules_below_it(offered):
    offered("from wetwires.drying import Evaporation\n\nDrying = Evaporation\n")
    assert type(catalogue()["evaporation"]).__module__ == "wetwires.drying"
    assert not is_shipped(mechanism("evaporation"))
    assert is_shipped(mechanism("creep"))


def test_what_a_package_only_uses_of_others_is_not_its_own(offered):
    offered("from scpjax.physics.mechanisms.creep import Creep\n")
    with pytest.raises(ModelError, match="entry point wetwires: defines no Mechanism"):
        catalogue()
