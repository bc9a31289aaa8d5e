"""The Recording itself: units, weights, slices, validation, pandas, and that it is a pytree."""

import math

import jax
import numpy as np
import pandas as pd
import pytest

from scpjax.errors import RecordingError
from scpjax.recordings import Metadata, Recording, check_informative, from_pandas, to_pandas
from scpjax.units import UNITS, get_unit, parse_column

TIME = np.arange(20) * 0.1


def make(**changes):
    options = {
        "time": TIME,
        "inputs": {"voltage_V": np.where(TIME > 0.5, 3.0, 0.0)},
        "outputs": {"temperature_degC": 23 + TIME, "displacement_mm": TIME**2},
    }
    options.update(changes)
    time, inputs, outputs = (options.pop(key) for key in ("time", "inputs", "outputs"))
    return Recording.from_arrays(time, inputs, outputs, **options)


@pytest.mark.parametrize("unit", UNITS, ids=lambda u: u.suffix)
def test_units_round_trip(unit):
    x = np.array([-3.0, 0.0, 7.25])
    np.testing.assert_allclose(unit.from_si(unit.to_si(x)), x, atol=1e-12)


@pytest.mark.parametrize(
    ("column", "raw", "stem", "si", "value"),
    [
        ("temperature_agonist_degC", 100.0, "temperature_agonist", "K", 373.15),
        ("displacement_mm", 12.0, "displacement", "m", 0.012),
        ("angle_deg", 180.0, "angle", "rad", math.pi),
        ("pressure_psi", 14.6959, "pressure", "Pa", 101325.0),
        ("pressure_bar", 1.01325, "pressure", "Pa", 101325.0),
        ("heater_pct", 25.0, "heater", "pct", 25.0),
        ("current_mA", 125.0, "current", "A", 0.125),
        ("pwm", 200.0, "pwm", "pwm", 200.0),
        ("pwm_agonist", 200.0, "pwm_agonist", "pwm", 200.0),
        ("load_g", 82.7, "load", "kg", 0.0827),
    ],
)
def test_parse_column(column, raw, stem, si, value):
    found, unit = parse_column(column)
    assert (found, unit.si) == (stem, si)
    assert unit.to_si(raw) == pytest.approx(value, rel=1e-5)


def test_unknown_units():
    with pytest.raises(RecordingError, match="_degC"):
        parse_column("neighbour_degc")
    with pytest.raises(RecordingError, match="displacement_mm"):
        parse_column("displacement_inch", allow_unknown=True)
    with pytest.raises(RecordingError, match="degC"):
        get_unit("F")
    assert parse_column("level_foo", allow_unknown=True)[1].scale == 1.0
    assert parse_column("speed_m_per_s", allow_unknown=True)[1].quantity == "unknown"


def test_properties():
    recording = make()
    assert recording.n == 20
    assert recording.duration == pytest.approx(1.9)
    assert recording.period == pytest.approx(0.1)
    assert recording.is_uniform
    assert recording.dtype == np.float64
    assert recording.output("temperature")[0] == pytest.approx(296.15)
    assert recording.output("displacement")[10] == pytest.approx(1e-3)
    assert "voltage_V -> temperature_degC, displacement_mm" in repr(recording)
    assert len(repr(recording)) < 150


def test_uniform_allows_rounding_only():
    step = 0.0016384
    long = np.arange(5000)
    rounded = np.round(long * step, 6)
    inputs, outputs = {"voltage_V": long % 7}, {"level_V": long}
    assert Recording.from_arrays(rounded, inputs, outputs).is_uniform
    assert not make(time=TIME + 0.01 * (np.arange(20) == 7)).is_uniform


def test_nan_in_output_is_weight_0():
    values = TIME**2
    values[[0, 5, 6]] = np.nan
    recording = make(outputs={"displacement_mm": values})
    np.testing.assert_array_equal(recording.weights[:, 0] == 0, np.isnan(values))
    assert all(np.isfinite(leaf).all() for leaf in jax.tree.leaves(recording))
    assert recording.outputs[5, 0] * 1e3 == pytest.approx(0.16 + (0.49 - 0.16) / 3)


def test_slice_select_weights():
    recording = make()
    part = recording.slice(0.5, 1.5)
    np.testing.assert_allclose(part.time, TIME[5:15])
    np.testing.assert_array_equal(part.outputs, recording.outputs[5:15])
    assert recording.slice().n == 20
    only = recording.select_outputs("displacement")
    assert only.outputs.shape == (20, 1)
    assert only.output_channels[0].column == "displacement_mm"
    assert np.all(recording.with_weights(0.5).weights == 0.5)
    with pytest.raises(RecordingError, match="at least 8"):
        recording.slice(0.0, 0.3)
    with pytest.raises(RecordingError, match="temperature, displacement"):
        recording.select_outputs("angle")
    with pytest.raises(RecordingError, match="voltage"):
        recording.input("power")


@pytest.mark.parametrize(
    ("changes", "words"),
    [
        ({"time": TIME[::-1]}, ("sample 1", "sort")),
        ({"time": np.where(TIME[4] == TIME, TIME[3], TIME)}, ("sample 4", "repeated")),
        ({"time": np.where(TIME[4] == TIME, np.nan, TIME)}, ("sample 4", "repair")),
        ({"inputs": {}}, ("no inputs", "at least one")),
        ({"outputs": {}}, ("no outputs", "at least one")),
        ({"inputs": {"voltage_V": np.ones(19)}}, ("voltage_V", "one value per time")),
        ({"inputs": {"voltage_V": TIME + np.nan}}, ("sample 0, column voltage_V", "fill it in")),
        ({"outputs": {"force_N": TIME + np.inf}}, ("infinite", "empty")),
        ({"outputs": {"displacement_mm": TIME, "displacement_cm": TIME}}, ("twice", "keep one")),
        ({"hold": "zoh"}, ("zoh", "use one of")),
        ({"outputs": {"displacement_inch": TIME}}, ("displacement_inch", "displacement_mm")),
    ],
)
def test_validation(changes, words):
    with pytest.raises(RecordingError) as caught:
        make(metadata=Metadata(path="lab/run.csv"), **changes)
    for word in words:
        assert word in str(caught.value)


def test_check_informative():
    check_informative(make())
    with pytest.raises(RecordingError, match=r"never changes.*step or multilevel"):
        check_informative(make(inputs={"voltage_V": np.full(20, 3.0)}))
    with pytest.raises(RecordingError, match=r"displacement_mm never changes"):
        check_informative(make(outputs={"displacement_mm": np.zeros(20)}))
    with pytest.raises(RecordingError, match=r"displacement_mm has no values"):
        check_informative(make(outputs={"displacement_mm": np.full(20, np.nan)}))


def test_is_a_pytree():
    recording = make()
    assert len(jax.tree.leaves(recording)) == 4
    doubled = jax.tree.map(lambda x: 2 * x, recording)
    np.testing.assert_array_equal(doubled.outputs, 2 * recording.outputs)
    total = jax.jit(lambda r: (r.outputs * r.weights).sum())(recording)
    assert float(total) == pytest.approx(float(recording.outputs.sum()), rel=1e-5)
    assert hash(recording.metadata) == hash(Metadata())
    assert "voltage_V" in repr(jax.tree.map(lambda x: None, recording))


def test_pandas_round_trip():
    values = TIME**2
    values[3] = np.nan
    recording = make(outputs={"displacement_mm": values, "temperature_degC": 23 + TIME})
    frame = to_pandas(recording)
    assert list(frame.columns) == ["time_s", "voltage_V", "displacement_mm", "temperature_degC"]
    assert np.isnan(frame["displacement_mm"][3])
    again = from_pandas(frame, response="displacement_mm,temperature_degC")
    np.testing.assert_allclose(again.outputs, recording.outputs, rtol=1e-12)
    np.testing.assert_array_equal(again.weights, recording.weights)
    with pytest.raises(RecordingError, match="time_s"):
        from_pandas(pd.DataFrame({"voltage_V": TIME}))
