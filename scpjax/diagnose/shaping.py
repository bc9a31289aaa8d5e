"""The search for the drive that best separates hypotheses: shaped by a gradient, within limits that are verified."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy.optimize import minimize

from scpjax.diagnose.heat import doubt, played
from scpjax.diagnose.profiles import Frame
from scpjax.diagnose.separation import Scene, Separated, separate, slope
from scpjax.errors import FitError
from scpjax.recordings.recording import Channel, Metadata, Recording

_STEPS = 25  # of the search from each start
_WEIGHT = 1e5  # of the mean squared excess of temperature or travel, as a share of what may be, against ln(separation)


@dataclass(frozen=True)
class Search:
    """A scene with its limits."""

    scene: Scene
    frame: Frame
    allowed: tuple[float, ...]  # K above ambient, by rival; inf: not limited
    told: bool  # whether the limit on temperature was told: estimates then keep away from it by what they may be off
    channels: tuple[Channel, ...]
    near: np.ndarray  # (2, y) [noise], between which predictions stay
    substeps: int = 1  # of a sample, where it is simulated by itself

    def at(self, nodes: np.ndarray, before: Separated | None = None, steps: int = 60) -> Separated:
        """Separations with nodes (n, sides) as they are played."""
        return separate(self.scene, self.frame.played(nodes), before, steps=steps)

    def exactly(self, drive: np.ndarray) -> Separated:
        """Separations with a drive (n, sides), imitations come to rest from the present estimates."""
        return separate(self.scene, drive, steps=120, tolerance=1e-8)

    def within(self, said: np.ndarray, hot: np.ndarray | float, most: float) -> bool:
        """Whether predictions (n, y) [noise] stay near what was seen and temperatures [K] below the ``most``; nothing
        that blows up does.
        """
        inside = np.isfinite(said) & (said >= self.near[0]) & (said <= self.near[1])
        return bool(np.all(inside) and np.all(hot <= most))

    def keeps(self, drive: np.ndarray) -> bool:
        """Whether all hypotheses stay within with a drive (n, sides), also by what their parameters leave open."""
        for i, (r, most) in enumerate(zip(self.scene.rivals, self.allowed, strict=True)):
            said, hot, _, hot_slope = self.scene.said(i, r.centre, drive)
            if not self.within(said, hot, most - (doubt(r, hot_slope) if self.told else 0.0)):
                return False
        return True

    def cooled(self, nodes: np.ndarray) -> np.ndarray:
        """Nodes drawn towards the coolest drive until every hypothesis stays within."""
        drawn = lambda share: self.frame.coolest + share * (nodes - self.frame.coolest)  # noqa: E731
        keeps = lambda share: self.keeps(self.frame.played(drawn(share)))  # noqa: E731
        if keeps(1.0):
            return nodes
        low, high = 0.0, 1.0
        for _ in range(10):
            middle = (low + high) / 2
            low, high = (middle, high) if keeps(middle) else (low, middle)
        return drawn(low)

    def shaped(self, start: np.ndarray) -> np.ndarray:
        """Levels (as nodes) from which no small change separates better, from nodes to start with."""
        f = self.frame
        margin = self._doubts(start)
        memory: list[Separated] = []

        def merit(x: np.ndarray) -> tuple[float, np.ndarray]:
            nodes = f.spread(f.low + (f.high - f.low) * x.reshape(f.levels, f.sides))
            s = self.at(nodes, memory[0] if memory else None)
            least = s.smooth[0]
            if s.unpredictable or not np.isfinite(least):
                return 1e3, np.zeros_like(x)
            memory[:] = [s]
            penalty, by_hot, by_said = self._penalty(s, margin)
            by = f.played_slope(nodes, slope(self.scene, s, by_hot, by_said))
            return penalty - float(np.log(least)), -(f.high - f.low) * f.gathered(by).ravel()

        x0 = (f.gathered(start, mean=True) - f.low) / (f.high - f.low)
        bounds = [(0.0, 1.0)] * x0.size
        found = minimize(
            merit, x0.ravel().clip(0, 1), jac=True, bounds=bounds, method="L-BFGS-B", options={"maxfun": _STEPS}
        )
        return f.spread(f.low + (f.high - f.low) * found.x.reshape(f.levels, f.sides))

    def _penalty(self, s: Separated, margin: Sequence[float]) -> tuple[float, list[np.ndarray], list[np.ndarray]]:
        """On what is too hot, by a ``margin`` [K] by rival, or goes too far; less its derivative by temperatures and by
        predictions.
        """
        hot = [_beyond(h, -np.inf, most - off, most) for h, most, off in zip(s.hot, self.allowed, margin, strict=True)]
        low, high = self.near
        far = [_beyond(y, low, high, high - low) for y in s.said]
        return sum(p for p, _ in hot + far), [by for _, by in hot], [by for _, by in far]

    def _doubts(self, nodes: np.ndarray) -> list[float]:
        """By rival, how much hotter [K] than it expects nodes may become."""
        if not self.told:
            return [0.0 for _ in self.allowed]
        drive, rivals = self.frame.played(nodes), self.scene.rivals
        return [doubt(r, self.scene.said(i, r.centre, drive)[3]) for i, r in enumerate(rivals)]

    def written(self, nodes: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Every sample (count, sides) of nodes as the rig plays it, and its mean over each node."""
        samples = self.frame.samples(nodes)
        return samples, self.means(samples)

    def means(self, samples: np.ndarray) -> np.ndarray:
        """Mean of samples (count, sides) over each node."""
        f = self.frame
        padded = np.concatenate([samples, np.repeat(samples[-1:], f.n * f.every - f.count, axis=0)])
        return padded.reshape(f.n, f.every, -1).mean(axis=1)

    def verified(self, samples: np.ndarray) -> np.ndarray:
        """The samples, or cooler ones, with which every hypothesis stays within by an independent simulation.

        **Raises** `FitError` when even the coolest drive is too hot, or takes one too far.
        """
        margin = self._doubts(self.means(samples))
        coolest, drive, cold = self.frame.coolest, samples, True
        for k in range(60):
            cold, near = True, True
            for r, most, off in zip(self.scene.rivals, self.allowed, margin, strict=True):
                outputs, hot = played(r, self.recording(drive), substeps=self.substeps)
                cold &= not hot > most - off
                near &= not np.isnan(hot) and self.within(outputs * self.scene.weights, -np.inf, most)
            if cold and near:
                return drive
            drive = self.frame.samples_of(coolest + 0.98 ** (k + 1) * (samples - coolest))
        if cold:
            raise FitError(
                "no drive within its limits keeps what hypotheses predict near what was recorded",
                mend="give a lower greatest drive, or record such a drive first",
            )
        raise FitError(
            "no drive within its limits stays below the limit on temperature",
            mend="allow a lower least drive or a higher temperature",
        )

    def recording(self, samples: np.ndarray) -> Recording:
        """The profile (count, sides) as a recording without outputs."""
        f = self.frame
        drive = {c.column: c.unit.from_si(samples[:, i]) for i, c in enumerate(self.channels)}
        meta = Metadata(name="next_experiment", supply_V=self.scene.rivals[0].supply)
        return Recording.from_arrays(f.period * np.arange(f.count), drive, {}, metadata=meta, require_outputs=False)


def _beyond(
    value: np.ndarray, least: np.ndarray | float, most: np.ndarray | float, scale: np.ndarray | float
) -> tuple[float, np.ndarray]:
    """Penalty on what lies beyond limits, as a share of a scale (inf: not limited), and less its derivative."""
    scale = np.where(np.isfinite(scale) & (scale > 0), scale, np.inf)
    over = (np.maximum(value - most, 0.0) + np.minimum(value - least, 0.0)) / scale
    return _WEIGHT * float(np.mean(over**2)), -2 * _WEIGHT * over / over.size / scale
