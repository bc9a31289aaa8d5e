"""Which of two hypotheses is better?"""

from types import SimpleNamespace

import numpy as np
import pytest

from scpjax.diagnose import evidence
from scpjax.diagnose.evidence import Comparison, Evidence


@pytest.mark.parametrize(
    ("gain", "held_out", "better"), [(5.0, 0.1, True), (5.0, -0.1, False), (-5.0, 0.1, False), (0.0, 0.1, False)]
)
def test_the_better_has_more_evidence_and_predicts_better(monkeypatch, gain, held_out, better):
    state = SimpleNamespace(trial=SimpleNamespace(active=np.zeros(3)))
    asked = Comparison(None, "", "", gain, held_out, 0.0, 0.0, False)  # type: ignore[arg-type]
    monkeypatch.setattr(evidence, "compare", lambda *_: asked)
    assert evidence.is_better(state, state, None, Evidence()) == better  # type: ignore[arg-type]
