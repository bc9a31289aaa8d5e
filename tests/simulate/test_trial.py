"""The trial of a base or a mechanism of a user's own: what is quick or runs away passes, what is wrong does not."""

import jax.numpy as jnp
import numpy as np
import pytest

from scpjax.errors import ModelError
from scpjax.parameter import Parameter
from scpjax.physics.mechanism import Mechanism
from scpjax.physics.system import System
from scpjax.simulate import trial
from scpjax.simulate.trial import try_base, try_null


def size(value: float, null: float | None = None) -> Parameter:
    return Parameter(
        name="size", symbol="s", unit="1", description="size", typical=value, bounds=(-1e9, 1e9), null=null,
        scale="linear", spread=1.0,
    )  # fmt: skip


class Spring(System):
    """Whose force bends, of a frequency that is its parameter."""

    name = "spring"
    states, outputs, parameters = ("place", "speed"), ("place_V",), (size(400.0),)
    cubic = 1.5

    def rates(self, p, view):
        place, speed = view.own
        pull = p.size**2 * (view.effort - place - self.cubic * place**3)
        return speed, pull - 0.1 * p.size * speed

    def observe(self, p, view):
        return (view.own[0],)


class Softer(Spring):
    cubic = -0.05


class Nowhere(Spring):
    def observe(self, p, view):
        return (jnp.log(-1.0 - view.own[0] ** 2),)


class Still(System):
    """The second of whose outputs no drive moves."""

    name = "still"
    states, outputs, parameters, substeps = ("level", "other"), ("level_V", "other_V"), (size(0.1),), 7

    def rates(self, p, view):
        level, other = view.own
        return p.size * (view.effort - level), -p.size * other

    def observe(self, p, view):
        return view.own


class Loss(Mechanism):
    name = "loss"
    subsystem = "balance"
    needs, parameters, shift = ("still",), (size(0.1, 0.0),), 0.0

    def flows(self, p, view):
        return {"level": -p.size * view.states["level"] ** 2, "other": self.shift + 0.0 * p.size}


class Shifted(Loss):
    shift = 1e-3


@pytest.mark.parametrize("frequency", [5.0, 400.0])
@pytest.mark.parametrize("kind", [Spring, Softer])
def test_a_base_that_is_too_quick_or_driven_too_hard_is_tried_more_gently(kind, frequency, monkeypatch):
    found, simulate = [], trial.simulate
    monkeypatch.setattr(trial, "simulate", lambda *a, method: found.append(simulate(*a, method=method)) or found[-1])
    try_base(type(kind.__name__, (kind,), {"parameters": (size(frequency),)})())
    *before, last = [bool(np.all(np.isfinite(path.outputs))) for path in found]
    assert before
    assert not any(before)
    assert last


def test_a_base_that_is_never_finite_is_refused():
    with pytest.raises(ModelError, match=r"mine\.py: spring does not stay finite"):
        try_base(Nowhere(), "mine.py")


def test_a_base_that_works_at_once_is_tried_once_and_in_its_own_substeps(monkeypatch):
    seen, simulate = [], trial.simulate
    monkeypatch.setattr(trial, "simulate", lambda *a, method: seen.append(method) or simulate(*a, method=method))
    try_base(Still())
    assert [method.substeps for method in seen] == [Still.substeps]


def test_an_output_that_the_drive_never_moves_is_no_fault_of_a_mechanism(monkeypatch):
    monkeypatch.setattr(trial, "systems", lambda: {"still": Still()})
    try_null(Loss())
    with pytest.raises(ModelError, match=r"does not vanish at its null values.*the other is off"):
        try_null(Shifted())
