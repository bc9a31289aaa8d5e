"""A closure as a smooth curve of one variable, times at most one other: a spline in the balance.

Which curves to try is read off one linearisation of the simulation; each is then fitted through the simulation with
all base parameters, with few pieces and with many, and judged on stretches held out from the fit.
"""

from __future__ import annotations

import itertools
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from scpjax.abreast import abreast
from scpjax.compiled import quickly_compiled
from scpjax.diagnose.evidence import Comparison, Evidence, are_alike, compare
from scpjax.diagnose.holdout import Split
from scpjax.diagnose.hypothesis import State, grown, laws_of
from scpjax.diagnose.patience import ENDLESS, WHAT_NO_NAME_EXPLAINS, Patience
from scpjax.diagnose.trials import fit_leading, integrable
from scpjax.fit.data import Data
from scpjax.fit.problem import CEILING, Space, Trial, by_recording, initial_state, unpack
from scpjax.fit.setup import Setup, carry
from scpjax.fit.solve import binned_of, evaluate, make_room, stack
from scpjax.physics.catalogue import mechanism
from scpjax.physics.curves import PIECES, VARIABLES, WEIGHTS, Form, basis, form_of, share_of
from scpjax.physics.mechanism import Mechanism
from scpjax.physics.model import Model
from scpjax.recordings.recording import Recording
from scpjax.simulate.drive import Grid
from scpjax.simulate.simulate import node_states

CURVES = ("learned_heat_curve", "learned_force_curve", "learned_reading_curve")
_TRIED = 3  # forms of a balance, fitted
_STEPS = 96
_COMPARED = 400  # places in time at which drives are compared
_DIFFER = 0.25  # share of a drive's variation that another does not have, from which they differ
_MARGIN = 0.03  # of a range, added at both ends


def forms_named(names: Sequence[str]) -> list[tuple[str, Form]]:
    """(balance, form) of every curve that is one of these mechanisms, whatever its shape."""
    every = [(m.subsystem, f) for m in map(mechanism, CURVES) for f in m.forms]  # pyright: ignore[reportAttributeAccessIssue]
    return [(subsystem, form) for subsystem, form in every if {*form.names} & {*names}]


@dataclass(frozen=True)
class Curve:
    """A curve found: the hypothesis that holds it, which it is, the evidence, and others that predict the same."""

    state: State
    mechanism: str
    law: int
    evidence: Comparison
    alike: tuple[Curve, ...] = ()

    @property
    def form(self) -> Form:
        """What it is a function of, and times what."""
        return form_of(mechanism(self.mechanism).forms, self.law)[0]  # pyright: ignore[reportAttributeAccessIssue]

    @property
    def place(self) -> str:
        """What it stands for: "learned_heat", its "learned_heat store", or a sensor's "learned_reading temperature"."""
        return self.mechanism.removesuffix("_curve") + (f" {self.form.of}" if self.form.of else "")

    @property
    def pieces(self) -> int:
        """Of the spline."""
        return PIECES[self.law % len(PIECES)]

    def reference(self, name: str) -> float:
        """A fixed number of it: an end of a variable's range."""
        return float(self.state.values[self.state.setup.structure.index[f"{self.mechanism}.{name}"]])

    @property
    def ends(self) -> tuple[float, float]:
        """Its variable's range."""
        low, high = (self.reference(f"{self.form.variable}_{end}") for end in ("low", "high"))
        return low, high

    @property
    def zero(self) -> float:
        """Where rest is in that range, from 0 to 1."""
        return min(max(float(share_of(self.form.variable, 0.0, *self.ends)), 0.0), 1.0)

    @property
    def keys(self) -> tuple[str, ...]:
        """Its weights."""
        m = mechanism(self.mechanism)
        return tuple(f"{m.name}.{p.name}" for p in m.free_parameters(self.law))


def bend(
    state: State, split: Split, rules: Evidence, subsystems: Sequence[str] = (), patience: Patience = ENDLESS
) -> Curve | None:
    """The curve that the recordings ask for beyond ``state``; None when none is better than none.

    ``subsystems``: where it may stand; anywhere when none is given. The best with few pieces is given more if they
    predict the held-out stretches better. None is begun late by ``patience``.
    """
    if state.setup.structure.system or patience.late(WHAT_NO_NAME_EXPLAINS):
        return None
    return best_of(curves(state, split, rules, subsystems), state, split, rules)


def curves(
    state: State,
    split: Split,
    rules: Evidence,
    subsystems: Sequence[str] = (),
    *,
    allowed: Callable[[Form], bool] = lambda form: form.variable != "time",
) -> list[Curve]:
    """The curves with evidence for them beyond ``state``, with few pieces; of every balance the forms ``allowed`` that
    promise most. A curve of the time says nothing of other recordings unless it comes down to the noise as a mechanism,
    and is no closure otherwise.
    """
    s = state.setup.structure
    if s.system:
        return []
    there = {"thermal": s.thermal, "mechanical": s.mechanical}
    able = [m for m in map(mechanism, CURVES) if all(there[need] for need in m.needs)]
    make_room()
    where = [m for m in able if m.subsystem in subsystems] or able
    seen = ranges(state, split)
    found = abreast(lambda m: _of(m, state, split, rules, seen, allowed), where)  # each has a program to be compiled
    return [c for c in itertools.chain(*found) if c.evidence.accepted and _stands(c, state, split)]


def best_of(found: Sequence[Curve], state: State, split: Split, rules: Evidence) -> Curve | None:
    """The one of some curves beyond ``state`` that predicts best, with more pieces where that is better still, and
    those that predict the same; None of none.
    """
    if not found:
        return None
    best = max(found, key=lambda c: c.evidence.held_out_gain)
    alike = tuple(c for c in found if c is not best and are_alike(c.state, best.state, split))
    return replace(finer(best, state, split, rules), alike=alike)


def ranges(state: State, split: Split) -> dict[str, float]:
    """Lowest and highest value of every variable where the simulation was fitted, 0 among them, with a margin: the
    weight of a piece of the curve beyond that would be anything.
    """
    structure, data = state.setup.structure, split.whole
    sides, names = len(structure.sides), structure.state_names
    states, efforts = _simulated(state.trial, data, state.setup.space)
    fitted = np.asarray(split.train.weights).sum(axis=2) > 0
    nodes = [np.asarray(at)[mine] for at, mine in zip(np.asarray(data.grids.at), fitted, strict=True)]
    states, efforts = (np.concatenate([np.asarray(x)[i, at] for i, at in enumerate(nodes)]) for x in (states, efforts))
    seen = {v: np.zeros(1) for v in VARIABLES}
    if structure.thermal:
        seen["temperature"] = np.asarray(states[..., :sides])
    for v in ("displacement", "velocity"):
        if v in names:
            seen[v] = np.asarray(states[..., names.index(v)])
    seen["effort"] = np.asarray(efforts)
    seen["time"] = np.array([r.time[-1] - r.time[0] for r in state.setup.recordings])
    out = {}
    for v, x in seen.items():
        x = x[np.isfinite(x)]
        low, high = min(float(x.min()), 0.0), max(float(x.max()), 0.0)
        margin = _MARGIN * (high - low) or 1.0
        if v in ("displacement", "velocity") and sides == 2:  # each side sees its own contraction
            low, high = min(low, -high), max(high, -low)
        out[f"{v}_low"], out[f"{v}_high"] = (low - margin if low < 0 else 0.0), high + margin
    return out


@quickly_compiled
def _simulated(trial: Trial, data: Data, space: Space) -> tuple[Float[Array, "r n z"], Float[Array, "r n s"]]:
    """States and efforts of a trial at its free vector."""
    model, local = unpack(trial.free, trial, space)

    def one(grid: Grid, effort: Array, values: Array, m: Model) -> tuple[Array, Array]:
        return node_states(m, grid, initial_state(m, space.locals, values, effort), order=data.order)

    return jax.vmap(one)(data.grids, jnp.asarray(data.start_effort), local, by_recording(model, data))


def drives_differ(recordings: Sequence[Recording]) -> bool:
    """Whether some two recordings were driven so differently that what they have in common over time is the time's:
    under one drive, or a weaker one of its form, whatever is slow is a curve of the time.
    """
    for a, b in itertools.combinations(recordings, 2):
        at = np.linspace(0.0, min(a.time[-1] - a.time[0], b.time[-1] - b.time[0]), _COMPARED)
        held = [r.inputs[np.searchsorted(r.time - r.time[0], at, "right") - 1] for r in (a, b)]
        one, other = ((x - x.mean(axis=0)).ravel() for x in held)
        if (one @ other) ** 2 < (1.0 - _DIFFER) * (one @ one) * (other @ other):
            return True
    return False


def _of(
    m: Mechanism,
    state: State,
    split: Split,
    rules: Evidence,
    seen: Mapping[str, float],
    allowed: Callable[[Form], bool],
) -> list[Curve]:
    """The forms of a balance that promise most, fitted with few pieces; ``seen``: the variables' `ranges`."""
    forms: tuple[Form, ...] = m.forms  # pyright: ignore[reportAttributeAccessIssue]
    laws = [law for law in range(0, len(m.laws), len(PIECES)) if allowed(form_of(forms, law)[0])]
    if not drives_differ(state.setup.recordings):
        laws = [law for law in laws if form_of(forms, law)[0].variable != "time"]
    if not laws:
        return []
    problem = grown(state.setup, m)
    fixed = problem.fixed.copy()
    for name, value in seen.items():
        fixed[problem.structure.index[f"{m.name}.{name}"]] = value
    problem = replace(problem, fixed=fixed)
    trials = [_trial(problem, state, m, law) for law in laws]
    left = _left(problem, split, trials, m)
    chosen = sorted(left, key=left.__getitem__)[:_TRIED]
    return _fitted(problem, state, split, rules, m, {laws[i]: trials[i] for i in chosen})


def _fitted(
    problem: Setup, state: State, split: Split, rules: Evidence, m: Mechanism, trials: dict[int, Trial]
) -> list[Curve]:
    """Curves by their laws, fitted; as bad as can be where one blew up."""
    if not trials:
        return []
    solved, cost = fit_leading(problem, split, list(trials.values()), state.cost, _STEPS)
    residuals = binned_of(solved, split.whole, problem.space)
    residuals[np.any(np.abs(residuals) >= CEILING, axis=(1, 2, 3))] = 10.0 * state.residual
    out = []
    for law, trial, r, c in zip(trials, solved, residuals, cost, strict=True):
        after = State(problem, trial, r, float(c))
        evidence = compare(state, after, "closure", "", split, rules, len(m.free_parameters(law)))
        out.append(Curve(after, m.name, law, evidence))
    return out


def finer(found: Curve, before: State, split: Split, rules: Evidence, *, most: int = PIECES[-1]) -> Curve:
    """The same curve with more pieces, ``most`` of them at most, from where it stands, as long as that predicts what
    was held out better.
    """
    if found.pieces >= most:
        return found
    m, law, problem = mechanism(found.mechanism), found.law + 1, found.state.setup
    where = np.linspace(0.0, 1.0, 10 * PIECES[-1])
    zero = found.zero
    weights = np.array([found.state.values[problem.structure.index[k]] for k in found.keys])
    now = basis(where, zero, found.pieces) @ weights
    more = np.linalg.lstsq(basis(where, zero, 2 * found.pieces), now, rcond=1e-9)[0]
    trial = _trial(problem, found.state, m, law)
    value = np.array(problem.space.values(trial.free, trial.fixed, trial.active))
    for p, w in zip(m.free_parameters(law), more, strict=True):
        value[problem.structure.index[f"{m.name}.{p.name}"]] = w
    trial = replace(problem, fixed=np.asarray(trial.fixed)).trial(
        value, np.asarray(trial.active), np.asarray(trial.laws), len(trial.index)
    )
    (more_of_it,) = _fitted(problem, before, split, rules, m, {law: trial})
    extra = len(more_of_it.keys) - len(found.keys)
    better = compare(found.state, more_of_it.state, "closure", "", split, rules, extra).accepted
    if not better or not _stands(more_of_it, before, split):
        return found
    return finer(more_of_it, before, split, rules, most=most)


def _stands(curve: Curve, before: State, split: Split) -> bool:
    """Whether it is no artefact of the integrator, which only what depends on velocity can be."""
    return "velocity" not in (curve.form.factor, curve.form.variable) or integrable(curve.state, split, before)


def _trial(problem: Setup, state: State, m: Mechanism, law: int) -> Trial:
    """The hypothesis with a curve under a law, all of it zero, and its weights moving."""
    old, new = state.setup.structure, problem.structure
    n = len(new.slots)
    value = carry(old, new, state.values, np.asarray(problem.starts[0])[:n])
    active = carry(old, new, np.asarray(state.trial.active), np.zeros(n)).astype(bool)
    held = carry(old, new, np.asarray(state.trial.fixed), problem.fixed[:n])
    active &= ~_weights(problem, m)
    for p in m.free_parameters(law):
        active[new.index[f"{m.name}.{p.name}"]] = True
    laws = laws_of(state.setup, np.asarray(state.trial.laws), problem)
    laws[next(i for i, other in enumerate(new.mechanisms) if other.name == m.name)] = law
    few = max(len(m.free_parameters(level)) for level in (0, 1))  # so that few and more of them share a program
    width = int(np.sum(active & ~_weights(problem, m))) + max(few, len(m.free_parameters(law)))
    return replace(problem, fixed=held).trial(value, active, laws, width)


def _weights(problem: Setup, m: Mechanism) -> np.ndarray:
    """Which entries are weights of a curve."""
    out = np.zeros(problem.space.size, bool)
    out[[problem.structure.index[f"{m.name}.{w}"] for w in WEIGHTS]] = True
    return out


def _left(problem: Setup, split: Split, trials: Sequence[Trial], m: Mechanism) -> dict[int, float]:
    """By law, the sum of squares that its curve would leave if the simulation were linear in it."""
    mine = set(np.flatnonzero(_weights(problem, m)))
    here = evaluate(stack(trials), split.train, problem.space)
    out = {}
    for i, trial in enumerate(trials):
        index = np.asarray(trial.index)
        jacobian, residual = np.asarray(here.jacobian[i]), np.asarray(here.residual[i])
        keep = np.all(np.isfinite(jacobian), axis=0) & np.any(jacobian != 0, axis=0)
        own = any(int(e) in mine for e, k in zip(index, keep, strict=False) if k)
        if own and np.all(np.isfinite(residual)):
            scaled = jacobian[:, keep] / np.linalg.norm(jacobian[:, keep], axis=0)
            basis, size, _ = np.linalg.svd(scaled, full_matrices=False)
            basis = basis[:, size > 1e-7 * size[0]]
            out[i] = float(residual @ residual - np.sum((basis.T @ residual) ** 2))
    return out
