"""The main job: recordings in; what physics was left out, the evidence, and the extended model out."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import partial

from scpjax.abreast import meanwhile
from scpjax.diagnose.answer import answer
from scpjax.diagnose.beyond import Beyond, able
from scpjax.diagnose.choice import Choice, Progress
from scpjax.diagnose.evidence import Evidence, ahead, is_better
from scpjax.diagnose.experiment import check_limits
from scpjax.diagnose.expression import in_words
from scpjax.diagnose.free import nameless
from scpjax.diagnose.given_up import beyond_names, form_rather_than_name, nothing_explains, outdone
from scpjax.diagnose.holdout import Split, split
from scpjax.diagnose.hypothesis import State, grown
from scpjax.diagnose.latent import Misfit, missing
from scpjax.diagnose.locate import observe
from scpjax.diagnose.naming import Found, find_names, state_at
from scpjax.diagnose.patience import Patience
from scpjax.diagnose.profiles import Limits
from scpjax.diagnose.proposal import NO_EXPERIMENT
from scpjax.diagnose.remainder import AT_NOISE, level, no_scale, swings_within_bins
from scpjax.diagnose.result import Diagnosis, Latent
from scpjax.diagnose.rhythm import Rhythm, rhythms, ripple
from scpjax.diagnose.rivals import Outcome, next_experiment
from scpjax.diagnose.rows import drive_until_then
from scpjax.diagnose.screen import ready
from scpjax.diagnose.swing import Swing, swinging
from scpjax.errors import FitError
from scpjax.fit.fit import best_start, refine, settle
from scpjax.fit.setup import Setup, prepare, what_there_is
from scpjax.physics.catalogue import applicable, left_out
from scpjax.recordings.recording import Recording

_NO_SCALE = (
    "the base model misses by {far:.0f} times the noise: so far from it names are judged by four sets of stretches "
    "held out in turn, the second half of each recording among them; so are gains told of those with evidence, beside "
    "what leaves as much"
)


@dataclass(frozen=True, kw_only=True)
class DiagnoseOptions:
    """``evidence``: what it takes to be named. ``order``, ``substeps``, ``bin`` of the simulation as of a fit.
    ``next``: limits within which an experiment is designed that separates what is left close (None: none is).
    ``patience``: seconds after which no other explanation is sought where none has reached the noise, a second name
    apart; after half as many more (a minute at least) nothing else is begun that the answer can do without. An
    experiment (``next``) comes on top."""

    evidence: Evidence = field(default_factory=Evidence)
    order: int = 2
    substeps: int | None = None
    bin: int | None = None
    max_steps: int = 40
    next: Limits | None = None
    patience: float = math.inf


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
    Stretches of every recording that is long enough are held out from fitting and judge every choice; the model
    returned is then fitted to all of it. ``progress(text, fraction)`` is called between steps.

    **Raises** `FitError`, `RecordingError` for recordings that cannot be fitted, and limits that leave no experiment
    (a note tells of it where that shows in the end only).
    """
    options = options or DiagnoseOptions()
    patience = Patience(options.patience)
    tell = progress or (lambda text, fraction: None)
    tell("reading the recordings for a start", 0.0)
    prepared = partial(
        prepare, model=model, fixed=fixed, bin=options.bin, order=options.order, substeps=options.substeps
    )
    setup = prepared(recordings)
    if options.next is not None:
        check_limits(options.next, setup)
    there = what_there_is(setup.structure, setup.recordings)
    catalogue = grown(setup, *(m for m in left_out() if applicable(m, there)))
    tell("fitting the base model", 0.05)
    with meanwhile(lambda: None if setup.structure.system else ready(setup, catalogue)):
        parts, base, notes = _base(setup)
    rules, steps = options.evidence, options.max_steps
    found = find_names(base, parts, catalogue, rules, max_steps=steps, patience=patience, progress=tell)
    parts, base = found.parts, found.base
    notes += drive_until_then(base, parts, recordings, lambda others: _base(prepared(others))[:2], patience)
    binned = observe(setup, parts.whole, base.trial, base.residual)
    misfit = Misfit(setup, parts.whole, base.trial, binned)
    lacking = missing(misfit)
    choice, learned, swing = _beyond(found, misfit, lacking, rules, patience, tell)
    tell("what outside the catalogue would do as well", 0.8)
    as_well = nameless(base, choice, parts, rules, patience) if learned is None else ()
    tell("fitting the chosen model to all data", 0.85)
    told = answer(
        parts,
        base,
        choice,
        learned,
        binned,
        lacking,
        swing,
        as_well=as_well,
        notes=notes + found.notes,
        patience=patience,
        settings={"order": options.order, "substeps": options.substeps, "evidence": vars(rules)},
    )
    if options.next is None:
        return told
    beyond = learned.state if learned else None
    alike = {in_words(c): c.state for c in as_well}
    outcome = Outcome(base, choice.state, beyond, choice.ranking, choice.equivalents, alike)
    try:
        proposed = next_experiment(outcome, parts, options.next, lambda text: tell(text, 0.9))
    except FitError as error:  # what was found is not lost for that
        return replace(told, notes=(*told.notes, f"{NO_EXPERIMENT}{error}"))
    return replace(told, next_experiment=proposed)


def _base(setup: Setup) -> tuple[Split, State, tuple[str, ...]]:
    """The base model fitted to the training part, jumps in gaps timed and wild samples out."""
    parts = split(setup.data)
    trial, _, _ = best_start(setup, parts.train)
    trial, data, notes = settle(setup, trial, setup.data)
    if data is not setup.data:
        parts = split(data)
    trial, _, _ = refine(setup, parts.train, trial)
    base = state_at(setup, parts, trial)
    told = (_NO_SCALE.format(far=level(base, parts)),) if no_scale(base, parts) else ()
    return parts, base, notes + told


def _beyond(
    found: Found, misfit: Misfit, lacking: tuple[Latent, ...], rules: Evidence, patience: Patience, tell: Progress
) -> tuple[Choice, Beyond | Swing | None, Rhythm | None]:
    """What is named in the end, what is learned beyond it, and what repeats, where nothing explains the misfit or where
    that alone does better than what does not reach the noise, or than a name that goes by a curve.
    """
    parts, base, choice, learned = found.parts, found.base, found.choice, found.curve
    if learned is None and level(choice.state, parts) > AT_NOISE:
        tell("learning what the catalogue does not hold", 0.75)
        choice, learned = beyond_names(parts, base, choice, rules, able(lacking, base, parts), patience)
    elif learned is None:
        choice, learned = form_rather_than_name(parts, base, choice, rules, patience)
    if found.curve is None and learned is not None and swings_within_bins(learned.state, choice.state, parts):
        stay = found.choice if choice.outdone else choice  # also names that it alone was better than
        choice, learned = replace(stay, rang=True), None
    best = learned.state if learned is not None else choice.state
    nothing = nothing_explains(base, choice, learned, parts)
    if not (nothing or choice.free or level(best, parts) > AT_NOISE):
        return choice, learned, None
    swing, by_swing = _repeating(misfit, lacking, base, parts, rules, patience)
    if nothing:
        return choice, by_swing or learned, swing
    if by_swing is None or not is_better(by_swing.state, best, parts, rules):
        return choice, learned, None
    return outdone(choice, best, base, parts), by_swing, swing


def _repeating(
    misfit: Misfit, lacking: Sequence[Latent], base: State, parts: Split, rules: Evidence, patience: Patience
) -> tuple[Rhythm | None, Swing | None]:
    """What repeats in the misfit, with time or with the displacement, and the model of it where one does better.

    Found beside the base model, a swing as great as the drive is only nearly in its place: of those that come near each
    other the one has it of which the model has clearly most evidence.
    """
    in_time, in_place = rhythms(misfit, lacking), ripple(misfit, base.setup.structure.pulley_radius or 1.0)
    if in_place is not None and not (in_time and in_time[0].share >= in_place.share):
        in_time = [in_place]
    if not in_time:
        return None, None
    if patience.late("a model of what swings"):
        return in_time[0], None
    found = [(swing, swinging(base, parts, rules, swing)) for swing in in_time]
    swing, by_swing = next((f for f in found if f[1] is not None), found[0])
    if by_swing is None:
        return swing, None
    for other, by_other in found:
        if by_other is not None and ahead(by_other.state, by_swing.state, parts, rules) > rules.bic:
            swing, by_swing = other, by_other
    return replace(swing, period=by_swing.period), by_swing
