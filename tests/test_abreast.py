"""Work shared out among threads: in order, all of it, and what they share is compiled once."""

import threading

import jax.numpy as jnp
import numpy as np
import pytest

from scpjax import abreast as room
from scpjax import kept
from scpjax.abreast import abreast, cores, meanwhile
from scpjax.compiled import quickly_compiled


@pytest.fixture
def three_cores(monkeypatch):
    monkeypatch.setattr(room, "cores", lambda: 3)


def test_results_come_in_order(three_cores):
    assert abreast(lambda x: x * x, range(20)) == [x * x for x in range(20)]
    assert abreast(lambda x: x, []) == []


def test_as_many_at_once_as_there_are_cores(three_cores):
    """Each waits for two others: fewer threads than three would wait for ever."""
    meeting = threading.Barrier(3, timeout=10)
    assert abreast(lambda x: (meeting.wait(), x)[1], range(6)) == list(range(6))


def test_one_core_needs_no_thread(monkeypatch):
    monkeypatch.setattr(room, "cores", lambda: 1)
    mine = threading.get_ident()
    assert set(abreast(lambda _: threading.get_ident(), range(3))) == {mine}


def test_what_goes_wrong_is_told(three_cores):
    with pytest.raises(ZeroDivisionError):
        abreast(lambda x: 1 // x, [1, 0, 1])


def test_what_is_done_meanwhile_is_done_beside_the_rest_and_at_the_end():
    """Each waits for the other: one after the other they would wait for ever."""
    meeting, done = threading.Barrier(2, timeout=10), []
    with meanwhile(lambda: (meeting.wait(), done.append("beside"))):
        meeting.wait()
    assert done == ["beside"]


def test_what_goes_wrong_meanwhile_is_told():
    with pytest.raises(ZeroDivisionError), meanwhile(lambda: 1 // 0):
        pass


def test_there_is_a_core():
    assert cores() >= 1


@pytest.mark.parametrize("keeps", [False, True])
def test_threads_that_ask_for_one_program_have_it_traced_once(three_cores, tmp_path, keeps):
    kept.keep_in(tmp_path if keeps else None)
    traces = []

    @quickly_compiled
    def function(x, name):
        traces.append(name)
        return jnp.sum(jnp.sin(x))

    found = abreast(lambda i: float(function(np.arange(5.0) + i, "a")), range(12))
    np.testing.assert_allclose(found, [np.sum(np.sin(np.arange(5.0) + i)) for i in range(12)])
    assert traces == ["a"]
