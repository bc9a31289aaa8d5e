"""A diagnosis put together: verdict, scores, names with their error bars, and the models fitted to all data."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import Any

import numpy as np

from scpjax.diagnose.beyond import Beyond, balance_of
from scpjax.diagnose.choice import Choice
from scpjax.diagnose.curve import Curve
from scpjax.diagnose.distil import draw
from scpjax.diagnose.expression import describe, in_words
from scpjax.diagnose.final import fitted_to_all, resolved
from scpjax.diagnose.holdout import Split
from scpjax.diagnose.hypothesis import State, residual_on
from scpjax.diagnose.intervals import profiled
from scpjax.diagnose.locate import Binned, locate
from scpjax.diagnose.mode import Mode, draw_mode
from scpjax.diagnose.patience import Patience
from scpjax.diagnose.reaction import Reaction, draw_reaction
from scpjax.diagnose.remainder import AT_NOISE, form_at_most, level, takes_most
from scpjax.diagnose.result import FREE, Closure, Diagnosis, Drawn, Latent, Named, Reference, Scores, Verdict
from scpjax.diagnose.rhythm import Rhythm
from scpjax.diagnose.swing import Swing, draw_swing
from scpjax.fit.fit import final_model, noise_by_column, scores, traces
from scpjax.fit.identifiability import Uncertainty, estimates, uncertainty
from scpjax.fit.result import Estimate
from scpjax.parameter import Parameter
from scpjax.physics.catalogue import mechanism

TRUSTED: dict[Verdict, float] = {
    "explained": (363 + 1) / (371 + 2),
    "adequate": 1.0,
    "unexplained": (24 + 1) / (29 + 2),
}
"""By verdict, how often a name is right of which the evidence alone is certain: the counts in ``docs/concealed.md`` by
Laplace's rule of succession. The evidence compares the laws of the catalogue as if one of them were exact; this is what
it does not know.
"""

_RANG = (
    "what was learned beyond the model told here was left out: it fits the means of a few samples each by ringing "
    "between them, and misses the single samples by more than that model does"
)

_SWINGS = {
    "drive": "a supply or a driver that wavers",
    "thermoelectric": "a fan, a thermostat or sunshine",
    "thermomechanical": "what shakes or loads the actuator",
    "sensor": "what disturbs the sensor, such as the mains,",
    "balance": "what acts on it",
}
"""What may swing in a balance."""


def answer(
    parts: Split,
    base: State,
    choice: Choice,
    learned: Beyond | Swing | None,
    binned: Binned,
    lacking: tuple[Latent, ...],
    swing: Rhythm | None = None,
    *,
    as_well: Sequence[Curve] = (),
    notes: tuple[str, ...],
    patience: Patience,
    settings: Mapping[str, Any],
) -> Diagnosis:
    """The whole answer; the hypotheses are fitted once more, to all data. ``swing`` is of what nothing explains;
    ``as_well`` what no name is and predicts what the only one does; ``patience`` began with the diagnosis."""
    setup = base.setup
    state = learned.state if learned else choice.state
    problem = state.setup
    fine, by_fine, steps = resolved(state, parts, patience)
    final, final_data = fitted_to_all(fine, by_fine, patience)
    base_final, _ = fitted_to_all(parts, base, patience)
    doubt = uncertainty(final, final_data, problem.space, coloured=final_data is fine.whole)
    every = profiled(problem, final, final_data, doubt, estimates(final, problem.space, doubt), patience)
    fitted = final_model(problem, final)
    closure = _in_units(learned, every, fitted.values(), doubt)
    named = _named(choice, every, fitted.values(), tuple(in_words(c) for c in as_well)) + _by_curve(
        choice, learned, closure
    )
    most = learned is not None and takes_most(base, learned.state, parts)
    subsystem = swing.subsystem if swing else _subsystem(choice, closure if most else None, lacking)
    left = level(replace(state, residual=residual_on(final, fine.whole, problem)), parts)
    verdict, says = _verdict(base, choice, state, parts, named, closure, left)
    if swing:
        says += f" {swing.says}"
    named = tuple(replace(m, probability=m.probability * TRUSTED[verdict]) for m in named)
    model = " + ".join((setup.structure.name, *choice.state.names, *(["closure"] if learned else [])))
    return Diagnosis(
        verdict=verdict,
        says=says,
        base=_scores(setup.structure.name, base, parts),
        extended=_scores(model, state, parts),
        location=replace(locate(setup, binned, subsystem, lacking), **_repeating(swing)),
        mechanisms=named,
        ranking=choice.ranking,
        closure=closure,
        missing=lacking,
        base_parameters={k: e for k, e in every.items() if k.split(".")[0] in setup.structure.base},
        not_identifiable=doubt.open_directions,
        notes=setup.notes + notes + patience.notes() + steps + _nearest(choice) + _of(swing),
        model=fitted,
        base_model=final_model(setup, base_final),
        traces=traces(setup, parts.whole, base.trial, state.trial, parts.mask, extended_setup=problem),
        seconds=patience.passed(),
        settings={
            "files": [r.metadata.path or r.metadata.name for r in setup.recordings],
            "bin": setup.data.bin,
            **settings,
            "held_out": "25-35 %, 60-70 % and 90-100 % of every recording that is long enough",
        },
    )


def _in_units(
    learned: Beyond | Swing | None,
    every: Mapping[str, Estimate],
    values: Mapping[str, float],
    doubt: Uncertainty,
) -> Closure | None:
    """What was learned, as it is told."""
    if isinstance(learned, Curve):
        return draw(learned, every, values, doubt)
    if isinstance(learned, Swing):
        return draw_swing(learned, every, values, doubt)
    if isinstance(learned, Reaction):
        return draw_reaction(learned, every, values, doubt)
    if isinstance(learned, Mode):
        return draw_mode(learned, every, values, doubt)
    return None if learned is None else describe(learned, every, values)


def _scores(model: str, state: State, parts: Split) -> Scores:
    """How well a hypothesis fits what it was fitted to, and predicts what was held out."""
    held = np.where(parts.mask, np.asarray(parts.whole.weights), 0.0)
    return Scores(
        model,
        scores(state.setup, parts.train, state.trial, np.asarray(parts.train.weights)),
        scores(state.setup, parts.whole, state.trial, held),
        noise_by_column(state.setup),
    )


def _named(
    choice: Choice, every: Mapping[str, Estimate], values: Mapping[str, float], as_well: tuple[str, ...]
) -> tuple[Named, ...]:
    out = []
    laws = choice.state.laws
    for name in choice.state.names:
        m = choice.state.setup.structure.mechanism(name)
        mine = {k.split(".", 1)[1]: e for k, e in every.items() if k.startswith(f"{name}.")}
        own = [key.split(".", 1) for key in choice.state.setup.structure.own]
        out.append(
            Named(
                name=name,
                title=m.title,
                subsystem=m.subsystem,
                law=laws[name],
                probability=choice.probability.get(name, 0.0),
                parameters=mine,
                equivalents=tuple(n for n in choice.equivalents.get(name, ()) if n not in choice.state.names),
                says=m.says,
                equation=m.equation,
                source=m.source,
                as_well=as_well,
                by_recording=tuple(p for mechanism_, p in own if mechanism_ == name),
                references={
                    p.name: Reference(values[f"{name}.{p.name}"], p.unit, p.symbol)
                    for p in m.parameters
                    if p.fixed and m.serves(p, m.laws.index(laws[name]))
                },
            )
        )
    return tuple(out)


def _by_curve(choice: Choice, learned: Beyond | Swing | None, closure: Closure | None) -> tuple[Named, ...]:
    """The mechanism that a learned curve is, with the curve's values at quarters of its range for parameters."""
    if not choice.free:
        return ()
    assert isinstance(learned, Curve)
    assert closure is not None
    assert closure.curve is not None
    m, curve = mechanism(choice.free), mechanism(learned.mechanism)
    return (
        Named(
            name=m.name,
            title=m.title,
            subsystem=m.subsystem,
            law=FREE,
            probability=choice.probability[m.name],
            parameters=_values_of(closure.curve),
            equivalents=choice.equivalents[m.name],
            says=m.says,
            equation=f"{curve.equation}; here f s(w) = {learned.form.name}",
            source=curve.source,
        ),
    )


def _values_of(drawn: Drawn) -> dict[str, Estimate]:
    """A curve at the quarters of its range from rest to the far end, in SI."""
    per_mm = drawn.unit.endswith("/mm")
    unit, size = (drawn.unit.replace("/mm", "/m"), 1e3) if per_mm else (drawn.unit, 1.0)
    far = float(drawn.at[np.argmax(np.abs(drawn.at))])
    out = {}
    for quarter in (1, 2, 3, 4):
        at = far * quarter / 4
        value, std = (size * float(np.interp(at, drawn.at, x)) for x in (drawn.value, drawn.std))
        where = f"{at:.3g} {drawn.at_unit}"
        words = f"the curve of {drawn.product} at a {drawn.variable} of {where}"
        out[f"s{quarter}"] = Estimate(value, std, unit, value - 1.96 * std, value + 1.96 * std, words, f"s({where})")
    return out


def _nearest(choice: Choice) -> tuple[str, ...]:
    """Notes on the names that were given up, and on what was learned and left out."""
    names, left = choice.given_up
    rang = (_RANG,) if choice.rang else ()
    kept = [_beyond(n, asked) for n, asked in choice.overstretched.items() if n not in names]
    rang = (*(f"named, as nothing else explains it, though it is more than physics allows: {k}" for k in kept), *rang)
    if not names:
        return rang
    why = f"with it {100 * left:.0f} % of the misfit stays"
    if choice.outdone:
        why = "what was learned in their place explains the same, and better"
    elif choice.overstretched:
        asked = ", ".join(_beyond(n, asked) for n, asked in choice.overstretched.items() if n in names)
        why = f"the recordings ask for more than physics allows: {asked}"
    return (f"nearest in the catalogue: {' with '.join(names)}; not named, for {why}", *rang)


def _beyond(name: str, parameters: Sequence[str]) -> str:
    """What the recordings ask for of a mechanism of which some parameters ask for more than its law allows."""
    m = mechanism(name)
    asked = [f"{p.name.replace('_', ' ')} of {name} {_outside(p)}" for p in m.parameters if p.name in parameters]
    return " and ".join([*asked, *([m.impossible] if m.impossible in parameters else [])])


def _outside(p: Parameter) -> str:
    """Where a parameter is asked for: a strength can only be asked for above its bounds."""
    low, high = p.bounds
    return f"above {high:g}" if p.null == 0.0 else f"outside {low:g} to {high:g}"


def _repeating(swing: Rhythm | None) -> dict[str, float]:
    """The period of what swings, for the location."""
    if swing is None:
        return {}
    return {"period_s" if swing.variable == "time" else "period_m": swing.period}


def _of(swing: Rhythm | None) -> tuple[str, ...]:
    """A note on what swings."""
    if swing is None:
        return ()
    if swing.variable == "displacement":
        return (
            f"a swing of {swing.place} over every {1e3 * swing.period:.3g} mm of displacement takes away "
            f"{100 * swing.share:.0f} % of the misfit beyond the noise: look for a pulley out of round, or an encoder "
            "or scale whose error repeats; slow motion hardly tells that from a force that repeats",
        )
    return (
        f"a swing of {swing.place.replace('_', ' ')} with a period of {swing.period:.3g} s, in a phase of its own in "
        f"each recording, takes away {100 * swing.share:.0f} % of the misfit beyond the noise: "
        f"look for {_SWINGS[swing.subsystem]} with that period",
    )


def _subsystem(choice: Choice, closure: Closure | None, lacking: Sequence[Latent]) -> str:
    """The balance of the mechanism that removes most; without one, that which best answers for the misfit, among those
    that ``closure`` stands for, if one was learned that takes most of it.
    """
    if choice.free:
        return mechanism(choice.free).subsystem
    if choice.state.names:
        return choice.state.setup.structure.mechanism(choice.state.names[0]).subsystem
    if closure is None:
        return lacking[0].subsystem
    if closure.depends_on != ("drive",):
        return closure.subsystem
    return next((m.subsystem for m in lacking if balance_of(m.subsystem) == closure.subsystem), closure.subsystem)


def _verdict(
    base: State,
    choice: Choice,
    final: State,
    parts: Split,
    named: tuple[Named, ...],
    closure: Closure | None,
    left: float,
) -> tuple[Verdict, str]:
    """``choice.state`` holds what is named, ``final`` the closure as well, if there is one; ``left`` is the misfit in
    units of the noise when that is fitted to all data."""
    state = choice.state
    ratio = level(state, parts)
    names = " and ".join(_in_a_sentence(m.title) for m in named)
    as_well = f" ({' or '.join(closure.equivalents)} would do as well here)" if closure and closure.equivalents else ""
    instead = (closure.in_a_sentence or closure.expression) if closure else ""
    form = f"{instead}{as_well}; with it the misfit is {left:.1f} times the noise." if closure else ""
    learned = f" Learned in its place: {form}" if closure else ""
    if not named and ratio <= AT_NOISE:
        return "adequate", "Nothing is missing: at this noise the base model explains the recordings."
    if closure and not state.names and named:
        said = f"Left out of the base model: {names}, by a law that the catalogue does not hold: {closure.expression}"
        if left <= AT_NOISE:
            return "explained", f"{said}. With it the misfit is down to the noise."
        return "unexplained", f"{said}; but the misfit is still {left:.1f} times the noise."
    if closure and choice.outdone:
        others = " with ".join(f'"{_in_a_sentence(mechanism(n).title)}"' for n in choice.given_up[0])
        return (
            "unexplained",
            f"Something is missing (the misfit is {ratio:.1f} times the noise). What was learned for it explains it "
            f"better than {others} would: {form}",
        )
    if not named:
        return (
            "unexplained",
            f"Something is missing (the misfit is {ratio:.1f} times the noise) that no mechanism of the catalogue "
            f"explains.{learned}",
        )
    if ratio <= AT_NOISE:
        return "explained", f"Left out of the base model: {names}. With it the misfit is down to the noise."
    if closure and form_at_most(base, state, parts) and level(final, parts) <= AT_NOISE:
        return (
            "explained",
            f"Left out of the base model: {names}. That leaves {ratio:.1f} times the noise, which a correction in form "
            f"takes away: {instead}.",
        )
    return (
        "unexplained",
        f"Left out of the base model: {names}; but the misfit is still {ratio:.1f} times the noise, so something "
        f"else is missing too.{learned}",
    )


def _in_a_sentence(title: str) -> str:
    return title[0].lower() + title[1:]
