"""The list of cases: which effects, under which law, on which plant, how strong, at which noise, driven how."""

from __future__ import annotations

import hashlib
import itertools
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Literal, TypeVar

import numpy as np

from fits.concealed.drives import Family
from fits.concealed.effects.registry import CATALOGUE, EFFECTS, FOREIGN, OUTSIDE
from fits.concealed.plants import KINDS, Kind
from fits.concealed.recorder import LEVELS, Level, Mess

Card = TypeVar("Card")
Sort = Literal["single", "pair", "triple", "null", "outside", "foreign"]
SORTS: tuple[Sort, ...] = ("single", "pair", "triple", "null", "outside", "foreign")
Tier = Literal["none", "weak", "moderate", "strong"]
TIERS: dict[Tier, tuple[float, float]] = {"weak": (1.25, 2.9), "moderate": (3.3, 8.0), "strong": (9.0, 25.0)}
SEEDS = 5  # of a draw
# (given, kept): three or two families to learn from, and others to be judged on
FILES: tuple[tuple[tuple[Family, ...], tuple[Family, ...]], ...] = (
    (("step", "multilevel", "pulses"), ("sweep", "multilevel")),
    (("multilevel", "triangle"), ("pulses",)),
    (("step", "pulses", "sweep"), ("multilevel",)),
    (("multilevel", "sweep", "pulses"), ("triangle", "step")),
)
# effects that move the same states in nearly the same way are not put into one case
ALIKE: tuple[frozenset[str], ...] = (
    frozenset({"nonlinear_thermal_force", "thermal_softening", "nonlinear_stiffness", "antagonist_load", "slack"}),
    frozenset({"hysteresis", "friction"}),
    frozenset({"sensor_drift", "ambient_drift", "fatigue"}),
    frozenset({"two_node_thermal", "sensor_lag", "input_delay"}),
    frozenset({"supply_sag", "drive_dead_zone", "resistance_temperature"}),
    frozenset({"nonlinear_heat_loss", "resistance_temperature"}),
    frozenset({"creep", "fatigue"}),
)
_MESSY: dict[int, tuple[Mess, ...]] = {3: ("skipped",), 4: ("warm",), 5: ("outliers",)}  # some singles, by seed


@dataclass(frozen=True)
class Case:
    """One case as planned. ``effects``: (name, law) of each; ``name`` is the folder, which tells nothing."""

    sort: Sort
    effects: tuple[tuple[str, str], ...]
    kind: Kind
    tier: Tier
    level: Level
    seed: int
    files: int  # index into FILES
    mess: tuple[Mess, ...] = ()
    subset: bool = False

    @property
    def label(self) -> str:
        """In words, unique."""
        what = "+".join(f"{e}:{law}" for e, law in self.effects) or "nothing"
        return "-".join(
            (self.sort, what, self.tier, self.kind, self.level, "+".join(self.mess) or "tidy", f"s{self.seed}")
        )

    @property
    def name(self) -> str:
        """Folder."""
        return hashlib.sha256(self.label.encode()).hexdigest()[:8]

    def rng(self) -> np.random.Generator:
        """Random numbers of this case alone."""
        return np.random.Generator(np.random.PCG64(int(hashlib.sha256(self.label.encode()).hexdigest()[:16], 16)))


def seen() -> frozenset[str]:
    """Names of the cases on which the engine was run while it was being built (``seen.txt``)."""
    lines = (Path(__file__).parent / "seen.txt").read_text(encoding="utf-8").splitlines()
    return frozenset(line.strip() for line in lines if line.strip() and not line.startswith("#"))


def plan() -> list[Case]:
    """Every case, in order."""
    first = [*_singles(), *_several(2), *_several(3), *_nulls(), *_outside(), *_foreign()]
    second = [*_several(2, draw=1), *_several(3, draw=1), *_nulls(draw=1)]
    third, fourth = (
        [*_singles(draw=d), *_several(2, draw=d), *_several(3, draw=d), *_nulls(draw=d), *_outside(draw=d)]
        for d in (2, 3)
    )
    return [*first, *second, *third, *_foreign(draw=2), *fourth, *_foreign(draw=3)]


class _Decks:
    """Laws, kinds, noise and files dealt evenly but in no order that would tie one to another."""

    def __init__(self, seed: int):
        self.rng = np.random.Generator(np.random.PCG64(seed))
        self.used: dict[object, int] = {}

    def deal(self, among: Sequence[Card], of: str) -> Card:
        """The one of ``among`` dealt least often so far under ``of``; by lot where several are."""
        counts = [self.used.get((of, card), 0) + 0.9 * self.rng.random() for card in among]
        card = among[int(np.argmin(counts))]
        self.used[of, card] = self.used.get((of, card), 0) + 1
        return card

    def law(self, effect: str, kinds: Sequence[Kind] = KINDS) -> tuple[str, Kind]:
        """A law and a kind of plant that shows it."""
        laws = EFFECTS[effect].laws
        kind: Kind = self.deal([k for k in kinds if any(k in seen for seen in laws.values())], f"kind {effect}")
        return self.deal([law for law, seen in laws.items() if kind in seen], f"law {effect}"), kind


def _seeds(draw: int) -> range:
    return range(1 + draw * SEEDS, 1 + (draw + 1) * SEEDS)


def _singles(*, draw: int = 0) -> list[Case]:
    out = []
    for i, effect in enumerate(CATALOGUE):
        decks = _Decks(100 + i + 1000 * draw)
        for seed, (j, tier) in itertools.product(_seeds(draw), enumerate(TIERS)):
            law, kind = decks.law(effect)
            mess = _MESSY.get(seed - draw * SEEDS, ()) if j == seed % 3 else ()
            inside = (seed == 1 + i % 5 and j == 1 + i % 2) or (seed == 2 and j == 0 and i % 4 == 0)
            level = decks.deal(LEVELS[:2] if tier == "strong" else LEVELS, "level")
            files = decks.deal(range(len(FILES)), "files")
            out.append(Case("single", ((effect, law),), kind, tier, level, seed, files, mess, inside))
    return out


def _several(size: int, *, draw: int = 0) -> list[Case]:
    """Pairs or triples that go together, drawn evenly over the catalogue; another draw has other ones."""
    rng = np.random.Generator(np.random.PCG64(40 + size + 1000 * draw))
    names = [n for n in CATALOGUE if n != "thermal_crosstalk"]
    number = 12 if size == 2 else 6
    sets: list[tuple[str, ...]] = []
    used = dict.fromkeys(names, 0)
    while len(sets) < number:
        order = sorted(names, key=lambda n: used[n] + rng.random())
        chosen = tuple(sorted(_compatible(order, size), key=names.index))
        if chosen not in sets:
            sets.append(chosen)
            for n in chosen:
                used[n] += 1
    out, decks = [], _Decks(50 + size + 1000 * draw)
    sort: Sort = "pair" if size == 2 else "triple"
    for i, (chosen, seed) in enumerate(itertools.product(sets, _seeds(draw))):
        kinds: tuple[Kind, ...] = ("full", "full", "joint", "full", "plant" if size == 2 else "joint")
        kind = _shared_kind(chosen, kinds[seed % len(kinds)])
        effects = tuple((n, decks.law(n, (kind,))[0]) for n in chosen)
        tier: Tier = "strong" if seed % 2 else "moderate"
        inside = seed == 1 and i % (15 if size == 2 else 10) == 0
        level, files = decks.deal(LEVELS[:2], "level"), decks.deal(range(len(FILES)), "files")
        out.append(Case(sort, effects, kind, tier, level, seed, files, (), inside))
    return out


def _compatible(order: list[str], size: int) -> list[str]:
    chosen: list[str] = []
    for name in order:
        alone = all(not {name, other} <= alike for other in chosen for alike in ALIKE)
        if alone and len(chosen) < size:
            chosen.append(name)
    return chosen


def _shared_kind(effects: tuple[str, ...], wish: Kind) -> Kind:
    seen: list[Kind] = [k for k in KINDS if all(any(k in kinds for kinds in EFFECTS[e].laws.values()) for e in effects)]
    return wish if wish in seen else "full" if "full" in seen else seen[0]


def _nulls(*, draw: int = 0) -> list[Case]:
    messes: tuple[tuple[Mess, ...], ...] = ((), ("warm",), ("skipped",), ("outliers",), ("warm", "skipped", "outliers"))
    out, decks = [], _Decks(60 + 1000 * draw)
    for i, (kind, mess, seed) in enumerate(itertools.product(KINDS, messes, _seeds(draw))):
        inside = seed == 1 and i in (0, 30, 60, 90, 70)
        level, files = decks.deal(LEVELS, f"level {kind}"), decks.deal(range(len(FILES)), f"files {kind}")
        out.append(Case("null", (), kind, "none", level, seed, files, mess, inside))
    return out


def _outside(*, draw: int = 0) -> list[Case]:
    out = []
    for i, effect in enumerate(OUTSIDE):
        decks = _Decks(70 + i + 1000 * draw)
        for seed in _seeds(draw):
            law, kind = decks.law(effect)
            tier: Tier = "strong" if seed % 2 else "moderate"
            level, files = decks.deal(LEVELS[:2], "level"), decks.deal(range(len(FILES)), "files")
            inside = seed == 1 + i % 2 and i % 2 == 0
            out.append(Case("outside", ((effect, law),), kind, tier, level, seed, files, (), inside))
    return out


def _foreign(*, draw: int = 0) -> list[Case]:
    """Single effects under laws that the library does not hold: moderate and strong by turns."""
    out = []
    for i, effect in enumerate(FOREIGN):
        decks = _Decks(200 + i + 1000 * draw)
        for seed in _seeds(draw):
            for law, kinds in FOREIGN[effect].laws.items():
                kind = decks.deal(kinds, "kind")
                tier: Tier = "strong" if (seed + i) % 2 else "moderate"
                level, files = decks.deal(LEVELS[:2], "level"), decks.deal(range(len(FILES)), "files")
                out.append(Case("foreign", ((effect, law),), kind, tier, level, seed, files))
    return out
