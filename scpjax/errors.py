"""The errors that a user meets: one line that says where, what and the mend."""

from __future__ import annotations


class ScpjaxError(ValueError):
    """Something the caller can mend. ``str(error)`` is one line: place, problem, mend.

    The command line prints that line and leaves with exit code 2.
    """

    def __init__(self, problem: str, *, where: str = "", mend: str = ""):
        self.problem, self.where, self.mend = problem, where, mend
        text = f"{where}: {problem}" if where else problem
        super().__init__(" ".join((f"{text}; {mend}" if mend else text).split()))


class RecordingError(ScpjaxError):
    """A recording, or the file it is read from, cannot be used as it stands."""


class ModelError(ScpjaxError):
    """A model, a parameter or a model file does not fit together."""


class FitError(ScpjaxError):
    """The data or the options do not allow the fit that was asked for."""
