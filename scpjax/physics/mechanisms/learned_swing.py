"""Closure of any balance or sensor by what swings in time, or repeats with the displacement: learned, unnamed."""

from dataclasses import dataclass
from typing import ClassVar

import jax.numpy as jnp
from jaxtyping import Array

from scpjax.parameter import Parameter, weight
from scpjax.physics.curves import SYMBOLS
from scpjax.physics.mechanism import Mechanism, Quantity, Side, Values, View

HARMONICS = (1, 2, 4)
"""Numbers of harmonics between which the recordings choose."""
WEIGHTS = tuple(f"{wave}{h}" for h in range(1, max(HARMONICS) + 1) for wave in ("cos", "sin"))


@dataclass(frozen=True)
class Swings:
    """What swings, as it is or in proportion to the temperature (``factor``), over which variable."""

    what: str
    factor: str = ""
    variable: str = "time"

    @property
    def name(self) -> str:
        """Such as "T s(t)"."""
        return f"{'T ' if self.factor else ''}s({SYMBOLS[self.variable]})"


FORMS = (
    Swings("drive"),
    Swings("heat"),
    Swings("heat", "temperature"),
    Swings("force"),
    Swings("force", "temperature"),
    Swings("temperature reading"),
    Swings("temperature reading", "temperature"),
    Swings("displacement reading"),
    Swings("displacement reading", "temperature"),
    Swings("force", variable="displacement"),
    Swings("displacement reading", variable="displacement"),
)


def law_of(form: Swings, harmonics: int) -> int:
    """The law under which something swings with so many harmonics."""
    return FORMS.index(form) * len(HARMONICS) + HARMONICS.index(harmonics)


def _over(variable: str) -> tuple[int, ...]:
    """Laws under which something swings over a variable."""
    return tuple(i for i in range(len(_LAWS)) if FORMS[i // len(HARMONICS)].variable == variable)


_LAWS = tuple(f"{f.what}: {f.name}, {h} harmonic{'s' * (h > 1)}" for f in FORMS for h in HARMONICS)


class LearnedSwing(Mechanism):
    name = "learned_swing"
    title = "Learned swing"
    subsystem = "balance"
    equation = (
        "s(t) = sum_h c_h cos(2 pi h t/P) + s_h sin(2 pi h t/P), t since the recording began;  or of x, x/p for t/P; "
        "by its law: "
        "effort (1 + s),  heat = -lambda T_ref f s,  force = -k x_ref f s,  or a reading greater by its reference "
        "times f s, with f = 1 or T/T_ref"
    )
    source = (
        "closure by a Fourier series, fitted through the simulation: VanderPlas, Astrophys. J. Suppl. 236 (2018) 16"
    )
    says = "Something swings with a period of its own, whatever the drive does, or repeats with the displacement."
    excited_by = "recordings that last or reach over many of its periods"
    learned = True
    timed = True
    laws = _LAWS
    terms: ClassVar[tuple[()]] = ()
    only_under: ClassVar[dict[str, tuple[int, ...]]] = {
        "period": _over("time"),
        "pitch": _over("displacement"),
        **{w: tuple(i for i in range(len(_LAWS)) if HARMONICS[i % len(HARMONICS)] >= int(w[3:])) for w in WEIGHTS},
    }
    parameters = (
        Parameter(
            name="period",
            symbol="P",
            unit="s",
            description="period of the swing",
            typical=10.0,
            bounds=(1e-4, 1e7),
            null=10.0,
        ),
        Parameter(
            name="pitch",
            symbol="p",
            unit="m",
            description="displacement after which it repeats",
            typical=1e-3,
            bounds=(1e-12, 1e6),
            null=1e-3,
        ),
        *(weight(w, w, f"{'cosine' if w[:3] == 'cos' else 'sine'} of harmonic {w[3:]}") for w in WEIGHTS),
        Parameter(
            name="reference_temperature",
            symbol="T_ref",
            unit="K",
            description="temperature excess at which the swing is stated",
            typical=50.0,
            bounds=(1e-6, 1e9),
            null=50.0,
            fixed=True,
        ),
        Parameter(
            name="reference",
            symbol="x_ref",
            unit="m",
            description="displacement for which the swing is stated",
            typical=0.01,
            bounds=(1e-12, 1e12),
            null=0.01,
            fixed=True,
        ),
    )
    starts = ((10.0, 1e-3, *(0.0,) * (len(WEIGHTS) + 2)),)

    def _of(self, what: str, p: Values, view: View) -> Array | float:
        """f s where the law is of it, else 0."""
        which, out, swing, along = jnp.floor_divide(p.law, len(HARMONICS)), 0.0, 0.0, 0.0
        for i, form in enumerate(FORMS):
            along = along + (which == i) * (form.variable == "displacement")
        angle = 2.0 * jnp.pi * jnp.where(along > 0, view.displacement / p.pitch, view.time / p.period)
        for h in range(1, max(HARMONICS) + 1):
            swing = swing + getattr(p, f"cos{h}") * jnp.cos(h * angle) + getattr(p, f"sin{h}") * jnp.sin(h * angle)
        for i, form in enumerate(FORMS):
            if form.what == what:
                f = view.temperature / p.reference_temperature if form.factor else jnp.ones_like(view.temperature)
                if what == "force" and view.radius and not form.factor:
                    f = f * jnp.array([1.0, 0.0])  # of a joint: alike on both sides, it would move nothing
                out = out + jnp.where(which == i, f, 0.0)
        return out * swing

    def effort(self, p: Values, view: View, effort: Side) -> Side:
        return effort * (1.0 + self._of("drive", p, view))

    def effort_for(self, p: Values, view: View, effort: Side) -> Side:
        return effort / (1.0 + self._of("drive", p, view))

    def heat(self, p: Values, view: View) -> Side | float:
        if "conductance" not in view.shared:
            return 0.0
        return -view.shared["conductance"] * p.reference_temperature * self._of("heat", p, view)

    def force(self, p: Values, view: View) -> Side | float:
        if "stiffness" not in view.shared:
            return 0.0
        return -view.shared["stiffness"] * p.reference * self._of("force", p, view)

    def reading(self, p: Values, view: View, quantity: Quantity, value: Side) -> Side:
        if quantity == "temperature":
            return value + p.reference_temperature * self._of("temperature reading", p, view)
        if quantity == "displacement":
            return value + p.reference * self._of("displacement reading", p, view)
        return value
