"""Zero points of the sensors: part of every model, since a ruler and a thermistor have one."""

from math import inf

from scpjax.parameter import Parameter
from scpjax.physics.mechanism import Mechanism, Quantity, Side, Values, View


class SensorOffset(Mechanism):
    name = "sensor_offset"
    title = "Sensor zero"
    subsystem = "sensor"
    equation = "y = value + offset"
    source = "thesis 3.3.3 (offset removal)"
    says = "The sensor does not read exactly zero at rest."
    parameters = (
        Parameter(
            name="temperature",
            symbol="T_off",
            unit="K",
            description="reading of the temperature sensor at ambient, less ambient",
            typical=0.0,
            bounds=(-inf, inf),
            scale="linear",
        ),
        Parameter(
            name="displacement",
            symbol="x_off",
            unit="m",
            description="reading of the displacement (or angle, as displacement) sensor at rest",
            typical=0.0,
            bounds=(-inf, inf),
            scale="linear",
        ),
    )

    def reading(self, p: Values, view: View, quantity: Quantity, value: Side) -> Side:
        return value + (p.temperature if quantity == "temperature" else p.displacement)
