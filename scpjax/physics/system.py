"""A base model of one's own, that is no heated actuator: tanks, an oscillator, whatever has states and a drive.

A file defines one `System`, and beside it the physics that it may leave out: mechanisms whose ``needs`` name the
system, and that add to the rates of its states by `Mechanism.flows` or to what its sensors read by
`Mechanism.reading`. ``scpjax fit`` and ``scpjax diagnose`` take the file with ``--base``.
"""

from __future__ import annotations

from typing import ClassVar

import numpy as np

from scpjax.physics.mechanism import Mechanism, Side, Subsystem, Values, View
from scpjax.units import Unit, parse_column


class System(Mechanism):
    """All balances of a base model: ``states``, how they change (`rates`) and what is measured of them (`observe`).

    ``outputs`` are columns with their unit (``level_V``); inside, everything is SI. ``view.effort`` is the drive
    column, in SI, ``view.own`` the states. `rates` and `observe` should be smooth where all states are zero, about
    which integrators linearise them; what is not belongs into `flows` of a mechanism.

    ``substeps`` of the integrator between two samples resolve its quickest flow. ``starts`` are values of the
    parameters where a fit may begin, best guess first; their typical ones when empty. The state that a recording begins
    in is estimated; when predicting, it is the one in which the system would stand still (under a constant drive) and
    show the first readings.
    """

    subsystem: ClassVar[Subsystem] = "balance"
    outputs: ClassVar[tuple[str, ...]]
    substeps: ClassVar[int] = 1

    def observe(self, p: Values, view: View) -> tuple[Side, ...]:
        """True value of each output, in SI."""
        raise NotImplementedError

    @property
    def channels(self) -> tuple[tuple[str, Unit], ...]:
        """Stem and unit of each output."""
        return tuple(parse_column(column, allow_unknown=True) for column in self.outputs)

    def beginnings(self) -> tuple[dict[str, float], ...]:
        """Values by parameter key where a fit may begin."""
        rows = self.starts or (tuple(p.typical for p in self.parameters),)
        return tuple(
            {f"{self.name}.{p.name}": float(v) for p, v in zip(self.parameters, row, strict=True)} for row in rows
        )


def fault(s: System) -> tuple[str, str] | None:
    """What a base of one's own lacks, and the mend; None where it is whole."""
    for text in ("title", "equation", "source", "says"):
        if not str(getattr(s, text, "")).strip():
            return f"has no {text}", f'write {text} = "..."'
    if not s.states or not s.parameters:
        return "has no states or no parameters", 'write states = ("level",) and parameters = (Parameter(...),)'
    if not getattr(s, "outputs", ()):
        return "has no outputs", 'write outputs = ("level_V",): the columns that it explains'
    for hook in ("rates", "observe"):
        if getattr(type(s), hook) in (getattr(Mechanism, hook, None), getattr(System, hook)):
            return f"has no {hook}", f"write {hook}(self, p, view), which returns one value each"
    for p in s.parameters:
        if p.null is not None:
            return f"{p.name} has a null value", "a base has none; what can vanish is a mechanism of its own"
    if any(len(row) != len(s.parameters) for row in s.starts):
        return "starts do not give a value for each parameter", "write starts = ((first, second, ...),)"
    for row in s.beginnings():
        for value, p in zip(row.values(), s.parameters, strict=True):
            if not p.fixed and not (np.isfinite(value) and p.bounds[0] <= value <= p.bounds[1]):
                return f"a start of {p.name} lies outside its bounds {p.bounds}", "start inside them"
    return None
