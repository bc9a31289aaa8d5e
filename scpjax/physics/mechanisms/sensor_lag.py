"""A sensor that takes its time."""

import jax.numpy as jnp

from scpjax.parameter import Parameter
from scpjax.physics.mechanism import Mechanism, Quantity, Side, Values, View

SHORTEST = 1e-3  # s: below this the sensor is immediate


class SensorLag(Mechanism):
    name = "sensor_lag"
    title = "The temperature sensor lags"
    subsystem = "sensor"
    equation = "tau dy/dt = T - y"
    source = "first-order thermometer; the thesis notes the thermistor's lag in 3.3.2"
    says = "The thermometer needs time to take the temperature of what it touches, so it reads late."
    needs = ("thermal", "temperature_output")
    excited_by = "voltage steps"
    states = ("sensed_temperature",)
    parameters = (
        Parameter(
            name="time_constant",
            symbol="τ",
            unit="s",
            description="time constant of the sensor",
            typical=0.1,
            bounds=(0.003, 10.0),
            null=0.0,
            spread=2.0,
            time="response",
        ),
    )
    starts = ((0.05,), (0.4,))

    def rates(self, p: Values, view: View) -> tuple[Side, ...]:
        rate = (view.felt - view.own[0]) / jnp.maximum(p.time_constant, SHORTEST)
        return (jnp.where(p.time_constant > SHORTEST, rate, 0.0),)

    def initial(self, p: Values, view: View) -> tuple[Side, ...]:
        return (view.temperature,)

    def reading(self, p: Values, view: View, quantity: Quantity, value: Side) -> Side:
        if quantity != "temperature":
            return value
        return jnp.where(p.time_constant > SHORTEST, value + view.own[0] - view.felt, value)
