"""What can go wrong on the bench, each with a mend."""

from __future__ import annotations

from scpjax.errors import ScpjaxError


class BenchError(ScpjaxError):
    """The board, the port or what was asked of them does not allow it."""


class PortLost(BenchError):
    """The port went away: unplugged, closed at the other end, or the simulator died."""


class BoardReset(BenchError):
    """The board began anew while it was in use: its drive is off and its settings are gone."""


class BoardFault(BenchError):
    """The board cut the power: a limit was met (`scpjax.bench.messages.FAULTS`)."""


class NoAnswer(BenchError):
    """The board did not answer in time."""
