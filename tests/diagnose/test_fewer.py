"""A name that only made up for another one's differing by recording is not kept; one that is there is."""

from functools import cache

import numpy as np
from diagnose.heated import base_of, recorded
from diagnose.test_own import DRIVES, warmer

from scpjax.diagnose.evidence import Evidence
from scpjax.diagnose.fewer import fewer
from scpjax.diagnose.holdout import Split
from scpjax.diagnose.hypothesis import State
from scpjax.diagnose.remainder import AT_NOISE, level
from scpjax.diagnose.rivals import added


def settling(size: float):
    """What the sensor of the displacement is off by [mm] as it warms up."""
    return lambda time: size * -np.expm1(-time / 30.0)


@cache
def fitted(which: str) -> tuple[State, Split]:
    time = np.arange(len(DRIVES[0])) * 0.1
    sizes = {"differs": (0.05, 0.09, 0.13), "shared, and a loss": (0.2, 0.2, 0.2)}[which]
    heat = warmer(0.6 if which == "shared, and a loss" else 0.0)
    drives = enumerate(zip(sizes, DRIVES, strict=True))
    return base_of(*(recorded(heat, settling(s)(time), seed=i, drive=d) for i, (s, d) in drives))


def test_what_differs_by_recording_stands_alone():
    base, parts = fitted("differs")
    both = added(added(base, "sensor_drift", parts), "creep", parts)
    assert level(both, parts) < AT_NOISE < 1.5 < level(base, parts)
    alone = fewer(both, parts, Evidence())
    assert alone.names == ("sensor_drift",)
    assert alone.setup.structure.own
    assert level(alone, parts) < AT_NOISE


def test_what_is_there_as_well_stays():
    base, parts = fitted("shared, and a loss")
    both = added(added(base, "nonlinear_heat_loss", parts), "sensor_drift", parts)
    assert level(both, parts) < AT_NOISE
    assert fewer(both, parts, Evidence()) is both
