"""How a diagnosis compares with the truth. Works on plain ``truth.json`` and ``diagnosis.json`` content."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass, field
from typing import Any, Literal

Outcome = Literal[
    "right",  # every effect named, nothing else; of a null: adequate; of one outside the catalogue: placed, not named
    "equivalent",  # as right, but some effect stands among at most three equivalents of the name given
    "partly",  # names given are right, some effect is not named
    "unnamed",  # nothing named, but something said to be missing
    "missed",  # nothing named and nothing said to be missing
    "extra",  # every effect named, and something else
    "misnamed",  # a wrong name, and an effect that was not named
    "alarm",  # of a null: something said to be missing, without a name
    "false name",  # of a null or of one outside the catalogue: a name
    "misplaced",  # of one outside the catalogue: not named, but put in the wrong balance
    "failed",  # no diagnosis came
]
MOST_EQUIVALENTS = 3
GOOD: tuple[Outcome, ...] = ("right", "equivalent")
HARMLESS: tuple[Outcome, ...] = ("right", "equivalent", "partly", "unnamed", "missed")
Errors = Mapping[str, Mapping[str, float]]  # file: {column: rmse}
_INFINITE = "inf"


@dataclass(frozen=True)
class Score:
    """One case scored. ``kept`` and ``kept_base``: worst RMSE over noise of the files that were kept back."""

    name: str
    label: str
    sort: str
    tier: str
    kind: str
    noise: str
    mess: str
    seed: int
    subset: bool
    effects: list[str]
    misfit: float
    outcome: Outcome
    named: list[str]
    verdict: str
    subsystem: str
    placed: bool
    kept: float
    kept_base: float
    minutes: float
    believed: list[tuple[float, bool]] = field(default_factory=list)  # (probability, right) of each name given
    ranked: list[tuple[float, bool]] = field(default_factory=list)  # the same of every name tried
    error: str = ""
    commit: str = ""  # of the package, that gave the answer
    first: bool = False  # the engine had not been run on it when it was asked
    sealed: str = ""  # sha256 of its truth.json, by which that was sealed

    def plain(self) -> dict[str, Any]:
        """For JSON: what is no number is null, what is infinite a word."""

        def written(v: Any) -> Any:
            return v if not isinstance(v, float) or math.isfinite(v) else None if math.isnan(v) else _INFINITE

        return {k: written(v) for k, v in asdict(self).items()}

    @classmethod
    def read(cls, plain: Mapping[str, Any]) -> Score:
        """What `plain` wrote."""
        numbers = {"misfit", "kept", "kept_base", "minutes"}
        given = {k: float("nan" if v is None else v) if k in numbers else v for k, v in plain.items()}
        pairs = {k: [(float(p), bool(right)) for p, right in plain[k]] for k in ("believed", "ranked")}
        return cls(**{**given, **pairs})


def score(truth: Mapping[str, Any], result: Mapping[str, Any]) -> Score:
    """Score of a result: ``diagnosis`` (or ``error``), ``kept`` and ``kept_base`` errors, ``seconds``."""
    found = result.get("diagnosis")
    mechanisms: Sequence[Mapping[str, Any]] = found["mechanisms"] if found else []
    right = matched(truth["effects"] if truth["catalogue"] else [], mechanisms)
    own = [m for m in mechanisms if not truth["catalogue"] and m["name"] in truth["effects"]]
    subsystem = found["location"]["subsystem"] if found else ""
    placed = subsystem in truth["subsystems"]
    return Score(
        **{k: truth[k] for k in ("name", "label", "sort", "tier", "kind", "noise", "seed", "subset", "effects")},
        mess="+".join(truth["mess"]),
        misfit=truth["misfit"],
        outcome=_outcome(truth, found, right, placed, bool(own)) if found else "failed",
        named=[m["name"] for m in mechanisms],
        verdict=found["verdict"] if found else "",
        subsystem=subsystem,
        placed=placed,
        kept=worst(result.get("kept", {}), truth),
        kept_base=worst(result.get("kept_base", {}), truth),
        minutes=result.get("seconds", math.nan) / 60,
        believed=[(float(m["probability"]), i in right.values()) for i, m in enumerate(mechanisms)],
        ranked=_ranked(truth, found) if found else [],
        error=result.get("error", ""),
    )


def matched(effects: Sequence[str], mechanisms: Sequence[Mapping[str, Any]]) -> dict[int, int]:
    """Effect by effect, the index of the name that stands for it; as many as can be, each name once."""
    stands = [[_stands(m, e) for m in mechanisms] for e in effects]
    taken: dict[int, int] = {}  # name: effect

    def place(effect: int, seen: set[int]) -> bool:
        order = sorted(range(len(mechanisms)), key=lambda i: mechanisms[i]["name"] != effects[effect])
        for i in order:
            if stands[effect][i] and i not in seen:
                seen.add(i)
                if i not in taken or place(taken[i], seen):
                    taken[i] = effect
                    return True
        return False

    for effect in range(len(effects)):
        place(effect, set())
    return {e: i for i, e in taken.items()}


def _stands(mechanism: Mapping[str, Any], effect: str) -> bool:
    same = list(mechanism.get("equivalents", ()))
    return mechanism["name"] == effect or (len(same) <= MOST_EQUIVALENTS and effect in same)


def _outcome(
    truth: Mapping[str, Any], found: Mapping[str, Any], right: Mapping[int, int], placed: bool, own: bool
) -> Outcome:
    named, verdict, effects = found["mechanisms"], found["verdict"], truth["effects"]
    if not effects:
        return "false name" if named else "right" if verdict == "adequate" else "alarm"
    if not named:
        if verdict == "adequate":
            return "missed"
        return "unnamed" if truth["catalogue"] else "right" if placed else "misplaced"
    if not truth["catalogue"]:
        return "right" if own and len(named) == 1 else "false name"
    if len(right) < len(effects):
        return "partly" if len(right) == len(named) else "misnamed"
    if len(named) > len(effects):
        return "extra"
    return "right" if all(named[i]["name"] == effects[e] for e, i in right.items()) else "equivalent"


def worst(errors: Errors, truth: Mapping[str, Any]) -> float:
    """Greatest RMSE over noise among files and columns; nan where there is none."""
    ratios = [
        rmse / truth["files"][f"kept/{file}"]["noise"][column]
        for file, row in errors.items()
        for column, rmse in row.items()
    ]
    return max(ratios, default=math.nan)


def _ranked(truth: Mapping[str, Any], found: Mapping[str, Any]) -> list[tuple[float, bool]]:
    """Each name tried, with its last probability, and whether it or one it equals is there."""
    last: dict[str, tuple[float, bool]] = {}
    for entry in found.get("ranking", ()):
        last[entry["name"]] = (float(entry["probability"]), entry["name"] in truth["effects"])
    for m in found["mechanisms"]:
        right = any(_stands(m, e) for e in truth["effects"])
        last[m["name"]] = (float(m["probability"]), right)
    return list(last.values())
