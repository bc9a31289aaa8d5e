"""Is the drive that stands in a row the one that was applied until then? Many a logger reads after it has driven."""

from __future__ import annotations

from collections.abc import Callable, Sequence

import numpy as np

from scpjax.diagnose.holdout import Split
from scpjax.diagnose.hypothesis import State
from scpjax.diagnose.patience import ENDLESS, Patience
from scpjax.diagnose.remainder import AT_NOISE, level
from scpjax.errors import FitError, RecordingError
from scpjax.recordings.plausible import LOOK
from scpjax.recordings.recording import Recording
from scpjax.recordings.sidecar import NEXT

_TOLD = LOOK + (
    "were the drive in each row that which was applied until its time, not from it on, the base model alone would miss "
    "by {left:.2f} times the noise in place of {now:.2f}: if what recorded it reads after it has driven, write "
    'hold = "{next}" under [recording] in the .toml beside it and diagnose again'
)


def drive_until_then(
    base: State,
    parts: Split,
    recordings: Sequence[Recording],
    fitted: Callable[[list[Recording]], tuple[Split, State]],
    patience: Patience = ENDLESS,
) -> tuple[str, ...]:
    """A note where the base model misses the recordings, and does not if their drive is taken a row earlier; ``fitted``
    gives the base model's fit to others, and their parts. Late by ``patience`` it is not asked.
    """
    held = all(r.hold == "zero_order" for r in recordings)
    if base.setup.structure.system or not held or level(base, parts) <= AT_NOISE:
        return ()
    if patience.late("whether the drive stands a row too late"):
        return ()
    earlier = [r.with_inputs(np.concatenate([r.inputs[1:], r.inputs[-1:]])) for r in recordings]
    try:
        its, state = fitted(earlier)
    except (
        FitError,
        RecordingError,
    ):  # as where the drive changes after the first row only: then it would not change at all
        return ()
    left = level(state, its)
    return () if left > AT_NOISE else (_TOLD.format(left=left, now=level(base, parts), next=NEXT),)
