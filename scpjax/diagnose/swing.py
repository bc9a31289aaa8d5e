"""A closure by what swings: a Fourier series in the time since a recording began, or in the displacement, in the
balance where it swings.

The period comes from `scpjax.diagnose.rhythm`, which lets every recording have a phase of its own; here all share one,
so that other recordings can be predicted. Where they do not, there is no such closure, and the period is all to tell.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace

import numpy as np

from scpjax.diagnose.evidence import Comparison, Evidence, compare
from scpjax.diagnose.expression import WHAT, scale_of
from scpjax.diagnose.holdout import Split
from scpjax.diagnose.hypothesis import State, grown, laws_of
from scpjax.diagnose.result import Closure, Drawn
from scpjax.diagnose.rhythm import Rhythm
from scpjax.diagnose.trials import at_rest
from scpjax.fit.identifiability import Uncertainty
from scpjax.fit.problem import Trial
from scpjax.fit.result import Estimate
from scpjax.fit.setup import Setup, carry
from scpjax.fit.solve import make_room
from scpjax.physics.catalogue import mechanism
from scpjax.physics.mechanisms.learned_swing import HARMONICS, WEIGHTS, Swings, law_of

_NAME = "learned_swing"
_POINTS = 121
_PLACES = {
    "heat": "learned_heat",
    "force": "learned_force",
    "temperature reading": "learned_reading temperature",
    "displacement reading": "learned_reading displacement",
}
"""Where what swings stands (by `scpjax.diagnose.expression.WHAT`); the drive is none of them."""


@dataclass(frozen=True)
class Swing:
    """A swing found: the hypothesis that holds it, what swings with how many harmonics, and the evidence."""

    state: State
    form: Swings
    harmonics: int
    evidence: Comparison

    @property
    def period(self) -> float:
        """Period as fitted, [s] or [m]."""
        key = f"{_NAME}.{_period(self.form)}"
        return float(self.state.values[self.state.setup.structure.index[key]])

    @property
    def keys(self) -> tuple[str, ...]:
        """Its weights."""
        return tuple(f"{_NAME}.{w}" for w in WEIGHTS[: 2 * self.harmonics])


def swinging(state: State, split: Split, rules: Evidence, found: Rhythm) -> Swing | None:
    """The swing beyond ``state`` with as many harmonics as predict best; None where none is better than none."""
    if state.setup.structure.system:  # its balances have no swings here
        return None
    make_room()
    place = "displacement reading" if found.place == "angle reading" else found.place
    form = Swings(place, found.factor, found.variable)
    problem = _problem(state.setup, form, found.period)
    best: Swing | None = None
    before = state
    for harmonics in HARMONICS:
        law = law_of(form, harmonics)
        held = at_rest(problem, split, [_trial(problem, before, law, moves=False)])
        after = at_rest(problem, split, [_trial(problem, held, law, moves=True)])
        extra = 2 * (harmonics - (best.harmonics if best else 0)) + (best is None)
        evidence = compare(before, after, "closure", "", split, rules, extra)
        better = evidence.delta_bic > rules.bic and evidence.held_out_gain > 0
        if not (evidence.accepted if best is None else better):
            break
        whole = compare(state, after, "closure", "", split, rules, 2 * harmonics + 1)
        best, before = Swing(after, form, harmonics, whole), after
    return best


def _period(form: Swings) -> str:
    """Its parameter."""
    return "period" if form.variable == "time" else "pitch"


def _problem(setup: Setup, form: Swings, period: float) -> Setup:
    """The problem with a swing in its model."""
    problem = grown(setup, mechanism(_NAME))
    fixed, s, at = problem.fixed.copy(), setup.scales, problem.structure.index
    for name, value in (
        (_period(form), period),
        ("reference_temperature", s.temperature),
        ("reference", s.displacement),
    ):
        fixed[at[f"{_NAME}.{name}"]] = value
    return replace(problem, fixed=fixed)


def _trial(problem: Setup, state: State, law: int, *, moves: bool) -> Trial:
    """A hypothesis with a swing under a law, from where it stands; ``moves``: its period too."""
    old, new = state.setup.structure, problem.structure
    n, at = len(new.slots), new.index
    first = np.asarray(problem.starts[0])[:n].copy()
    for name in ("period", "pitch"):
        first[at[f"{_NAME}.{name}"]] = problem.fixed[at[f"{_NAME}.{name}"]]
    value = carry(old, new, state.values, first)
    active = carry(old, new, np.asarray(state.trial.active), np.zeros(n)).astype(bool)
    held = carry(old, new, np.asarray(state.trial.fixed), problem.fixed[:n])
    free = [p.name for p in mechanism(_NAME).free_parameters(law)]
    for p in mechanism(_NAME).parameters:
        active[at[f"{_NAME}.{p.name}"]] = p.name in free and (moves or p.name not in ("period", "pitch"))
    laws = laws_of(state.setup, np.asarray(state.trial.laws), problem)
    laws[next(i for i, m in enumerate(new.mechanisms) if m.name == _NAME)] = law
    width = int(problem.base_active.sum()) + len(WEIGHTS) + 1
    return replace(problem, fixed=held).trial(value, active, laws, max(width, int(active.sum())))


def draw_swing(found: Swing, every: Mapping[str, Estimate], values: Mapping[str, float], doubt: Uncertainty) -> Closure:
    """The closure with its swing over one period in units, and its 95 % band; arguments as of
    `scpjax.diagnose.distil.draw`.
    """
    what, unit, subsystem, place = "drive greater by", "%", "drive", "learned_swing drive"
    if found.form.what != "drive":
        place = _PLACES[found.form.what]
        what, unit, subsystem = WHAT[place]
    references = {n: float(values[f"{_NAME}.{n}"]) for n in ("reference_temperature", "reference")}
    size = 100.0 if found.form.what == "drive" else scale_of(place, values, *references.values())
    if found.form.factor:
        size, unit = size / references["reference_temperature"], f"{unit}/K"
    symbol, at_unit, factor = ("t", "s", 1.0) if found.form.variable == "time" else ("x", "mm", 1e3)
    key = f"{_NAME}.{_period(found.form)}"
    period, std = factor * every[key].value, factor * every[key].std
    phase = np.linspace(0.0, 1.0, _POINTS)
    turns = np.outer(2.0 * np.pi * phase, np.arange(1, found.harmonics + 1))
    waves = size * np.stack([np.cos(turns), np.sin(turns)], axis=2).reshape(_POINTS, -1)
    weights = np.array([every[k].value for k in found.keys])
    at = [doubt.keys.index(k) for k in found.keys]
    spread = np.sqrt(np.maximum(np.einsum("ij,jk,ik->i", waves, doubt.covariance[np.ix_(at, at)], waves), 0.0))
    curve = waves @ weights
    again = f"{_with_error(period, std)} {at_unit}"
    says = f"{what} {found.form.name}, s from {curve.min():.3g} to {curve.max():.3g} {unit} and back every {again}"
    if found.harmonics == 1:
        ahead = float(np.arctan2(weights[0], weights[1]))
        shift = f" {'+-'[ahead < 0]} {abs(ahead):.2f}" if abs(ahead) >= 0.005 else ""
        turn = f"sin(2π {symbol}/({again}){shift})"
        says = f"{what} {found.form.name}, s = {size * np.hypot(*weights):.3g} {unit} {turn}"
    return Closure(
        subsystem,
        place,
        (*(("temperature",) if found.form.factor else ()), found.form.variable),
        says,
        {k: every[k] for k in (key, *found.keys)},
        found.evidence.held_out_gain,
        found.evidence.delta_bic,
        Drawn(found.form.variable, at_unit, found.form.name, unit, phase * period, curve, spread, "", curve, 0.0),
    )


def _with_error(value: float, std: float) -> str:
    """A period and its standard error, to the last digit that counts, in brackets."""
    if not (np.isfinite(std) and std > 0):
        return f"{value:.4g}"
    places = max(-int(np.floor(np.log10(std))), 0)
    return f"({value:.{places}f} ± {std:.{places}f})"
