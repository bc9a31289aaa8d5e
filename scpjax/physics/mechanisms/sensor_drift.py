"""A sensor whose zero or sensitivity wanders while it records."""

from typing import ClassVar

import jax.numpy as jnp

from scpjax.parameter import Parameter
from scpjax.physics.mechanism import Mechanism, Quantity, Side, Values, View

_AT_ONCE = 1e-12  # of the reference time, after which a power has a slope


class SensorDrift(Mechanism):
    name = "sensor_drift"
    title = "A sensor drifts"
    subsystem = "sensor"
    equation = (
        "y = x + d x_ref s(t), or y = T + d T_ref s(t);  s = t/t_ref, "
        "1 - exp(-t/tau) under the laws that settle, (t/t_ref)^n under those of a power;  "
        "laws of a gain: x or T times 1 + d t/t_ref"
    )
    source = "zero drift, sensitivity drift and warm-up drift: Doebelin, Measurement Systems, ch. 3"
    says = "The sensor's zero or its sensitivity moves with time, whatever the actuator does."
    excited_by = "rests, early and late in a recording"
    timed = True
    laws = (
        "displacement",
        "temperature",
        "displacement settling",
        "temperature settling",
        "displacement gain",
        "temperature gain",
        "displacement power",
        "temperature power",
    )
    law_needs: ClassVar[dict[int, tuple[str, ...]]] = {
        0: ("displacement_output",),
        1: ("temperature_output",),
        2: ("displacement_output",),
        3: ("temperature_output",),
        4: ("displacement_output",),
        5: ("temperature_output",),
        6: ("displacement_output",),
        7: ("temperature_output",),
    }
    only_under: ClassVar[dict[str, tuple[int, ...]]] = {"time_constant": (2, 3), "exponent": (6, 7)}
    parameters = (
        Parameter(
            name="drift",
            symbol="d",
            unit="1",
            description="drift of the reading, as a share of the reference displacement or excess (of the reading "
            "under the laws of a gain): in the reference time, or in the end",
            typical=0.0,
            bounds=(-2.0, 2.0),
            null=0.0,
            scale="linear",
            spread=0.3,
        ),
        Parameter(
            name="time_constant",
            symbol="τ",
            unit="s",
            description="time in which the drift settles (laws that settle)",
            typical=0.2,
            bounds=(0.01, 3.0),
            null=1.0,
            spread=1.5,
            time="duration",
        ),
        Parameter(
            name="exponent",
            symbol="n",
            unit="1",
            description="power of the time with which it drifts: above 1 faster and faster (laws of a power)",
            typical=1.5,
            bounds=(0.3, 4.0),
            null=1.0,
            spread=0.5,
        ),
        Parameter(
            name="reference",
            symbol="x_ref",
            unit="m",
            description="displacement at which the drift is stated",
            typical=0.01,
            bounds=(1e-12, 1e12),
            null=0.01,
            fixed=True,
        ),
        Parameter(
            name="reference_temperature",
            symbol="T_ref",
            unit="K",
            description="temperature excess at which the drift is stated",
            typical=50.0,
            bounds=(1e-6, 1e9),
            null=50.0,
            fixed=True,
        ),
        Parameter(
            name="reference_time",
            symbol="t_ref",
            unit="s",
            description="time for which a drift that does not settle is stated",
            typical=100.0,
            bounds=(1e-9, 1e9),
            null=100.0,
            fixed=True,
        ),
    )
    starts = ((0.05, 0.2, 1.5, 0.0, 0.0, 0.0), (-0.05, 0.2, 1.5, 0.0, 0.0, 0.0))

    def reading(self, p: Values, view: View, quantity: Quantity, value: Side) -> Side:
        settles = (p.law == 2) | (p.law == 3)
        passed = view.time / p.reference_time
        exponent = jnp.where(p.law >= 6, p.exponent, 1.0)
        shape = jnp.where(
            settles, -jnp.expm1(-view.time / p.time_constant), (jnp.maximum(passed, 0.0) + _AT_ONCE) ** exponent
        )
        of_temperature = (p.law == 1) | (p.law == 3) | (p.law == 5) | (p.law == 7)
        of_gain = (p.law == 4) | (p.law == 5)
        mine = of_temperature if quantity == "temperature" else ~of_temperature
        scale = p.reference_temperature if quantity == "temperature" else p.reference
        return value + jnp.where(mine, p.drift, 0.0) * jnp.where(of_gain, value, scale) * shape
