"""A closure by what uses itself up: a heat that fades the faster the hotter the actuator is, as that of drying does."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from scpjax.diagnose.evidence import Evidence
from scpjax.diagnose.expression import WHAT, of_base
from scpjax.diagnose.holdout import Split
from scpjax.diagnose.hypothesis import State, grown, starts_with
from scpjax.diagnose.learned import Found, fitted_beyond
from scpjax.diagnose.patience import ENDLESS, WHAT_NO_NAME_EXPLAINS, Patience
from scpjax.diagnose.result import Closure, Drawn
from scpjax.fit.identifiability import Uncertainty
from scpjax.fit.result import Estimate
from scpjax.fit.solve import make_room
from scpjax.physics.catalogue import mechanism

_NAME = "learned_reaction"
_KEYS = tuple(f"{_NAME}.{p}" for p in ("heat", "time", "acceleration"))
_PLACE = "learned_heat reaction"
_POINTS = 61


class Reaction(Found):
    """A reaction found."""


def reacting(state: State, split: Split, rules: Evidence, patience: Patience = ENDLESS) -> Reaction | None:
    """The reaction beyond ``state``; None where none is better than none, there is no heat balance for it, or it is
    late by ``patience``.
    """
    old = state.setup.structure
    if old.system or not old.thermal or patience.late(WHAT_NO_NAME_EXPLAINS):
        return None
    make_room()
    m = mechanism(_NAME)
    problem = grown(state.setup, m)
    begun = [(s.value, s.laws) for s in starts_with(state, m, problem)]
    found = fitted_beyond(state, split, rules, problem, begun, _KEYS)
    return None if found is None else Reaction(found.state, found.evidence)


def draw_reaction(
    found: Reaction, every: Mapping[str, Estimate], values: Mapping[str, float], doubt: Uncertainty
) -> Closure:
    """The closure as an expression with units, and its rate over the temperature with a 95 % band; arguments as of
    `scpjax.diagnose.distil.draw`.
    """
    heat, time, steep = (every[key] for key in _KEYS)
    temperature, reference = (values[f"{_NAME}.{n}"] for n in ("reference_temperature", "reference_time"))
    scale = of_base(values, "newton_cooling.conductance") * temperature * reference
    what, _, subsystem = WHAT["learned_heat"]
    error = f" ± {abs(heat.std * scale):.1g}" if np.isfinite(heat.std) else ""
    taken = f"{'-' * (heat.value < 0)}({abs(heat.value * scale):.3g}{error})"
    says = (
        f"{what} = {taken} J s(T) w, with s = exp((T - {temperature:.3g} K)/({temperature / steep.value:.3g} K)) "
        f"/ ({time.value:.3g} s) and w, 1 at the start of every recording, falling at the rate s w"
    )
    below = np.linspace(-1.0, 0.0, _POINTS)  # share of the reference excess, below it
    rate = np.exp(steep.value * below) / time.value
    slow, fast = -rate / time.value * time.std, rate * below * steep.std  # one standard error of each
    at = [doubt.keys.index(key) for key in _KEYS[1:]]
    together = doubt.covariance[at[0], at[1]] / max(doubt.std_free[at[0]] * doubt.std_free[at[1]], 1e-300)
    spread = np.sqrt(np.maximum(slow**2 + fast**2 + 2 * together * slow * fast, 0.0))
    return Closure(
        subsystem,
        _PLACE,
        ("temperature", "history"),
        says,
        {key: every[key] for key in _KEYS},
        found.evidence.held_out_gain,
        found.evidence.delta_bic,
        Drawn("temperature", "K", "Q s(T) w", "1/s", temperature * (1.0 + below), rate, spread, "", rate, 0.0),
        in_a_sentence=(
            f"something that {'takes' if heat.value >= 0 else 'gives'} {abs(heat.value * scale):.3g}{error} J of heat "
            "until it is used up, the faster the hotter it is"
        ),
    )
