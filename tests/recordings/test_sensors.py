"""Sensors against data sheet points, hand calculation, the thesis' text, and their own inverses."""

import math

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from scpjax.recordings import sensors

TEMPERATURES = np.linspace(273.15, 453.15, 19)


def test_thermistor_points():
    assert sensors.thermistor_temperature(100e3) == pytest.approx(298.15)
    # by hand: 1/(1/298.15 + ln(0.1)/3950) = 360.87 K
    assert sensors.thermistor_temperature(10e3) == pytest.approx(360.87, abs=0.02)
    assert sensors.thermistor_resistance(298.15) == pytest.approx(100e3)


@pytest.mark.parametrize("xp", [np, jnp])
def test_round_trips(xp):
    temperature = xp.asarray(TEMPERATURES)
    tolerance = 1e-9 if xp is np else 1e-4
    resistance = sensors.thermistor_resistance(temperature)
    volt = sensors.divider_voltage(resistance)
    back = sensors.thermistor_temperature(sensors.divider_resistance(volt))
    np.testing.assert_allclose(back, TEMPERATURES, rtol=tolerance)
    wire = sensors.copper_resistance(temperature, reference_ohm=1.28)
    np.testing.assert_allclose(sensors.copper_temperature(wire, reference_ohm=1.28), TEMPERATURES, rtol=tolerance)
    distance = xp.asarray([0.02, 0.3, 4.0])
    for air in (None, 293.15):
        echo = sensors.echo_duration(distance, temperature_K=air)
        np.testing.assert_allclose(sensors.echo_distance(echo, temperature_K=air), distance, rtol=tolerance)
    assert isinstance(back, jax.Array if xp is jnp else np.ndarray)


def test_divider_halves_at_equal_resistance():
    assert sensors.divider_voltage(1660.0) == pytest.approx(2.5)
    assert sensors.divider_resistance(2.5) == pytest.approx(1660.0)


def test_copper_as_the_thesis_measured_it():
    # section 3.3.2: 2 ohm is about 160 degC for a wire of 1.28 ohm at 22 degC
    assert sensors.copper_temperature(2.0, reference_ohm=1.28) - 273.15 == pytest.approx(161.2, abs=0.1)
    assert sensors.copper_resistance(295.15, reference_ohm=1.28) == pytest.approx(1.28)


def test_echo_is_that_of_the_thesis():
    assert sensors.echo_distance(1e-6) * 100 == pytest.approx(0.034 / 2)  # cm per microsecond
    assert sensors.sound_speed(293.15) == pytest.approx(343.2, abs=0.1)  # handbook, dry air at 20 degC


def test_pwm():
    np.testing.assert_allclose(sensors.pwm_mean_voltage(np.array([100, 225, 255])), [1.451, 3.2647, 3.7], rtol=1e-4)
    counts = np.arange(0, 256, 5)
    wave = (np.arange(255)[None, :] < counts[:, None]) * 3.7  # a real PWM period
    np.testing.assert_allclose(sensors.pwm_mean_voltage(counts), wave.mean(axis=1), atol=1e-12)
    np.testing.assert_allclose(sensors.pwm_rms_voltage(counts), np.sqrt((wave**2).mean(axis=1)), atol=1e-12)
    np.testing.assert_allclose(sensors.voltage_pwm(sensors.pwm_mean_voltage(counts)), counts)


def test_adc():
    assert sensors.adc_voltage(1023) == 5.0
    assert sensors.adc_counts(5.2) == 1023
    assert sensors.adc_counts(-0.1) == 0
    counts = np.arange(1024)
    np.testing.assert_array_equal(sensors.adc_counts(sensors.adc_voltage(counts)), counts)
    assert sensors.adc_voltage(4095, bits=12, reference_V=3.3) == pytest.approx(3.3)


def test_traces_and_differentiates():
    slope = jax.grad(lambda r: sensors.thermistor_temperature(r))(100e3)
    assert float(slope) == pytest.approx(-(298.15**2) / 3950 / 100e3, rel=1e-4)
    assert float(jax.jit(sensors.pwm_rms_voltage)(jnp.asarray(255.0))) == pytest.approx(3.7, rel=1e-6)


def test_wire_resistance():
    by_hand = 1.68e-8 * 0.45 / (math.pi * 0.05e-3**2)
    assert sensors.wire_resistance(0.45) == pytest.approx(by_hand)
