"""The room does not keep the temperature that it had when the recording began."""

from typing import ClassVar

import jax.numpy as jnp

from scpjax.parameter import Parameter
from scpjax.physics.mechanism import Mechanism, Side, Values, View


class AmbientDrift(Mechanism):
    name = "ambient_drift"
    title = "The room's temperature drifts"
    subsystem = "thermoelectric"
    equation = (
        "loss = lambda (T - D);  law linear: D = d T_ref t/t_ref;  law settling: D = d T_ref (1 - exp(-t/tau));  "
        "law cycling: D = d T_ref sin(t/tau)"
    )
    source = (
        "Newton's law with a moving ambient: Incropera, Fundamentals of Heat and Mass Transfer, ch. 5; settling: a "
        "room as one thermal mass; cycling: a thermostat that switches"
    )
    says = "The room (or the air about the actuator) warms or cools while the recording runs."
    needs = ("thermal",)
    excited_by = "rests long enough to come back to the room's temperature, early and late"
    timed = True
    laws = ("linear", "settling", "cycling")
    only_under: ClassVar[dict[str, tuple[int, ...]]] = {"time_constant": (1, 2)}
    parameters = (
        Parameter(
            name="drift",
            symbol="d",
            unit="1",
            description="change of the room's temperature, as a share of the reference excess",
            typical=0.0,
            bounds=(-0.8, 0.8),
            null=0.0,
            scale="linear",
            spread=0.15,
        ),
        Parameter(
            name="time_constant",
            symbol="τ",
            unit="s",
            description="time in which it settles, or its period over 2 pi (laws settling, cycling)",
            typical=0.3,
            bounds=(0.01, 3.0),
            null=1.0,
            spread=1.5,
            time="duration",
        ),
        Parameter(
            name="reference",
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
            description="time for which the drift of law linear is stated",
            typical=100.0,
            bounds=(1e-9, 1e9),
            null=100.0,
            fixed=True,
        ),
    )
    # a cycle is only found from a period not far from its own
    starts = tuple((d, tau, 0.0, 0.0) for tau in (0.2, 0.1, 0.05, 0.025) for d in (0.05, -0.05))

    def heat(self, p: Values, view: View) -> Side:
        since = view.time / p.time_constant
        shape = jnp.where(p.law == 1, -jnp.expm1(-since), jnp.sin(since))
        shape = jnp.where(p.law == 0, view.time / p.reference_time, shape)
        return view.shared["conductance"] * p.drift * p.reference * shape * jnp.ones_like(view.temperature)
