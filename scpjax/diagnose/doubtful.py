"""Which names are in doubt, by where their parameters came to rest."""

from __future__ import annotations

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array

from scpjax.diagnose.evidence import at_its_least
from scpjax.diagnose.holdout import Split
from scpjax.diagnose.hypothesis import State
from scpjax.fit.identifiability import at_limit, estimates, held_back, uncertainty
from scpjax.fit.problem import unpack
from scpjax.physics.mechanism import Mechanism

_TOLD = 1.96  # standard errors: a time that is less is not told from none


def strained(state: State) -> tuple[str, ...]:
    """Names of which a parameter, other than a time, stands at the end of its bounds, as it does where the law of
    another name is wrong. Times end there where recordings are too short.
    """
    ends = at_limit(state.trial, state.setup.space) & np.asarray(state.trial.active)
    found = {s.mechanism for s in state.setup.structure.slots if ends[s.index] and not s.parameter.time}
    return tuple(n for n in state.names if n in found)


def asking_for_more(state: State, parts: Split) -> dict[str, tuple[str, ...]]:
    """Names of which parameters with strict bounds stand at their end though the recordings determine them, and which
    these are: something else is imitated. A strength at the least that counts as one asks for less, not for more.
    """
    slots, space = {s.key: s for s in state.setup.structure.slots}, state.setup.space
    if not any(s.parameter.strict and s.mechanism in state.names for s in slots.values()):
        return {}
    beyond = held_back(state.trial, space, uncertainty(state.trial, parts.train, space))
    found = [slots[key] for key in beyond if key in slots and slots[key].parameter.strict]
    least = np.asarray(state.trial.free) < 0.0
    found = [s for s in found if not (s.parameter.null == 0.0 and least[s.index])]
    by_name = {n: tuple(dict.fromkeys(s.parameter.name for s in found if s.mechanism == n)) for n in state.names}
    return {n: asked for n, asked in by_name.items() if asked}


def impossible(state: State, parts: Split) -> dict[str, tuple[str, ...]]:
    """Names of which the parameters together are beyond what nature allows, by more than their errors, and what that
    is; on average where they differ by recording. Only where a law fits do its parameters say that much.
    """
    named = [m for m in state.setup.structure.mechanisms if m.name in state.names and m.impossible]
    if not named:
        return {}
    space, trial = state.setup.space, state.trial
    error = uncertainty(trial, parts.train, space)
    index = jnp.asarray([space.keys.index(key) for key in error.keys])
    ambient = float(np.mean(np.asarray(state.setup.data.ambient)))
    out = {}
    for m in named:
        which = state.setup.structure.mechanisms.index(m)

        def beyond(moved: Array, m: Mechanism = m, which: int = which) -> Array:
            model, _ = unpack(jnp.asarray(trial.free).at[index].set(moved), trial, space)
            values = model.on_average().balances().values[which]
            return jnp.max(jnp.asarray(m.beyond_physics(values, ambient), float))

        by, slope = jax.value_and_grad(beyond)(jnp.asarray(trial.free)[index])
        if float(by) > _TOLD * float(np.sqrt(np.asarray(slope) @ error.covariance @ np.asarray(slope))):
            out[m.name] = (m.impossible,)
    return out


def acting_at_once(state: State, parts: Split) -> tuple[str, ...]:
    """Names of which a time stands at the lower end of its bounds, or is less than a bin and not told from none: what
    they delay is delayed by nothing that was recorded, and a force that follows the drive itself may be imitated.
    """
    setup, moves = state.setup, np.asarray(state.trial.active)
    times = [s for s in setup.structure.slots if s.parameter.time and moves[s.index]]
    quickest = at_limit(state.trial, setup.space) & (np.asarray(state.trial.free[:-1]) < 0.0)
    short = [s for s in times if s.mechanism in state.names and state.values[s.index] < _bin_width(parts)]
    if short:
        told = estimates(state.trial, setup.space, uncertainty(state.trial, parts.train, setup.space))
        for s in short:
            quickest[s.index] |= not told[s.key].value > _TOLD * told[s.key].std
    found = {s.mechanism for s in times if quickest[s.index]}
    return tuple(n for n in state.names if n in found)


def _bin_width(parts: Split) -> float:
    """Seconds, of the recording in which a bin is longest."""
    return float(np.max(np.asarray(parts.whole.grids.step))) * parts.whole.bin


def nothing_stays(state: State, name: str, parts: Split, *, at_least_only: bool) -> bool:
    """Whether a name has come to nothing beside a closure: fitted to the least that counts as a strength, or to what
    the data do not tell from none (all its 95 % intervals hold zero).
    """
    if at_its_least(state, name) or at_least_only:
        return at_its_least(state, name)
    m, setup = state.setup.structure.mechanism(name), state.setup
    strengths = [p for p in m.free_parameters(m.laws.index(state.laws[name])) if p.null == 0.0]
    if not strengths or any(p.bounds[0] > 0.0 for p in strengths):  # on a logarithmic scale none is infinitely far
        return False
    found = estimates(state.trial, setup.space, uncertainty(state.trial, parts.train, setup.space))
    keys = [s.key for s in setup.structure.slots if s.mechanism == name and s.parameter in strengths]
    return all(found[key].low <= 0.0 <= found[key].high for key in keys)
