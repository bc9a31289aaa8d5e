"""What lies behind the board's pins when there is no bench: a still one, or any model with sensors and noise."""

from __future__ import annotations

import abc
import math
from dataclasses import dataclass
from typing import Any

import numpy as np
from scipy.constants import g

from scpjax.bench.errors import BenchError
from scpjax.bench.guard import Inputs
from scpjax.bench.parameters import TICK_S
from scpjax.bench.wiring import ECHO_UNIT_S, REFERENCE_V, Wiring
from scpjax.recordings.sensors import copper_resistance

_ADC = 1024


class World(abc.ABC):
    """Volts at A0 to A5, echo and encoder; time passes in `advance`."""

    noise_V: float = 0.0
    """Standard deviation of what every conversion reads beside the truth."""

    @abc.abstractmethod
    def advance(self, duty: tuple[float, float], dt: float) -> None:
        """Pass ``dt`` [s] under these shares of the supply."""

    @abc.abstractmethod
    def volts(self) -> np.ndarray:
        """At A0 to A5 (6,)."""

    def echo_s(self) -> float:
        """Duration of an ultrasonic echo, 0 for none."""
        return 0.0

    def encoder(self) -> int:
        """Counts of the encoder."""
        return 0


@dataclass
class Still(World):
    """Nothing moves and nothing warms: thermistors at room temperature, everything else as set."""

    inputs: np.ndarray

    def __init__(self, inputs: Any = (0.5, 0.5, 2.5, 0.0, 3.0, 3.0)):
        self.inputs = np.array(inputs, float)

    def advance(self, duty: tuple[float, float], dt: float) -> None:
        """Nothing happens."""

    def volts(self) -> np.ndarray:
        return self.inputs


@dataclass(frozen=True, kw_only=True)
class Noise:
    """``volts``: standard deviation of a conversion's error; ``ripple``: of the supply, as a share of it."""

    volts: float = 2e-3
    ripple: float = 0.0


class Muscle(World):
    """A plant (`scpjax.control.plant`) behind the sensors of a wiring, with whatever mechanisms its models hold.

    ``hottest`` is the highest temperature [K] that any heated part has had, ``energy`` [J] what each side was given.
    One actuator is a `Difference` of one without a pulley (displacement in m), a joint any plant with two sides.

    **Raises** `BenchError` for a plant whose sides are not those of the wiring.
    """

    def __init__(self, plant: Any, wiring: Wiring, *, noise: Noise | None = None, seed: int = 0):
        if plant.sides != wiring.sides:
            raise BenchError(f"a plant with {plant.sides} drives on a bench with {wiring.sides}", mend="change sides")
        self.wiring, self.noise = wiring, noise or Noise()
        self.noise_V = self.noise.volts
        self._plant = plant
        self._z, self._seen = self._behind(plant, 0.0)
        ohms = [_resistance(m) for m in plant.models()]
        self._resistance = ohms if len(ohms) == wiring.sides else ohms[:1] * wiring.sides
        self._rng = np.random.default_rng(seed)
        self._duty = (0.0, 0.0)
        self.hottest = float(np.max(self.temperature))
        self.energy = np.zeros(wiring.sides)

    def _behind(self, plant: Any, load: float) -> tuple[Any, np.ndarray]:
        """Make the ticks of a plant under a load [N]; its first state and what is seen of it."""
        import jax
        import jax.numpy as jnp
        from jax.flatten_util import ravel_pytree

        ready = plant.prepare(TICK_S)
        first, unravel = ravel_pytree(ready.initial)

        def read(state: Any) -> Any:
            seen = ready.read(state)
            return jnp.stack([seen.position, *seen.temperature, *seen.heated])

        def pass_tick(z: Any, effort: Any) -> tuple[Any, Any]:
            state = ready.advance(unravel(z), tuple(effort[i] for i in range(plant.sides)), load)
            return ravel_pytree(state)[0], read(state)

        self._pass = jax.jit(pass_tick)
        return first, np.asarray(jax.jit(lambda z: read(unravel(z)))(first))

    def hang(self, mass: float) -> None:
        """Take the weight off and hang another of ``mass`` [kg] on: it moves with it, and draws it out or lets it up.

        **Raises** `BenchError` for two actuators, and a mass that is not positive.
        """
        if self.wiring.sides != 1:
            raise BenchError("a weight is changed on one actuator", mend="use a bench of one")
        if not 0 < mass < math.inf:
            raise BenchError(f"{mass:g} kg is no weight", mend="give kilograms above 0")
        model = self._plant.agonist
        load = (model.value("inertia.mass") - mass) * g
        self._behind(type(self._plant)(model.replace({"inertia.mass": mass}), radius=None), float(load))

    @property
    def position(self) -> float:
        """Position as the sensor has it, before noise: m, or rad of a joint."""
        return float(self._seen[0])

    @property
    def temperature(self) -> np.ndarray:
        """Temperatures [K] of the heated parts (sides,), which the thermistors may see late."""
        return self._seen[1 + self.wiring.sides :]

    def advance(self, duty: tuple[float, float], dt: float) -> None:
        """Pass a tick; ``dt`` must be `TICK_S`."""
        w = self.wiring
        share = np.array(duty[: w.sides])
        if self.noise.ripple:
            share = share * (1 + self.noise.ripple * self._rng.standard_normal()) ** 2
        effort = share * w.supply_V**2
        self._z, seen = self._pass(self._z, effort)
        self._seen = np.asarray(seen)
        self._duty = (float(duty[0]), float(duty[1]))
        self.energy += dt * effort / np.array(self._resistance)
        self.hottest = max(self.hottest, float(np.max(self.temperature)))

    def volts(self) -> np.ndarray:
        w, s = self.wiring, self.wiring.sides
        out = np.zeros(6)
        if w.thermistors.fitted:
            out[:s] = w.thermistors.volts(self._seen[1 : 1 + s])
        if w.position.source == "potentiometer":
            out[2] = REFERENCE_V * float(w.position.counts(self.position)) / (4 * _ADC)
        amperes = sum(d * w.supply_V / r for d, r in zip(self._duty, self._resistance, strict=False))
        out[3] = amperes * w.current_V_per_A
        for i in range(s):
            out[4 + i] = w.sensing.volts(self.wire_resistance(i))
        return np.clip(out, 0.0, REFERENCE_V)

    def wire_resistance(self, side: int) -> float:
        """Ohms of the copper wire at its temperature, thesis (3.13)."""
        return float(copper_resistance(self.temperature[side], reference_ohm=self._resistance[side]))

    def echo_s(self) -> float:
        w = self.wiring.position
        return float(w.counts(self.position)) * ECHO_UNIT_S if w.source == "echo" else 0.0

    def encoder(self) -> int:
        w = self.wiring.position
        return round(float(w.counts(self.position))) if w.source == "encoder" else 0


def convert(world: World, rng: np.random.Generator) -> Inputs:
    """What the board's converter makes of a world: every sum of four truncated conversions."""
    volts = world.volts()
    if world.noise_V:
        noisy = volts + world.noise_V * rng.standard_normal((4, 6))
        counts = np.clip((noisy * (_ADC / REFERENCE_V)).astype(int), 0, _ADC - 1).sum(axis=0)
    else:
        counts = 4 * np.clip((volts * (_ADC / REFERENCE_V)).astype(int), 0, _ADC - 1)
    return Inputs(counts.tolist(), min(int(world.echo_s() / ECHO_UNIT_S), 0xFFFF), world.encoder())


def _resistance(model: Any) -> float:
    values = model.values()
    gain = max(v for k, v in values.items() if k.split("@")[0] == "joule_heating.gain")
    if model.structure.drive not in ("voltage", "pwm") or not (math.isfinite(gain) and gain > 0):
        raise BenchError(f"{model!r} is not driven by volts", mend="use a model of volts to displacement")
    return 1 / gain
