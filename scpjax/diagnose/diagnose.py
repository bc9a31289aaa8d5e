"""The main job: recordings in; what physics was left out, the evidence, and the extended model out."""

from __future__ import annotations

import time
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace

import numpy as np

from scpjax.diagnose.closure import Learned, describe, learn
from scpjax.diagnose.holdout import Split, split
from scpjax.diagnose.latent import missing
from scpjax.diagnose.locate import locate, observe
from scpjax.diagnose.profiles import Limits
from scpjax.diagnose.result import Closure, Diagnosis, Latent, Named, Scores, Verdict
from scpjax.diagnose.rivals import Outcome, next_experiment
from scpjax.diagnose.select import Choice, Evidence, Progress, choose
from scpjax.diagnose.trials import State, grown, residual_on
from scpjax.fit.colour import Whitener
from scpjax.fit.data import Data
from scpjax.fit.fit import (
    best_start,
    final_model,
    noise_by_column,
    refine,
    scores,
    settle,
    traces,
)
from scpjax.fit.identifiability import estimates, uncertainty
from scpjax.fit.problem import Trial
from scpjax.fit.setup import Setup, prepare, what_there_is
from scpjax.physics.catalogue import applicable, left_out
from scpjax.recordings.recording import Recording

_AT_NOISE = 1.15  # ratio of residual to noise, in some column, up to which nothing more is asked for
_LITTLE_LEFT = 0.03  # of the held-out misfit in excess of the noise: what names may leave unsought
_MOST_LEFT = 0.4  # of it: names that leave more are not given
_FAR_BETTER = 0.5  # ratio of what a closure without names leaves to what the names leave, below which they are false


@dataclass(frozen=True, kw_only=True)
class DiagnoseOptions:
    """``evidence``: what it takes to be named. ``order``, ``substeps``, ``bin`` of the simulation as of a fit.
    ``next``: limits within which an experiment is designed that separates what is left close (None: none is)."""

    evidence: Evidence = field(default_factory=Evidence)
    order: int = 2
    substeps: int | None = None
    bin: int | None = None
    max_steps: int = 40
    next: Limits | None = None


def diagnose(
    recordings: Sequence[Recording],
    *,
    model: str | None = None,
    fixed: Mapping[str, float] | None = None,
    options: DiagnoseOptions | None = None,
    progress: Progress | None = None,
) -> Diagnosis:
    """Find what a base model of these recordings leaves out.

    ``recordings`` are of one actuator; ``model`` is te, tm, plant or aaa (from the files or their columns when None).
    Stretches of every recording are held out from fitting and judge every choice; the model returned is then fitted to
    all of it. ``progress(text, fraction)`` is called between steps.

    **Raises** `FitError`, `RecordingError` for recordings that cannot be fitted.
    """
    options = options or DiagnoseOptions()
    began = time.monotonic()
    tell = progress or (lambda text, fraction: None)
    tell("reading the recordings for a start", 0.0)
    setup = prepare(
        recordings,
        model=model,
        fixed=fixed,
        bin=options.bin,
        order=options.order,
        substeps=options.substeps,
    )
    candidates = (m for m in left_out() if applicable(m, what_there_is(setup.structure, setup.recordings)))
    catalogue = grown(setup, *candidates)
    tell("fitting the base model", 0.05)
    parts, base, notes = _base(setup)
    choice = choose(base, parts, options.evidence, catalogue, max_steps=options.max_steps, progress=tell)
    if choice.state.names:  # jumps inside gaps are timed better by the better model
        problem = choice.state.setup
        again, data, _ = settle(problem, choice.state.trial, parts.train, drop_outliers=False)
        parts = _with_effort(parts, data)
        choice = replace(choice, state=_state(problem, parts, again))
    learned = None
    if level(choice.state, parts) > _AT_NOISE:
        tell("learning what the catalogue does not hold", 0.75)
        choice, learned = _closure(parts, base, choice, options.evidence)
    tell("fitting the chosen model to all data", 0.85)
    found = _report(setup, parts, base, choice, learned, notes, began, options)
    if options.next is None:
        return found
    outcome = Outcome(base, choice.state, learned.state if learned else None, choice.ranking, choice.equivalents)
    return replace(found, next_experiment=next_experiment(outcome, parts, options.next, lambda text: tell(text, 0.9)))


def _base(setup: Setup) -> tuple[Split, State, tuple[str, ...]]:
    """The base model fitted to the training part, jumps in gaps timed and wild samples out."""
    parts = split(setup.data)
    trial, _, _ = best_start(setup, parts.train)
    trial, data, notes = settle(setup, trial, setup.data)
    if data is not setup.data:
        parts = split(data)
    trial, _, _ = refine(setup, parts.train, trial)
    return parts, _state(setup, parts, trial), notes


def _state(setup: Setup, parts: Split, trial: Trial) -> State:
    residual = residual_on(trial, parts.whole, setup)
    return State(setup, trial, residual, float(np.sum(residual[parts.is_train] ** 2)))


def level(state: State, parts: Split) -> float:
    """RMS misfit in units of the noise, in the column where it is greatest."""
    there = parts.is_train | parts.is_held
    columns = [j for j in range(there.shape[2]) if there[..., j].any()]
    return max(float(np.sqrt(np.mean(state.residual[..., j][there[..., j]] ** 2))) for j in columns)


def _excess(state: State, where: np.ndarray) -> float:
    """Sum of squares beyond what the noise makes."""
    return max(float(np.sum(state.residual[where] ** 2) - where.sum()), 0.0)


def _closure(parts: Split, base: State, choice: Choice, rules: Evidence) -> tuple[Choice, Learned | None]:
    """What is to be said when the named mechanisms do not reach the noise.

    Names that leave much of the misfit are false if a closure without them predicts the held-out stretches far better,
    or if they leave most of it. A closure is learned beyond the names that stay.
    """
    held = parts.is_held
    whole, left = _excess(base, held), _excess(choice.state, held)
    if left <= _LITTLE_LEFT * whole:
        return choice, None
    alone = learn(base, parts, rules)
    if not choice.state.names:
        return choice, alone
    nameless = Choice(base, choice.ranking, {}, {})
    if alone is not None and _excess(alone.state, held) < _FAR_BETTER * left:
        return nameless, alone
    if left > _MOST_LEFT * whole:
        return nameless, alone
    return choice, learn(choice.state, parts, rules)


def _with_effort(parts: Split, data: Data) -> Split:
    effort = np.asarray(data.grids.effort)
    return Split(
        parts.train.with_effort(effort),
        parts.whole.with_effort(effort),
        parts.is_train,
        parts.is_held,
        parts.mask,
    )


def _report(
    setup: Setup,
    parts: Split,
    base: State,
    choice: Choice,
    learned: Learned | None,
    notes: tuple[str, ...],
    began: float,
    options: DiagnoseOptions,
) -> Diagnosis:
    state = learned.state if learned else choice.state
    problem = state.setup
    held = np.where(parts.mask, np.asarray(parts.whole.weights), 0.0)
    train = np.asarray(parts.train.weights)
    final, final_data = _final(parts, state)
    base_final, _ = _final(parts, base)
    doubt = uncertainty(final, final_data, problem.space, coloured=final_data is parts.whole)
    every = estimates(final, problem.space, doubt)
    binned = observe(setup, parts.whole, base.trial, base.residual)
    lacking = missing(setup, parts.whole, base.trial, binned)
    named = _named(choice, every)
    closure = describe(learned, every) if learned else None
    subsystem = closure.subsystem if closure and not named else _subsystem(choice, lacking)
    verdict, says = _verdict(choice.state, parts, named, closure)
    noise = noise_by_column(setup)
    model = " + ".join((setup.structure.name, *choice.state.names, *(["closure"] if learned else [])))
    return Diagnosis(
        verdict=verdict,
        says=says,
        base=Scores(
            setup.structure.name,
            scores(setup, parts.train, base.trial, train),
            scores(setup, parts.whole, base.trial, held),
            noise,
        ),
        extended=Scores(
            model,
            scores(problem, parts.train, state.trial, train),
            scores(problem, parts.whole, state.trial, held),
            noise,
        ),
        location=locate(setup, binned, subsystem, lacking),
        mechanisms=named,
        ranking=choice.ranking,
        closure=closure,
        missing=lacking,
        base_parameters={k: e for k, e in every.items() if k.split(".")[0] in setup.structure.base},
        not_identifiable=doubt.open_directions,
        notes=setup.notes + notes,
        model=final_model(problem, final),
        base_model=final_model(setup, base_final),
        traces=traces(setup, parts.whole, base.trial, state.trial, parts.mask, extended_setup=problem),
        seconds=time.monotonic() - began,
        settings={
            "files": [r.metadata.path or r.metadata.name for r in setup.recordings],
            "bin": setup.data.bin,
            "order": setup.data.order,
            "substeps": options.substeps,
            "evidence": vars(options.evidence),
            "held_out": "25-35 %, 60-70 % and 90-100 % of every recording",
        },
    )


def _final(parts: Split, state: State) -> tuple[Trial, Data]:
    """The hypothesis fitted to all data, by generalised least squares where its residuals stay coloured.

    The colour is believed if the held-out stretches, filtered by it, are predicted no worse by a training fit that
    uses it than by one that does not.
    """
    setup, there = state.setup, parts.is_train | parts.is_held
    white = Whitener.learn(state.residual, there)
    trial, _, _ = refine(setup, parts.whole, state.trial)
    if white.is_white:
        return trial, parts.whole
    trained, _, _ = refine(setup, parts.train.with_colour(white.colour), state.trial)
    plain, filtered = (white(r, parts.is_held)[0] for r in (state.residual, residual_on(trained, parts.whole, setup)))
    if filtered > plain * (1 + 1e-3):
        return trial, parts.whole
    data = parts.whole
    for _ in range(2):
        data = parts.whole.with_colour(white.colour)
        trial, _, _ = refine(setup, data, trial)
        white = Whitener.learn(residual_on(trial, parts.whole, setup), there)
    return trial, data


def _named(choice: Choice, every: Mapping) -> tuple[Named, ...]:
    out = []
    laws = choice.state.laws
    for name in choice.state.names:
        m = choice.state.setup.structure.mechanism(name)
        mine = {k.split(".")[1]: e for k, e in every.items() if k.startswith(f"{name}.")}
        out.append(
            Named(
                name=name,
                title=m.title,
                subsystem=m.subsystem,
                law=laws[name],
                probability=choice.probability.get(name, 0.0),
                parameters=mine,
                equivalents=choice.equivalents.get(name, ()),
                says=m.says,
                equation=m.equation,
                source=m.source,
            )
        )
    return tuple(out)


def _subsystem(choice: Choice, lacking: Sequence[Latent]) -> str:
    """The balance of the mechanism that removes most; without one, that which best answers for the misfit."""
    if choice.state.names:
        return choice.state.setup.structure.mechanism(choice.state.names[0]).subsystem
    return lacking[0].subsystem


def _verdict(state: State, parts: Split, named: tuple[Named, ...], closure: Closure | None) -> tuple[Verdict, str]:
    ratio = level(state, parts)
    names = " and ".join(m.title[0].lower() + m.title[1:] for m in named)
    learned = f" Learned in its place: {closure.expression}." if closure else ""
    if not named and ratio <= _AT_NOISE:
        return "adequate", "Nothing is missing: at this noise the base model explains the recordings."
    if not named:
        return (
            "unexplained",
            f"Something is missing (the misfit is {ratio:.1f} times the noise) that no mechanism of the catalogue "
            f"explains.{learned}",
        )
    if ratio <= _AT_NOISE:
        return "explained", f"Left out of the base model: {names}. With it the misfit is down to the noise."
    return (
        "unexplained",
        f"Left out of the base model: {names}; but the misfit is still {ratio:.1f} times the noise, so something "
        f"else is missing too.{learned}",
    )
