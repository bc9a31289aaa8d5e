"""A sensor that takes its time."""

from typing import ClassVar

import jax.numpy as jnp
from jax import Array

from scpjax.parameter import Parameter
from scpjax.physics.mechanism import Mechanism, Quantity, Side, Values, View

SHORTEST = 1e-3  # s: below this the sensor is immediate
AVERAGE, MOVED = 3, 4
IN_SERIES, UNLIKE, PATHS = 1, 5, 6


class SensorLag(Mechanism):
    name = "sensor_lag"
    title = "A sensor lags"
    subsystem = "sensor"
    equation = (
        "tau dy/dt = T - y;  law two in series: tau dw/dt = T - w, tau dy/dt = w - y;  "
        "law in part: the reading is (1 - s) T + s y;  law average: the mean of T over the last W = 2 tau, "
        "y = q_0 + q_2/42, W dq_i/dt = q_(i+1), q_4/1680 + q_3/84 + 3 q_2/28 + q_1/2 + q_0 = T;  "
        "law displacement average: of the displacement in place of T;  law two in series, unlike: r tau dw/dt = T - w, "
        "tau dy/dt = w - y;  law two paths: the reading is (1 - s) w + s y, r tau dw/dt = T - w, tau dy/dt = T - y"
    )
    source = (
        "first-order thermometer; the thesis notes the thermistor's lag in 3.3.2; in series with its well, or in part "
        "from the conduction of its leads, which may be late itself (two paths): Doebelin, Measurement Systems, "
        "ch. 8; a moving average as a filter: Smith, "
        "Scientist and Engineer's Guide to Digital Signal Processing, ch. 15, (1 - exp(-W p))/(W p) with Pade's "
        "approximant of order (4, 4) of the exponential"
    )
    says = (
        "The thermometer needs time to take the temperature of what it touches, or a sensor averages, so it reads late."
    )
    needs = ("thermal", "temperature_output")
    law_needs: ClassVar[dict[int, tuple[str, ...]]] = {MOVED: ("mechanical", "displacement_output")}
    excited_by = "voltage steps"
    states = ("sensed", "second", "third", "fourth")
    laws = (
        "first order",
        "two in series",
        "in part",
        "average",
        "displacement average",
        "two in series, unlike",
        "two paths",
    )
    only_under: ClassVar[dict[str, tuple[int, ...]]] = {"share": (2, PATHS), "stage_ratio": (UNLIKE, PATHS)}
    parameters = (
        Parameter(
            name="time_constant",
            symbol="τ",
            unit="s",
            description="time constant of the sensor (laws two in series, unlike, and two paths: of the slower one), "
            "or half of the time over which it averages",
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
            description="share of the reading that comes late (law in part), or by the slower path (law two paths)",
            typical=0.5,
            bounds=(0.02, 1.0),
            null=1.0,
            spread=1.0,
        ),
        Parameter(
            name="stage_ratio",
            symbol="r",
            unit="1",
            description="time constant of the quicker stage or path over that of the slower one (laws two in series, "
            "unlike, and two paths)",
            typical=0.4,
            bounds=(0.02, 1.0),
            null=0.4,
            spread=1.0,
        ),
    )
    starts = ((0.05, 0.5, 0.4), (0.4, 0.5, 0.4))

    def rates(self, p: Values, view: View) -> tuple[Side, ...]:
        y, second, third, fourth = view.own
        true = jnp.where(p.law == MOVED, view.displacement, view.felt)
        late, averages, series = p.time_constant > SHORTEST, _averages(p), _in_series(p)
        pace = jnp.where(late, jnp.where(averages, 0.5, 1.0) / jnp.maximum(p.time_constant, SHORTEST), 0.0)
        first = jnp.where(averages, second, jnp.where(series, second, true) - y)
        then = jnp.where(averages, third, jnp.where(series | (p.law == PATHS), true - second, 0.0))
        quicker = jnp.where((p.law == UNLIKE) | (p.law == PATHS), 1.0 / p.stage_ratio, 1.0)
        last = 1680.0 * (true - y) - 840.0 * second - 180.0 * third - 20.0 * fourth
        return (
            pace * first,
            pace * quicker * then,
            pace * jnp.where(averages, fourth, 0.0),
            pace * jnp.where(averages, last, 0.0),
        )

    def initial(self, p: Values, view: View) -> tuple[Side, ...]:
        true = jnp.where(p.law == MOVED, view.displacement, view.temperature)
        return (
            true,
            jnp.where(_in_series(p) | (p.law == PATHS), true, 0.0),
            jnp.zeros_like(true),
            jnp.zeros_like(true),
        )

    def reading(self, p: Values, view: View, quantity: Quantity, value: Side) -> Side:
        late, read = p.time_constant > SHORTEST, view.own[0]
        read = jnp.where(_averages(p), read + view.own[2] / 42.0, read)
        if quantity == "displacement":
            return jnp.where(late & (p.law == MOVED), value + read - view.displacement, value)
        if quantity != "temperature":
            return value
        paths = p.law == PATHS
        share = jnp.where((p.law == 2) | paths, p.share, 1.0)
        at_best = jnp.where(paths, view.own[1], view.felt)  # what comes in that is not so late
        return jnp.where(late & (p.law != MOVED), value - view.felt + at_best + share * (read - at_best), value)


def _averages(p: Values) -> Array:
    return (p.law == AVERAGE) | (p.law == MOVED)


def _in_series(p: Values) -> Array:
    return (p.law == IN_SERIES) | (p.law == UNLIKE)
