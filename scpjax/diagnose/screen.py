"""Which mechanisms are worth fitting? A score test of all of them, from simulations alone."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
from scipy.optimize import nnls

from scpjax.abreast import abreast
from scpjax.diagnose.holdout import Split
from scpjax.diagnose.hypothesis import Start, State, alike, grown, starts_with, trial_at
from scpjax.fit.problem import CEILING, Trial
from scpjax.fit.setup import Setup
from scpjax.fit.solve import evaluate, residuals_at, stack
from scpjax.physics.mechanism import Mechanism


@dataclass(frozen=True)
class Promise:
    """What a mechanism promises: fall of the sum of squares by all its starts together, and by each."""

    mechanism: Mechanism
    gain: float
    starts: tuple[Start, ...]
    each: np.ndarray


def screen(state: State, split: Split, catalogue: Setup, mechanisms: Sequence[Mechanism]) -> list[Promise]:
    """What each mechanism promises, most first, by a score test along its own effects.

    With ``d`` what a mechanism at its start changes and ``r`` the residuals, both after all that the parameters of the
    present hypothesis can imitate is taken out of them (by its Jacobian), an effect ``alpha`` times as strong would
    take (d r)^2 / d^2 away if the simulation were linear in it. An effect of the wrong sign promises nothing. Starts
    of one mechanism together promise what their best mixture with no negative share does.
    """
    residual, clean = _beyond_parameters(state.setup, state.trial, split)
    starts, simulated, blown = _simulated(state, split, catalogue, mechanisms)
    return _promises(mechanisms, starts, clean(residual), clean(simulated - residual), blown)


def _promises(
    mechanisms: Sequence[Mechanism],
    starts: Sequence[Start],
    target: np.ndarray,
    changed: np.ndarray,
    blown: np.ndarray,
) -> list[Promise]:
    """By the residuals (m,) and what each start changes of them (starts, m), beside what the base can imitate."""
    size = np.sqrt(np.sum(changed**2, axis=1))
    ok = ~blown & np.isfinite(size) & (size > 0)
    unit = np.where(ok[:, None], -changed / np.where(ok, size, 1.0)[:, None], 0.0)
    along = np.maximum(unit @ target, 0.0)
    gain = along**2
    out = []
    for m in mechanisms:
        mine = [i for i, s in enumerate(starts) if s.mechanism is m]
        if not mine:
            continue
        left = nnls(unit[mine].T, target)[1] if np.any(gain[mine] > 0) else float(np.linalg.norm(target))
        whole = max(float(target @ target) - float(left) ** 2, float(np.max(gain[mine])))
        out.append(Promise(m, whole, tuple(starts[i] for i in mine), gain[mine]))
    return sorted(out, key=lambda p: -p.gain)


def _beyond_parameters(
    setup: Setup, trial: Trial, split: Split
) -> tuple[np.ndarray, Callable[[np.ndarray], np.ndarray]]:
    """Residuals (m,) of a trial on the training part, and what takes out of such (.., m) all that its parameters do."""
    here = evaluate(stack([trial]), split.train, setup.space)
    n = split.train.target.size
    residual, jacobian = np.asarray(here.residual[0])[:n], np.asarray(here.jacobian[0])[:n]
    jacobian = jacobian[:, np.all(np.isfinite(jacobian), axis=0) & np.any(jacobian != 0, axis=0)]
    imitated, _ = np.linalg.qr(jacobian)
    return residual, lambda x: x - (x @ imitated) @ imitated.T


def _simulated(
    state: State, split: Split, catalogue: Setup, mechanisms: Sequence[Mechanism]
) -> tuple[list[Start], np.ndarray, np.ndarray]:
    """(every start of these mechanisms beside a hypothesis, residuals (starts, m) of the training part there, whether a
    simulation blew up).
    """
    named = {m.name: m for m in mechanisms}

    def there(problem: Setup) -> tuple[list[Start], np.ndarray]:
        mine = [m for m in problem.structure.mechanisms if m.name in named]
        starts = [s for m in mine for s in starts_with(state, named[m.name], problem)]
        if not starts:
            return [], np.zeros((0, split.train.target.size))
        values, laws = np.stack([s.value for s in starts]), np.stack([s.laws for s in starts])
        return starts, residuals_at(values, laws, split.train, problem.space).reshape(len(starts), -1)

    found = abreast(there, _simulators(state, catalogue))
    flat = np.concatenate([residual for _, residual in found])
    return [s for starts, _ in found for s in starts], flat, np.any(np.abs(flat) >= CEILING, axis=1)


def _simulators(state: State, catalogue: Setup) -> list[Setup]:
    """The problems in which candidates beside a hypothesis are simulated: together where others are named already (or
    differ by recording), as one may be of either half.
    """
    if state.names or state.setup.structure.own:
        return [alike(catalogue, state.setup)]
    return _halves(state.setup, catalogue)


def _halves(base: Setup, catalogue: Setup) -> list[Setup]:
    """The problem with all candidates that move the load, and that with all others: the program of either is compiled
    beside the other's, in half the time, and simulates in less than half.
    """
    every = [m for m in catalogue.structure.mechanisms if not m.is_base]
    moves = [m for m in every if m.subsystem == "thermomechanical"]
    others = [m for m in every if m.subsystem != "thermomechanical"]
    return [grown(base, *half) for half in (moves, others) if half]


def ready(base: Setup, catalogue: Setup) -> None:
    """Have the programs that simulate candidates loaded or compiled, which takes longest of all when they are new."""
    abreast(_ready, _halves(base, catalogue))


def ready_beside_names(catalogue: Setup) -> None:
    """The same of the program that simulates candidates beside others."""
    _ready(catalogue)


def _ready(problem: Setup) -> None:
    laws = np.zeros((1, len(problem.structure.mechanisms)))
    residuals_at(problem.starts[0][None], laws, problem.data, problem.space)


@dataclass(frozen=True)
class Fresh:
    """Beside the base parameters that the data first suggested: what promises most there, and where its fit may begin.

    ``best``: what improves most on them, by a share worth it. ``likeliest``: what promises most by the score test
    there, or takes most away from where it starts; likeliest first. ``promises`` of the score test, most first.
    """

    state: State  # the hypothesis with those parameters, not fitted
    best: Mechanism | None
    likeliest: tuple[str, ...]
    promises: tuple[Promise, ...]


def fresh(state: State, split: Split, catalogue: Setup, mechanisms: Sequence[Mechanism]) -> Fresh | None:
    """What mechanisms promise beside the base parameters first suggested; None where these blow up.

    Fitted without it, the base may have been bent so far (a damping that hardly lets the load move, in place of dry
    friction) that the right mechanism promises nothing there.
    """
    setup = state.setup
    value = setup.starts[0].copy()
    for slot in setup.structure.slots:
        if slot.mechanism not in setup.structure.base:
            value[slot.index] = state.values[slot.index]
    at = State(setup, trial_at(setup, value, np.asarray(state.trial.laws)), state.residual, state.cost)
    residual, clean = _beyond_parameters(setup, at.trial, split)
    if np.any(np.abs(residual) >= CEILING):
        return None
    starts, simulated, blown = _simulated(at, split, catalogue, mechanisms)
    target = clean(residual)
    after = np.where(blown, np.inf, np.sum(clean(simulated) ** 2, axis=1))
    order = np.argsort(after, kind="stable")
    worth = after[order[0]] <= (1 - _WORTH) * np.sum(target**2)
    promises = _promises(mechanisms, starts, target, clean(simulated - residual), blown)
    by_score = [p.mechanism.name for p in promises][:_BY_SCORE]
    as_simulated = list(dict.fromkeys(starts[i].mechanism.name for i in order))[:_AS_SIMULATED]
    likeliest = tuple(dict.fromkeys([*by_score, *as_simulated]))
    return Fresh(at, starts[order[0]].mechanism if worth else None, likeliest, tuple(promises))


_WORTH = 0.1  # share of the misfit, beside what the base can imitate, that a fresh start must take away
_BY_SCORE, _AS_SIMULATED = 5, 3  # likeliest beside the base parameters first suggested
