"""Outside the catalogue: a closure learned in the balance that answers for the misfit, as a readable expression.

Every balance and sensor is offered the simple terms of `scpjax.physics.terms`. Which ones to try is read off one
linearisation of the simulation (orthogonal matching pursuit: Pati, Rezaiifar, Krishnaprasad, Asilomar 1993); each set
is then fitted through the simulation, together with all base parameters, and judged as a mechanism is: on stretches
held out from the fit. Sparse sums of physical terms after Brunton, Proctor, Kutz, PNAS 113 (2016) 3932.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from scpjax.diagnose.evidence import Comparison, Evidence, compare
from scpjax.diagnose.holdout import Split
from scpjax.diagnose.hypothesis import State, grown, laws_of
from scpjax.diagnose.patience import ENDLESS, WHAT_NO_NAME_EXPLAINS, Patience
from scpjax.diagnose.remainder import at_noise
from scpjax.diagnose.trials import fit_leading, integrable
from scpjax.fit.identifiability import uncertainty
from scpjax.fit.problem import CEILING, Trial
from scpjax.fit.setup import Setup, carry
from scpjax.fit.solve import binned_of, evaluate, make_room, solve_all, stack
from scpjax.physics.catalogue import mechanism
from scpjax.physics.mechanism import Mechanism
from scpjax.physics.terms import Term

_LEARNED = ("learned_heat", "learned_force", "learned_reading")
_READING = "learned_reading"
_CHUNK = 5  # terms in one linearisation, and so the most in a closure
_ROUNDS = 2  # of adding up to three terms at a time
_SETS = 12  # fitted in a round
_STEPS, _PRUNING = 48, 20  # of a fit
_WEAK = 8  # terms of which each is tried out, at most


@dataclass(frozen=True)
class Learned:
    """A closure found: the hypothesis that holds it, and the evidence; ``instead``: the terms of a sensor's reading
    from which its own are not told apart.
    """

    state: State
    terms: tuple[str, ...]  # keys
    evidence: Comparison
    instead: tuple[str, ...] = ()


@dataclass(frozen=True)
class _Offer:
    key: str  # of the coefficient: "learned_heat.Tx"
    place: str
    term: Term


def learn(
    state: State, split: Split, rules: Evidence, subsystems: Sequence[str] = (), patience: Patience = ENDLESS
) -> Learned | None:
    """The closure that the recordings ask for beyond ``state``; None when no sum of terms is better than none.

    ``subsystems``: where it may stand; anywhere when none is given. No terms are added late by ``patience``.
    """
    if state.setup.structure.system or patience.late(WHAT_NO_NAME_EXPLAINS):  # its states have no terms here
        return None
    make_room()
    problem = _with_terms(state.setup, subsystems)
    if not offers(problem):
        return None
    before = current = _carried(problem, state)
    every = offers(problem)
    chosen: tuple[str, ...] = ()
    instead: tuple[str, ...] = ()
    for _ in range(_ROUNDS):
        room = [o for o in every if o.key not in chosen and (not chosen or o.place == place_of(chosen[0]))]
        found = _round(problem, current, split, rules, chosen, room)
        if found is None:
            break
        current, chosen, instead = found
        if at_noise(current, split, 1.1) or patience.late(WHAT_NO_NAME_EXPLAINS):
            break
    if not chosen:
        return None
    current, chosen = _pruned(problem, current, chosen, split, rules)
    whole = compare(before, current, "closure", "", split, rules, len(chosen))
    if not whole.accepted or (_steep(problem, chosen) and not integrable(current, split, before)):
        return None
    return Learned(current, chosen, whole, instead)


def _steep(problem: Setup, chosen: Sequence[str]) -> bool:
    """Whether a term depends on velocity."""
    return any(o.term.velocity for o in offers(problem) if o.key in chosen)


def _with_terms(setup: Setup, subsystems: Sequence[str]) -> Setup:
    """The problem with all learnable terms in its model."""
    able = [m for n in _LEARNED if _possible(setup, m := mechanism(n))]
    new = grown(setup, *([m for m in able if m.subsystem in subsystems] or able))
    values = references(setup)
    fixed = new.fixed.copy()
    for slot in new.structure.slots:
        if slot.mechanism in _LEARNED and slot.parameter.name in values:
            fixed[slot.index] = values[slot.parameter.name]
    return replace(new, fixed=fixed)


def _possible(setup: Setup, m: Mechanism) -> bool:
    s = setup.structure
    return {"thermal": s.thermal, "mechanical": s.mechanical, "": True}[m.needs[0] if m.needs else ""]


def references(setup: Setup) -> dict[str, float]:
    s = setup.scales
    top = float(np.max(np.abs(np.asarray(setup.data.grids.effort)))) or 1.0
    return {
        "reference_temperature": s.temperature,
        "reference": s.displacement,
        "velocity_scale": s.displacement / s.response,
        "effort_scale": top,
    }


def offers(problem: Setup) -> list[_Offer]:
    out = []
    for m in problem.structure.mechanisms:
        if m.learned:
            for term in m.terms:  # pyright: ignore[reportAttributeAccessIssue]
                key = f"{m.name}.{term.name}"
                out.append(_Offer(key, place_of(key), term))
    return out


def place_of(key: str) -> str:
    """Where a term acts: the heat, the force, or the reading of one sensor."""
    m, name = key.split(".")
    return f"{m} {name.split('_')[0]}" if m == "learned_reading" else m


def _carried(problem: Setup, state: State) -> State:
    """The hypothesis in the problem with terms, all of them zero."""
    old, new = state.setup.structure, problem.structure
    n = len(new.slots)
    value = carry(old, new, state.values, np.asarray(problem.starts[0])[:n])
    active = carry(old, new, np.asarray(state.trial.active), np.zeros(n)).astype(bool)
    fixed = carry(old, new, np.asarray(state.trial.fixed), problem.fixed[:n])
    laws = laws_of(state.setup, np.asarray(state.trial.laws), problem)
    trial = replace(problem, fixed=fixed).trial(value, active, laws, int(active.sum()) + _CHUNK)
    return State(problem, trial, state.residual, state.cost)


def _moving(problem: Setup, state: State, keys: Sequence[str]) -> Trial:
    """The hypothesis with these coefficients moving as well."""
    now = np.asarray(problem.space.values(state.trial.free, state.trial.fixed, state.trial.active))
    active = np.asarray(state.trial.active).copy()
    for key in keys:
        active[problem.structure.index[key]] = True
    holds = replace(problem, fixed=np.asarray(state.trial.fixed))
    return holds.trial(now, active, np.asarray(state.trial.laws), len(state.trial.index))


def _round(
    problem: Setup, state: State, split: Split, rules: Evidence, chosen: tuple[str, ...], room: Sequence[_Offer]
) -> tuple[State, tuple[str, ...], tuple[str, ...]] | None:
    """(with the best set of further terms fitted, all terms, a sensor's that do as well); None when none has evidence.

    Where a force or a heat and a sensor's reading are not told apart, it rather is what is measured that acts.
    """
    free = len(state.trial.index) - int(np.asarray(state.trial.active).sum())
    sets = _promising_sets(problem, state, split, room, min(free, 3))
    if not sets:
        return None
    found = [
        (c, keys)
        for keys, after in zip(sets, _fitted(problem, state, split, sets), strict=True)
        if (c := compare(state, after, "closure", "", split, rules, len(keys))).accepted
    ]
    if not found:
        return None
    best, keys = max(found, key=lambda f: f[0].delta_bic)
    instead: tuple[str, ...] = ()
    if place_of(keys[0]).startswith(_READING):
        acting = [f for f in found if not place_of(f[1][0]).startswith(_READING) and len(f[1]) <= len(keys)]
        other = max(acting, key=lambda f: f[0].delta_bic, default=None)
        if other and not compare(other[0].state, best.state, "closure", "", split, rules, 0).accepted:
            (best, keys), instead = other, keys
    for c, fewer in sorted(found, key=lambda f: len(f[1])):  # as few terms as do as well
        if len(fewer) < len(keys) and place_of(fewer[0]) == place_of(keys[0]):
            more = len(keys) - len(fewer)
            if not compare(c.state, best.state, "closure", "", split, rules, more).accepted:
                best, keys = c, fewer
                break
    return best.state, chosen + keys, instead


def _fitted(problem: Setup, state: State, split: Split, sets: Sequence[tuple[str, ...]]) -> list[State]:
    """The hypothesis with each set of terms, fitted; as bad as can be where it blew up."""
    trials = [_moving(problem, state, keys) for keys in sets]
    solved, costs = fit_leading(problem, split, trials, state.cost, _STEPS)
    residuals = binned_of(solved, split.whole, problem.space)
    residuals[np.any(np.abs(residuals) >= CEILING, axis=(1, 2, 3))] = 10.0 * state.residual
    return [State(problem, t, r, float(c)) for t, r, c in zip(solved, residuals, costs, strict=True)]


def _pruned(
    problem: Setup, state: State, chosen: tuple[str, ...], split: Split, rules: Evidence
) -> tuple[State, tuple[str, ...]]:
    """Terms taken out one by one as long as nothing is lost; those tried first that are least sure of their size."""
    while len(chosen) > 1:
        weak = sorted(chosen, key=_certainty(problem, state, split, chosen).__getitem__)[:_WEAK]
        bare = [_without_term(problem, state, out) for out in weak]
        solved, costs, _ = solve_all(bare, split.train, problem.space, max_steps=_PRUNING, tolerance=0.02)
        residuals = binned_of(solved, split.whole, problem.space)
        fewer = [State(problem, t, r, float(c)) for t, r, c in zip(solved, residuals, costs, strict=True)]
        lost = [compare(f, state, "closure", "", split, rules, 1) for f in fewer]
        spare = [i for i, c in enumerate(lost) if not c.accepted]
        if not spare:
            break
        i = min(spare, key=lambda i: fewer[i].cost)
        state, chosen = fewer[i], tuple(k for k in chosen if k != weak[i])
    return state, chosen


def _certainty(problem: Setup, state: State, split: Split, chosen: Sequence[str]) -> dict[str, float]:
    """Size of each coefficient in units of its standard deviation."""
    doubt = uncertainty(state.trial, split.train, problem.space, coloured=False)
    spread = dict(zip(doubt.keys, doubt.std_free, strict=True))
    value = np.asarray(state.trial.free)
    entry = problem.structure.index
    return {k: abs(float(value[entry[k]])) / spread[k] if spread[k] > 0 else 0.0 for k in chosen}


def _without_term(problem: Setup, state: State, out: str) -> Trial:
    """The hypothesis with one coefficient held at zero."""
    now = np.array(problem.space.values(state.trial.free, state.trial.fixed, state.trial.active))
    active, fixed = np.asarray(state.trial.active).copy(), np.asarray(state.trial.fixed).copy()
    active[problem.structure.index[out]] = False
    fixed[problem.structure.index[out]] = 0.0
    return replace(problem, fixed=fixed).trial(now, active, np.asarray(state.trial.laws), len(state.trial.index))


_FAMILIES = (
    ("learned_heat", ("T2", "T3")),
    ("learned_heat", ("Tx", "Tx2", "Tx3")),
    ("learned_heat", ("x", "x2", "x3")),
    ("learned_heat", ("v", "speed", "T_speed")),
    ("learned_heat", ("u2", "uT", "ux")),
    ("learned_force", ("x2", "x3")),
    ("learned_force", ("T2", "T3")),
    ("learned_force", ("Tx", "T2x", "Tx2")),
    ("learned_force", ("v_speed", "xv", "Tv")),
    ("learned_reading", ("temperature_T2", "temperature_T3")),
    ("learned_reading", ("displacement_x2", "displacement_x3")),
)
"""Functions of one variable, each beside its natural partner: a loss T f(x), a spring x f(x), ..."""


def _promising_sets(
    problem: Setup, state: State, split: Split, room: Sequence[_Offer], most: int
) -> list[tuple[str, ...]]:
    """Sets of terms of one place each, by what they take away in one linearisation, the most promising first.

    Matching pursuit among all terms of a place, and the polynomials of `_FAMILIES`.
    """
    residual, imitated, columns = _linearised(problem, state, split, [o.key for o in room])
    clean = lambda x: x - imitated @ (imitated.T @ x)  # noqa: E731
    target = clean(residual)
    usable = {k: clean(c) for k, c in columns.items()}
    usable = {k: c for k, c in usable.items() if c @ c > 1e-6 * max(float(columns[k] @ columns[k]), 1e-300)}
    sets: list[tuple[str, ...]] = []
    for m, names in _FAMILIES:
        keys = tuple(k for name in names if (k := f"{m}.{name}") in usable)
        sets += [keys[:n] for n in range(1, min(len(keys), most) + 1)]
    for place in dict.fromkeys(o.place for o in room):
        mine = [o.key for o in room if o.place == place and o.key in usable]
        for lead in sorted(mine, key=lambda k: _left([usable[k]], target))[:2]:
            keys = (lead,)
            while len(keys) < min(most, 3) and len(keys) < len(mine):
                rest = [k for k in mine if k not in keys]
                keys = (*keys, min(rest, key=lambda k: _left([usable[j] for j in (*keys, k)], target)))
                sets.append(keys)
            sets.append((lead,))
    n = len(target)
    value = {}
    for keys in sets:
        left = _left([usable[k] for k in keys], target)
        value.setdefault(frozenset(keys), (n * np.log(max(left, 1e-300) / n) + len(keys) * np.log(n), keys))
    ranked = [keys for _, keys in sorted(value.values())]
    # the best of every place, and of every family, then whatever promises most
    first = [next((s for s in ranked if place_of(s[0]) == p), None) for p in dict.fromkeys(o.place for o in room)]
    families = [tuple(f"{m}.{n}" for n in names if f"{m}.{n}" in usable)[:most] for m, names in _FAMILIES]
    families = [f for f in families if f]
    queue = ranked[:3] + [s for s in first if s] + sorted(families, key=lambda f: value[frozenset(f)][0])[:4] + ranked
    return list({frozenset(k): k for k in queue}.values())[:_SETS]


def _left(columns: Sequence[np.ndarray], target: np.ndarray) -> float:
    """Sum of squares that a combination of the columns leaves."""
    basis, _ = np.linalg.qr(np.stack(columns, axis=1))
    return float(target @ target - np.sum((basis.T @ target) ** 2))


def _linearised(
    problem: Setup, state: State, split: Split, keys: Sequence[str]
) -> tuple[np.ndarray, np.ndarray, dict[str, np.ndarray]]:
    """(residuals, orthonormal basis of what moves already, column of each term) on the training part."""
    free = len(state.trial.index) - int(np.asarray(state.trial.active).sum())  # places left
    parts = [tuple(keys[i : i + free]) for i in range(0, len(keys), free)]
    trials = [_moving(problem, state, part) for part in parts]
    here = evaluate(stack(trials), split.train, problem.space)
    residual, jacobian = np.asarray(here.residual[0]), np.asarray(here.jacobian)
    at = [{problem.structure.index[k]: k for k in part} for part in parts]
    columns = {
        mine[int(e)]: j[:, c]
        for trial, mine, j in zip(trials, at, jacobian, strict=True)
        for c, e in enumerate(np.asarray(trial.index))
        if int(e) in mine
    }
    base = jacobian[0][:, [c for c, e in enumerate(np.asarray(trials[0].index)) if int(e) not in at[0]]]
    base = base[:, np.any(base != 0, axis=0)]
    scaled = base / np.linalg.norm(base, axis=0)
    basis, values, _ = np.linalg.svd(scaled, full_matrices=False)
    return residual, basis[:, values > 1e-9 * values[0]], columns
