"""The error of this room."""

from __future__ import annotations

from scpjax.errors import ScpjaxError


class ControlError(ScpjaxError):
    """Gains, a reference, a loop or a gains file that cannot be used as they stand."""
