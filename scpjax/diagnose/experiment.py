"""The next experiment: the drive profile, within the limits of the rig, that best separates hypotheses.

The least expected separation (`scpjax.diagnose.separation`) is maximised by its gradient through the simulator over
the levels of a profile, from the best standard excitations; what is proposed is never worse than those. The limit on
temperature is a penalty while searching and is verified at the end by a simulation of another order on every sample.
To measure where predictions differ most: Hunter, Reiner, Technometrics 7 (1965) 307; Box, Hill, Technometrics 9 (1967)
57; after the false hypothesis was fitted anew: Atkinson, Fedorov, Biometrika 62 (1975) 57.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
from scipy.optimize import minimize

from scpjax.diagnose.heat import allowed, doubt, limit, played
from scpjax.diagnose.hypothesis import State, residual_on
from scpjax.diagnose.profiles import Frame, Limits, again, frame, standards
from scpjax.diagnose.proposal import NextExperiment
from scpjax.diagnose.separation import Scene, Separated, noise_weights, rival, separate, slope
from scpjax.errors import FitError
from scpjax.fit.data import Data, columns
from scpjax.fit.fit import refine
from scpjax.fit.setup import Setup
from scpjax.recordings.recording import Channel, Metadata, Recording

_STARTS = 3  # standard excitations from which the search goes on
_STEPS = 25  # of the search from each
_WEIGHT = 1e5  # of the mean squared excess of temperature, as a share of what is allowed, against ln(separation)
_LEAST_BITS = 1.0  # expected, below which an experiment is not worth its while
_FINEST = 20  # nodes in a response time, at least

Tell = Callable[[str], None]


@dataclass(frozen=True)
class _Search:
    """A scene with its limits."""

    scene: Scene
    frame: Frame
    allowed: tuple[float, ...]  # K above ambient, by rival; inf: not limited
    told: bool  # whether the limit on temperature was told: estimates then keep away from it by what they may be off
    channels: tuple[Channel, ...]

    def at(self, nodes: np.ndarray, before: Separated | None = None, steps: int = 60) -> Separated:
        """Separations with nodes (n, sides) as they are played."""
        return separate(self.scene, self.frame.played(nodes), before, steps=steps)

    def exactly(self, drive: np.ndarray) -> Separated:
        """Separations with a drive (n, sides), imitations come to rest from the present estimates."""
        return separate(self.scene, drive, steps=120, tolerance=1e-8)

    def limits_of(self, drive: np.ndarray) -> tuple[np.ndarray, ...]:
        """By rival, what is left (n, sides) [K] of the temperature allowed; less what its parameters leave open."""
        out = []
        for i, (r, most) in enumerate(zip(self.scene.rivals, self.allowed, strict=True)):
            _, hot, _, hot_slope = self.scene.said(i, r.centre, drive)
            out.append(most - (doubt(r, hot_slope) if self.told else 0.0) - hot)
        return tuple(out)

    def cooled(self, nodes: np.ndarray) -> np.ndarray:
        """Nodes drawn towards the coolest drive until no hypothesis expects to be hotter than allowed."""
        drawn = lambda share: self.frame.coolest + share * (nodes - self.frame.coolest)  # noqa: E731
        cool = lambda share: all(np.min(x) >= 0 for x in self.limits_of(self.frame.played(drawn(share))))  # noqa: E731
        if not np.any(np.isfinite(self.allowed)) or cool(1.0):
            return nodes
        low, high = 0.0, 1.0
        for _ in range(10):
            middle = (low + high) / 2
            low, high = (middle, high) if cool(middle) else (low, middle)
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
            if not np.isfinite(least):
                return 1e3, np.zeros_like(x)
            memory[:] = [s]
            penalty, by_hot = 0.0, []
            for hot, most, off in zip(s.hot, self.allowed, margin, strict=True):
                over = np.maximum(hot - (most - off), 0.0) / most if np.isfinite(most) else np.zeros_like(hot)
                penalty += _WEIGHT * float(np.mean(over**2))
                by_hot.append(-2 * _WEIGHT * over / over.size / (most if np.isfinite(most) else 1.0))
            by = f.played_slope(nodes, slope(self.scene, s, by_hot))
            return penalty - float(np.log(least)), -(f.high - f.low) * f.gathered(by).ravel()

        x0 = (f.gathered(start, mean=True) - f.low) / (f.high - f.low)
        bounds = [(0.0, 1.0)] * x0.size
        found = minimize(
            merit, x0.ravel().clip(0, 1), jac=True, bounds=bounds, method="L-BFGS-B", options={"maxfun": _STEPS}
        )
        return f.spread(f.low + (f.high - f.low) * found.x.reshape(f.levels, f.sides))

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
        """The samples, or cooler ones, with which no hypothesis is hotter than allowed by an independent simulation.

        **Raises** `FitError` when even the coolest drive is too hot.
        """
        if not np.any(np.isfinite(self.allowed)):
            return samples
        margin = self._doubts(self.means(samples))
        coolest, drive = self.frame.coolest, samples
        for k in range(60):
            hot = [played(r, self.recording(drive))[1] for r in self.scene.rivals]
            if all(h <= most - off for h, most, off in zip(hot, self.allowed, margin, strict=True)):
                return drive
            drive = self.frame.samples_of(coolest + 0.98 ** (k + 1) * (samples - coolest))
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


def propose(
    candidates: Sequence[State],
    data: Data,
    *,
    labels: Sequence[str],
    limits: Limits | None = None,
    tell: Tell | None = None,
) -> NextExperiment | None:
    """The experiment that best separates the first of the ``candidates`` from the others.

    All are fitted to ``data`` (all present recordings) first; ``labels`` name them. None when the best experiment
    within the ``limits`` is expected to bring less than one bit: they cannot be told apart there.

    **Raises** `FitError` for limits that leave no experiment.
    """
    began, tell = time.monotonic(), tell or (lambda text: None)
    if len(candidates) < 2:
        raise FitError("one hypothesis cannot be separated from itself", mend="give two or more")
    states = [_refitted(s, data) for s in candidates]
    search = _search(states, data, limits or Limits(), labels)
    f, setup = search.frame, states[0].setup
    tell("trying standard excitations")
    usual = {k: search.cooled(u) for k, u in standards(f, setup.scales.response).items()}
    found = {k: search.at(u, steps=20) for k, u in usual.items()}
    order = sorted(found, key=lambda k: -found[k].least)
    kinds = {k: usual[k] for k in order[:1]}
    for k in order[:_STARTS]:
        tell(f"shaping the drive from: {k}")
        kinds[f"shaped from: {k}"] = search.cooled(search.shaped(usual[k]))
    nodes = {k: search.written(u) for k, u in kinds.items()}
    scored = {k: search.exactly(mean) for k, (_, mean) in nodes.items()}
    best = max(scored, key=lambda k: scored[k].least)
    longest = max(setup.recordings, key=lambda r: r.duration)
    repeat = search.exactly(again(f, longest, _order(setup)))
    samples = nodes[best][0]
    played_ = search.verified(samples)
    if played_ is not samples:  # the finer simulation was hotter
        scored[best] = search.exactly(search.means(played_))
    if scored[best].least < _LEAST_BITS * np.log(2):
        return None
    return _result(search, setup, played_, scored[best], (order[0], scored[order[0]]), repeat, time.monotonic() - began)


def _refitted(state: State, data: Data) -> State:
    trial, _, cost = refine(state.setup, data, state.trial, max_steps=20)
    return State(state.setup, trial, residual_on(trial, data, state.setup), cost)


def _order(setup: Setup) -> tuple[int, ...]:
    """Drive column of each side."""
    stems = [c.stem for c in setup.recordings[0].input_channels]
    sides = setup.structure.sides
    if len(sides) == 1:
        return (0,)
    return tuple(next(i for i, stem in enumerate(stems) if stem.endswith(f"_{side}")) for side in sides)


def check_limits(limits: Limits, setup: Setup) -> None:
    """Whether limits leave an experiment, as far as that can be said before anything is named.

    **Raises** `FitError` where they do not.
    """
    _framed(limits, setup)
    if limits.hottest is not None:
        limit(setup, limits.hottest)


def _framed(limits: Limits, setup: Setup) -> tuple[Frame, tuple[Channel, ...]]:
    channels = tuple(setup.recordings[0].input_channels[i] for i in _order(setup))
    return frame(limits, setup.recordings, channels, setup.scales.response / _FINEST), channels


def _search(states: Sequence[State], data: Data, limits: Limits, labels: Sequence[str]) -> _Search:
    setup = states[0].setup
    best = min(states, key=lambda s: float(np.sum(s.residual**2)))
    weights = noise_weights(best, data)
    f, channels = _framed(limits, setup)
    rivals = tuple(rival(s, data, weights, label) for s, label in zip(states, labels, strict=True))
    scene = Scene(rivals, weights * np.sqrt(f.every), f.step)
    return _Search(scene, f, allowed(states, data, limits.hottest), limits.hottest is not None, channels)


def _result(
    search: _Search,
    setup: Setup,
    samples: np.ndarray,
    found: Separated,
    standard: tuple[str, Separated],
    repeat: Separated,
    seconds: float,
) -> NextExperiment:
    scene, f = search.scene, search.frame
    labels = [r.label for r in scene.rivals]
    seen = {j: c for r in reversed(setup.recordings) for j, c in _channels(setup, r).items()}
    ambient = float(scene.rivals[0].ambient)
    expected = {r.label: played(r, search.recording(samples)) for r in scene.rivals}
    bits = {(labels[i], labels[j]): s.nats / np.log(2) for (i, j), s in found.imitations.items()}
    left = {
        (labels[i], labels[j]): {c.column: s.off[:, k] / scene.weights[k] / c.unit.scale for k, c in seen.items()}
        for (i, j), s in found.imitations.items()
    }
    thermal = setup.structure.thermal
    bits_of = lambda s: float(s.least / np.log(2))  # noqa: E731
    return NextExperiment(
        separates=tuple(labels),
        says=_words(labels, search, bits_of(found), bits_of(repeat)),
        drive_columns=tuple(c.column for c in search.channels),
        time=f.period * np.arange(f.count),
        drive=np.stack([c.unit.from_si(samples[:, i]) for i, c in enumerate(search.channels)], axis=1),
        expected_bits=bits_of(found),
        pair_bits=bits,
        repeat_bits=bits_of(repeat),
        standard=standard[0],
        standard_bits=bits_of(standard[1]),
        hottest={k: ambient + hot for k, (_, hot) in expected.items()} if thermal else {},
        hottest_allowed={k: ambient + a for k, a in zip(labels, search.allowed, strict=True)} if thermal else {},
        predicted={
            k: {c.column: np.asarray(c.unit.from_si(y[:, j])) for j, c in seen.items()}
            for k, (y, _) in expected.items()
        },
        left_time=f.step * np.arange(f.n),
        left=left,
        noise={c.column: np.sqrt(f.every) / scene.weights[j] / c.unit.scale for j, c in seen.items()},
        seconds=seconds,
    )


def _channels(setup: Setup, r: Recording) -> dict[int, Channel]:
    """Recorded column of each output of the model."""
    return {j: next(c for c in r.output_channels if c.stem == stem) for j, stem in columns(setup.structure, r)}


def _words(labels: Sequence[str], search: _Search, bits: float, repeat: float) -> str:
    f = search.frame
    unit = search.channels[0].unit
    ends = f"{unit.from_si(f.low):g} to {unit.from_si(f.high):g} {unit.suffix}"
    return (
        f"Play next_experiment.csv ({f.count * f.period:.3g} s, {ends}) and diagnose it together with the present "
        f"recordings: it is expected to tell {labels[0]} from {' and from '.join(labels[1:])} by {bits:.3g} bits; the "
        f"present drive once more would by {repeat:.3g}."
    )
