"""Laws of the sensors, and the file that says what is connected."""

import numpy as np
import pytest

from scpjax.bench.errors import BenchError
from scpjax.bench.messages import Resistance
from scpjax.bench.wiring import Position, Sensing, Thermistors, Wiring, load_wiring, save_wiring


def test_thermistor_law_is_that_of_a_table():
    # 100 kohm, B 3950: resistances worked out by hand with the B equation
    law = Thermistors(fixed_ohm=10e3)
    for celsius, ohms in ((25.0, 100e3), (50.0, 35_896.0), (100.0, 6_972.0)):
        counts = 4096 * 10e3 / (10e3 + ohms) - 2.0
        assert float(law.temperature(counts)) - 273.15 == pytest.approx(celsius, abs=0.05)
        assert float(law.volts(celsius + 273.15)) == pytest.approx(5 * 10e3 / (10e3 + ohms), rel=2e-3)
    assert np.isnan(law.temperature(0))
    assert np.isnan(law.temperature(4092))
    counts = np.arange(-20, 4200)
    np.testing.assert_array_equal([law.reading(int(c)) for c in counts], law.temperature(counts))


def test_resistance_law_is_ohms():
    assert Sensing().resistance(4096 * 3.0 / 5.0 - 2) == pytest.approx(3.0 / 20 / 0.125)
    reading = Resistance(1, 0, 0, round(4096 * 3.0 / 5.0))
    assert Wiring().resistance(reading) == pytest.approx(1.2, abs=2e-3)


def test_voltage_of_a_duty_heats_as_the_duty():
    w = Wiring()
    pwm = np.arange(256)
    np.testing.assert_allclose(w.voltage(pwm) ** 2, pwm / 255 * 3.7**2)
    np.testing.assert_array_equal(w.pwm(w.voltage(pwm)), pwm)


@pytest.mark.parametrize("sides", [1, 2])
def test_bench_file_is_read_back(tmp_path, sides):
    wiring = Wiring(
        sides=sides,
        ambient_K=295.5,
        position=Position(source="echo", per_count=-8.5e-5, zero=1234.5),
        thermistors=Thermistors(fitted=False),
        known=(("resistance_ohm", 1.2),),
    )
    assert load_wiring(save_wiring(wiring, tmp_path / "bench.toml")) == wiring


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("supply = 3.7", "did you mean supply_V"),
        ("sides = 3", "sides is 1, or 2"),
        ("supply_V = -1", "above 0"),
        ("[position]\nsource = 'sonar'", "no position sensor 'sonar'"),
        ("[position]\nper_cuont = 1", "did you mean per_count"),
        ("[position]\nper_count = 0", "does not change"),
        ("[position]\nsource = 'echo'", "echo without per_count; give per_count, m per count"),
        ("sides = 2\n[position]\nsource = 'encoder'", "encoder without per_count; give per_count, rad per count"),
        ("position = 3", "is no section"),
        ("supply_V = ", "is not TOML"),
        ("supply_V = 'x'", "no finite number"),
    ],
)
def test_a_bad_bench_file_is_refused_in_one_line(tmp_path, text, words):
    path = tmp_path / "bench.toml"
    path.write_text(text)
    with pytest.raises(BenchError, match=words) as error:
        load_wiring(path)
    assert str(path) in str(error.value)
    assert "\n" not in str(error.value)


def test_the_usual_potentiometer_turns_the_pulley():
    """270 degrees over 4096 counts: metres at the rim of one actuator's pulley, radians of a joint."""
    one, two = Wiring(pulley_radius_m=0.02), Wiring(sides=2)
    turn = np.radians(270) / 4096
    assert one.position.per_count == pytest.approx(0.02 * turn)
    assert two.position.per_count == pytest.approx(turn)
    assert one.degrees_per_count == pytest.approx(270 / 4096)
    assert two.degrees_per_count == pytest.approx(270 / 4096)
