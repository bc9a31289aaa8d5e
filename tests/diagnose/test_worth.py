"""What little of a misfit that stands out goes, must not go by the errors of long steps."""

from dataclasses import dataclass

import numpy as np
import pytest

from scpjax.diagnose import final, worth
from scpjax.diagnose.evidence import Evidence
from scpjax.diagnose.hypothesis import State
from scpjax.fit.problem import CEILING


@dataclass(frozen=True)
class Data:
    """Simulated by so many steps a sample."""

    parts: int = 1

    def finer(self, factor):
        return Data(self.parts * factor)


@dataclass(frozen=True)
class Parts:
    train: Data = Data()
    whole: Data = Data()
    columns: int = 1

    @property
    def is_train(self):
        return np.ones((1, 100, self.columns), bool)

    @property
    def is_held(self):
        return ~self.is_train


def residuals(levels):
    return np.ones((1, 100, 1)) * np.atleast_1d(levels)


def is_worth(monkeypatch, *, base=900.0, before=35.0, after=29.0, halved=(), finer=()):
    """Of levels by steps as they are; ``halved``: before and after, unfitted; ``finer``: both, fitted again."""
    fitted = []

    def residual_on(trial, data, setup):
        return residuals((halved if data.parts == 2 else finer)[trial == "after"])

    def refine(setup, data, trial):
        assert data.parts == 4
        fitted.append(trial)
        return trial, True, 0.0

    for room in (worth, final):
        monkeypatch.setattr(room, "residual_on", residual_on)
    monkeypatch.setattr(final, "refine", refine)
    of = {"base": base, "before": before, "after": after}
    states = {name: State(None, name, residuals(level), 0.0) for name, level in of.items()}
    rules = Evidence(worth=0.015, share=0.2)
    parts = Parts(columns=np.size(base))
    return worth.worthwhile(states["before"], states["after"], states["base"], parts, rules), sorted(fitted)


def test_a_share_of_the_whole_is_enough(monkeypatch):
    assert is_worth(monkeypatch, base=20.0, before=9.0, after=5.0) == (True, [])


@pytest.mark.parametrize(("before", "after"), [(9.0, 5.0), (35.0, 34.0), (35.0, 36.0)])
def test_little_of_the_whole_must_stand_out_and_be_a_share_of_that(monkeypatch, before, after):
    assert is_worth(monkeypatch, before=before, after=after) == (False, [])


def test_what_stands_out_is_spoken_of_where_steps_do_not_matter(monkeypatch):
    assert is_worth(monkeypatch, halved=(35.1, 29.1)) == (True, [])


@pytest.mark.parametrize("halved", [(35.0, 35.1), (35.0, 29.9), (29.1, 29.0), (35.0, np.nan)])
@pytest.mark.parametrize(
    ("finer", "goes"),
    [
        ((35.0, 29.5), True),
        ((35.0, 33.0), False),
        ((29.5, 29.0), False),
        ((9.0, 5.0), False),
        ((CEILING, 29.0), False),
        ((35.0, CEILING), False),
    ],
)
def test_what_goes_by_long_steps_must_go_by_shorter_ones(monkeypatch, halved, finer, goes):
    assert is_worth(monkeypatch, halved=halved, finer=finer) == (goes, ["after", "before"])


def test_it_is_the_column_that_stands_out_of_which_a_share_goes(monkeypatch):
    whole = (900.0, 900.0)
    assert is_worth(monkeypatch, base=whole, before=(35.0, 9.0), after=(35.0, 5.0)) == (False, [])
    halved, finer = ((35.0, 9.0), (35.0, 5.0)), ((35.0, 9.0), (29.0, 9.0))
    assert is_worth(monkeypatch, base=whole, before=(35.0, 9.0), after=(29.0, 5.0), halved=halved, finer=finer)[0]
    stays = ((35.0, 9.0), (34.0, 5.0))
    assert not is_worth(monkeypatch, base=whole, before=(35.0, 9.0), after=(29.0, 5.0), halved=halved, finer=stays)[0]
