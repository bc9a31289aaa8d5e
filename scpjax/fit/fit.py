"""Fit one actuator: recordings in, model with error bars out."""

from __future__ import annotations

import time
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import equinox as eqx
import jax.numpy as jnp
import numpy as np

from scpjax.errors import FitError
from scpjax.fit.data import Data, columns
from scpjax.fit.gaps import fill, find_gaps, improve
from scpjax.fit.identifiability import estimates, uncertainty
from scpjax.fit.metrics import mae, nrmse, rmse
from scpjax.fit.problem import Trial, unpack
from scpjax.fit.result import Fit, Trace
from scpjax.fit.setup import Setup, names_of, prepare
from scpjax.fit.solve import outputs_of, solve, stack
from scpjax.physics.model import Model
from scpjax.recordings.recording import Recording


@dataclass(frozen=True, kw_only=True)
class FitOptions:
    """``robust`` > 0: pseudo-Huber loss beyond that many standard deviations. ``prior`` divides the spread of the weak
    base priors (0 would be none; they matter only where data leave a direction open). ``bin``: samples averaged into
    one residual (chosen from the time scales when None). ``order`` and ``substeps`` of the integrator. ``release``: the
    weight may be moving when the recording begins (it was plucked or let go), so its start is estimated too."""

    robust: float = 0.0
    prior: float = 0.3
    bin: int | None = None
    order: int = 2
    substeps: int | None = None
    max_steps: int = 60
    drop_outliers: bool = True
    release: bool = False


def best_start(
    setup: Setup, data: Data, *, width: int = 0, max_steps: int = 60, robust: float = 0.0
) -> tuple[Trial, bool, float]:
    """(trial at the best solution over all starts, converged, cost)."""
    best: tuple[Trial, bool, float] | None = None
    for value in setup.starts:  # one after the other: the program for a single trial is needed later anyway
        found = refine(
            setup,
            data,
            setup.trial(value, setup.base_active, width=width),
            max_steps=max_steps,
            robust=robust,
        )
        if np.isfinite(found[2]) and (best is None or found[2] < best[2]):
            best = found
    if best is None:
        raise FitError(
            "no start led to a finite simulation",
            where=setup.recordings[0].metadata.path,
            mend="check the units of the drive and of the known values",
        )
    return best


def refine(
    setup: Setup, data: Data, trial: Trial, *, max_steps: int = 60, robust: float = 0.0
) -> tuple[Trial, bool, float]:
    """The trial solved again from where it stands."""
    found = solve(stack([trial]), data, setup.space, max_steps=max_steps, robust=robust)
    return eqx.tree_at(lambda t: t.free, trial, found.free[0]), bool(found.converged[0]), float(found.cost[0])


_MOST_WILD = 0.05  # share of an output's samples, from which what stands out is no matter of single ones


def outliers(setup: Setup, data: Data, trial: Trial, *, threshold: float = 6.0, window: int = 11) -> np.ndarray:
    """Weights with isolated wild samples taken out, judged on the residuals of a fit.

    A sample is wild when its residual lies more than ``threshold`` standard deviations from the median of its
    neighbours' and stands alone (no more than two in a row); a misfit of the model is neither. Where a twentieth of an
    output's samples or more would be, none is.
    """
    residual = np.asarray(outputs_of(trial, data, setup.space)) - np.asarray(data.outputs)
    weights = np.array(data.weights)
    for i in range(residual.shape[0]):
        for j in range(residual.shape[2]):
            seen = np.flatnonzero(weights[i, :, j] > 0)
            if len(seen) < 4 * window:
                continue
            x = residual[i, seen, j]
            padded = np.pad(x, window // 2, mode="reflect")
            views = np.lib.stride_tricks.sliding_window_view(padded, window)
            middle = np.median(views, axis=1)
            spread = 1.4826 * np.median(np.abs(views - middle[:, None]), axis=1)
            wild = np.abs(x - middle) > threshold * np.maximum(spread, float(data.sigma[j]))
            runs = np.convolve(wild, np.ones(3), mode="same")
            wild &= runs <= 2
            if wild.mean() < _MOST_WILD:
                weights[i, seen[wild], j] = 0.0
    return weights


def _without_wild(setup: Setup, data: Data, judge: Trial, trial: Trial, robust: float) -> tuple[Trial, Data]:
    """What is wild beside one trial left out, and a fit to the rest; the other trial where nothing is."""
    kept = data.with_weights(outliers(setup, data, judge))
    if np.array_equal(np.asarray(kept.weights), np.asarray(data.weights)):
        return trial, data
    return refine(setup, kept, judge, robust=robust)[0], kept


_UNBENT = 3.0  # standard deviations from which samples pull a fit no harder the farther they are
_FEW, _TO_NOISE = 0.01, 1.05  # share of the samples; mean square, in units of the noise's, without them


def _few_make_it(setup: Setup, data: Data, trial: Trial) -> bool:
    """Whether the misfit of some column is that of its few worst samples."""
    error = np.asarray(outputs_of(trial, data, setup.space)) - np.asarray(data.outputs)
    square = (error / np.asarray(data.sigma)) ** 2
    for j in range(square.shape[2]):
        x = np.sort(square[..., j][np.asarray(data.weights)[..., j] > 0])
        most = len(x) - int(np.ceil(_FEW * len(x)))
        if most > 0 and np.mean(x) > _TO_NOISE > np.mean(x[:most]):
            return True
    return False


def settle(
    setup: Setup,
    trial: Trial,
    data: Data,
    *,
    drop_outliers: bool = True,
    rounds: int = 3,
    robust: float = 0.0,
) -> tuple[Trial, Data, tuple[str, ...]]:
    """A fit made at peace with its recordings: jumps inside gaps timed, wild samples left out."""
    notes: list[str] = []
    gaps = find_gaps(data)
    if gaps:
        original, shares = data, np.full(len(gaps), 0.5)
        for _ in range(rounds):
            data = original.with_effort(fill(np.asarray(original.grids.effort), gaps, shares))
            trial, _, _ = refine(setup, data, trial, robust=robust)
            shares = improve(original, gaps, shares, trial, setup.space)
        data = original.with_effort(fill(np.asarray(original.grids.effort), gaps, shares))
        trial, _, _ = refine(setup, data, trial, robust=robust)
        notes.append(f"the drive changed during {len(gaps)} gaps in the sampling; when, was estimated beside the fit")
    if drop_outliers:
        trial, kept = _without_wild(setup, data, trial, trial, robust)
        if _few_make_it(setup, kept, trial):  # they may have bent the fit until they stood out no more
            unbent, _, _ = refine(setup, kept, trial, robust=_UNBENT)
            trial, kept = _without_wild(setup, kept, unbent, trial, robust)
        dropped = int(np.sum(np.asarray(kept.weights) != np.asarray(data.weights)))
        if dropped:
            data = kept
            notes.append(f"{dropped} isolated wild samples were left out")
    return trial, data, tuple(notes)


def fit(
    recordings: Sequence[Recording],
    *,
    model: str | None = None,
    fixed: Mapping[str, float] | None = None,
    options: FitOptions | None = None,
) -> Fit:
    """Fit a preset to recordings of one actuator.

    ``model`` is te, tm, plant or aaa (chosen from the columns when None); ``fixed`` holds physical values by parameter
    key that are not to be fitted, beside those that the recordings' ``[actuator]`` gives. All recordings share the
    parameters; each has its own initial state.

    **Raises** `FitError`, `RecordingError` for recordings that cannot be fitted.
    """
    options = options or FitOptions()
    began = time.monotonic()
    setup = prepare(
        recordings,
        model=model,
        fixed=fixed,
        bin=options.bin,
        order=options.order,
        substeps=options.substeps,
        prior_strength=options.prior,
        release=options.release,
    )
    trial, _, _ = best_start(setup, setup.data, max_steps=options.max_steps, robust=options.robust)
    trial, data, notes = settle(setup, trial, setup.data, drop_outliers=options.drop_outliers, robust=options.robust)
    trial, converged, cost = refine(setup, data, trial, max_steps=options.max_steps, robust=options.robust)
    return told(setup, trial, data, converged=converged, cost=cost, notes=notes, began=began)


def told(
    setup: Setup,
    trial: Trial,
    data: Data,
    *,
    converged: bool,
    cost: float,
    notes: tuple[str, ...],
    began: float,
    at: tuple[np.ndarray, np.ndarray] | None = None,
    with_traces: bool = True,
) -> Fit:
    """A solution as it is told: with error bars, scores and curves. ``at`` as of `uncertainty`; ``began`` [s], by
    `time.monotonic`."""
    doubt = uncertainty(trial, data, setup.space, at=at)
    return Fit(
        model=final_model(setup, trial),
        parameters=estimates(trial, setup.space, doubt),
        known=setup.known,
        scores=scores(setup, data, trial, np.asarray(data.weights)),
        noise=noise_by_column(setup),
        rank=doubt.rank,
        n_free=sum(not k.startswith("recording_") for k in doubt.keys),
        not_identifiable=doubt.open_directions,
        converged=converged,
        notes=setup.notes + notes,
        traces=traces(setup, data, trial, trial, None) if with_traces else (),
        cost=cost,
        n_data=data.used_bins,
        seconds=time.monotonic() - began,
    )


def final_model(setup: Setup, trial: Trial) -> Model:
    """Model of a trial, with the ambient of the first recording, and the mean of what differs by recording."""
    model, _ = unpack(trial.free, trial, setup.space)
    model = model.on_average()
    return eqx.tree_at(lambda m: m.ambient, model, jnp.asarray(setup.data.ambient[0]))


def _units(setup: Setup) -> dict[int, tuple[str, float]]:
    """(file column, file units per SI unit) of each output of the model that is recorded."""
    out: dict[int, tuple[str, float]] = {}
    for r in setup.recordings:
        for j, stem in columns(setup.structure, r):
            channel = next(c for c in r.output_channels if c.stem == stem)
            out.setdefault(j, (channel.column, 1.0 / channel.unit.scale))
    return out


def noise_by_column(setup: Setup) -> dict[str, float]:
    """Noise standard deviation per file column, in the file's unit."""
    return {c: float(setup.data.sigma[j]) * k for j, (c, k) in sorted(_units(setup).items())}


def scores(setup: Setup, data: Data, trial: Trial, weights: np.ndarray) -> dict[str, dict[str, float]]:
    """RMSE, NRMSE and MAE per file column over the samples with weight, in the file's unit."""
    predicted, actual = np.asarray(outputs_of(trial, data, setup.space)), np.asarray(data.outputs)
    out = {}
    for j, (column, k) in sorted(_units(setup).items()):
        w = weights[..., j].ravel()
        if w.sum() == 0:
            continue
        p, a = predicted[..., j].ravel(), actual[..., j].ravel()
        out[column] = {"rmse": k * rmse(p, a, w), "nrmse": nrmse(p, a, w), "mae": k * mae(p, a, w)}
    return out


def traces(
    setup: Setup,
    data: Data,
    base: Trial,
    extended: Trial,
    held_out: np.ndarray | None,
    *,
    extended_setup: Setup | None = None,
) -> tuple[Trace, ...]:
    """Curves of every recorded column in the file's unit; ``extended`` may be a trial of another problem."""
    first = np.asarray(outputs_of(base, data, setup.space))
    space = (extended_setup or setup).space
    both = [first, first if extended is base else np.asarray(outputs_of(extended, data, space))]
    out = []
    for (i, r), name in zip(enumerate(setup.recordings), names_of(setup.recordings), strict=True):
        for j, stem in columns(setup.structure, r):
            channel = next(c for c in r.output_channels if c.stem == stem)
            drive = np.column_stack([c.unit.from_si(r.inputs[:, m]) for m, c in enumerate(r.input_channels)])
            hidden = np.zeros(r.n, bool) if held_out is None else held_out[i, : r.n, j]
            out.append(
                Trace(
                    recording=name,
                    column=channel.column,
                    time=np.asarray(r.time),
                    drive=drive,
                    drive_columns=tuple(c.column for c in r.input_channels),
                    measured=np.asarray(channel.unit.from_si(r.output(stem))),
                    weights=np.asarray(data.weights)[i, : r.n, j],
                    base=np.asarray(channel.unit.from_si(both[0][i, : r.n, j])),
                    extended=np.asarray(channel.unit.from_si(both[1][i, : r.n, j])),
                    held_out=hidden,
                )
            )
    return tuple(out)
