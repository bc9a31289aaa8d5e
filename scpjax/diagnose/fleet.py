"""Many actuators, each diagnosed: which effects are in which, what spreads, which actuator is not like the others."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from scipy import stats

from scpjax.fit.setup import UNKNOWN_POWER

OUTLYING = 3.5
"""Robust standard deviations from the median beyond which a value is an outlier (Iglewicz, Hoaglin, How to Detect and
Handle Outliers, 1993, section 3.2)."""
_FEW = 5  # actuators, with fewer of which nothing can be told to lie outside
_DIFFERS = 0.01  # p-value below which values differ by more than their errors


@dataclass(frozen=True)
class Member:
    """One actuator: its diagnosis in the form ``scpjax.diagnosis/1``, or the sentence why there is none."""

    name: str
    content: Mapping[str, Any] | None
    failure: str = ""

    @property
    def effects(self) -> dict[str, float]:
        """Probability of each mechanism named."""
        return {} if self.content is None else {m["name"]: float(m["probability"]) for m in self.content["mechanisms"]}

    @property
    def equivalents(self) -> tuple[str, ...]:
        """Mechanisms that could stand in for one named."""
        if self.content is None:
            return ()
        return tuple(e for m in self.content["mechanisms"] for e in m["equivalents"])

    @property
    def verdict(self) -> str:
        """adequate, explained or unexplained; nothing where it failed."""
        return "" if self.content is None else str(self.content["verdict"])

    @property
    def notes(self) -> tuple[str, ...]:
        """What is told beside."""
        return () if self.content is None else tuple(self.content.get("notes", ()))

    @property
    def parameters(self) -> dict[str, Mapping[str, Any]]:
        """Estimates by key, of the base model and of the mechanisms named."""
        if self.content is None:
            return {}
        own = {f"{m['name']}.{k}": e for m in self.content["mechanisms"] for k, e in m["parameters"].items()}
        return {**self.content["parameters"], **own}


@dataclass(frozen=True)
class Spread:
    """One parameter over a fleet, ``names`` that have it. ``differs``: p-value of all being the same within their
    errors (Cochran's Q); 1 where no error is known. ``relative``: scatter beyond the errors as a share of the median.
    """

    key: str
    unit: str
    names: tuple[str, ...]
    values: np.ndarray
    std: np.ndarray
    logarithmic: bool
    differs: float
    relative: float

    @property
    def median(self) -> float:
        """The middle value."""
        return float(np.median(self.values))


@dataclass(frozen=True)
class Outlier:
    """An actuator that is not like the others, and in what: a parameter with its robust ``score``, or its effects."""

    name: str
    says: str
    score: float


def effects(members: Sequence[Member]) -> dict[str, tuple[str, ...]]:
    """Which actuators each mechanism was named in, most often named first."""
    found: dict[str, list[str]] = {}
    for m in members:
        for effect in m.effects:
            found.setdefault(effect, []).append(m.name)
    return {k: tuple(v) for k, v in sorted(found.items(), key=lambda item: (-len(item[1]), item[0]))}


def spreads(members: Sequence[Member]) -> tuple[Spread, ...]:
    """Every parameter that two actuators or more have, in the order of their diagnoses; without those in watts or
    joules where the power of one is not known: each then has a scale of its own.
    """
    keys = dict.fromkeys(k for m in members for k in m.parameters)
    no_power = any(n.startswith(UNKNOWN_POWER) for m in members for n in m.notes)
    out = []
    for key in keys:
        have = [(m.name, m.parameters[key]) for m in members if key in m.parameters]
        have = [(n, e) for n, e in have if e["value"] is not None]
        if len(have) < 2 or (no_power and str(have[0][1]["unit"]).startswith(("W", "J"))):
            continue
        values = np.array([float(e["value"]) for _, e in have])
        std = np.array([np.inf if e["std"] is None or e.get("at_limit") else float(e["std"]) for _, e in have])
        ends = [e["low"] for _, e in have if e["low"] is not None]
        logarithmic = bool(np.all(values > 0) and ends and min(ends) > 0)
        unit = str(have[0][1]["unit"])
        out.append(_spread(key, unit, tuple(n for n, _ in have), values, std, logarithmic))
    return tuple(out)


def _spread(
    key: str, unit: str, names: tuple[str, ...], values: np.ndarray, std: np.ndarray, logarithmic: bool
) -> Spread:
    """Cochran's Q and the scatter beyond the errors (DerSimonian, Laird, Control. Clin. Trials 7 (1986) 177)."""
    x, error = (np.log(values), std / values) if logarithmic else (values, std)
    known = np.isfinite(error) & (error > 0)
    differs, beyond = 1.0, 0.0
    if known.sum() >= 2:
        x, weight = x[known], 1.0 / error[known] ** 2
        mean = float(weight @ x / weight.sum())
        q, free = float(weight @ (x - mean) ** 2), int(known.sum()) - 1
        differs = float(stats.chi2.sf(q, free))
        c = weight.sum() - (weight**2).sum() / weight.sum()
        beyond = float(np.sqrt(max(q - free, 0.0) / c)) if c > 0 else 0.0
    middle = abs(float(np.median(values)))
    relative = beyond if logarithmic else beyond / middle if middle > 0 else float("inf") if beyond else 0.0
    return Spread(key, unit, names, values, std, logarithmic, differs, relative)


def outliers(members: Sequence[Member], found: Sequence[Spread]) -> tuple[Outlier, ...]:
    """Actuators with a parameter far from the others' (in units of their scatter and its own error), or with effects
    that hardly any other has, or without those that nearly all have; farthest first.
    """
    out = []
    for s in found:
        if len(s.values) < _FEW:
            continue
        x, error = (np.log(s.values), s.std / s.values) if s.logarithmic else (s.values, s.std)
        middle = np.median(x)
        scatter = 1.4826 * float(np.median(np.abs(x - middle)))
        score = (x - middle) / np.sqrt(scatter**2 + np.where(np.isfinite(error), error, np.inf) ** 2 + 1e-300)
        for i in np.flatnonzero(np.abs(score) > OUTLYING):
            side = "above" if score[i] > 0 else "below"
            says = f"{s.key} = {s.values[i]:.4g} {s.unit} is far {side} the others' {s.median:.4g} {s.unit}"
            out.append(Outlier(s.names[i], f"{says} ({abs(score[i]):.1f} robust standard deviations)", abs(score[i])))
    return tuple(sorted([*out, *_odd_effects(members)], key=lambda o: -o.score))


def _odd_effects(members: Sequence[Member]) -> list[Outlier]:
    whole = [m for m in members if m.content is not None]
    out = []
    rare = max(1, len(whole) // 20)
    for effect, names in effects(whole).items() if len(whole) >= _FEW else ():
        lacking = [m for m in whole if effect not in m.effects and effect not in m.equivalents]
        if len(names) <= rare:
            others = f"in {len(names) - 1} of the others" if len(names) > 1 else "in none of the others"
            out += [Outlier(n, f"{effect} was named here and {others}", 0.0) for n in names]
        elif len(lacking) <= rare:
            words = f"{effect} was not named here, but in {len(names)} of {len(whole)}"
            out += [Outlier(m.name, words, 0.0) for m in lacking]
    return out


def summary(members: Sequence[Member], found: Sequence[Spread]) -> tuple[str, ...]:
    """The fleet in sentences: how many of which verdict, which effects, what differs between actuators."""
    whole = [m for m in members if m.content is not None]
    counts = {v: sum(m.verdict == v for m in whole) for v in ("adequate", "explained", "unexplained")}
    out = [
        f"{len(whole)} of {len(members)} actuators were diagnosed: "
        + ", ".join(f"{n} {v}" for v, n in counts.items() if n)
        + "."
    ]
    named = effects(whole)
    if named:
        said = ", ".join(f"{e} in {len(n)}" for e, n in named.items())
        out.append(f"Left out of the base model: {said}.")
    elif whole:
        out.append("No mechanism was named in any of them.")
    apart = [s.key for s in found if s.differs < _DIFFERS]
    same = [s.key for s in found if s.differs >= _DIFFERS and np.isfinite(s.std).sum() >= 2]
    if apart:
        out.append(f"Different from actuator to actuator by more than the errors: {', '.join(apart)}.")
    if same:
        out.append(f"The same in all to within the errors: {', '.join(same)}.")
    return tuple(out)
