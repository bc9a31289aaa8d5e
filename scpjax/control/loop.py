"""The closed loop: reference in, trajectory out, one compiled scan."""

from __future__ import annotations

from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jax.core import Tracer
from jaxtyping import Array, Float, PRNGKeyArray

from scpjax.control.controller import Controller, to_voltage
from scpjax.control.errors import ControlError
from scpjax.control.plant import Plant, Prepared
from scpjax.control.sensor import Sensor


class Loop(eqx.Module):
    """A plant, the controller that drives it and the sensor between them (thesis Figure 3.12).

    **Raises** `ControlError` when the controller's commands do not fit the plant's sides.
    """

    plant: Plant
    controller: Controller
    sensor: Sensor

    def __init__(self, plant: Plant, controller: Controller, sensor: Sensor | None = None):
        self.plant, self.controller = plant, controller
        self.sensor = Sensor() if sensor is None else sensor

    def __check_init__(self) -> None:
        if self.plant.sides != self.controller.sides:
            raise ControlError(
                f"a controller with {self.controller.sides} commands for a plant with {self.plant.sides} drives",
                mend="use a Pair for a joint and a PID for one actuator",
            )


class Disturbance(eqx.Module):
    """What acts from outside, sample by sample: ``output`` [rad] on the angle, ``load`` [N] on the coordinate."""

    output: Float[Array, " n"] | None = None
    load: Float[Array, " n"] | None = None


class Response(eqx.Module):
    """A loop's trajectory; SI. ``angle`` is the true one (m where the plant has no pulley), disturbance included.

    ``effort`` [V^2] was applied from each sample to the next, ``asked`` is the command before its limits;
    ``temperature`` [K] is that of the heated parts, whatever their thermometers say.
    """

    time: Float[Array, " n"]
    reference: Float[Array, " n"]
    angle: Float[Array, " n"]
    measured: Float[Array, " n"]
    effort: Float[Array, "n sides"]
    asked: Float[Array, "n sides"]
    temperature: Float[Array, "n sides"]

    @property
    def voltage(self) -> Float[Array, "n sides"]:
        """Voltage [V] of each side."""
        return to_voltage(self.effort)

    @property
    def error(self) -> Float[Array, " n"]:
        """Reference less angle [rad]."""
        return self.reference - self.angle


def run(
    loop: Loop,
    reference: Float[Array, " n"] | np.ndarray,
    *,
    dt: Any = 0.02,
    disturbance: Disturbance | None = None,
    key: PRNGKeyArray | None = None,
) -> Response:
    """Run a loop from rest along a reference [rad] sampled every ``dt`` [s].

    At each sample the sensor reads the plant, the controller answers, and its effort acts until the next. Pure:
    jit, vmap and differentiate it in the loop, the reference, the disturbance and ``dt``. ``key`` draws the
    sensor's noise; without it there is none.

    **Raises** `ControlError` for a reference that is no vector of finite numbers, or one that a disturbance does not
    match in length.
    """
    reference = checked(reference, "the reference")
    plant, controller, sensor = loop.plant.prepare(dt), loop.controller, loop.sensor
    n = reference.shape[0]
    outside = Disturbance() if disturbance is None else disturbance
    for name in ("output", "load"):
        given = getattr(outside, name)
        if given is not None and checked(given, f"the disturbance's {name}").shape[0] != n:
            raise ControlError(f"{given.shape[0]} samples of {name} for {n} of reference", mend="give as many")
    noise = None if key is None else sensor.draw(key, n)
    step = _body(plant, controller, sensor, dt)
    _, seen = jax.lax.scan(step, start(plant, controller, sensor), (jnp.arange(n), reference, outside, noise))
    angle, measured, effort, asked, temperature = seen
    stack = lambda parts: jnp.stack(parts, axis=-1) if parts else jnp.zeros((n, 0))  # noqa: E731
    time = dt * jnp.arange(n)
    return Response(time, reference, angle, measured, stack(effort), stack(asked), stack(temperature))


def play(plant: Plant, effort: Float[Array, "n sides"] | np.ndarray, *, dt: Any = 0.02) -> tuple[Array, Array]:
    """Angle [rad] (n,) and temperatures [K] (n, sides) of a plant under efforts [V^2] from a table, without a loop.

    As the thesis drove the real joint (section 4.4.4).

    **Raises** `ControlError` for efforts that are not (n, sides).
    """
    given = jnp.asarray(effort)
    if given.ndim != 2 or given.shape[1] != plant.sides:
        raise ControlError(f"efforts {given.shape} for {plant.sides} sides", mend="give one column for each side")
    ready = plant.prepare(dt)

    def body(z: Any, u: Array) -> tuple[Any, tuple]:
        seen = ready.read(z)
        return ready.advance(z, tuple(u[i] for i in range(plant.sides)), 0.0), (seen.position, seen.temperature)

    _, (angle, temperature) = jax.lax.scan(body, ready.initial, given)
    return angle, jnp.stack(temperature, axis=-1)


def start(plant: Prepared, controller: Controller, sensor: Sensor) -> tuple:
    """State of a loop at rest."""
    zero = jnp.zeros(())
    return (
        plant.initial,
        controller.initial(),
        sensor.initial(plant.read(plant.initial).position),
        tuple((zero, zero) for _ in range(controller.sides)) if sensor.every > 1 else (),
    )


def _body(plant: Prepared, controller: Controller, sensor: Sensor, dt: Any):
    def body(carry: tuple, x: tuple) -> tuple[tuple, tuple]:
        z, memory, line, held = carry
        k, reference, outside, noise = x
        seen = plant.read(z)
        position, temperature = seen.position, seen.heated
        if outside.output is not None:
            position = position + outside.output
        line, measured = sensor.read(line, position, 0.0 if noise is None else noise)
        after, command = controller.step(memory, measured, reference, dt * sensor.every)
        effort, asked = command
        if sensor.every > 1:
            acts = k % sensor.every == 0
            choose = lambda new, old: jnp.where(acts, new, old)  # noqa: E731
            after = jax.tree.map(choose, after, memory)
            effort = tuple(choose(u, h[0]) for u, h in zip(effort, held, strict=True))
            asked = tuple(choose(u, h[1]) for u, h in zip(asked, held, strict=True))
            held = tuple(zip(effort, asked, strict=True))
        z = plant.advance(z, effort, 0.0 if outside.load is None else outside.load)
        return (z, after, line, held), (position, measured, effort, asked, temperature)

    return body


def checked(values: Any, name: str) -> Float[Array, " n"]:
    """A signal as a vector of finite numbers. **Raises** `ControlError`."""
    if isinstance(values, Tracer):
        signal = values
    else:
        signal = np.asarray(values, float)
        if signal.size and not np.all(np.isfinite(signal)):
            at = int(np.argmax(~np.isfinite(signal.ravel())))
            raise ControlError(f"{name} is {signal.ravel()[at]:g} at sample {at}", mend="give finite numbers")
    if signal.ndim != 1 or signal.shape[0] < 2:
        raise ControlError(f"{name} has the shape {tuple(signal.shape)}", mend="give a vector of 2 samples or more")
    return jnp.asarray(signal, float)
