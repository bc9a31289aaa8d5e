"""One fixture for all boards."""

import boards
import pytest


@pytest.fixture(params=boards.KINDS)
def board(request):
    """A function that makes a board of each kind."""
    return lambda *args, **options: boards.make(request.param, *args, **options)


@pytest.fixture
def talk(board):
    """A host without manners to a still board of each kind."""
    return boards.Talk(board())
