"""Many actuators, each diagnosed: which effects are in which, what spreads, which actuator is not like the others."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from scipy.special import chdtrc, stdtrit

from scpjax.diagnose.restated import powers_of
from scpjax.diagnose.result import FREE
from scpjax.fit.setup import UNKNOWN_POWER

TABLE = "fleet.csv"
"""What the table with a row per actuator is called."""

OUTLYING = 3.5
"""Robust standard deviations from the median beyond which a value is an outlier (Iglewicz, Hoaglin, How to Detect and
Handle Outliers, 1993, section 3.2)."""
_FEW = 5  # actuators, with fewer of which nothing can be told to lie outside
_DIFFERS = 0.01  # p-value below which values differ by more than their errors
_SAME = 1e-6  # of a reference, by which two may differ by rounding


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

    def stands_for(self, effect: str) -> tuple[str, ...]:
        """Mechanisms that could stand in for this one."""
        named = () if self.content is None else self.content["mechanisms"]
        return tuple(e for m in named if m["name"] == effect for e in m["equivalents"])

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

    @property
    def stated(self) -> dict[str, tuple[str, Mapping[str, Any]]]:
        """By mechanism named: its law, and the references for which its parameters are stated."""
        named = () if self.content is None else self.content["mechanisms"]
        return {m["name"]: (m["law"], m.get("references", {})) for m in named}


@dataclass(frozen=True)
class Spread:
    """One parameter over a fleet, ``names`` that have it. ``differs``: p-value of all being the same within their
    errors (Cochran's Q); 1 where no error is known. ``relative``: scatter beyond the errors as a share of the median.
    ``mean`` (value, low, high): of the fleet that these actuators are a sample of, with its 95 % interval; geometric
    where all are positive; not numbers where fewer than two errors are known. ``estimates`` by name, restated for
    ``references`` where their own differed; all of one ``law``.
    """

    key: str
    unit: str
    names: tuple[str, ...]
    values: np.ndarray
    std: np.ndarray
    logarithmic: bool
    differs: float
    relative: float
    mean: tuple[float, float, float]
    law: str = ""
    references: Mapping[str, Mapping[str, Any]] = field(default_factory=dict)
    estimates: Mapping[str, Mapping[str, Any]] = field(default_factory=dict)

    @property
    def stated(self) -> str:
        """What the values are stated for, in words; empty where for nothing."""
        said = (f"{k.replace('_', ' ')} {r['value']:.3g} {r['unit']}" for k, r in self.references.items())
        return ", ".join(said)

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
    """Every parameter that two actuators or more have under the same law, in the order of their diagnoses; without
    those in watts or joules where the power of one is not known: each then has a scale of its own; and without those
    that are `not_compared`.
    """
    return _compared(members)[0]


def not_compared(members: Sequence[Member]) -> tuple[str, ...]:
    """Parameters that several have, but for references, or at places of a curve, that are each one's own."""
    return _compared(members)[1]


def _compared(members: Sequence[Member]) -> tuple[tuple[Spread, ...], tuple[str, ...]]:
    pools: dict[tuple[str, str, str], list[tuple[Member, Mapping[str, Any]]]] = {}
    for m in members:
        for key, e in m.parameters.items():
            if e["value"] is not None:
                law = m.stated.get(key.split(".")[0], ("", {}))[0]
                pools.setdefault((key, law, str(e["unit"])), []).append((m, e))
    no_power = any(n.startswith(UNKNOWN_POWER) for m in members for n in m.notes)
    found: list[Spread] = []
    left: dict[str, None] = {}
    for (key, law, unit), have in pools.items():
        mechanism = key.split(".")[0]
        if len(have) < 2 or (no_power and unit.startswith(("W", "J"))):
            continue
        told = [m.stated.get(mechanism, ("", {}))[1] for m, _ in have]
        common = None if law == FREE else _common(key, law, told)
        if common is None:
            left[f"{mechanism} ({FREE})" if law == FREE else _label(key, law, unit, pools)] = None
            continue
        powers = powers_of(key, law) or {}
        factors = [np.prod([(r[k]["value"] / common[k]["value"]) ** n for k, n in powers.items()]) for r in told]
        restated = {m.name: _times(e, float(f)) for (m, e), f in zip(have, factors, strict=True)}
        found.append(_spread(_label(key, law, unit, pools), unit, restated, law, common))
    return tuple(found), tuple(left)


def _label(key: str, law: str, unit: str, pools: Mapping[tuple[str, str, str], Any]) -> str:
    """A parameter by its key; with its law, or its unit, where it has others elsewhere in the fleet."""
    laws, units = ({pool[i] for pool in pools if pool[0] == key} for i in (1, 2))
    more = [law] * (len(laws) > 1) + [unit] * (len(units) > 1)
    return f"{key} ({', '.join(filter(None, more))})" if any(more) else key


def _common(key: str, law: str, told: Sequence[Mapping[str, Any]]) -> dict[str, dict[str, Any]] | None:
    """References for which a parameter of all can be stated: those that it depends on, in the middle of the fleet;
    None where theirs differ and it cannot be restated.
    """
    powers = powers_of(key, law)
    out = {}
    for name in dict.fromkeys(k for references in told for k in references) if powers is None else powers:
        if any(name not in references for references in told):
            return None
        values = np.array([float(references[name]["value"]) for references in told])
        if powers is None and np.ptp(values) > _SAME * np.abs(values).max():
            return None
        out[name] = {"value": float(np.median(values)), "unit": told[0][name]["unit"]}
    return out


def _times(e: Mapping[str, Any], factor: float) -> dict[str, Any]:
    scaled = {k: e[k] if e[k] is None else factor * float(e[k]) for k in ("value", "std", "low", "high")}
    return {**e, **scaled}


def _spread(
    key: str,
    unit: str,
    have: Mapping[str, Mapping[str, Any]],
    law: str,
    references: Mapping[str, Mapping[str, Any]],
) -> Spread:
    """Cochran's Q, the scatter beyond the errors (DerSimonian, Laird, Control. Clin. Trials 7 (1986) 177), and the mean
    by weights of both, its interval after Knapp, Hartung, Stat. Med. 22 (2003) 2693, no narrower than by these weights
    alone (Röver, Knapp, Friede, BMC Med. Res. Methodol. 15 (2015) 99).
    """
    values = np.array([float(e["value"]) for e in have.values()])
    std = np.array([np.inf if e["std"] is None or e.get("at_limit") else float(e["std"]) for e in have.values()])
    ends = [e["low"] for e in have.values() if e["low"] is not None]
    logarithmic = bool(np.all(values > 0) and ends and min(ends) > 0)
    x, error = (np.log(values), std / values) if logarithmic else (values, std)
    known = np.isfinite(error) & (error > 0)
    differs, beyond, ends_of_mean = 1.0, 0.0, (np.nan, np.nan, np.nan)
    if known.sum() >= 2:
        x, weight = x[known], 1.0 / error[known] ** 2
        mean = float(weight @ x / weight.sum())
        q, free = float(weight @ (x - mean) ** 2), int(known.sum()) - 1
        differs = float(chdtrc(free, q))
        c = weight.sum() - (weight**2).sum() / weight.sum()
        beyond = float(np.sqrt(max(q - free, 0.0) / c)) if c > 0 else 0.0
        weight = 1.0 / (error[known] ** 2 + beyond**2)
        mean = float(weight @ x / weight.sum())
        wider = max(float(weight @ (x - mean) ** 2) / free, 1.0)
        reach = float(stdtrit(free, 0.975)) * np.sqrt(wider / weight.sum())
        of_scale = np.exp if logarithmic else float
        with np.errstate(over="ignore"):  # of two that are hardly known it may reach to infinity
            ends_of_mean = (float(of_scale(mean)), float(of_scale(mean - reach)), float(of_scale(mean + reach)))
    middle = abs(float(np.median(values)))
    relative = beyond if logarithmic else beyond / middle if middle > 0 else float("inf") if beyond else 0.0
    return Spread(
        key, unit, tuple(have), values, std, logarithmic, differs, relative, ends_of_mean, law, references, have
    )


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
            says += f", stated for {s.stated}" if s.stated else ""
            out.append(Outlier(s.names[i], f"{says} ({abs(score[i]):.1f} robust standard deviations)", abs(score[i])))
    return tuple(sorted([*out, *_odd_effects(members)], key=lambda o: -o.score))


def _odd_effects(members: Sequence[Member]) -> list[Outlier]:
    whole = [m for m in members if m.content is not None]
    out = []
    rare = max(1, len(whole) // 20)
    for effect, names in effects(whole).items() if len(whole) >= _FEW else ():
        having = [m for m in whole if effect in m.effects]
        lacking = [m for m in whole if effect not in m.effects and effect not in m.equivalents]
        if len(names) <= rare:
            others = f"in {len(names) - 1} of the others" if len(names) > 1 else "in none of the others"
            alone = [m for m in having if sum(_may_share(m, other, effect) for other in whole) <= rare]
            out += [Outlier(m.name, f"{effect} was named here and {others}", 0.0) for m in alone]
        elif len(lacking) <= rare:
            words = f"{effect} was not named here, but in {len(names)} of {len(whole)}"
            apart = [m for m in lacking if sum(not _may_be(h, m, effect) for h in having) > rare]
            out += [Outlier(m.name, words, 0.0) for m in apart]
    return out


def _may_share(m: Member, other: Member, effect: str) -> bool:
    """Whether what was named in one may be in another too, by a name that the recordings of either leave open."""
    return effect in other.effects or effect in other.equivalents or _may_be(m, other, effect)


def _may_be(m: Member, other: Member, effect: str) -> bool:
    """Whether an effect named in one may be what was named in the other."""
    return any(e in other.effects for e in m.stands_for(effect))


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
    left = not_compared(whole)
    if left:
        out.append(
            f"Not compared, for each actuator states them for references or at places of its own: {', '.join(left)}."
        )
    return tuple(out)
