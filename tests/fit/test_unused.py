"""What the recordings say that a model has no use for is told, and nothing else is."""

import numpy as np
import pytest

from scpjax.errors import RecordingError
from scpjax.fit.setup import KNOWN, prepare
from scpjax.recordings import read_recording
from scpjax.recordings.plausible import LOOK


def told(tmp_path, columns, actuator=""):
    t = np.arange(0.0, 30.0, 0.1)
    drive = np.where(t % 20 < 10, 2.0, 0.5)
    answer = 3 - 3 * np.exp(-t / 5) + 0.01 * np.random.default_rng(1).normal(size=t.size)
    rows = "\n".join(
        ",".join(f"{x:.6g}" for x in (a, b, *[c] * len(columns))) for a, b, c in zip(t, drive, answer, strict=True)
    )
    (tmp_path / "a.csv").write_text(f"time_s,voltage_V,{','.join(columns)}\n{rows}\n")
    (tmp_path / "a.toml").write_text(f"[environment]\nambient_degC = 20\n[actuator]\n{actuator}\n")
    return prepare([read_recording(tmp_path / "a.csv")]).notes


def test_a_column_that_no_model_gives(tmp_path):
    notes = told(tmp_path, ("displacement_mm", "force_N"))
    assert [n for n in notes if "not fitted" in n] == [
        "force_N is not fitted: the model plant gives temperature, displacement"
    ]


def test_what_is_not_fitted_may_stand_still(tmp_path):
    """The load of an isotonic test, beside a displacement; one that should have moved is refused."""
    told(tmp_path, ("displacement_mm", "force_N"))
    lines = (tmp_path / "a.csv").read_text().splitlines()

    def still(at):
        cells = [line.split(",") for line in lines[1:]]
        return [lines[0], *(",".join([*row[:at], "1.5", *row[at + 1 :]]) for row in cells)]

    (tmp_path / "a.csv").write_text("\n".join(still(3)))
    assert any("force_N is not fitted" in n for n in prepare([read_recording(tmp_path / "a.csv")]).notes)
    (tmp_path / "a.csv").write_text("\n".join(still(2)))
    with pytest.raises(RecordingError, match="displacement_mm never changes"):
        prepare([read_recording(tmp_path / "a.csv")])


@pytest.mark.parametrize(("key", "said"), [("mass_kg", True), ("moving_mass_kg", False), ("supply_V", False)])
def test_a_key_that_is_no_parameter(tmp_path, key, said):
    notes = [n for n in told(tmp_path, ("displacement_mm",), f"{key} = 0.3") if "not used" in n]
    assert [n.removeprefix(LOOK).split()[0] for n in notes] == [key] * said
    assert all(known in n for n in notes for known in KNOWN)


def test_nothing_is_told_where_all_is_used(tmp_path):
    assert not [n for n in told(tmp_path, ("displacement_mm",)) if "not used" in n or "not fitted" in n]
