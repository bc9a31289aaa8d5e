"""How long other explanations are sought. What was found by then is told, and that more was left untried."""

from __future__ import annotations

import math
import time

_LATE, _LEAST = 0.5, 60.0  # times as long as is searched, and seconds at least, that are left for what comes after it


class Patience:
    """``over()`` says whether ``seconds`` have passed since it was made; ``late()`` whether ``most`` have: half as many
    more, and a minute at least, unless told. ``ended`` and ``cut_short`` tell what either left.
    """

    def __init__(self, seconds: float = math.inf, most: float | None = None):
        self.seconds = seconds
        self.most = seconds + max(_LATE * seconds, _LEAST) if most is None else most
        self.ended = False
        self.cut_short: dict[str, None] = {}  # in order
        self._began = time.monotonic()

    def passed(self) -> float:
        """Seconds since it was made."""
        return time.monotonic() - self._began

    def over(self) -> bool:
        """Asked before each thing that may be left for the answer to be sought no longer: it then is."""
        if self.passed() < self.seconds:
            return False
        self.ended = True
        return True

    def late(self, what: str) -> bool:
        """Asked before each thing that comes after the search and may be left: it then is, which the user is told."""
        if self.passed() < self.most:
            return False
        self.cut_short[what] = None
        return True

    def allows(self, seconds: float) -> bool:
        """Whether so much of it is left."""
        return self.passed() + seconds < self.seconds

    def notes(self) -> tuple[str, ...]:
        """What to tell the user of what was left."""
        told = ()
        if self.ended:
            told = (
                f"the search was ended after {_minutes(self.seconds)}, still away from the noise: other names, or more "
                "of them, were left untried; --minutes gives it longer",
            )
        if self.cut_short:
            told += (
                f"after {_minutes(self.most)} this was left out or cut short: {'; '.join(self.cut_short)}; --minutes "
                "gives all of it longer",
            )
        return told


def _minutes(seconds: float) -> str:
    return f"{seconds / 60:.3g} minute{'' if seconds == 60 else 's'}"


ENDLESS = Patience()
WHAT_NO_NAME_EXPLAINS = "learning what no name explains"
