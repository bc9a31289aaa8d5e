"""What the emulated board does from tick to tick: ``rig/firmware/control.cpp`` in Python."""

from __future__ import annotations

from collections import deque

from scpjax.bench import messages as m
from scpjax.bench.guard import CHANNELS, Guard
from scpjax.bench.parameters import TICK_S

SLOTS = 256
"""Entries of the table, of which one is kept free."""


class Controls(Guard):
    """Hold, play a table, close the loop."""

    def _forget(self) -> None:
        super()._forget()
        self.driven = [0, 0]
        self.mode, self.fault = m.IDLE, m.NO_FAULT
        self.table: deque[int] = deque()
        self.given = self.taken = self.entries = 0
        self.per_entry, self.wait = 0, 0
        self.pids = [[0.0, 0.0], [0.0, 0.0]]  # integral, filtered

    def _stop(self) -> None:
        self.mode = m.IDLE
        self.table.clear()
        self.given = self.taken = self.entries = 0
        self.driven, self.counts = [0, 0], [0, 0]

    def _step(self) -> int:
        """One tick; `TABLE_END` or `UNDERRUN` where the table ends, else 0."""
        if self.mode not in (m.PLAY, m.LOOP):
            return m.NO_FAULT
        if self.wait:
            self.wait -= 1
            return m.NO_FAULT
        if self.taken == self.entries or not self.table:
            how = m.TABLE_END if self.taken == self.entries else m.UNDERRUN
            self._stop()
            return how
        entry = self.table.popleft()
        self.taken += 1
        self.wait = self.per_entry - 1
        if self.mode == m.PLAY:
            self.counts = [entry >> 8, entry & 0xFF]
            return m.NO_FAULT
        reference = (entry - 0x10000 if entry & 0x8000 else entry) * 0.01
        degrees = self._get("position_scale") * (self._counts_of_position() - self._get("position_zero"))
        dt = self.per_entry * TICK_S
        sides = ((0, 1.0), (1, -1.0))[: int(self._get("channels"))]
        self.counts = [self._count_of(self._pid(c, sign, reference - degrees, dt)) for c, sign in sides]
        self.counts += [0] * (CHANNELS - len(sides))
        return m.NO_FAULT

    def _pid(self, c: int, sign: float, error: float, dt: float) -> float:
        """Thesis (3.16)-(3.18), forward Euler; the clamp as in `scpjax.control.pid`."""
        integral, filtered = self.pids[c]
        push = dt * sign * self._get("ki") * error
        derivative = self._get("n") * (sign * self._get("kd") * error - filtered)
        asked = sign * self._get("kp") * error + integral + derivative
        effort = min(max(asked, 0.0), self._get("effort_limit"))
        if asked == effort or push * asked <= 0:
            integral += push
        self.pids[c] = [integral, filtered + dt * derivative]
        return effort

    def _count_of(self, effort: float) -> int:
        return int(255 * effort / self.config.supply_V**2 + 0.5)

    def _position(self) -> int:
        source = int(self._get("position_source"))
        return (self.inputs.sums[2], self.inputs.echo, self.inputs.encoder & 0xFFFF)[source]

    def _counts_of_position(self) -> int:
        raw = self._position()
        return raw - 0x10000 if self._get("position_source") >= 2 and raw & 0x8000 else raw
