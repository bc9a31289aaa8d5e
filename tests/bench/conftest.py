"""One fixture for all boards."""

import multiprocessing
import time

import boards
import pytest
from ports import ours


@pytest.fixture(params=boards.KINDS)
def board(request):
    """A function that makes a board of each kind."""
    return lambda *args, **options: boards.make(request.param, *args, **options)


@pytest.fixture
def talk(board):
    """A host without manners to a still board of each kind."""
    return boards.Talk(board())


@pytest.fixture
def nothing_is_left():
    yield
    deadline = time.monotonic() + 3
    while time.monotonic() < deadline and ours():
        time.sleep(0.02)
    assert ours() == []
    assert multiprocessing.active_children() == []
