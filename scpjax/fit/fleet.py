"""Many actuators in one compiled call. Ragged fleets are padded with samples and recordings of weight 0."""

from __future__ import annotations

import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np

from scpjax.errors import FitError, ScpjaxError
from scpjax.fit.data import Data
from scpjax.fit.fit import FitOptions, refine, settle, told
from scpjax.fit.problem import Space, Trial
from scpjax.fit.result import Fit
from scpjax.fit.setup import Setup, choose_model, greatest_effort, prepare, structure_for, usual_substeps
from scpjax.fit.solve import pick, solve_fleet, stack
from scpjax.parameter import Bounded
from scpjax.recordings.recording import Recording
from scpjax.simulate.drive import grid_of


@dataclass(frozen=True)
class Fleet:
    """``fits[i]`` is the fit of actuator i, or the sentence that says why there is none. ``seconds`` in all."""

    names: tuple[str, ...]
    fits: tuple[Fit | str, ...]
    seconds: float

    def table(self) -> dict[str, np.ndarray]:
        """Parameter values by key, (actuators,), NaN where a fit failed."""
        keys = dict.fromkeys(k for f in self.fits if isinstance(f, Fit) for k in f.parameters)
        return {
            k: np.array(
                [f.parameters[k].value if isinstance(f, Fit) and k in f.parameters else np.nan for f in self.fits]
            )
            for k in keys
        }


def fit_fleet(
    actuators: Sequence[Sequence[Recording]],
    *,
    names: Sequence[str] | None = None,
    model: str | None = None,
    fixed: Mapping[str, float] | None = None,
    options: FitOptions | None = None,
    chunk: int = 256,
    progress: Callable[[str, float], None] | None = None,
    with_traces: bool = False,
) -> Fleet:
    """Fit every actuator of a fleet, each from its own recordings and starts, ``chunk`` of them in one compiled call.
    Those with wild samples, or whose drive changed in a gap, are then fitted once more without them, one by one.

    An actuator whose recordings cannot be fitted does not stop the others: its place holds the reason.

    **Raises** `FitError` when there is no actuator at all.
    """
    options = options or FitOptions()
    began = time.monotonic()
    if not actuators:
        raise FitError("no actuator to fit", mend="give at least one recording")
    labels = tuple(names or [rs[0].metadata.name if rs else f"actuator {i}" for i, rs in enumerate(actuators)])
    setups, failures = _setups(actuators, model, fixed, options, progress)
    fits: dict[int, Fit | str] = dict(failures)
    groups: dict[object, list[int]] = {}
    for i, s in setups.items():
        groups.setdefault((s.structure, s.data.bin, s.data.order, s.data.grids.constant, s.space.locals), []).append(i)
    for members in groups.values():
        for at in range(0, len(members), chunk):
            part = members[at : at + chunk]
            if progress:
                progress(f"fitting {len(part)} actuators abreast", 0.2 + 0.7 * at / max(len(members), 1))
            fits |= dict(zip(part, _solve([setups[i] for i in part], options, with_traces), strict=True))
    return Fleet(labels, tuple(fits[i] for i in range(len(actuators))), time.monotonic() - began)


def _setups(
    actuators: Sequence[Sequence[Recording]],
    model: str | None,
    fixed: Mapping[str, float] | None,
    options: FitOptions,
    progress: Callable[[str, float], None] | None,
) -> tuple[dict[int, Setup], dict[int, str]]:
    steps = 256
    setups: dict[int, Setup] = {}
    failures: dict[int, str] = {}
    for recordings in actuators:
        fine = options.substeps or usual_substeps(recordings, model)
        steps = max([steps, *(grid_of(r.time, substeps=fine)[1] for r in recordings)])
    steps = 64 * -(-steps // 64)
    bin = options.bin or _common_bin(actuators)
    full = _full_effort(actuators, model)
    for i, recordings in enumerate(actuators):
        if progress:
            progress("reading starts from the data", 0.2 * i / len(actuators))
        try:
            setups[i] = prepare(
                recordings,
                model=model or choose_model(recordings),
                fixed=fixed,
                bin=bin,
                order=options.order,
                substeps=options.substeps,
                prior_strength=options.prior,
                release=options.release,
                pad_to=steps,
                full_effort=full,
            )
        except ScpjaxError as error:
            failures[i] = str(error)
    return setups, failures


def _full_effort(actuators: Sequence[Sequence[Recording]], model: str | None) -> float | None:
    """Greatest effort of any actuator, so that what is known up to the power at full drive can be compared; None where
    none can be fitted, or their drives are not of one kind.
    """
    found: dict[str, float] = {}
    for recordings in actuators:
        try:
            s = structure_for(recordings, model)
            found[s.drive] = max(greatest_effort(recordings, s), found.get(s.drive, 0.0))
        except ScpjaxError:  # `prepare` tells of it
            continue
    return next(iter(found.values())) if len(found) == 1 else None


def _common_bin(actuators: Sequence[Sequence[Recording]]) -> int:
    """Samples per bin for all: about 1000 bins in the longest recording."""
    longest = max((r.n for rs in actuators for r in rs), default=1)
    return 2 ** int(np.floor(np.log2(max(longest / 1000, 1))))


_ABREAST = 64  # actuators in one compiled call: they wait for the slowest among them


def _solve(setups: list[Setup], options: FitOptions, with_traces: bool) -> list[Fit | str]:
    began = time.monotonic()
    r = max(len(s.recordings) for s in setups)
    padded = [_pad(s, r) for s in setups]
    width, lanes = _widths(padded)
    data = jax.tree.map(lambda *leaves: jnp.stack(leaves), *[s.data for s in padded])
    spaces = jax.tree.map(lambda *leaves: jnp.stack(leaves), *[s.space for s in padded])
    n = len(padded)
    best: list[Trial | None] = [None] * n
    cost, converged = np.full(n, np.inf), np.zeros(n, bool)
    there: list[tuple[np.ndarray, np.ndarray] | None] = [None] * n
    rounds = max(len(s.starts) for s in padded)
    for k in range(rounds + 1):
        # another start only for those that the ones before did not bring near the noise; then longer from the best
        last = k == rounds
        open_ = [i for i, s in enumerate(padded) if (last or k < len(s.starts)) and cost[i] > 1.1 * s.data.used_bins]
        for at in range(0, len(open_), _ABREAST):
            part = open_[at : at + _ABREAST]
            filled = np.array(part + [part[-1]] * (_ABREAST - len(part)) if n >= _ABREAST else part)
            trials = stack([_begin(padded[i], k, best[i], width, lanes) for i in filled])
            take = lambda tree, rows=filled: jax.tree.map(lambda x: x[rows], tree)  # noqa: E731
            steps = options.max_steps * (3 if last else 1)
            found = solve_fleet(trials, take(data), take(spaces), max_steps=steps, robust=options.robust)
            for row, i in enumerate(part):
                c = float(found.cost[row])
                if np.isfinite(c) and c < cost[i]:
                    cost[i], converged[i] = c, bool(found.converged[row])
                    there[i] = np.asarray(found.residual[row]), np.asarray(found.jacobian[row])
                    best[i] = eqx.tree_at(lambda t: t.free, pick(trials, row), found.free[row])
    out: list[Fit | str] = []
    share = (time.monotonic() - began) / len(setups)
    for i, s in enumerate(padded):
        trial = best[i]
        if trial is None:
            out.append(f"{s.recordings[0].metadata.name}: no start led to a finite simulation; check units")
            continue
        try:
            out.append(_finished(s, trial, there[i], float(cost[i]), bool(converged[i]), options, share, with_traces))
        except (ScpjaxError, np.linalg.LinAlgError) as error:  # of one that blows up; the others are none the worse
            out.append(f"{s.recordings[0].metadata.name}: {error}")
    return out


def _finished(
    s: Setup,
    trial: Trial,
    there: tuple[np.ndarray, np.ndarray] | None,
    cost: float,
    converged: bool,
    options: FitOptions,
    seconds: float,
    with_traces: bool,
) -> Fit:
    """The fit of one actuator, at peace with its recordings; ``seconds`` were its share of what went before."""
    began = time.monotonic()
    trial, data, notes = settle(s, trial, s.data, drop_outliers=options.drop_outliers, robust=options.robust)
    if data is not s.data:
        trial, converged, cost = refine(s, data, trial, max_steps=options.max_steps, robust=options.robust)
        there = None
    return told(
        s,
        trial,
        data,
        converged=converged,
        cost=cost,
        notes=notes,
        began=began - seconds,
        at=there,
        with_traces=with_traces,
    )


def _begin(setup: Setup, k: int, best: Trial | None, width: int, lanes: int) -> Trial:
    """Start k of an actuator, or where it stands when there are no more."""
    if k >= len(setup.starts) and best is not None:
        return best
    start = setup.starts[min(k, len(setup.starts) - 1)]
    return setup.trial(start, setup.base_active, width=width, lanes=lanes)


def _widths(setups: Sequence[Setup]) -> tuple[int, int]:
    """Entries that move, and those of them that a recording depends on, of whom they are most."""
    width = max(int(s.base_active.sum()) for s in setups)
    return width, max(s.trial(s.starts[0], s.base_active, width=width).lanes.shape[1] for s in setups)


def _pad(setup: Setup, r: int) -> Setup:
    """The same problem with ``r`` recordings, the added ones empty and their initial states held."""
    have = len(setup.recordings)
    if have == r:
        return setup
    more = r - have
    n_local = setup.space.locals.count(setup.structure)
    grow = lambda x: np.concatenate([x, np.repeat(x[-1:], more, axis=0)])  # noqa: E731
    old: Data = jax.tree.map(np.asarray, setup.data)
    shared = lambda d: (d.sigma, d.colour)  # noqa: E731  # by output, not by recording
    data = jax.tree.map(grow, eqx.tree_at(shared, old, (np.zeros((have, 1)),) * 2))
    for name, empty in (
        ("weights", 0.0),
        ("at_start", 0.0),
        ("at_end", 0.0),
        ("target", 0.0),
        ("norm", np.inf),
    ):
        leaf = np.array(getattr(data, name))
        leaf[have:] = empty
        data = eqx.tree_at(lambda d, n=name: getattr(d, n), data, leaf)
    data = jax.tree.map(jnp.asarray, eqx.tree_at(shared, data, shared(old)))
    tail = lambda x: np.concatenate([np.asarray(x), np.tile(np.asarray(x)[len(x) - n_local :], more)])  # noqa: E731
    b = setup.space.bounds
    bounds: Bounded = jax.tree.map(lambda x: jnp.asarray(tail(x)), b)
    space = Space(
        setup.structure,
        setup.space.locals,
        r,
        bounds,
        jnp.asarray(tail(setup.space.prior_mean)),
        jnp.asarray(tail(setup.space.prior_spread)),
    )
    zeros = np.zeros(more * n_local)
    return replace(
        setup,
        data=data,
        space=space,
        fixed=np.concatenate([setup.fixed, zeros]),
        base_active=np.concatenate([setup.base_active, np.zeros(more * n_local, bool)]),
        starts=tuple(np.concatenate([s, zeros]) for s in setup.starts),
    )


__all__ = ["Fleet", "Trial", "fit_fleet"]
