"""The scores of many cases together: shares, what was asked for, calibration."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass
from itertools import pairwise

import numpy as np

from fits.concealed.effects.foreign import HELD
from fits.concealed.effects.registry import CATALOGUE, OUTSIDE
from fits.concealed.score import GOOD, HARMLESS, Score

SEEN = ("moderate", "strong")
NEAR = 1.15  # of the noise: what files kept back may be predicted with
BINS = (0.0, 0.5, 0.7, 0.8, 0.9, 0.95, 0.99, 1.0)


def by_method(
    scores: Sequence[Score], others: Mapping[str, Mapping[str, float]]
) -> tuple[dict[str, dict[str, float]], set[str]]:
    """(error on kept files by method and case, cases that every method was given): only those are to be compared, as a
    run may leave the baselines out.
    """
    methods: dict[str, dict[str, float]] = {
        "base model": {s.name: s.kept_base for s in scores},
        "scpjax": {s.name: s.kept for s in scores},
        **{m: dict(e) for m, e in others.items()},
    }
    methods = {m: {n: v for n, v in errors.items() if not math.isnan(v)} for m, errors in methods.items()}
    return methods, set.intersection(*([set(errors) for errors in methods.values() if errors] or [set()]))


@dataclass(frozen=True)
class Goal:
    """A share of some cases, with what is asked of it. ``low``, ``high``: 95 % interval of the share (Wilson)."""

    title: str
    hits: int
    of: int
    asked: float
    at_most: bool = False

    @property
    def share(self) -> float:
        """Hits among the cases; nan where there are none."""
        return self.hits / self.of if self.of else math.nan

    @property
    def met(self) -> bool | None:
        """None where there was nothing to judge."""
        if not self.of:
            return None
        return self._is_enough(self.share)

    @property
    def told(self) -> str:
        """The share in percent, with the digits that it takes to see on which side of the goal it is."""
        told = (f"{self.share:.{digits}%}" for digits in range(6))
        return next((t for t in told if self._is_enough(float(t[:-1]) / 100) == self.met), f"{self.share:%}")

    def _is_enough(self, share: float) -> bool:
        return share <= self.asked if self.at_most else share >= self.asked

    def interval(self) -> tuple[float, float]:
        """Wilson's score interval."""
        if not self.of:
            return 0.0, 1.0
        z, n, p = 1.96, self.of, self.share
        middle, half = p + z * z / (2 * n), z * math.sqrt(p * (1 - p) / n + z * z / (4 * n * n))
        return max(0.0, (middle - half) / (1 + z * z / n)), min(1.0, (middle + half) / (1 + z * z / n))


def named_and_judged(s: Score) -> bool:
    """Whether a case was named right and has files that were kept back."""
    return s.sort in ("single", "foreign", "pair", "triple") and s.outcome in GOOD and math.isfinite(s.kept)


def is_held(s: Score) -> bool:
    """Whether a case is of a law that was chosen as foreign, and is the library's."""
    return s.sort == "foreign" and any(f"-{effect}:{law}-" in s.label for effect, law in HELD)


def goals(scores: Sequence[Score]) -> list[Goal]:
    """What the project asks of itself, in order."""

    def one(title: str, asked: float, among: Callable[[Score], bool], hit: Callable[[Score], bool], most: bool = False):
        chosen = [s for s in scores if among(s)]
        return Goal(title, sum(map(hit, chosen)), len(chosen), asked, most)

    def good(s: Score) -> bool:
        return s.outcome in GOOD

    def seen(sort: str) -> Callable[[Score], bool]:
        return lambda s: s.sort == sort and s.tier in SEEN

    return [
        one("single effects, moderate or strong: named, nothing else", 0.97, seen("single"), good),
        one(
            "single effects, weak: named or left unnamed",
            0.95,
            lambda s: s.sort == "single" and s.tier == "weak",
            lambda s: s.outcome in HARMLESS,
        ),
        one(
            "single effects under foreign laws, moderate or strong: named, nothing else",
            0.90,
            lambda s: s.sort == "foreign" and s.tier in SEEN and not is_held(s),
            good,
        ),
        one("pairs: both named, nothing else", 0.90, seen("pair"), good),
        one("triples: all three named, nothing else", 0.75, seen("triple"), good),
        one(
            "nothing concealed: false alarms",
            0.02,
            lambda s: s.sort == "null",
            lambda s: s.outcome != "right",
            most=True,
        ),
        one(
            "outside the catalogue: no false name",
            0.90,
            lambda s: s.sort == "outside" and s.tier in SEEN,
            lambda s: s.outcome not in ("false name", "failed"),
        ),
        one("outside the catalogue: placed in the right balance", 0.90, seen("outside"), lambda s: s.placed),
        one("named right: kept files within 1.15 of the noise", 0.95, named_and_judged, lambda s: s.kept <= NEAR),
    ]


@dataclass(frozen=True)
class Bin:
    """Names given with a probability in a range: mean probability, share that was right, how many."""

    believed: float
    right: float
    number: int


def calibration(pairs: Iterable[tuple[float, bool]], edges: Sequence[float] = BINS) -> tuple[list[Bin], float]:
    """Reliability, and the mean gap between belief and truth weighted by number (expected calibration error)."""
    believed = np.array([(p, float(r)) for p, r in pairs]).reshape(-1, 2)
    bins = []
    for low, high in pairwise(edges):
        inside = believed[(believed[:, 0] >= low) & ((believed[:, 0] < high) | (high == edges[-1]))]
        if len(inside):
            bins.append(Bin(float(inside[:, 0].mean()), float(inside[:, 1].mean()), len(inside)))
    total = sum(b.number for b in bins)
    return bins, sum(abs(b.believed - b.right) * b.number for b in bins) / total if total else math.nan


def by_verdict(scores: Iterable[Score]) -> dict[str, tuple[int, int]]:
    """By verdict, how many of the names given were right, and of how many."""
    out: dict[str, tuple[int, int]] = {}
    for s in scores:
        right, of = out.get(s.verdict, (0, 0))
        if s.believed:
            out[s.verdict] = (right + sum(ok for _, ok in s.believed), of + len(s.believed))
    return dict(sorted(out.items()))


def confusion(scores: Sequence[Score]) -> tuple[list[str], list[str], np.ndarray]:
    """(effects, what was said, counts) of single effects, in the order of the catalogue, nothing, and those outside."""
    chosen = [s for s in scores if s.sort in ("single", "foreign", "outside", "null")]
    found = dict.fromkeys(s.effects[0] if s.effects else "nothing" for s in chosen)
    effects = sorted(found, key=lambda e: (*_ORDER, e).index(e))
    said = [_said(s) for s in chosen]
    order = [e for e in effects if e in said and e not in _SILENT]
    columns = order + sorted(set(said) - set(order) - set(_SILENT)) + [w for w in _SILENT if w in said]
    counts = np.zeros((len(effects), len(columns)), int)
    for s, word in zip(chosen, said, strict=True):
        counts[effects.index(s.effects[0] if s.effects else "nothing"), columns.index(word)] += 1
    return effects, columns, counts


_ORDER = (*CATALOGUE, "nothing", *OUTSIDE)
_SILENT = ("nothing", "something unnamed", "several", "no answer")


def _said(s: Score) -> str:
    if s.outcome == "failed":
        return "no answer"
    if not s.named:
        return "nothing" if s.verdict == "adequate" else "something unnamed"
    if len(s.named) > 1:
        return "several"
    return s.effects[0] if s.outcome in GOOD and s.effects else s.named[0]


def median(values: Iterable[float]) -> float:
    """Of the finite ones; nan where there are none."""
    finite = [v for v in values if math.isfinite(v)]
    return float(np.median(finite)) if finite else math.nan
