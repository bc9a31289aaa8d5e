"""How long other explanations are sought. What was found by then is told, and that more was left untried."""

from __future__ import annotations

import math
import time

_LATE = 1.5  # times as long as is searched, unless told


class Patience:
    """``over()`` says whether ``seconds`` have passed since it was made; ``late()`` whether ``most`` have, half as many
    more unless told. ``ended`` and ``cut_short`` tell whether either left anything.
    """

    def __init__(self, seconds: float = math.inf, most: float | None = None):
        self.seconds, self.most = seconds, _LATE * seconds if most is None else most
        self.ended, self.cut_short = False, False
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

    def late(self) -> bool:
        """Asked before each thing that comes after the search and may be left: it then is."""
        if self.passed() < self.most:
            return False
        self.cut_short = True
        return True

    def allows(self, seconds: float) -> bool:
        """Whether so much of it is left."""
        return self.passed() + seconds < self.seconds

    def notes(self) -> tuple[str, ...]:
        """What to tell the user of what was left."""
        told = ()
        if self.ended:
            told = (
                f"the search was ended after {_minutes(self.seconds)}, away from the noise: other names, or more of "
                "them, were left untried; --minutes gives it longer",
            )
        if self.cut_short:
            told += (
                f"after {_minutes(self.most)} what was left to do was cut short: names set against what "
                "could stand in their place, what no name explains, and how well the last fits are filtered and "
                "resolved; --minutes gives all of it longer",
            )
        return told


def _minutes(seconds: float) -> str:
    return f"{seconds / 60:.3g} minute{'' if seconds == 60 else 's'}"


ENDLESS = Patience()
