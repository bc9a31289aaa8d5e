"""What the rig's sensors read, both ways: thermistor, copper wire, ultrasonic distance, PWM and ADC.

All functions take and give numbers or arrays of any shape, numpy or jax, in SI unless the name says
otherwise. Defaults are the parts of the thesis (section 3.3, appendix A).
"""

from __future__ import annotations

from types import ModuleType
from typing import Any

import numpy as np

ZERO_C = 273.15
COPPER_RESISTIVITY = 1.68e-8
"""Ohm metre at 20 degC, as the thesis takes it (footnote of Table 3.4)."""


def thermistor_temperature(
    resistance_ohm: Any,
    *,
    nominal_ohm: float = 100e3,
    nominal_K: float = 25.0 + ZERO_C,
    beta_K: float = 3950.0,
) -> Any:
    """Temperature (K) of an NTC thermistor by the B equation: 1/T = 1/T0 + ln(R/R0)/B."""
    return 1.0 / (1.0 / nominal_K + _np(resistance_ohm).log(resistance_ohm / nominal_ohm) / beta_K)


def thermistor_resistance(
    temperature_K: Any,
    *,
    nominal_ohm: float = 100e3,
    nominal_K: float = 25.0 + ZERO_C,
    beta_K: float = 3950.0,
) -> Any:
    """Resistance (ohm) of an NTC thermistor by the B equation: R = R0 exp(B (1/T - 1/T0))."""
    return nominal_ohm * _np(temperature_K).exp(beta_K * (1.0 / temperature_K - 1.0 / nominal_K))


def divider_resistance(voltage_V: Any, *, fixed_ohm: float = 1660.0, supply_V: float = 5.0) -> Any:
    """Resistance (ohm) of a sensor from the supply to the tap, by the tap voltage over ``fixed_ohm`` to
    ground.
    """
    return fixed_ohm * (supply_V / voltage_V - 1.0)


def divider_voltage(resistance_ohm: Any, *, fixed_ohm: float = 1660.0, supply_V: float = 5.0) -> Any:
    """Tap voltage over ``fixed_ohm`` to ground, of a sensor (ohm) from the supply to the tap."""
    return supply_V * fixed_ohm / (fixed_ohm + resistance_ohm)


def copper_resistance(
    temperature_K: Any,
    *,
    reference_ohm: float,
    reference_K: float = 22.0 + ZERO_C,
    alpha_per_K: float = 0.00404,
) -> Any:
    """Resistance (ohm) of a copper wire, thesis (3.13): R = R0 (1 + alpha (T - T0))."""
    return reference_ohm * (1.0 + alpha_per_K * (temperature_K - reference_K))


def copper_temperature(
    resistance_ohm: Any,
    *,
    reference_ohm: float,
    reference_K: float = 22.0 + ZERO_C,
    alpha_per_K: float = 0.00404,
) -> Any:
    """Mean temperature (K) of a copper wire by its resistance, thesis (3.13) solved for T."""
    return reference_K + (resistance_ohm / reference_ohm - 1.0) / alpha_per_K


def wire_resistance(length_m: Any, *, diameter_m: float = 0.10e-3, resistivity: float = COPPER_RESISTIVITY) -> Any:
    """Resistance (ohm) of a round wire: rho L / (pi d^2 / 4); defaults: the thesis' enamelled copper wire."""
    return resistivity * length_m / (np.pi * diameter_m**2 / 4.0)


def sound_speed(temperature_K: Any = None) -> Any:
    """Speed of sound in air (m/s): 340 as in the thesis, or 331.3 sqrt(T / 273.15) (ideal gas) at a
    temperature.
    """
    return 340.0 if temperature_K is None else 331.3 * _np(temperature_K).sqrt(temperature_K / ZERO_C)


def echo_distance(echo_s: Any, *, temperature_K: Any = None) -> Any:
    """Distance (m) of an ultrasonic echo of this duration (s), there and back: c t / 2."""
    return 0.5 * sound_speed(temperature_K) * echo_s


def echo_duration(distance_m: Any, *, temperature_K: Any = None) -> Any:
    """Duration (s) of an ultrasonic echo from this distance (m): 2 d / c."""
    return 2.0 * distance_m / sound_speed(temperature_K)


def pwm_mean_voltage(pwm: Any, *, supply_V: float = 3.7) -> Any:
    """Mean voltage (V) of a PWM count 0..255: supply pwm / 255, which the thesis gives as the voltage."""
    return supply_V * (pwm / 255.0)


def pwm_rms_voltage(pwm: Any, *, supply_V: float = 3.7) -> Any:
    """Root mean square voltage (V) of a PWM count 0..255: supply sqrt(pwm / 255); its square over R is the
    heat.
    """
    return supply_V * _np(pwm).sqrt(pwm / 255.0)


def voltage_pwm(voltage_V: Any, *, supply_V: float = 3.7) -> Any:
    """PWM count (not rounded) whose mean voltage this is."""
    return 255.0 * (voltage_V / supply_V)


def adc_voltage(counts: Any, *, bits: int = 10, reference_V: float = 5.0) -> Any:
    """Voltage (V) of an ADC reading: reference counts / (2^bits - 1), full scale at the reference as on
    Arduino.
    """
    return reference_V * (counts / (2.0**bits - 1.0))


def adc_counts(voltage_V: Any, *, bits: int = 10, reference_V: float = 5.0) -> Any:
    """ADC reading, rounded and clipped to 0 .. 2^bits - 1, of a voltage (V)."""
    full = 2.0**bits - 1.0
    xp = _np(voltage_V)
    return xp.clip(xp.round(voltage_V / reference_V * full), 0.0, full)


def _np(x: Any) -> ModuleType:
    """``jax.numpy`` for jax arrays and tracers, else numpy; jax is not imported for its sake."""
    if isinstance(x, np.ndarray | float | int | np.generic):
        return np
    import jax

    return jax.numpy if isinstance(x, jax.Array) else np
