"""What little of a misfit that stands out goes, must not go by the errors of long steps."""

from dataclasses import dataclass, replace
from types import SimpleNamespace

import numpy as np
import pytest

from scpjax.diagnose import worth
from scpjax.diagnose.evidence import Evidence

N = 100
ONE = np.ones((1, N, 1))


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

    @property
    def is_train(self):
        return ONE > 0

    @property
    def is_held(self):
        return ONE < 0


def level(rms):
    return SimpleNamespace(residual=rms * ONE, trial=f"{rms}", setup=None)


def is_worth(monkeypatch, before, after, *, base, halved, finer):
    """Of levels before and after by steps as they are; ``halved``: after, unfitted; ``finer``: both, fitted again."""
    fitted = []

    def residual_on(trial, data, setup):
        if data.parts == 2:
            return halved * ONE
        return finer[trial != f"{before}"] * ONE

    def refine(setup, data, trial):
        fitted.append(trial)
        return trial, True, 0.0

    monkeypatch.setattr(worth, "residual_on", residual_on)
    monkeypatch.setattr(worth, "refine", refine)
    monkeypatch.setattr(worth, "State", lambda setup, trial, residual, cost: SimpleNamespace(residual=residual))
    rules = replace(Evidence(), worth=0.015, share=0.2)
    return worth.worthwhile(level(before), level(after), level(base), Parts(), rules), fitted


def test_a_share_of_the_whole_is_enough(monkeypatch):
    assert is_worth(monkeypatch, 9.0, 5.0, base=20.0, halved=np.nan, finer=()) == (True, [])


def test_little_of_the_whole_must_stand_out(monkeypatch):
    assert is_worth(monkeypatch, 9.0, 5.0, base=900.0, halved=np.nan, finer=()) == (False, [])


def test_what_stands_out_is_spoken_of_where_steps_do_not_matter(monkeypatch):
    assert is_worth(monkeypatch, 35.0, 29.0, base=900.0, halved=29.1, finer=()) == (True, [])


@pytest.mark.parametrize(("finer", "goes"), [((35.0, 29.5), True), ((35.0, 34.4), False), ((29.5, 29.0), False)])
def test_what_goes_by_long_steps_must_go_by_shorter_ones(monkeypatch, finer, goes):
    found, fitted = is_worth(monkeypatch, 35.0, 29.0, base=900.0, halved=38.0, finer=finer)
    assert found is goes
    assert sorted(fitted) == ["29.0", "35.0"]
