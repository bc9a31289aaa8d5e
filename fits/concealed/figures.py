"""Figures of the page: confusion matrix, kept files by method, calibration. Each gives its path within the folder."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path

import matplotlib

matplotlib.use("Agg")
import numpy as np
from matplotlib import pyplot as plt
from matplotlib.figure import Figure

from fits.concealed.score import Score
from fits.concealed.tally import by_method, calibration, confusion

INK, RIGHT, WRONG = "0.25", "tab:blue", "tab:red"
SHOWN = 30.0  # kept-file errors beyond this are drawn at it


def _save(figure: Figure, folder: Path, name: str) -> str:
    figure.savefig(folder / f"{name}.svg", metadata={"Date": None})
    figure.savefig(folder / f"{name}.png", dpi=130)
    plt.close(figure)
    return f"{folder.name}/{name}.svg"


def draw_confusion(scores: Sequence[Score], folder: Path) -> str:
    """Concealed against named, singles, nulls and those outside the catalogue."""
    effects, said, counts = confusion(scores)
    if not effects:
        effects, said, counts = ["nothing"], ["nothing"], np.zeros((1, 1), int)
    size = (2.8 + 0.34 * len(said), 1.9 + 0.27 * len(effects))
    figure, axis = plt.subplots(figsize=size, layout="constrained")
    share = counts / np.maximum(counts.sum(axis=1, keepdims=True), 1)
    right = np.array([[_fine(e, s, scores) for s in said] for e in effects])
    axis.imshow(np.where(right, share, np.nan), cmap="Blues", vmin=0, vmax=1.4, aspect="auto")
    axis.imshow(np.where(right | (counts == 0), np.nan, share), cmap="Reds", vmin=0, vmax=1.4, aspect="auto")
    for (i, j), n in np.ndenumerate(counts):
        if n:
            ink = "white" if share[i, j] > 0.7 else INK
            axis.text(j, i, str(n), ha="center", va="center", fontsize=8, color=ink)
    axis.set_xticks(range(len(said)), [s.replace("_", " ") for s in said], rotation=60, ha="right", fontsize=8)
    axis.set_yticks(range(len(effects)), [e.replace("_", " ") for e in effects], fontsize=8)
    axis.set(xlabel="named", ylabel="concealed")
    axis.tick_params(length=0)
    for side in axis.spines.values():
        side.set_visible(False)
    return _save(figure, folder, "confusion")


def _fine(effect: str, said: str, scores: Sequence[Score]) -> bool:
    outside = any(s.sort == "outside" and s.effects == [effect] for s in scores)
    return effect == said or (outside and said == "something unnamed")


def draw_kept(scores: Sequence[Score], others: Mapping[str, Mapping[str, float]], folder: Path) -> str:
    """Every case that all methods were given a dot; one row of dots per method."""
    methods, common = by_method(scores, others)
    figure, axis = plt.subplots(figsize=(7, 3.2), layout="constrained")
    rng = np.random.default_rng(0)
    for i, errors in enumerate(methods.values()):
        x = np.array([errors[n] for n in sorted(common) if n in errors])
        if not len(x):
            continue
        spread = i + rng.uniform(-0.22, 0.22, len(x))
        axis.plot(np.minimum(x, SHOWN), spread, ".", ms=4, alpha=0.5, color=RIGHT if i == 1 else "0.5")
        middle = float(np.sort(x)[(len(x) - 1) // 2])
        axis.plot([min(middle, SHOWN)] * 2, [i - 0.34, i + 0.34], color=INK, lw=1.6)
    axis.axvline(1.15, color=INK, ls=":", lw=1)
    ticks = [1, 2, 5, 10, SHOWN]
    label = f"RMSE on kept files over noise, {len(common)} cases that all were given (line: median; dots: 1.15)"
    axis.set(xscale="log", xlim=(0.9, SHOWN * 1.08), xlabel=label)
    axis.set_xticks(ticks, [f"{t:g}" for t in ticks[:-1]] + [f"≥ {SHOWN:g}"])
    axis.minorticks_off()
    axis.set_yticks(range(len(methods)), list(methods))
    axis.invert_yaxis()
    return _save(figure, folder, "kept")


def draw_calibration(scores: Sequence[Score], folder: Path) -> str:
    """Share of names that were right against the probability they were given with."""
    figure, axis = plt.subplots(figsize=(3.8, 3.6), layout="constrained")
    axis.plot([0, 1], [0, 1], color="0.7", lw=1)
    axis.fill_between([0, 1], [-0.05, 0.95], [0.05, 1.05], color="0.93", lw=0)
    tried = calibration((p for s in scores for p in s.ranked), tuple(np.linspace(0, 1, 11)))[0]
    named = calibration(p for s in scores for p in s.believed)[0]
    for bins, colour, label in ((tried, "0.5", "every name tried"), (named, RIGHT, "names given")):
        axis.plot([b.believed for b in bins], [b.right for b in bins], "o-", ms=4, lw=1, color=colour, label=label)
        for b in bins:
            axis.annotate(str(b.number), (b.believed, b.right), textcoords="offset points", xytext=(4, -9), fontsize=6)
    axis.set(xlim=(-0.03, 1.03), ylim=(-0.03, 1.03), xlabel="probability said", ylabel="share that was right")
    axis.legend(frameon=False, fontsize=8, loc="lower left", bbox_to_anchor=(0, 1), ncols=2)
    return _save(figure, folder, "calibration")
