"""The missing power, force or sensor error itself: a latent input estimated under a smoothness prior.

Before any name is given: what would have to be added to a balance of the base model, as a function of time, for its
simulation to meet the recordings, with a band; and how well each balance can answer for the misfit at all. The base
model is linear, so its outputs respond linearly to such an input, and everything is a Gaussian process regression in
closed form: Rasmussen, Williams, Gaussian Processes for Machine Learning (2006), sections 2.2 and 5.4;
Alvarez, Luengo, Lawrence, Latent Force Models, AISTATS 2009.
"""

from __future__ import annotations

import itertools
from collections.abc import Sequence
from dataclasses import dataclass

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array
from scipy.linalg import expm

from scpjax.compiled import quickly_compiled
from scpjax.diagnose.locate import Binned
from scpjax.diagnose.result import Latent
from scpjax.fit.data import Data
from scpjax.fit.problem import Trial, unpack
from scpjax.fit.setup import Setup
from scpjax.fit.solve import evaluate, stack
from scpjax.physics.model import Model

READING = 0.99  # of its evidence, that counts for a reading beside a balance
_KNOTS = 90  # per recording
_LENGTHS = (0.25, 0.1, 0.04, 0.015)  # correlation lengths tried, as shares of the longest recording
_ALIKE = 1e-6  # of the greatest singular value, below which directions are none of their own
_SIZES = np.logspace(-3, 3, 25)  # amplitudes tried, relative to what makes one standard deviation of misfit


@dataclass(frozen=True)
class _Place:
    subsystem: str
    name: str
    unit: str
    into: np.ndarray | None  # (states,) how the rates feel it
    output: int  # that it adds to directly, where ``into`` is None
    times: np.ndarray | None = None  # (r, k) what it is a share of: the drive; None for what is added as it is


class Misfit:
    """The residuals of a fitted base model, and how they would respond to an input of any balance or sensor; both
    without what its own parameters can imitate.

    ``target`` (rows,) is what has to be added, in standard deviations of the bins where there is a reading; ``own``
    (rows, parameters) how they would respond to the base model's own parameters.
    """

    def __init__(self, setup: Setup, data: Data, trial: Trial, binned: Binned):
        self.binned = binned
        self.model = unpack(trial.free, trial, setup.space)[0].on_average()
        self.linear = tuple(np.asarray(x) for x in _about_rest(self.model))
        self.places = {p.name: p for p in _places(setup, data, self.model, self.linear[1])}
        here = evaluate(stack([trial]), data, setup.space)
        self._rows = binned.there.ravel()
        residual = np.asarray(here.residual[0])[: self._rows.size][self._rows]
        jacobian = np.asarray(here.jacobian[0])[: self._rows.size][self._rows]
        self.own = jacobian[:, np.any(jacobian != 0, axis=0)]
        self._imitated, _ = np.linalg.qr(self.own)
        self.target = self.clean(-residual)
        r, k, y = binned.there.shape
        self.widths = np.asarray(data.grids.step) * data.bin  # s, of a bin of each recording
        count = np.asarray(data.at_start + data.at_end).reshape(r, k, data.bin, y).sum(axis=2)
        with np.errstate(divide="ignore"):
            self._scale = np.where(np.isfinite(data_norm(data)), count / data_norm(data), 0.0)

    def clean(self, x: np.ndarray) -> np.ndarray:
        """What is left of responses (rows, ...) without what the base model's own parameters can imitate."""
        return x - self._imitated @ (self._imitated.T @ x)

    def responses(self, place: str, inputs: Sequence[np.ndarray]) -> np.ndarray:
        """(rows, sum of m) to ``inputs`` (k, m) of each recording, linear over each bin, in a place."""
        return self.clean(self.whole_responses(place, inputs))

    def whole_responses(self, place: str, inputs: Sequence[np.ndarray]) -> np.ndarray:
        """The same with what the base model's own parameters can imitate."""
        where = self.places[place]
        r, k, y = self.binned.there.shape
        blocks = []
        for i, given in enumerate(inputs):
            g = np.zeros((r, k, y, given.shape[1]))
            times = given if where.times is None else given * where.times[i][:, None]
            g[i] = _linear_response(self.linear, where, float(self.widths[i]), times, y)
            blocks.append((g * self._scale[..., None]).reshape(-1, given.shape[1])[self._rows])
        return np.concatenate(blocks, axis=1)


def missing(misfit: Misfit) -> tuple[Latent, ...]:
    """Estimates for every balance and sensor that shows in what was recorded, best evidence first; a balance before a
    reading that is hardly better.
    """
    out = [found for place in misfit.places.values() if (found := _estimate(misfit, place)) is not None]
    # an error of a reading can imitate whatever shows in it, so it has to answer for the misfit better than a balance
    return tuple(sorted(out, key=lambda m: -m.evidence * (READING if m.subsystem == "sensor" else 1.0)))


@quickly_compiled
def _about_rest(model: Model) -> tuple[Array, Array, Array]:
    """A (n, n) and B (n, sides) of the balances, C (y, n) of the sensors."""
    still = jnp.zeros(len(model.structure.sides))
    return (*model.linearise(), jax.jacfwd(model.observe)(jnp.zeros(model.structure.n_states), still))


def _places(setup: Setup, data: Data, model: Model, driven: np.ndarray) -> list[_Place]:
    """Where something may be missing in this model; ``driven`` (n, sides) is how its rates feel the drive."""
    s, b = setup.structure, model.balances()
    names, places = s.state_names, []
    mass = np.broadcast_to(np.asarray(b.thermal_mass), (len(s.sides),))
    for i, side in enumerate(s.sides if s.thermal else ()):
        unit = np.zeros(len(names))
        unit[i] = 1.0 / mass[i]
        places.append(_Place("thermoelectric", f"heat_{side}" if side else "heat", "W", unit, 0))
        share = _by_bin(data, i)  # of the effort, that it lacks or has too much of
        places.append(_Place("drive", f"drive_{side}" if side else "drive", "1", driven[:, i], 0, share))
    if s.mechanical:
        unit = np.zeros(len(names))
        unit[names.index("velocity")] = 1.0 / float(np.asarray(b.moving_mass))
        places.append(_Place("thermomechanical", "force", "N", unit, 0))
    for i, state in enumerate(s.system.states if s.system else ()):
        places.append(_Place("balance", f"rate of {state}", "1/s", np.eye(len(names))[i], 0))
    there = np.any(np.isfinite(data_norm(setup.data)), axis=(0, 1))
    for j, output in enumerate(s.outputs):
        if there[j]:
            own = s.system.channels[j][1].si if s.system else "m"
            unit_name = "K" if output.startswith("temperature") else "rad" if output == "angle" else own
            places.append(_Place("sensor", f"{output} reading", unit_name, None, j))
    return places


def _by_bin(data: Data, side: int) -> np.ndarray:
    """Mean effort of a side in each bin (r, k)."""
    effort = np.asarray(data.grids.effort)[:, :, 1, side]
    return effort.reshape(len(effort), -1, data.bin).mean(axis=2)


def data_norm(data: Data) -> np.ndarray:
    """Standard deviation of each bin's sum (r, k, y); inf where it is empty."""
    return np.asarray(data.norm)


def _estimate(misfit: Misfit, place: _Place) -> Latent | None:
    """None where nothing recorded responds to what may be missing there, as to a force where only heat was."""
    binned = misfit.binned
    bins = [int(np.flatnonzero(there.any(axis=1))[-1]) + 1 for there in binned.there]
    gap = [max(n // _KNOTS, 1) for n in bins]
    count = [-(-n // step) + 1 for n, step in zip(bins, gap, strict=True)]
    triangles = [hats(binned.there.shape[1], step, m) for step, m in zip(gap, count, strict=True)]
    times = [np.arange(m) * step * width for m, step, width in zip(count, gap, misfit.widths, strict=True)]
    raw, target = misfit.whole_responses(place.name, triangles), misfit.target
    response = misfit.clean(raw)
    if not np.any(response):
        return None
    unit = 1.0 / np.sqrt(np.mean(np.sum(response**2, axis=0)))
    span = max(t[-1] for t in times)
    noise = 1.0
    fits = [_marginal(response * unit, target, times, share * span, noise) for share in _LENGTHS]
    best = max(fits, key=lambda f: f.evidence)
    std = np.sqrt(np.maximum(np.diag(best.covariance), 0.0))
    edges = np.cumsum([0, *[len(t) for t in times]])
    parts = [(best.mean[a:b] * unit, std[a:b] * unit) for a, b in itertools.pairwise(edges)]
    shares, leading = depends(binned.on(place.name), times, [m for m, _ in parts], [s for _, s in parts])
    band = unit * _of_the_rest(best, raw * unit, misfit.own)
    return Latent(
        place.subsystem,
        place.name,
        place.unit,
        float(best.evidence),
        float(1.0 - best.left / max(float(target @ target), 1e-300)),
        float(best.length),
        tuple(times),
        tuple(m for m, _ in parts),
        tuple(band[a:b] for a, b in itertools.pairwise(edges)),
        shares,
        leading,
    )


def hats(k: int, gap: int, m: int) -> np.ndarray:
    """(k, m) triangles of half-width ``gap`` bins that peak at 1, one at every ``gap``-th bin."""
    return np.maximum(1.0 - np.abs(np.arange(k)[:, None] - gap * np.arange(m)) / gap, 0.0)


def _linear_response(
    linear: Sequence[np.ndarray], place: _Place, width: float, inputs: np.ndarray, y: int
) -> np.ndarray:
    """Outputs (k, y, m) to inputs (k, m) that are linear over bins of a width [s]; ``linear`` is A, B and C."""
    k, m = inputs.shape
    out = np.zeros((k, y, m))
    if place.into is None:
        out[:, place.output] = inputs
        return out
    a, _, c = linear
    n = len(a)
    # exact for an input that is linear over each bin: Franklin, Powell, Workman, Digital Control, section 4.3.2
    big = np.zeros((n + 2, n + 2))
    big[:n, :n], big[:n, n], big[n, n + 1] = a * width, place.into * width, 1.0
    e = expm(big)
    ad, slope = e[:n, :n], e[:n, n + 1]
    step = e[:n, n] - slope
    x = np.zeros((n, m))
    for i in range(1, k):
        x = ad @ x + np.outer(step, inputs[i - 1]) + np.outer(slope, inputs[i])
        out[i] = c @ x
    return out


@dataclass(frozen=True)
class _Posterior:
    """Of the values at the knots: mean and covariance at the best amplitude for one correlation length; ``left`` of the
    sum of squares; ``root`` (of the prior's covariance) and the amplitude over the noise.
    """

    evidence: float
    mean: np.ndarray
    covariance: np.ndarray
    length: float
    left: float
    root: np.ndarray
    size: float


def _of_the_rest(found: _Posterior, responses: np.ndarray, own: np.ndarray) -> np.ndarray:
    """Standard deviations at the knots without what the base model's own parameters can take up: of that the misfit
    says nothing, so it would be as uncertain as the prior has it, and hide how well all else is known.
    """
    z = responses @ found.root
    inner = z.T @ z + np.eye(z.shape[1]) / found.size
    inputs = found.root @ np.linalg.solve(inner, z.T @ own)  # that do what the parameters do, as far as smooth ones can
    inputs = inputs[:, np.all(np.isfinite(inputs), axis=0)]
    left, values, _ = np.linalg.svd(inputs / np.maximum(np.linalg.norm(inputs, axis=0), 1e-300), full_matrices=False)
    taken = left[:, values > _ALIKE * values.max(initial=0.0)]
    rest = found.covariance - taken @ (taken.T @ found.covariance)
    rest = rest - (rest @ taken) @ taken.T
    return np.sqrt(np.maximum(np.diag(rest), 0.0))


def _marginal(
    g: np.ndarray, target: np.ndarray, times: Sequence[np.ndarray], length: float, noise: float
) -> _Posterior:
    """The posterior at the best amplitude for one correlation length."""
    roots = []
    for t in times:
        d = np.sqrt(3.0) * np.abs(t[:, None] - t[None]) / length  # Matern 3/2
        kernel = (1 + d) * np.exp(-d)
        roots.append(np.linalg.cholesky(kernel + 1e-8 * np.eye(len(t))))
    total = sum(len(t) for t in times)
    root = np.zeros((total, total))
    at = 0
    for part in roots:
        root[at : at + len(part), at : at + len(part)] = part
        at += len(part)
    z = g @ root
    eigen, vectors = np.linalg.eigh(z.T @ z)
    eigen = np.maximum(eigen, 0.0)
    along = vectors.T @ (z.T @ target)
    best = (-np.inf, 1.0)
    for size in _SIZES**2:
        shrink = size / (noise + size * eigen)
        fit = 0.5 * np.sum(shrink * along**2) / noise - 0.5 * np.sum(np.log1p(size * eigen / noise))
        best = max(best, (float(fit), float(size)))
    evidence, size = best
    shrink = size / (noise + size * eigen)
    weights = vectors @ (shrink * along)
    covariance = (root @ vectors) * shrink @ (root @ vectors).T * noise
    left = float(np.sum((target - z @ weights) ** 2))
    return _Posterior(evidence, root @ weights, covariance, length, left, root, size / noise)


def depends(
    binned: Binned, times: Sequence[np.ndarray], mean: Sequence[np.ndarray], std: Sequence[np.ndarray]
) -> tuple[tuple[tuple[str, float], ...], tuple[np.ndarray, ...]]:
    """Share of the estimate's variance that a smooth function of each variable alone explains, strongest first, and
    the values of the strongest.
    """
    known = {
        "temperature": binned.temperature,
        "displacement": binned.displacement,
        "velocity": binned.velocity,
        "drive": binned.drive,
        "time": binned.time,
        **binned.own,
    }
    value, weight = np.concatenate(mean), 1.0 / (np.concatenate(std) ** 2 + 1e-300)
    weight = np.minimum(weight, 20 * np.median(weight))
    out: list[tuple[str, float]] = []
    values: dict[str, tuple[np.ndarray, ...]] = {}
    for name, states in known.items():
        if states is None:
            continue
        values[name] = tuple(np.interp(t, binned.time[i] - binned.time[i, 0], states[i]) for i, t in enumerate(times))
        at = np.concatenate(values[name])
        if np.ptp(at) <= 1e-12 * (np.abs(at).max() + 1e-300):
            continue
        relative = 2 * (at - at.min()) / np.ptp(at) - 1
        basis = np.polynomial.chebyshev.chebvander(relative, 4)
        root = np.sqrt(weight)
        found = np.linalg.lstsq(basis * root[:, None], value * root, rcond=None)[0]
        centre = np.average(value, weights=weight)
        whole = np.sum(weight * (value - centre) ** 2) + 1e-300
        left = np.sum(weight * (value - basis @ found) ** 2)
        n = len(value)
        share = 1.0 - left / whole * (n - 1) / max(n - 5, 1)
        out.append((name, round(float(np.clip(share, 0.0, 1.0)), 4)))
    out.sort(key=lambda p: -p[1])
    return tuple(out), values[out[0][0]] if out else ()
