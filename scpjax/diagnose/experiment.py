"""The next experiment: the drive profile, within the limits of the rig, that best separates hypotheses.

The least expected separation (`scpjax.diagnose.separation`) is maximised by its gradient through the simulator over
the levels of a profile, from the best standard excitations; what is proposed is never worse than those. The limit on
temperature, and how far predictions may go beyond what was seen, are penalties while searching and are verified at the
end by a simulation of another order on every sample. Where a hypothesis cannot be predicted nothing is separated.
To measure where predictions differ most: Hunter, Reiner, Technometrics 7 (1965) 307; Box, Hill, Technometrics 9 (1967)
57; after the false hypothesis was fitted anew: Atkinson, Fedorov, Biometrika 62 (1975) 57.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Sequence

import numpy as np

from scpjax.diagnose.final import resolved
from scpjax.diagnose.heat import allowed, driven_below, limit, played
from scpjax.diagnose.holdout import Split
from scpjax.diagnose.hypothesis import State, residual_on
from scpjax.diagnose.patience import Patience
from scpjax.diagnose.profiles import Frame, Limits, again, frame, near, standards
from scpjax.diagnose.proposal import NextExperiment
from scpjax.diagnose.separation import Rival, Scene, Separated, noise_weights, rival
from scpjax.diagnose.shaping import Search
from scpjax.errors import FitError
from scpjax.fit.data import Data, columns
from scpjax.fit.fit import refine
from scpjax.fit.setup import Setup
from scpjax.recordings.recording import Channel, Recording
from scpjax.simulate.drive import effort, recorded_effort

_STARTS = 3  # standard excitations from which the search goes on
_LEAST_BITS = 1.0  # expected, below which an experiment is not worth its while
_FINEST = 20  # nodes in a response time, at least
_PARTS = 16  # steps between two nodes, at most: a search by more takes too long
_SHORTER = 60.0  # s, after which no still shorter steps are tried for a hypothesis

Tell = Callable[[str], None]


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

    **Raises** `FitError` for limits that leave no experiment, or none that can be predicted.
    """
    began, tell = time.monotonic(), tell or (lambda text: None)
    if len(candidates) < 2:
        raise FitError("one hypothesis cannot be separated from itself", mend="give two or more")
    states, data = _by_short_steps(candidates, data)
    search = _search(states, data, limits or Limits(), labels)
    f, setup = search.frame, states[0].setup
    tell("trying standard excitations")
    usual = {k: search.cooled(u) for k, u in standards(f, setup.scales.response).items()}
    found = {k: search.at(u, steps=20) for k, u in usual.items()}
    order = sorted(found, key=lambda k: -found[k].least)
    _predictable(found[order[0]], labels)
    kinds = {k: usual[k] for k in order[:1]}
    for k in (k for k in order[:_STARTS] if not found[k].unpredictable):
        tell(f"shaping the drive from: {k}")
        kinds[f"shaped from: {k}"] = search.cooled(search.shaped(usual[k]))
    nodes = {k: search.written(u) for k, u in kinds.items()}
    scored = {k: search.exactly(mean) for k, (_, mean) in nodes.items()}
    best = max(scored, key=lambda k: scored[k].least)
    _predictable(scored[best], labels)
    longest = max(setup.recordings, key=lambda r: r.duration)
    repeat = search.exactly(again(f, longest, _order(setup)))
    samples = nodes[best][0]
    played_ = search.verified(samples)
    if played_ is not samples:  # the finer simulation was hotter
        scored[best] = search.exactly(search.means(played_))
    if scored[best].least < _LEAST_BITS * np.log(2):
        return None
    return _result(search, setup, played_, scored[best], (order[0], scored[order[0]]), repeat, time.monotonic() - began)


def _predictable(best: Separated, labels: Sequence[str]) -> None:
    """**Raises** `FitError` where even the best experiment is one in which a hypothesis blows up."""
    if best.unpredictable:
        names = " and ".join(labels[i] for i in best.unpredictable)
        raise FitError(
            f"no experiment within these limits can be predicted: what is expected under {names} blows up",
            mend="give a drive, a duration and a period nearer to those recorded",
        )


def _by_short_steps(candidates: Sequence[State], data: Data) -> tuple[list[State], Data]:
    """Hypotheses fitted to all data, and these by steps as short as any of them asks for."""
    states = list(candidates)
    for i, state in enumerate(states):
        there = np.isfinite(np.asarray(data.norm))
        whole = Split(data, data, there, np.zeros_like(there), np.zeros(data.outputs.shape, bool))
        finer, states[i], _ = resolved(state, whole, Patience(_SHORTER))
        data = finer.whole
    return [_refitted(s, data) for s in states], data


def _steps(setup: Setup, data: Data, span: float, most: float = np.inf) -> int:
    """Steps in a ``span`` [s] that are as short as those in which these data are simulated, where these are shorter
    than samples: elsewhere 1, for a step may be as long as a sample. Not for a drive that bends within a sample alone:
    that of an experiment is held.
    """
    each = np.asarray(data.grids.step)
    bends = 2 if any(r.hold == "band_limited" for r in setup.recordings) else 1
    asked = max(round(r.period / h) for r, h in zip(setup.recordings, each, strict=True)) // bends
    return int(min(np.ceil(span / (float(each.min()) * bends) - 1e-6), most)) if asked > 1 else 1


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
    finest, most = setup.scales.response / _FINEST, driven_below(setup, limits.hottest)
    return frame(limits, setup.recordings, channels, finest, most=most), channels


def _search(states: Sequence[State], data: Data, limits: Limits, labels: Sequence[str]) -> Search:
    setup = states[0].setup
    best = min(states, key=lambda s: float(np.sum(s.residual**2)))
    weights = noise_weights(best, data)
    f, channels = _framed(limits, setup)
    rivals = tuple(rival(s, data, weights, label) for s, label in zip(states, labels, strict=True))
    new = noise_weights(best, data, period=f.period) * np.sqrt(f.every)
    scene = Scene(rivals, new, f.step, _steps(setup, data, f.step, _PARTS))
    hottest = allowed(states, data, limits.hottest)
    more = max(hottest) / setup.scales.temperature if limits.hottest is not None else 1.0
    if not setup.structure.thermal:
        more = _stronger(setup, f, rivals[0])
    around = _near(scene, f, data, more)
    substeps = _steps(setup, data, f.period)
    return Search(scene, f, hottest, limits.hottest is not None, channels, around, substeps)


def _stronger(setup: Setup, f: Frame, r: Rival) -> float:
    """Range of the effort that the limits allow, as a multiple of that recorded, rest included in both."""
    s, ambient = setup.structure, float(r.ambient)
    of = lambda drive: np.asarray(effort(s.drive, np.array(drive), ambient=ambient, supply=r.supply))  # noqa: E731
    seen = np.concatenate([np.asarray(recorded_effort(s, x, ambient=ambient)).ravel() for x in setup.recordings])
    seen = np.append(seen, of(f.coolest))
    return float(np.ptp(np.concatenate([seen, of([f.low, f.high])])) / np.ptp(seen))


def _near(scene: Scene, f: Frame, data: Data, more: float) -> np.ndarray:
    """Between which (2, y) [noise] predictions stay, with ``more`` than was recorded; temperatures of what is heated
    have a limit of their own.
    """
    s, there = scene.rivals[0].structure, np.asarray(data.weights) > 0
    seen = [
        g(np.asarray(data.outputs), axis=(0, 1), where=there, initial=x)
        for g, x in ((np.min, np.inf), (np.max, -np.inf))
    ]
    held = np.full((f.n, f.sides), f.coolest)
    rest = np.stack([scene.said(i, r.centre, held)[0] for i, r in enumerate(scene.rivals)])
    rest = np.where(np.isfinite(rest), rest, 0.0)
    bound = (scene.weights > 0) & (np.arange(len(scene.weights)) >= (len(s.sides) if s.thermal else 0))
    out = np.stack([np.full(len(bound), -np.inf), np.full(len(bound), np.inf)])
    around = np.stack(seen)[:, bound] * scene.weights[bound]
    ends = np.stack([rest.min(axis=(0, 1)), rest.max(axis=(0, 1))])[:, bound]
    out[:, bound] = near(around, ends, more, both_ways=len(s.sides) == 2)
    return out


def _result(
    search: Search,
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
    expected = {r.label: played(r, search.recording(samples), substeps=search.substeps) for r in scene.rivals}
    bits = {(labels[i], labels[j]): s.nats / np.log(2) for (i, j), s in found.imitations.items()}
    left = {
        (labels[i], labels[j]): {c.column: s.off[:, k] / scene.weights[k] / c.unit.scale for k, c in seen.items()}
        for (i, j), s in found.imitations.items()
    }
    thermal = setup.structure.thermal
    bits_of = lambda s: max(float(s.least / np.log(2)), 0.0)  # noqa: E731  # a repetition that blows up brings none
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


def _words(labels: Sequence[str], search: Search, bits: float, repeat: float) -> str:
    f = search.frame
    unit = search.channels[0].unit
    ends = f"{unit.from_si(f.low):g} to {unit.from_si(f.high):g} {unit.suffix}"
    return (
        f"Play next_experiment.csv ({f.count * f.period:.3g} s, {ends}) and diagnose it together with the present "
        f"recordings: it is expected to tell {labels[0]} from {' and from '.join(labels[1:])} by {bits:.3g} bits; the "
        f"present drive once more would by {repeat:.3g}."
    )
