"""Dead time between the recorded drive and the actuator."""

from typing import ClassVar

import jax.numpy as jnp
from jaxtyping import Array

from scpjax.parameter import Parameter
from scpjax.physics.mechanism import Mechanism, Side, Values, View

LAGS = 3
SHORTEST = 1e-3  # s: below this a lag is none
FLOOR = 1e-12  # V^2, that keeps the root's slope finite


class InputDelay(Mechanism):
    name = "input_delay"
    title = "Dead time"
    subsystem = "drive"
    equation = (
        "law pure: u(t) = recorded(t - tau);  "
        "law spread: V(t) = recorded(t - (1 - s) tau), then through three equal lags of s tau/3 each"
    )
    source = (
        "transport or communication delay: Astrom, Hagglund, Advanced PID Control, ch. 2; "
        "spread, as by a chain of lags: MacDonald, Biological Delay Systems, ch. 2"
    )
    says = "The drive reaches the actuator later than the recording says."
    excited_by = "voltage steps"
    laws = ("pure", "spread")
    only_under: ClassVar[dict[str, tuple[int, ...]]] = {"share": (1,)}
    law_needs: ClassVar[dict[int, tuple[str, ...]]] = {1: ("voltage",)}
    states = tuple(f"lagged_{i + 1}" for i in range(LAGS))
    parameters = (
        Parameter(
            name="time",
            symbol="τ",
            unit="s",
            description="dead time; its mean where it is spread",
            typical=0.1,
            bounds=(0.002, 3.0),
            null=0.0,
            spread=2.0,
            time="response",
        ),
        Parameter(
            name="share",
            symbol="s",
            unit="1",
            description="share of the dead time that is lags (law spread)",
            typical=0.3,
            bounds=(0.02, 1.0),
            null=0.3,
            spread=1.0,
        ),
    )
    starts = ((0.03, 0.4), (0.2, 0.4))

    def delay(self, p: Values) -> Array:
        return p.time * (1.0 - jnp.where(p.law == 1, p.share, 0.0))

    def _is_spread(self, p: Values) -> Array:
        return (p.law == 1) & (p.share * p.time > SHORTEST)

    def effort(self, p: Values, view: View, effort: Side) -> Side:
        return jnp.where(self._is_spread(p), view.own[-1] ** 2, effort)

    def rates(self, p: Values, view: View) -> tuple[Side, ...]:
        arriving = jnp.sqrt(jnp.maximum(view.asked, 0.0) + FLOOR)
        pace = jnp.where(self._is_spread(p), LAGS / jnp.maximum(p.share * p.time, SHORTEST), 0.0)
        return tuple(pace * (a - b) for a, b in zip((arriving, *view.own[:-1]), view.own, strict=True))

    def initial(self, p: Values, view: View) -> tuple[Side, ...]:
        return (jnp.sqrt(jnp.maximum(view.asked, 0.0) + FLOOR),) * LAGS
