"""Where model and recordings part: at which sensor, when, in which regime, and depending on what."""

from __future__ import annotations

import itertools
from collections.abc import Sequence
from dataclasses import dataclass, field, replace

import numpy as np

from scpjax.diagnose.residual import independence, whiteness
from scpjax.diagnose.result import Latent, Location, Window
from scpjax.fit.data import Data
from scpjax.fit.problem import Trial
from scpjax.fit.setup import Setup, names_of
from scpjax.fit.solve import outputs_of


@dataclass(frozen=True)
class Binned:
    """Residuals in standard deviations (r, k, y), where there are any, and what the states were meanwhile (r, k)."""

    residual: np.ndarray
    there: np.ndarray
    time: np.ndarray  # s from the start of each recording, (r, k)
    drive: np.ndarray
    temperature: np.ndarray | None
    displacement: np.ndarray | None
    velocity: np.ndarray | None
    own: dict[str, np.ndarray] = field(default_factory=dict)  # outputs of a base of the user's own, by stem
    sides: dict[str, tuple[np.ndarray | None, np.ndarray]] = field(default_factory=dict)
    """Of a joint: temperature and drive of each side. ``drive`` is that of the agonist beyond the antagonist's, which
    moves it, and ``temperature`` the agonist's."""

    def on(self, name: str) -> Binned:
        """As it is for the side that a place or a column is of."""
        own = next((own for side, own in self.sides.items() if f"_{side}" in name), None)
        return self if own is None else replace(self, temperature=own[0], drive=own[1])


def observe(setup: Setup, data: Data, trial: Trial, residual: np.ndarray) -> Binned:
    """Bin means of what the model simulates beside the residuals; of a motion of which nothing was recorded, none."""
    outputs = np.asarray(outputs_of(trial, data, setup.space))
    r, k, _ = residual.shape
    at = np.asarray(data.grids.at)

    def mean(values: np.ndarray) -> np.ndarray:
        out, count = np.zeros((r, k)), np.zeros((r, k))
        for i in range(r):
            bins = np.minimum(at[i] // data.bin, k - 1)
            n = setup.recordings[i].n
            np.add.at(out[i], bins[:n], values[i, :n])
            np.add.at(count[i], bins[:n], 1)
        return out / np.maximum(count, 1)

    efforts = np.asarray(data.grids.effort)[:, :, 1, :]
    drives = [efforts[..., i].reshape(r, k, data.bin).mean(axis=2) for i in range(efforts.shape[-1])]
    step = np.asarray(data.grids.step)[:, None]
    time = (np.arange(k) + 0.5)[None] * data.bin * step
    there = np.isfinite(np.asarray(data.norm))
    s = setup.structure
    room = np.asarray(data.ambient)[:, None]
    warm = [mean(outputs[..., i] - room) if s.thermal else None for i in range(len(s.sides))]
    moved = mean(outputs[..., -1]) if s.mechanical and there[..., -1].any() else None
    speed = None if moved is None else np.gradient(moved, axis=1) / (data.bin * step)
    own = {stem: mean(outputs[..., j]) for j, stem in enumerate(s.outputs)} if s.system else {}
    drive, sides = drives[0], {}
    if len(drives) > 1:
        drive, sides = drives[0] - drives[1], dict(zip(s.sides, zip(warm, drives, strict=True), strict=True))
    return Binned(residual, there, time, drive, warm[0], moved, speed, own, sides)


def locate(setup: Setup, b: Binned, subsystem: str, lacking: Sequence[Latent] = ()) -> Location:
    """Location of the misfit in excess of the noise. ``subsystem`` is the balance that evidence points to.

    What it depends on is read off the missing power, force or reading there, which does not lag behind its cause.
    """
    excess = np.where(b.there, b.residual**2, 0.0)
    per_output = np.sum(excess - b.there, axis=(0, 1))
    recorded = b.there.any(axis=(0, 1))  # what was not has no misfit, and may not pass for the worst where all is well
    worst = int(np.argmax(np.where(recorded, per_output, -np.inf)))
    columns = _column_names(setup)
    return Location(
        subsystem=subsystem,
        column=columns[worst],
        windows=_windows(setup, b, excess[..., worst], b.there[..., worst]),
        regimes=_regimes(b.on(columns[worst]), excess[..., worst], b.there[..., worst]),
        depends_on=_dependence(b.on(columns[worst]), worst, subsystem, lacking),
        whiteness={
            columns[j]: whiteness(b.residual[..., j], b.there[..., j])
            for j in range(len(columns))
            if b.there[..., j].any()
        },
        input_independence={
            columns[j]: independence(b.residual[..., j], b.on(columns[j]).drive, b.there[..., j])
            for j in range(len(columns))
            if b.there[..., j].any()
        },
    )


def _dependence(b: Binned, worst: int, subsystem: str, lacking: Sequence[Latent]) -> tuple[tuple[str, float], ...]:
    return next((latent.depends_on for latent in lacking if latent.subsystem == subsystem), _depends(b, worst))


def _column_names(setup: Setup) -> list[str]:
    from scpjax.fit.fit import _units

    named = _units(setup)
    return [named[j][0] if j in named else stem for j, stem in enumerate(setup.structure.outputs)]


def _windows(
    setup: Setup, b: Binned, excess: np.ndarray, there: np.ndarray, per_recording: int = 12
) -> tuple[Window, ...]:
    """The windows, a twelfth of a recording each, that hold most of the excess; together at least 60 % of it."""
    found = []
    for i in range(excess.shape[0]):
        last = np.flatnonzero(there[i])
        if last.size == 0:
            continue
        edges = np.linspace(0, last[-1] + 1, per_recording + 1).astype(int)
        half_bin = (b.time[i, 1] - b.time[i, 0]) / 2 if b.time.shape[1] > 1 else 0.0
        for a, c in itertools.pairwise(edges):
            if c > a:
                share = excess[i, a:c].sum() - there[i, a:c].sum()
                found.append((max(share, 0.0), i, b.time[i, a] - half_bin, b.time[i, c - 1] + half_bin))
    total = sum(f[0] for f in found)
    if total <= 0:
        return ()
    found.sort(key=lambda f: -f[0])
    names = names_of(setup.recordings)
    out, so_far = [], 0.0
    for share, i, start, end in found:
        if so_far >= 0.6 * total or len(out) >= 8:
            break
        so_far += share
        start_s = float(setup.recordings[i].time[0])
        out.append(
            Window(
                names[i],
                round(start_s + float(start), 4),
                round(start_s + float(end), 4),
                round(float(share / total), 4),
            )
        )
    return tuple(out)


def _regimes(b: Binned, excess: np.ndarray, there: np.ndarray) -> dict[str, float]:
    """Share of the excess misfit in each regime, by what the base model's main state does."""
    main = next((m for m in (b.temperature, b.displacement, *b.own.values()) if m is not None), None)
    if main is None:
        return {}
    span = np.ptp(main) + 1e-300
    slope = np.gradient(main, axis=1)
    fast = np.abs(slope) > 0.1 * np.quantile(np.abs(slope), 0.95) + 1e-300
    near = np.abs(main - main[:, :1].min()) < 0.05 * span
    width = 5
    sign = np.sign(np.where(fast, slope, 0.0))
    reversal = np.zeros_like(fast)
    for i in range(sign.shape[0]):
        changes = np.flatnonzero(np.diff(sign[i]) != 0)
        for c in changes:
            reversal[i, c + 1 : c + 1 + width] = True
    masks = {
        "reversal": reversal,
        "heating": ~reversal & fast & (slope > 0),
        "cooling": ~reversal & fast & (slope < 0),
        "rest": ~reversal & ~fast & near,
        "steady": ~reversal & ~fast & ~near,
    }
    share = {k: max(float(excess[m & there].sum() - (m & there).sum()), 0.0) for k, m in masks.items()}
    total = sum(share.values())
    return {k: round(v / total, 4) if total > 0 else 0.0 for k, v in share.items()}


def _depends(b: Binned, worst: int) -> tuple[tuple[str, float], ...]:
    """Share of the residual variance that a smooth function of each variable alone explains (correlation ratio)."""
    candidates = {
        "temperature": b.temperature,
        "displacement": b.displacement,
        "velocity": b.velocity,
        "drive": b.drive,
        "time": b.time,
        **b.own,
    }
    if b.temperature is not None:
        candidates["temperature_rate"] = np.gradient(b.temperature, axis=1)
    there = b.there[..., worst]
    e = b.residual[..., worst][there]
    out = []
    for name, values in candidates.items():
        if values is None:
            continue
        v = values[there]
        if np.ptp(v) <= 1e-12 * (np.abs(v).max() + 1e-300):
            continue
        n_groups = 12
        edges = np.unique(np.quantile(v, np.linspace(0, 1, n_groups + 1)[1:-1]))
        group = np.searchsorted(edges, v)
        means = np.array([e[group == g].mean() if np.any(group == g) else 0.0 for g in range(len(edges) + 1)])
        between = np.sum((means[group] - e.mean()) ** 2) / (np.sum((e - e.mean()) ** 2) + 1e-300)
        adjusted = max(between - len(edges) / max(len(e), 1), 0.0)
        out.append((name, round(float(adjusted), 4)))
    return tuple(sorted(out, key=lambda p: -p[1]))
