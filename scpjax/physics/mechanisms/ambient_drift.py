"""The room does not keep the temperature that it had when the recording began."""

from typing import ClassVar

import jax.numpy as jnp
from jaxtyping import Array

from scpjax.parameter import Parameter
from scpjax.physics.mechanism import Mechanism, Side, Values, View


def _change(name: str, symbol: str, description: str) -> Parameter:
    """A change of the room's temperature, of either sign, as a share of the reference excess."""
    return Parameter(
        name=name,
        symbol=symbol,
        unit="1",
        description=description,
        typical=0.0,
        bounds=(-0.8, 0.8),
        null=0.0,
        scale="linear",
        spread=0.15,
    )


class AmbientDrift(Mechanism):
    name = "ambient_drift"
    title = "The room's temperature drifts"
    subsystem = "thermoelectric"
    equation = (
        "loss = lambda (T - D);  law linear: D = d T_ref t/t_ref;  law settling: D = d T_ref S(t);  law cycling: "
        "D = T_ref (d sin(t/tau) + q (1 - cos(t/tau)));  law excursion: D = d T_ref (S(t - t1) - S(t - t2));  "
        "S(t) = 1 - exp(-t/tau) from t = 0"
    )
    source = (
        "Newton's law with a moving ambient: Incropera, Fundamentals of Heat and Mass Transfer, ch. 5; settling: a "
        "room as one thermal mass; cycling: a thermostat that switches; excursion: a door or window, opened and shut"
    )
    says = "The room (or the air about the actuator) warms or cools while the recording runs."
    needs = ("thermal",)
    excited_by = "rests long enough to come back to the room's temperature, early and late"
    timed = True
    laws = ("linear", "settling", "cycling", "excursion")
    only_under: ClassVar[dict[str, tuple[int, ...]]] = {
        "time_constant": (1, 2, 3),
        "quadrature": (2,),
        "begin": (3,),
        "end": (3,),
        "reference_time": (0,),
    }
    parameters = (
        _change("drift", "d", "change of the room's temperature, as a share of the reference excess"),
        Parameter(
            name="time_constant",
            symbol="τ",
            unit="s",
            description="time in which it settles, or its period over 2 pi (not of law linear)",
            typical=0.3,
            bounds=(0.01, 3.0),
            null=1.0,
            spread=1.5,
            time="duration",
        ),
        _change("quadrature", "q", "as d, of the part a quarter of a period behind (law cycling)"),
        Parameter(
            name="begin",
            symbol="t1",
            unit="s",
            description="when it begins to change (law excursion)",
            typical=0.3,
            bounds=(0.001, 1.0),
            null=1.0,
            spread=1.5,
            time="duration",
        ),
        Parameter(
            name="end",
            symbol="t2",
            unit="s",
            description="when it begins to come back (law excursion)",
            typical=0.6,
            bounds=(0.002, 3.0),
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
    starts = (
        *((d, tau, 0.0, 0.3, 0.6, 0.0, 0.0) for tau in (0.2, 0.1, 0.05, 0.025) for d in (0.05, -0.05)),
        *((d, 0.05, 0.0, begin, begin + 0.3, 0.0, 0.0) for begin in (0.1, 0.5) for d in (0.05, -0.05)),
    )

    def heat(self, p: Values, view: View) -> Side:
        turn = view.time / p.time_constant
        cycling = p.drift * jnp.sin(turn) + p.quadrature * (1.0 - jnp.cos(turn))
        excursion = _settled(turn - p.begin / p.time_constant) - _settled(turn - p.end / p.time_constant)
        shape = jnp.where(p.law == 1, _settled(turn), jnp.where(p.law == 0, view.time / p.reference_time, excursion))
        course = p.reference * jnp.where(p.law == 2, cycling, p.drift * shape)
        return view.shared["conductance"] * course * jnp.ones_like(view.temperature)


def _settled(since: Array) -> Array:
    """Share of a change that a room of one thermal mass has made, ``since`` time constants after it began."""
    return -jnp.expm1(-jnp.maximum(since, 0.0))
