"""A sensor that takes its time."""

from typing import ClassVar

import jax.numpy as jnp

from scpjax.parameter import Parameter
from scpjax.physics.mechanism import Mechanism, Quantity, Side, Values, View

SHORTEST = 1e-3  # s: below this the sensor is immediate


class SensorLag(Mechanism):
    name = "sensor_lag"
    title = "The temperature sensor lags"
    subsystem = "sensor"
    equation = (
        "tau dy/dt = T - y;  law two in series: tau dw/dt = T - w, tau dy/dt = w - y;  "
        "law in part: the reading is (1 - s) T + s y"
    )
    source = (
        "first-order thermometer; the thesis notes the thermistor's lag in 3.3.2; in series with its well, or in part "
        "from the conduction of its leads: Doebelin, Measurement Systems, ch. 8"
    )
    says = "The thermometer needs time to take the temperature of what it touches, so it reads late."
    needs = ("thermal", "temperature_output")
    excited_by = "voltage steps"
    states = ("sensed_temperature", "well_temperature")
    laws = ("first order", "two in series", "in part")
    only_under: ClassVar[dict[str, tuple[int, ...]]] = {"share": (2,)}
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
        Parameter(
            name="share",
            symbol="s",
            unit="1",
            description="share of the reading that comes late (law in part)",
            typical=0.5,
            bounds=(0.02, 1.0),
            null=1.0,
            spread=1.0,
        ),
    )
    starts = ((0.05, 0.5), (0.4, 0.5))

    def rates(self, p: Values, view: View) -> tuple[Side, ...]:
        sensed, well = view.own
        late = p.time_constant > SHORTEST
        pace = 1.0 / jnp.maximum(p.time_constant, SHORTEST)
        rate = (jnp.where(p.law == 1, well, view.felt) - sensed) * pace
        return (jnp.where(late, rate, 0.0), jnp.where(late & (p.law == 1), (view.felt - well) * pace, 0.0))

    def initial(self, p: Values, view: View) -> tuple[Side, ...]:
        return (view.temperature, view.temperature)

    def reading(self, p: Values, view: View, quantity: Quantity, value: Side) -> Side:
        if quantity != "temperature":
            return value
        share = jnp.where(p.law == 2, p.share, 1.0)
        return jnp.where(p.time_constant > SHORTEST, value + share * (view.own[0] - view.felt), value)
