"""Predicted against measured: scores, where they part, and a page."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import jax
import numpy as np

from scpjax.bench.play import Followed
from scpjax.control.controller import Controller
from scpjax.control.loop import Loop, run
from scpjax.control.plant import Plant, check_dead_times
from scpjax.fit.metrics import mae, nrmse, rmse
from scpjax.fit.noise import noise_floor
from scpjax.fit.predict import predict
from scpjax.physics.model import Model
from scpjax.recordings.recording import Recording
from scpjax.report import page, plot
from scpjax.report.numbers import column, number

_NOISES = 1.5  # an error up to so many standard deviations of the noise is none
_SHARE = 0.015  # nor one up to this share of the signal's range
_WINDOWS = 12


@dataclass(frozen=True)
class Compared:
    """One column: ``measured`` and ``predicted`` (n,) in the file's unit, their scores and the noise.

    ``windows``: start, end [s] and share of all squared misfit of the stretches where it is largest.
    """

    column: str
    time: np.ndarray
    measured: np.ndarray
    predicted: np.ndarray
    noise: float
    rmse: float
    nrmse: float
    mae: float
    windows: tuple[tuple[float, float, float], ...]

    @property
    def parts(self) -> bool:
        """Whether prediction and measurement part: by more than the noise, and than 1.5 % of the range."""
        return self.rmse > max(_NOISES * self.noise, _SHARE * float(np.ptp(self.measured)))

    @property
    def says(self) -> str:
        """One line."""
        words, unit = column(self.column)
        noise = f"noise {number(self.noise, 2)} {unit}"
        text = f"{words}: RMSE {number(self.rmse)} {unit} ({noise}), NRMSE {number(self.nrmse)} %"
        if not self.parts:
            return f"{text}: agrees"
        where = ", ".join(f"{a:.0f} to {b:.0f} s ({100 * s:.0f} %)" for a, b, s in self.windows)
        return f"{text}: parts, most at {where}"

    def to_json(self) -> dict[str, Any]:
        """Plain values."""
        return {
            "rmse": self.rmse,
            "nrmse": self.nrmse,
            "mae": self.mae,
            "noise": self.noise,
            "parts": self.parts,
            "windows": [{"start_s": a, "end_s": b, "share": s} for a, b, s in self.windows],
        }


def compared(name: str, time: np.ndarray, measured: np.ndarray, predicted: np.ndarray, noise: float) -> Compared:
    """Scores of a column."""
    off = (measured - predicted) ** 2
    pieces = np.array_split(np.arange(len(time)), min(_WINDOWS, len(time)))
    total = max(float(off.sum()), 1e-300)
    shares = [(float(time[p[0]]), float(time[p[-1]]), float(off[p].sum()) / total) for p in pieces]
    worst = tuple(sorted(sorted(shares, key=lambda w: -w[2])[:3]))
    scores = (rmse(predicted, measured), nrmse(predicted, measured), mae(predicted, measured))
    return Compared(name, time, measured, predicted, noise, *scores, worst)


def open_loop(model: Model, recording: Recording, extra: Mapping[str, Any] | None = None) -> list[Compared]:
    """A model's prediction of a recording it never saw, column by column."""
    extra = extra or {}
    time, said = predict(model, recording, noise=extra.get("noise"), rooms=tuple(extra.get("rooms_K", ())))
    out = []
    for i, channel in enumerate(recording.output_channels):
        if channel.column in said:
            values = np.asarray(channel.unit.from_si(recording.outputs[:, i]))
            there = recording.weights[:, i] > 0
            noise = noise_floor(values[there])
            found = np.asarray(said[channel.column])
            out.append(compared(channel.column, time[there], values[there], found[there], noise))
    return out


def closed_loop(plant: Plant, controller: Controller, followed: Followed) -> Compared:
    """The angle that a pure simulation of the loop says, beside the one that was measured."""
    dt = float(followed.time[1] - followed.time[0])
    check_dead_times(plant, dt)
    said = jax.jit(lambda loop, r: run(loop, r, dt=dt))(Loop(plant, controller), followed.reference)
    there = np.isfinite(followed.angle)
    measured, simulated = np.degrees(followed.angle)[there], np.degrees(np.asarray(said.angle))[there]
    return compared("angle_deg", followed.time[there], measured, simulated, noise_floor(measured))


def tracking(plant: Plant, controller: Controller, followed: Followed) -> tuple[float, float]:
    """Tracking RMSE [rad] measured and in pure simulation."""
    dt = float(followed.time[1] - followed.time[0])
    said = jax.jit(lambda loop, r: run(loop, r, dt=dt))(Loop(plant, controller), followed.reference)
    return followed.rmse, float(np.sqrt(np.mean(np.asarray(said.error) ** 2)))


def write_page(folder: Path, title: str, sections: Mapping[str, Sequence[Compared]], says: Sequence[str]) -> Path:
    """A page of the comparisons with a figure for each. Writes report.html."""
    body = [page.section("Does the model predict what was measured?", page.bullets(list(says)))]
    for name, found in sections.items():
        if not found:
            continue
        figure = plot.new_figure(8.6, 2.4 * len(found) + 0.4)
        axes = np.atleast_1d(figure.subplots(len(found), 1, sharex=True))
        for axis, c in zip(axes, found, strict=True):
            words, unit = column(c.column)
            axis.plot(c.time, c.measured, color=plot.MEASURED, lw=1.0, label="measured")
            axis.plot(c.time, c.predicted, color=plot.EXTENDED, lw=1.2, label="predicted")
            axis.set_ylabel(f"{words} ({unit})")
            plot.style(axis)
        axes[0].legend(loc="upper right", ncols=2, frameon=False, fontsize=8)
        axes[-1].set_xlabel("time (s)")
        figure.tight_layout()
        caption = f"{name}: measured and predicted. " + " ".join(f"{c.says}." for c in found)
        body.append(page.section(name, page.figure(plot.png(figure), caption)))
    path = folder / "report.html"
    path.write_text(page.page(title, body), encoding="utf-8")
    return path
