"""Files of a user's own that must be refused."""

from collections.abc import Callable
from pathlib import Path

import pytest

from scpjax.errors import ModelError
from scpjax.physics.catalogue import catalogue


def assert_refused(read: Callable[[Path], object], folder: Path, text: str, words: str) -> None:
    """A file of that text is refused in one line that names it and says these words, and leaves nothing behind."""
    file = folder / "mine.py"
    file.write_text(text)
    before = catalogue()
    with pytest.raises(ModelError) as raised:
        read(file)
    assert words in str(raised.value)
    assert str(raised.value).startswith(str(file))
    assert "\n" not in str(raised.value)
    assert catalogue() == before
