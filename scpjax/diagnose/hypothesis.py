"""A hypothesis: mechanisms added to a base model, fitted, and what a fit of it may begin with.

Every hypothesis has a model of its own that holds only what it names, which compiles and runs quickly; candidates
together are only simulated, to see which are worth fitting.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from scpjax.fit.data import Data
from scpjax.fit.problem import Trial
from scpjax.fit.setup import Setup, carry, laws_that_can_act, restructured
from scpjax.fit.solve import binned_of
from scpjax.parameter import Parameter
from scpjax.physics.mechanism import Mechanism


@dataclass(frozen=True, eq=False)
class State:
    """A hypothesis fitted to the training part, and its binned residuals on all data."""

    setup: Setup
    trial: Trial
    residual: np.ndarray  # (r, k, y) over training and held-out samples
    cost: float
    anew: bool = False  # fitted from the base parameters that the data suggested at first, too

    @property
    def names(self) -> tuple[str, ...]:
        """Left-out mechanisms in its model, in the order in which they were named."""
        return tuple(m.name for m in self.setup.structure.mechanisms if not (m.is_base or m.learned))

    @property
    def laws(self) -> dict[str, str]:
        """Law of each mechanism named."""
        which = np.asarray(self.trial.laws)
        return {m.name: m.laws[int(which[i])] for i, m in enumerate(self.setup.structure.mechanisms)}

    @property
    def values(self) -> np.ndarray:
        """Physical values of all parameters and locals."""
        return np.array(self.setup.space.values(self.trial.free, self.trial.fixed, self.trial.active))


@dataclass(frozen=True)
class Start:
    """Where a fit of a mechanism under a law may begin: physical values over the grown problem."""

    mechanism: Mechanism
    law: int
    own: tuple[float, ...]  # values of the mechanism's parameters
    value: np.ndarray
    laws: np.ndarray


def moving(state: State) -> int:
    """How many parameters were fitted."""
    return int(np.asarray(state.trial.active).sum())


def grown(setup: Setup, *added: Mechanism) -> Setup:
    """The problem with more mechanisms in its model."""
    return restructured(setup, setup.structure.with_mechanisms(*added))


def alike(setup: Setup, like: Setup) -> Setup:
    """The problem with the parameters that differ by recording in another one."""
    s = like.structure
    return restructured(setup, setup.structure.with_own(s.recordings, *s.own)) if s.own else setup


def reduced(setup: Setup, name: str) -> Setup:
    """The problem without one mechanism."""
    return restructured(setup, setup.structure.without(name))


def laws_of(old: Setup, laws: np.ndarray, new: Setup) -> np.ndarray:
    """Laws over the mechanisms of another problem, 0 where new."""
    known = {m.name: float(law) for m, law in zip(old.structure.mechanisms, laws, strict=True)}
    return np.array([known.get(m.name, 0.0) for m in new.structure.mechanisms])


def moved(state: State, setup: Setup) -> tuple[np.ndarray, np.ndarray]:
    """(values, laws) of a hypothesis over a problem with other mechanisms; first values where new."""
    old, first = state.setup, np.asarray(setup.starts[0])[: len(setup.structure.slots)]
    value = carry(old.structure, setup.structure, state.values, first)
    return value, laws_of(old, np.asarray(state.trial.laws), setup)


def owned_by(setup: Setup, names: Sequence[str], count: int) -> np.ndarray:
    """Which of ``count`` values belong to mechanisms named."""
    own = np.isin([s.mechanism for s in setup.structure.slots], names)
    return np.concatenate([own, np.zeros(count - len(own), bool)])


def moving_parameters(setup: Setup, laws: np.ndarray) -> np.ndarray:
    """Entries that move under these laws (mechanisms,)."""
    active = setup.base_active.copy()
    free = {m.name: m.free_parameters(int(law)) for m, law in zip(setup.structure.mechanisms, laws, strict=True)}
    for slot in setup.structure.slots:
        m = setup.structure.mechanism(slot.mechanism)
        if not (m.is_base or m.learned) and slot.parameter in free[slot.mechanism]:
            active[slot.index] = True
    return active


def width(setup: Setup) -> int:
    """Places enough for any laws of the mechanisms in the model."""
    s = setup.structure
    mine = [m for m in s.mechanisms if not (m.is_base or m.learned)]
    widest = (max(s.count_free(m.name, law) for law in range(len(m.laws))) for m in mine)
    return int(setup.base_active.sum()) + sum(widest)


def trial_at(setup: Setup, value: np.ndarray, laws: np.ndarray) -> Trial:
    """Everything that these laws have moving, from physical values."""
    return setup.trial(value, moving_parameters(setup, laws), laws, width(setup))


def starts_with(state: State, added: Mechanism, problem: Setup) -> list[Start]:
    """Every law and start of a mechanism added to a hypothesis, over a problem that holds it."""
    null = np.asarray(problem.starts[0])[: len(problem.structure.slots)]
    now, laws = moved(state, problem)
    which = next(i for i, m in enumerate(problem.structure.mechanisms) if m.name == added.name)
    out = []
    for law in laws_that_can_act(problem, added):
        idle = {p.name for p in added.parameters if not p.fixed} - {p.name for p in added.free_parameters(law)}
        for start in added.starts:
            value, vector = now.copy(), laws.copy()
            for k, p in enumerate(added.parameters):
                i = problem.structure.where[f"{added.name}.{p.name}"]
                value[i] = problem.fixed[i] if p.fixed else start[k] * unit(problem, p)
                if p.name in idle:
                    value[i] = null[i]
            vector[which] = law
            own = tuple(float(value[problem.structure.where[f"{added.name}.{p.name}"][0]]) for p in added.parameters)
            out.append(Start(added, law, own, value, vector))
    return out


def start_value(setup: Setup, m: Mechanism, p: Parameter) -> float:
    """Where a parameter of a mechanism starts, by its first start."""
    return m.starts[0][m.parameters.index(p)] * unit(setup, p)


def from_their_starts(setup: Setup, laws: np.ndarray) -> list[np.ndarray]:
    """Values with the base as the data suggested at first and every mechanism at its first start; at its last one."""
    out: list[np.ndarray] = []
    for which in (0, -1):
        value = np.asarray(setup.starts[0]).copy()
        for m, law in zip(setup.structure.mechanisms, laws, strict=True):
            if m.is_base or m.learned:
                continue
            for p in m.free_parameters(int(law)):
                start = m.starts[which][m.parameters.index(p)]
                value[setup.structure.where[f"{m.name}.{p.name}"]] = start * unit(setup, p)
        if not any(np.array_equal(value, other) for other in out):
            out.append(value)
    return out


def unit(setup: Setup, p: Parameter) -> float:
    """What a start of a parameter is a multiple of."""
    return {"response": setup.scales.response, "duration": setup.scales.duration}.get(p.time, 1.0)


def residual_on(trial: Trial, data: Data, setup: Setup) -> np.ndarray:
    """Binned residuals (r, k, y) of one trial."""
    return binned_of([trial], data, setup.space)[0]
