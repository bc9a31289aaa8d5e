"""A drive that stands a row too late is told of, and files may say that theirs does."""

import re

import numpy as np
import pytest

from scpjax.diagnose.diagnose import _base
from scpjax.diagnose.holdout import Split
from scpjax.diagnose.hypothesis import State
from scpjax.diagnose.rows import drive_until_then
from scpjax.errors import RecordingError
from scpjax.fit.setup import prepare
from scpjax.physics.presets import te
from scpjax.recordings.files import read_recording, write_recording
from scpjax.recordings.plausible import LOOK
from scpjax.recordings.recording import Metadata, Recording
from scpjax.simulate.simulate import simulate

HEATER = te(resistance=3.2, conductance=0.06, thermal_mass=0.26)


def recorded(*, late: bool, dead: float = 0.0) -> Recording:
    """A heater, driven by what stands in its rows or, ``late``, in the row after; behind a dead zone [V]."""
    t = 0.1 * np.arange(900)
    volts = np.array([0.0, 2.0, 1.0, 2.5, 0.5, 0.0, 1.5, 2.5, 0.0])[np.arange(900) // 100]
    meta = Metadata(ambient_K=float(HEATER.ambient), known=(("resistance_ohm", 3.2),), model="te")
    reaching = {"voltage_V": np.maximum(volts - dead, 0.0)}
    blank = Recording.from_arrays(t, reaching, {"temperature_degC": np.zeros(900)}, metadata=meta)
    exact = np.asarray(simulate(HEATER, blank).outputs)
    noisy = exact + 0.05 * np.random.default_rng(2).standard_normal(exact.shape)
    said = np.concatenate([volts[:1], volts[:-1]]) if late else volts
    return blank.with_inputs(said[:, None]).with_outputs(noisy)


def fitted(recordings: list[Recording]) -> tuple[Split, State]:
    return _base(prepare(recordings))[:2]


@pytest.mark.parametrize(("late", "dead", "told"), [(True, 0.0, True), (False, 0.3, False), (False, 0.0, False)])
def test_it_is_told_where_the_rows_before_explain_it(late, dead, told):
    mine = [recorded(late=late, dead=dead)]
    parts, base = fitted(mine)
    asked: list[bool] = []
    notes = drive_until_then(base, parts, mine, lambda others: (asked.append(True), fitted(others))[1])
    assert bool(asked) is (late or dead > 0.0)  # at the noise nothing is
    assert len(notes) == told
    if told:
        assert 'hold = "next" under [recording]' in notes[0]
        left, now = (float(n) for n in re.findall(r"([0-9.]+) times the noise in place of ([0-9.]+)", notes[0])[0])
        assert notes[0].startswith(LOOK)  # so that the terminal tells it too
        assert left < 1.1 < 2.0 < now


def test_what_does_not_hold_its_drive_is_not_asked():
    (one,) = mine = [recorded(late=True)]
    parts, base = fitted(mine)
    other = {c.column: c.unit.from_si(x) for c, x in zip(one.output_channels, one.outputs.T, strict=True)}
    mine = [Recording.from_arrays(one.time, {"voltage_V": one.inputs[:, 0]}, other, hold="linear")]
    assert drive_until_then(base, parts, mine, lambda _: pytest.fail("asked")) == ()


def test_a_drive_that_changes_after_the_first_row_only_is_not_asked():
    """A row earlier it would be constant, of which nothing can be fitted."""
    (one,) = [recorded(late=False, dead=0.3)]
    mine = [one.with_inputs(np.where(np.arange(900)[:, None] > 0, 2.0, 0.0))]
    parts, base = fitted(mine)
    with pytest.raises(RecordingError, match="never changes"):
        fitted([one.with_inputs(np.full((900, 1), 2.0))])
    assert drive_until_then(base, parts, mine, fitted) == ()


def test_a_file_may_say_it(tmp_path):
    """And the drive that reached the heater is read."""
    write_recording(recorded(late=True), tmp_path / "run.csv")
    toml = tmp_path / "run.toml"
    toml.write_text(toml.read_text().replace('hold = "zero_order"', 'hold = "next"'))
    read = read_recording(tmp_path / "run.csv")
    assert read.hold == "zero_order"
    np.testing.assert_array_equal(read.inputs, recorded(late=False).inputs)
