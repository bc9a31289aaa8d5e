"""From a planned case to its folder: ``given/``, ``kept/`` and ``truth.json``."""

from __future__ import annotations

import json
import os
from dataclasses import asdict
from pathlib import Path

import numpy as np

from fits.concealed.cases import FILES, TIERS, Case
from fits.concealed.drives import draw_drive
from fits.concealed.effect import Effect
from fits.concealed.effects.registry import kind_of
from fits.concealed.plants import FULL_DRIVE, Plant, draw_plant
from fits.concealed.recorder import columns, record
from fits.concealed.strength import BaseFit, base_fit, calibrate
from fits.concealed.system import IntegrationError, simulate

TRUTH = "truth.json"
SEEN = 1.2  # misfit over noise below which an effect cannot be expected to be seen


class Maker:
    """One case: its plant, drives and effects, drawn; strengths found so that the misfit is that of its tier."""

    def __init__(self, case: Case):
        self.case, self.rng = case, case.rng()
        self.plant: Plant = draw_plant(case.kind, self.rng)
        self.period = float(self.rng.choice([0.05, 0.1]))
        given, kept = FILES[case.files]
        sides = self.plant.sides
        self.given = [(f, draw_drive(f, sides, self.period, self.rng)) for f in given]
        self.kept = [(f, draw_drive(f, sides, self.period, self.rng)) for f in kept]
        self.effects: list[Effect] = [kind_of(name, law)(law, self.plant, self.rng) for name, law in case.effects]
        self.columns = columns(self.plant, case.level)
        self.alone: dict[str, float] = {}
        low, high = TIERS.get(case.tier, (1.0, 1.0))
        wanted = [float(np.exp(self.rng.uniform(np.log(low), np.log(high)))) for _ in self.effects]
        for effect, aim in zip(self.effects, wanted, strict=True):
            self._set(effect, aim)
        self.fit = self._fit(self.effects)

    def _fit(self, effects: list[Effect]) -> BaseFit:
        made = [(v, simulate(self.plant, effects, v, self.period)) for _, v in self.given]
        return base_fit(self.plant, self.columns, made, self.period)

    def _set(self, effect: Effect, wanted: float) -> None:
        def misfit(strength: float) -> float:
            effect.strength = strength
            try:
                return self._fit([effect]).worst
            except IntegrationError:  # so strong that the equations have become too stiff
                return float("inf")

        strength, reached = calibrate(misfit, wanted, effect.first_guess, effect.most)
        effect.strength = strength
        self.alone[effect.name] = round(reached, 3)

    def write(self, folder: Path) -> None:
        """Recordings, then the truth, which says that the folder is whole."""
        noise = {}
        places = [("given", i, f, v) for i, (f, v) in enumerate(self.given)]
        places += [("kept", len(self.given) + i, f, v) for i, (f, v) in enumerate(self.kept)]
        for where, i, family, volts in places:
            mess = self.case.mess if where == "given" else ()
            warm = "warm" in mess
            before = ([], 0.0)
            if warm:
                levels = FULL_DRIVE * self.rng.uniform(0.3, 0.9, self.plant.sides)
                before = ([round(float(v), 3) for v in levels], round(float(self.rng.uniform(4, 40)), 2))
            readings = simulate(self.plant, self.effects, volts, self.period, before=before)
            times = np.round(np.arange(len(volts)) * self.period, 6)
            stem = f"{i}_{family}"
            path = folder / where / f"{stem}.csv"
            noise[f"{where}/{stem}"] = record(path, self.plant, self.case.level, times, volts, readings, self.rng, mess)
        text = json.dumps(self.truth(noise), indent=1) + "\n"
        part = folder / f"{TRUTH}.part"
        part.write_text(text, encoding="utf-8", newline="\n")
        os.replace(part, folder / TRUTH)

    def truth(self, noise: dict[str, dict[str, float]]) -> dict[str, object]:
        """All there is to know."""
        case, worst = self.case, self.fit.worst
        return {
            "name": case.name,
            "label": case.label,
            "sort": case.sort,
            "kind": case.kind,
            "effects": [e.name for e in self.effects],
            "catalogue": all(e.catalogue for e in self.effects),
            "subsystems": [e.subsystem for e in self.effects],
            "noise": case.level,
            "tier": tier_of(worst, self.alone) if self.effects else "none",
            "misfit": round(worst, 3),
            "misfit_by_column": {k: round(v, 3) for k, v in self.fit.misfit.items()},
            "misfit_alone": self.alone,
            "mess": list(case.mess),
            "seed": case.seed,
            "subset": case.subset,
            "plant": asdict(self.plant),
            "strengths": {e.name: e.truth() for e in self.effects},
            "files": {k: {"noise": v} for k, v in noise.items()},
        }


def tier_of(misfit: float, alone: dict[str, float]) -> str:
    """Strength as reached: that of the weakest effect alone, where there are several."""
    least = min([misfit, *alone.values()])
    if least < SEEN:
        return "unseen"
    return "weak" if least < 3.0 else "moderate" if least < 8.5 else "strong"


def make(case: Case, out: Path) -> Path:
    """The folder of a case, made unless it is there and whole."""
    folder = out / case.name
    if not (folder / TRUTH).exists():
        Maker(case).write(folder)
    return folder
