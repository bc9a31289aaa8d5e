"""The main job: recordings in; what physics was left out, the evidence, and the extended model out."""

from __future__ import annotations

import math
import time
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import partial

import numpy as np

from scpjax.diagnose.answer import answer
from scpjax.diagnose.curve import Curve
from scpjax.diagnose.evidence import Evidence
from scpjax.diagnose.exchange import exchanged
from scpjax.diagnose.free import Free, free_law, one_for_several
from scpjax.diagnose.holdout import Split, split
from scpjax.diagnose.latent import Misfit, missing
from scpjax.diagnose.locate import observe
from scpjax.diagnose.outside import (
    AT_NOISE,
    able,
    beyond_names,
    form_rather_than_name,
    level,
    nothing_explains,
)
from scpjax.diagnose.patience import Patience
from scpjax.diagnose.profiles import Limits
from scpjax.diagnose.result import Diagnosis
from scpjax.diagnose.rhythm import rhythm, ripple
from scpjax.diagnose.rivals import Outcome, next_experiment
from scpjax.diagnose.select import Choice, Progress, choose, prune
from scpjax.diagnose.swing import swinging
from scpjax.diagnose.together import choose_together
from scpjax.diagnose.trials import State, grown, residual_on
from scpjax.fit.data import Data
from scpjax.fit.fit import (
    best_start,
    outliers,
    refine,
    settle,
)
from scpjax.fit.problem import Trial
from scpjax.fit.setup import Setup, prepare, what_there_is
from scpjax.physics.catalogue import applicable, left_out
from scpjax.recordings.recording import Recording


@dataclass(frozen=True, kw_only=True)
class DiagnoseOptions:
    """``evidence``: what it takes to be named. ``order``, ``substeps``, ``bin`` of the simulation as of a fit.
    ``next``: limits within which an experiment is designed that separates what is left close (None: none is).
    ``patience``: seconds after which no other explanation is sought where none has reached the noise; what is left to
    be done then may take some minutes."""

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
    Stretches of every recording are held out from fitting and judge every choice; the model returned is then fitted to
    all of it. ``progress(text, fraction)`` is called between steps.

    **Raises** `FitError`, `RecordingError` for recordings that cannot be fitted.
    """
    options = options or DiagnoseOptions()
    began, patience = time.monotonic(), Patience(options.patience)
    tell = progress or (lambda text, fraction: None)
    tell("reading the recordings for a start", 0.0)
    setup = prepare(
        recordings, model=model, fixed=fixed, bin=options.bin, order=options.order, substeps=options.substeps
    )
    candidates = (m for m in left_out() if applicable(m, what_there_is(setup.structure, setup.recordings)))
    catalogue = grown(setup, *candidates)
    tell("fitting the base model", 0.05)
    parts, base, notes = _base(setup)
    parts, base, choice, learned, notes = _chosen(parts, base, catalogue, options, patience, tell, notes)
    notes += patience.notes()
    binned = observe(setup, parts.whole, base.trial, base.residual)
    misfit = Misfit(setup, parts.whole, base.trial, binned)
    lacking = missing(misfit)
    if learned is None and level(choice.state, parts) > AT_NOISE:
        tell("learning what the catalogue does not hold", 0.75)
        choice, learned = beyond_names(parts, base, choice, options.evidence, able(lacking))
    elif learned is None:
        choice, learned = form_rather_than_name(parts, base, choice, options.evidence)
    swing = None
    if nothing_explains(base, choice, learned, parts):
        found_swings = (rhythm(misfit, lacking), ripple(misfit, setup.structure.pulley_radius or 1.0))
        swing = max(filter(None, found_swings), key=lambda r: r.share, default=None)
    if swing is not None:
        by_swing = swinging(base, parts, options.evidence, swing)
        if by_swing is not None:
            learned, swing = by_swing, replace(swing, period=by_swing.period)
    tell("fitting the chosen model to all data", 0.85)
    found = answer(
        parts,
        base,
        choice,
        learned,
        binned,
        lacking,
        swing,
        notes=notes,
        seconds=time.monotonic() - began,
        settings={"order": options.order, "substeps": options.substeps, "evidence": vars(options.evidence)},
    )
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


def _chosen(
    parts: Split,
    base: State,
    catalogue: Setup,
    options: DiagnoseOptions,
    patience: Patience,
    tell: Progress,
    notes: tuple[str, ...],
) -> tuple[Split, State, Choice, Curve | None, tuple[str, ...]]:
    """What is named, the curve where it goes by one, and the notes; the data with jumps inside gaps timed by the better
    model, and the base on them.

    Where there were wild samples, those that a strong misfit had concealed are left out once the first name is there.
    """
    if base.setup.structure.system:
        choice = choose_together(base, parts, options.evidence, catalogue, progress=tell)
        return *_settled(parts, base, choice, options.evidence), None, notes
    search = partial(
        choose,
        rules=options.evidence,
        catalogue=catalogue,
        max_steps=options.max_steps,
        progress=tell,
        patience=patience,
    )
    free: Free | None = None

    def by_curve(rival: State) -> bool:
        """Whether one mechanism under a law of its own does better than what does not reach the noise."""
        nonlocal free
        if level(rival, parts) <= AT_NOISE:
            return False
        tell("each mechanism under a law of its own", 0.3)
        free = free_law(base, rival, parts, options.evidence)
        return free is not None

    some = bool(np.any(np.asarray(parts.whole.weights) != np.asarray(base.setup.data.weights)))
    choice = search(base, parts, enough=lambda first: (some and bool(_wild(first, parts).any())) or by_curve(first))
    wild = _wild(choice.state, parts) if some and choice.state.names else np.zeros(())
    if wild.any():
        notes = (
            *notes,
            f"{wild.sum()} more were, which stood out beside {choice.state.names[0]}, the first name tried",
        )
        parts = parts.with_weights(np.where(wild, 0.0, parts.whole.weights))
        trial, _, _ = refine(base.setup, parts.train, base.trial)
        base, free = _state(base.setup, parts, trial), None
        choice = search(base, parts, enough=by_curve)
    if free is None and not choice.state.names:
        by_curve(base)
    if free is not None:
        return parts, base, free.choice(base, choice), free.curve, notes
    tell("each name against what could stand in its place", 0.7)
    choice = exchanged(choice, base, parts, options.evidence, catalogue, patience)
    parts, base, choice = _settled(parts, base, choice, options.evidence)
    free = one_for_several(base, choice, parts, options.evidence)
    if free is None:
        return parts, base, choice, None, notes
    notes = (
        *notes,
        f"{' and '.join(choice.state.names)} together would predict the same as {free.names[0]} by its curve",
    )
    return parts, base, free.choice(base, choice), free.curve, notes


def _settled(parts: Split, base: State, choice: Choice, rules: Evidence) -> tuple[Split, State, Choice]:
    """Jumps inside gaps timed by the model of what is named; without names that only made up for their times."""
    if not choice.state.names:
        return parts, base, choice
    problem = choice.state.setup
    again, data, _ = settle(problem, choice.state.trial, parts.train, drop_outliers=False)
    timed = _with_effort(parts, data)
    state = _state(problem, timed, again)
    if data is not parts.train and len(state.names) > 1:
        pruned = prune(state, timed, rules)
        if pruned.names != state.names:
            return timed, base, choice.with_only(pruned)
    return timed, base, replace(choice, state=state)


def _wild(state: State, parts: Split) -> np.ndarray:
    """Samples (r, n, y) that stand out alone beside a hypothesis, and are still in."""
    return outliers(state.setup, parts.whole, state.trial) != np.asarray(parts.whole.weights)


def _state(setup: Setup, parts: Split, trial: Trial) -> State:
    residual = residual_on(trial, parts.whole, setup)
    return State(setup, trial, residual, float(np.sum(residual[parts.is_train] ** 2)))


def _with_effort(parts: Split, data: Data) -> Split:
    effort = np.asarray(data.grids.effort)
    return Split(
        parts.train.with_effort(effort),
        parts.whole.with_effort(effort),
        parts.is_train,
        parts.is_held,
        parts.mask,
    )
