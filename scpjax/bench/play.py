"""Profiles and loops on a rig: a table played by the board, the PID on the board, the PID on the host."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from typing import Literal, TypeVar

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Float

from scpjax.bench import messages as m
from scpjax.bench.errors import BenchError, BoardFault
from scpjax.bench.link import Timed
from scpjax.bench.messages import Sample
from scpjax.bench.parameters import TICK_S
from scpjax.bench.rig import Rig, pairs
from scpjax.bench.wiring import Wiring
from scpjax.control.controller import Controller, scalar
from scpjax.control.pid import PID, Pair, check_sampling

C = TypeVar("C", bound=Controller)
Watch = Callable[[float], None]
"""Told the time [s] since the beginning, a few times in a second."""

_MOST_ENTRIES = 0xFFFF
_CHUNK = 12
_SLOTS = 250  # of the board's table
_GRID_TICKS = 4
_SPARE_S = 3.0
_SUPPLY_OFF = 0.1  # of the square of a supply, by which that of the firmware may differ from the bench's
_UNHEARD_S = 0.5  # after the end, when its event was lost on the line


@dataclass(frozen=True)
class Profile:
    """Counts (n, sides) that are held for ``ticks`` of 5 ms each."""

    counts: np.ndarray
    ticks: int

    @property
    def duration(self) -> float:
        """Seconds."""
        return len(self.counts) * self.ticks * TICK_S


def profile(rig: Rig, time: Float[np.ndarray, " n"], volts: Float[np.ndarray, "n sides"]) -> Profile:
    """A profile of root mean square voltages [V] at times [s], each held until the next.

    Periods that are whole ticks are kept; others are put on a grid of 20 ms.

    **Raises** `BenchError` for volts that the supply has not, times that do not grow, or more than the table can count.
    """
    volts = np.asarray(volts, float).reshape(len(time), -1)
    sides, supply = rig.wiring.sides, rig.wiring.supply_V
    if volts.shape[1] != sides:
        raise BenchError(f"{volts.shape[1]} drives for a bench with {sides}", mend="give one column for each side")
    if not np.all(np.isfinite(volts)) or volts.min() < 0 or volts.max() > supply * (1 + 1e-6):
        raise BenchError(
            f"a drive from {np.min(volts):.4g} to {np.max(volts):.4g} V with a supply of {supply:g} V",
            mend="stay within 0 and the supply, or scale the profile",
        )
    gaps = np.diff(time)
    if len(time) < 2 or gaps.min() <= 0:
        raise BenchError("the times of the profile do not grow", mend="give 2 rows or more, in order")
    period = float(np.median(gaps))
    ticks = round(period / TICK_S)
    even = np.max(np.abs(gaps - period)) < 1e-3 * period
    if not (even and 1 <= ticks <= 255 and abs(ticks * TICK_S - period) < 1e-3 * period):
        ticks = _GRID_TICKS
        grid = ticks * TICK_S * np.arange(max(2, math.ceil((time[-1] - time[0] + period) / (ticks * TICK_S) - 1e-6)))
        volts = volts[np.clip(np.searchsorted(time - time[0], grid + 1e-9, side="right") - 1, 0, len(time) - 1)]
    if len(volts) > _MOST_ENTRIES:
        raise BenchError(f"{len(volts)} steps are more than the board can count", mend=f"at most {_MOST_ENTRIES}")
    return Profile(rig.wiring.pwm(volts), ticks)


def play(rig: Rig, wanted: Profile, *, watch: Watch | None = None, begin: Callable[[], object] | None = None) -> None:
    """Let the board play a profile from its table, which is filled as it empties; returns when it has ended.

    ``begin()`` is called when the table is ready, right before the first entry.

    **Raises** `BoardFault` when a limit cut it off, and as `Rig` does.
    """
    first = wanted.counts[:, 0]
    second = wanted.counts[:, 1] if wanted.counts.shape[1] > 1 else np.zeros_like(first)
    _run(rig, "P", pairs(first.tolist(), second.tolist()), wanted.ticks, watch, begin)


def loop_on_board(
    rig: Rig, controller: Controller, reference: Float[np.ndarray, " n"], every: int, *, watch: Watch | None = None
) -> None:
    """Close the loop on the board along a reference [rad], one value for each ``every`` ticks.

    **Raises** `BenchError` for a controller that the firmware has not, or a reference beyond 327 degrees.
    """
    set_gains(rig, controller)
    degrees = np.round(100 * np.degrees(reference)).astype(int)
    if np.max(np.abs(degrees)) > 0x7FFF:
        raise BenchError("the reference goes beyond 327 degrees", mend="scale it down")
    _run(rig, "C", [int(d) & 0xFFFF for d in degrees], every, watch)


def set_gains(rig: Rig, controller: Controller) -> None:
    """Gains of a PID (or of a pair's agonist) onto the board, read back; and what its position means.

    **Raises** `BenchError` for what the firmware does not do: other forms than forward Euler with clamping, weights
    other than 1, an antagonist that is not the agonist's opposite, a number of sides that is not the bench's.
    """
    pid = controller.agonist if isinstance(controller, Pair) else controller
    if not isinstance(pid, PID):
        raise BenchError(f"a {type(controller).__name__} does not run on the board", mend="use --on host")
    w, opposite = rig.wiring, isinstance(controller, Pair) and _is_opposite(controller)
    if controller.sides != w.sides or (w.sides == 2 and not opposite):
        raise BenchError("the antagonist is not the agonist's opposite", mend="use --on host")
    weights = float(pid.reference_weight), float(pid.derivative_weight)
    if pid.form != "forward_euler" or pid.anti_windup != "clamping" or weights != (1.0, 1.0) or float(pid.low) != 0:
        mend = "use --on host, or form forward_euler with anti_windup clamping and weights 1"
        raise BenchError("the firmware does not do this form of PID", mend=mend)
    if w.position.source == "none":
        raise BenchError("no position sensor, so there is no loop to close", mend="connect one, see bench.toml")
    wanted = {k.lower(): float(v) for k, v in pid.gains.items()}
    _check_supply(rig)
    wanted["effort_limit"] = min(float(pid.high), w.supply_V**2)
    wanted |= {"position_scale": w.degrees_per_count, "position_zero": w.position.zero, "channels": float(w.sides)}
    for name, value in wanted.items():
        found = rig.set(name, value)
        if abs(found - value) > 1e-5 * max(1.0, abs(value)):
            raise BenchError(
                f"{name} is {found:g} on the board, not {value:g}", where=rig.device.name, mend="try again"
            )


def _check_supply(rig: Rig) -> None:
    """That the firmware was built for the bench's supply: it limits efforts to its own, and takes duties of it."""
    supply = rig.wiring.supply_V
    accepted = [rig.accepts("effort_limit", share * supply**2) for share in (1 - _SUPPLY_OFF, 1 + _SUPPLY_OFF)]
    if accepted != [True, False]:
        other = "a higher" if accepted[0] else "a lower"
        raise BenchError(
            f"the firmware was built for {other} supply than the bench's {supply:g} V",
            where=rig.device.name,
            mend="make SUPPLY_V of rig/firmware/config.h and supply_V of bench.toml what the supply is",
        )


def within_supply(controller: C, supply_V: float) -> C:
    """The controller with limits [V^2] that a supply can give, so that its integral stops where the drive does."""
    return jax.tree.map(
        lambda c: eqx.tree_at(lambda p: p.high, c, jnp.minimum(c.high, supply_V**2)) if isinstance(c, PID) else c,
        controller,
        is_leaf=lambda c: isinstance(c, PID),
    )


def _is_opposite(pair: Pair) -> bool:
    a, b = pair.agonist.gains, pair.antagonist.gains
    return all(abs(float(a[k]) + float(b[k])) < 1e-9 for k in ("Kp", "Ki", "Kd")) and float(a["N"]) == float(b["N"])


@dataclass(frozen=True)
class Followed:
    """A closed loop as it was: ``time`` [s], ``reference`` and ``angle`` [rad] (n,), ``voltage`` [V] (n, sides).

    Angle and voltage are NaN where the sample was lost on the line.
    """

    time: np.ndarray
    reference: np.ndarray
    angle: np.ndarray
    voltage: np.ndarray

    @property
    def rmse(self) -> float:
        """Of the tracking error, rad."""
        return float(np.sqrt(np.nanmean((self.reference - self.angle) ** 2)))


def follow(
    rig: Rig,
    controller: Controller,
    reference: Float[np.ndarray, " n"],
    *,
    every: int,
    on: Literal["board", "host"] = "board",
    watch: Watch | None = None,
) -> Followed:
    """Close the loop along a reference [rad], a value for each ``every`` ticks, on the board or here.

    **Raises** `BenchError` for what the board's controller does not do, `ControlError` for a filter that would blow up
    at this period, and as `Rig` does.
    """
    before = rig.options.every
    check_sampling(controller, every * TICK_S)
    rig.stream(every)
    rig.unread()
    seen: list[Timed] = []

    def take(time: float) -> None:
        seen.extend((t, s) for t, s in rig.unread() if s.mode == m.LOOP)
        if watch is not None:
            watch(time)

    if on == "host":
        seen += [(time, sample) for time, sample, _ in loop_on_host(rig, controller, reference, watch=watch)]
    else:
        loop_on_board(rig, controller, reference, every, watch=take)
        take(len(reference) * every * TICK_S)
    rig.stream(before)
    return _followed(rig.wiring, seen, np.asarray(reference, float), every * TICK_S)


def _followed(wiring: Wiring, seen: list[Timed], reference: np.ndarray, dt: float) -> Followed:
    """Samples beside the reference of their time since the first."""
    if not seen:
        raise BenchError("the loop gave no sample", mend="check the cable")
    at = np.array([round((time - seen[0][0]) / dt) for time, _ in seen])
    n = min(int(at[-1]) + 1, len(reference))
    angle, volts = np.full(n, np.nan), np.full((n, wiring.sides), np.nan)
    for k, (_, sample) in zip(at.tolist(), seen, strict=True):
        if k < n:
            angle[k], volts[k] = wiring.angle(sample), wiring.voltage(sample.pwm[: wiring.sides])
    return Followed(dt * np.arange(n), reference[:n], angle, volts)


def loop_on_host(
    rig: Rig, controller: Controller, reference: Float[np.ndarray, " n"], *, watch: Watch | None = None
) -> Iterator[tuple[float, Sample, tuple[float, ...]]]:
    """Close the loop here: at each sample the controller answers, and its effort is sent; one value of the reference
    [rad] for each sample. Yields time [s], sample and efforts [V^2].

    The period is that of the stream (`Rig.stream`); what the cable delays, the loop feels.
    """
    if controller.sides != rig.wiring.sides:
        raise BenchError(
            f"{controller.sides} controllers for a bench with {rig.wiring.sides}", mend="use a pair for a joint"
        )
    dt, controller = rig.period, within_supply(controller, rig.wiring.supply_V)
    step = jax.jit(lambda state, y, r: controller.step(state, y, r, scalar(dt)))
    step(controller.initial(), 0.0, 0.0)  # compiled before time counts
    state = controller.initial()
    supply = rig.wiring.supply_V**2
    began: float | None = None
    for time, sample in rig.samples(len(reference) * dt + 1.0):
        began = time if began is None else began
        k = round((time - began) / dt)
        if k >= len(reference):
            break
        angle = rig.wiring.angle(sample)
        if not math.isfinite(angle):
            mend = "check the sonar and what it looks at"
            raise BenchError("the position sensor gives nothing", where=rig.device.name, mend=mend)
        state, command = step(state, angle, float(reference[k]))
        efforts = tuple(float(e) for e in command.effort)
        rig.set_pwm(*(round(255 * min(max(e, 0.0), supply) / supply) for e in efforts))
        if watch is not None:
            watch(time - began)
        yield time - began, sample, efforts
    rig.stop()


def _run(
    rig: Rig,
    kind: str,
    entries: list[int],
    ticks: int,
    watch: Watch | None,
    begin: Callable[[], object] | None = None,
) -> None:
    if not 1 <= ticks <= 255:
        raise BenchError(f"{ticks} ticks of 5 ms for an entry", mend="take 1 to 255")
    rig.stop()
    sent, began = 0, 0.0
    ended = len(rig.events)
    step_s = ticks * TICK_S

    def fill(played: float) -> None:
        """Send what there must be room for: answers that say there is none would crowd out samples."""
        nonlocal sent
        while (chunk := entries[sent : sent + _CHUNK]) and sent + len(chunk) - played < _SLOTS:
            if rig.append(sent, chunk) < 0:
                return
            sent += len(chunk)

    fill(0.0)
    if begin is not None:
        begin()
    rig.begin(kind, ticks, len(entries))
    began = rig.device.now()
    until = began + len(entries) * step_s + _SPARE_S
    while True:
        rig.wait(min(0.25, max(6 * step_s, 0.02)), lambda: _over(rig, ended))
        passed = rig.device.now() - began
        if watch is not None:
            watch(min(passed, len(entries) * step_s))
        unheard = passed > len(entries) * step_s + _UNHEARD_S and rig.last is not None and rig.last.mode == m.IDLE
        if _over(rig, ended) or unheard:
            return
        if rig.device.now() > until:
            raise BoardFault("the table did not end in time", where=rig.device.name, mend="check the board")
        fill(passed / step_s - 2)


def _over(rig: Rig, since: int) -> bool:
    return any(e.what == m.TABLE_END for e in rig.events[since:])
