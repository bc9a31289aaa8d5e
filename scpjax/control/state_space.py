"""Models as python-control systems, and the thesis's questions about them (4.4)-(4.11).

A model that is not linear is linearised about rest. Inputs are efforts (V^2 for a voltage drive), outputs the
sensor readings about rest in SI.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

import jax
import jax.numpy as jnp
import numpy as np

from scpjax.errors import ModelError
from scpjax.physics.model import Model
from scpjax.physics.presets import Compact

if TYPE_CHECKING:
    import control

_EFFORT_UNITS = {
    "voltage": "V2",
    "pwm": "V2",
    "current": "A2",
    "power": "W",
    "temperature": "K",
    "gain": "1",
}
_RANK_TOLERANCE = 1e-10  # of the states' reach: what rounding leaves of a state that is not there
_OUTPUT_UNITS = {"temperature": "K", "displacement": "m", "angle": "rad"}


def state_space(model: Model) -> control.StateSpace:
    """Convert a model to a python-control state space system.

    Parameters
    ----------
    model : Model
        The model; linearised about rest where it is not linear. Its dead time is left out.

    Returns
    -------
    sys : control.StateSpace
        Inputs are the efforts per side (``drive_V2``), outputs the readings (``displacement_m``) less those
        at rest, states as in ``model.structure.state_names`` (with ``_`` for ``.``).

    Raises
    ------
    ModelError
        If the model has no finite linearisation at rest.
    """
    import control

    a, b, c, d = matrices(model)
    structure = model.structure
    return control.StateSpace(
        a,
        b,
        c,
        d,
        name=structure.name,
        states=[name.replace(".", "_") for name in structure.state_names],
        inputs=_input_names(model),
        outputs=_output_names(model),
    )


def transfer_function(model: Model, *, output: str | None = None) -> control.TransferFunction:
    """Transfer function from the efforts to one output, thesis (3.3), (3.5), (3.6), (3.11).

    Only the states that reach this output from the inputs are kept, so nothing cancels in the result.

    Parameters
    ----------
    model : Model
        The model; linearised about rest where it is not linear.
    output : str, optional
        ``"temperature"``, ``"displacement"``, ``"angle"`` or, for a joint, ``"temperature_agonist"``. The
        last output of the model when not given.

    Returns
    -------
    sys : control.TransferFunction
        One output, one input per side.
    """
    import control

    a, b, c, d = matrices(model)
    row = _row(model, output)
    columns = [minimal_polynomials(a, b[:, [j]], c[[row]], d[row, j]) for j in range(b.shape[1])]
    return control.TransferFunction(
        [[numerator for numerator, _ in columns]],
        [[denominator for _, denominator in columns]],
        name=model.structure.name,
        inputs=_input_names(model),
        outputs=[_output_names(model)[row]],
    )


def poles(model: Model) -> np.ndarray:
    """Poles of a model.

    Parameters
    ----------
    model : Model
        The model; linearised about rest where it is not linear.

    Returns
    -------
    poles : 1D complex array
        Eigenvalues of the system matrix [1/s], slowest first.
    """
    a, *_ = matrices(model)
    found = np.asarray(np.linalg.eigvals(a), dtype=np.complex128)
    return found[np.lexsort((found.imag, np.abs(found)))]


def controllability(model: Model | control.StateSpace) -> tuple[np.ndarray, int]:
    """Controllability matrix and its rank, thesis (4.7).

    Parameters
    ----------
    model : Model or control.StateSpace
        A model, linearised about rest where it is not linear, or a state space system.

    Returns
    -------
    matrix : 2D array
        ``[B, AB, ..., A^(n-1) B]``.
    rank : int
        Number of states that the inputs can move, found in balanced coordinates by orthogonal steps because
        the rank of the matrix itself drowns in rounding when poles lie decades apart.
    """
    a, b, *_ = _abcd(model)
    return np.hstack([np.linalg.matrix_power(a, i) @ b for i in range(a.shape[0])]), _reachable(a, b)[0].shape[1]


def observability(model: Model | control.StateSpace, outputs: tuple[str, ...] | None = None) -> tuple[np.ndarray, int]:
    """Observability matrix and its rank, thesis (4.9).

    Parameters
    ----------
    model : Model or control.StateSpace
        A model, linearised about rest where it is not linear, or a state space system.
    outputs : tuple of str, optional
        Which outputs of a model are measured; all when not given.

    Returns
    -------
    matrix : 2D array
        ``[C; CA; ...; C A^(n-1)]``.
    rank : int
        Number of states that these outputs show (see `controllability`).
    """
    a, _, c, _ = _abcd(model)
    if outputs is not None:
        if not isinstance(model, Model):
            raise ModelError("outputs are chosen by name from a Model", mend="cut the system's outputs instead")
        c = c[[_row(model, name) for name in outputs]]
    return np.vstack([c @ np.linalg.matrix_power(a, i) for i in range(a.shape[0])]), _reachable(a.T, c.T)[0].shape[1]


def canonical(compact: Compact) -> control.StateSpace:
    """Companion form of a plant's compact transfer function, thesis (4.4).

    Parameters
    ----------
    compact : Compact
        Coefficients of thesis (3.14).

    Returns
    -------
    sys : control.StateSpace
        States are acceleration, velocity and displacement of the chain of integrators, scaled so that the
        input enters with 1 and the output leaves with b0.
    """
    import control

    return control.StateSpace(
        [[-compact.a2, -compact.a1, -compact.a0], [1.0, 0.0, 0.0], [0.0, 1.0, 0.0]],
        [[1.0], [0.0], [0.0]],
        [[0.0, 0.0, compact.b0]],
        [[0.0]],
        states=["acceleration", "velocity", "displacement"],
        inputs=["drive_V2"],
        outputs=["displacement_m"],
    )


def matrices(model: Model) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
    """(A, B, C, D) of a model about rest, as float64 arrays.

    **Raises** `ModelError` when they are not finite.
    """
    rest = jnp.zeros(model.structure.n_states, model.theta.dtype)
    still = jnp.zeros(len(model.structure.sides), model.theta.dtype)
    a, b = model.linearise()
    c, d = jax.jacfwd(model.observe, argnums=(0, 1))(rest, still)
    a, b, c, d = (np.asarray(m, dtype=np.float64) for m in (a, b, c, d))
    if not all(np.isfinite(m).all() for m in (a, b, c, d)):
        raise ModelError(f"{model!r} has no finite linearisation at rest", mend="check its parameter values")
    return a, b, c, d


def _input_names(model: Model) -> list[str]:
    return [f"{name}_{_EFFORT_UNITS[model.structure.drive]}" for name in model.structure.inputs]


def _output_names(model: Model) -> list[str]:
    return [f"{name}_{_OUTPUT_UNITS[name.split('_')[0]]}" for name in model.structure.outputs]


def _abcd(model: Model | control.StateSpace) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
    if isinstance(model, Model):
        return matrices(model)
    a, b, c, d = (np.asarray(m, dtype=np.float64) for m in (model.A, model.B, model.C, model.D))
    return a, b, c, d


def _row(model: Model, output: str | None) -> int:
    names = model.structure.outputs
    if output is None:
        return len(names) - 1
    if output not in names:
        raise ModelError(f"no output {output!r}", mend=f"the model has {list(names)}")
    return names.index(output)


def minimal_polynomials(a: np.ndarray, b: np.ndarray, c: np.ndarray, d: float) -> tuple[np.ndarray, np.ndarray]:
    """Numerator and denominator of c (s - a)^-1 b + d, of what is reachable from b and seen by c only."""
    into, back = _reachable(a, b)
    reached = back @ a @ into
    into_seen, back_seen = _reachable(reached.T, (c @ into).T)
    order = into_seen.shape[1]
    denominator = np.poly(back_seen @ reached.T @ into_seen) if order else np.ones(1)
    markov = [d, *((c @ np.linalg.matrix_power(a, i) @ b).item() for i in range(order))]
    numerator = np.convolve(denominator, markov)[: order + 1]
    nonzero = np.flatnonzero(numerator)
    return (numerator[nonzero[0] :] if nonzero.size else np.zeros(1)), denominator


def _reachable(a: np.ndarray, b: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """(V, W) with W V = 1 and the columns of V spanning b, ab, a^2 b, ...

    The staircase algorithm (Van Dooren, IEEE Trans. Autom. Control 26 (1981) 111) after the states are
    measured in units of how far the inputs move them, so that neither units nor slow poles hide a state.
    """
    n = a.shape[0]
    rate = np.max(np.abs(np.linalg.eigvals(a))) or 1.0
    fresh = b / np.where(np.any(b, axis=0), np.linalg.norm(b, axis=0), 1.0)
    reach = np.max(np.abs(fresh), axis=1)
    for _ in range(n):
        reach = np.maximum(reach, np.max(np.abs(a) * reach, axis=1) / rate)
    scale = np.where(reach > 0, reach, 1.0)
    a, fresh = a * scale / scale[:, None] / rate, fresh / scale[:, None]
    basis = np.zeros((n, 0))
    while fresh.shape[1] and basis.shape[1] < n:
        for _ in range(2):  # once more against rounding
            fresh = fresh - basis @ (basis.T @ fresh)
        left, weight, _ = np.linalg.svd(fresh, full_matrices=False)
        fresh = left[:, weight > _RANK_TOLERANCE]
        basis = np.hstack([basis, fresh])
        fresh = a @ fresh
    return scale[:, None] * basis, basis.T / scale
