"""How long other explanations are sought. What was found by then is told, and that more was left untried."""

from __future__ import annotations

import math
import time


class Patience:
    """``over()`` says whether ``seconds`` have passed since it was made; ``ended``, whether it left anything."""

    def __init__(self, seconds: float = math.inf):
        self.seconds, self.ended = seconds, False
        self._until = time.monotonic() + seconds

    def over(self) -> bool:
        """Asked before each thing that may be left: it then is."""
        if time.monotonic() < self._until:
            return False
        self.ended = True
        return True

    def allows(self, seconds: float) -> bool:
        """Whether so much of it is left."""
        return time.monotonic() + seconds < self._until

    def notes(self) -> tuple[str, ...]:
        """What to tell the user of what was left."""
        if not self.ended:
            return ()
        minutes = f"{self.seconds / 60:.3g} minute{'' if self.seconds == 60 else 's'}"
        return (
            f"the search was ended after {minutes}, away from the noise: other names, or more of them, were left "
            "untried; --minutes gives it longer",
        )
