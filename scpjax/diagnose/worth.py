"""Whether enough of the base model's misfit goes to speak of another effect, and not by the errors of long steps."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from scpjax.abreast import abreast
from scpjax.diagnose.evidence import Evidence, excess
from scpjax.diagnose.final import fitted_finer
from scpjax.diagnose.holdout import Split
from scpjax.diagnose.hypothesis import State, residual_on

_PLAIN = 100.0  # mean square, in units of the noise's, that is no matter of a law's form
_PARTS = 4  # of a step, by which what little it is must go, too
_UNCHANGED = 0.1  # of what goes, by which halving the steps may change it


def worthwhile(before: State, after: State, base: State, split: Split, rules: Evidence) -> bool:
    """Whether enough of the base model's misfit goes, in some column, to speak of another effect.

    Where tenfold the noise is left, a share of that is enough, however little of the whole it is; unless it goes by the
    errors of steps as long as the samples alone: where so much stands out, these may, too.
    """
    left = excess(before, split)
    gone = left - excess(after, split)
    if np.any(gone > rules.worth * excess(base, split)):
        return True
    plain = (left > _PLAIN) & (gone > rules.share * left)
    return bool(plain.any()) and _goes_by_shorter_steps(before, after, split, gone, plain, rules.share)


def _goes_by_shorter_steps(
    before: State, after: State, split: Split, gone: np.ndarray, plain: np.ndarray, share: float
) -> bool:
    """Whether ``after``, by shorter steps and both fitted with them, still takes a ``share`` of what is left, tenfold
    the noise, before it. Nothing is fitted where halving the steps hardly changes what is ``gone`` from columns that
    are ``plain``; nothing goes from what blows up.
    """
    halved = split.whole.finer(2)
    left, less = (excess(replace(s, residual=residual_on(s.trial, halved, s.setup)), split) for s in (before, after))
    if np.all(np.abs(left - less - gone)[plain] < _UNCHANGED * gone[plain]):
        return True
    fitted = abreast(lambda s: fitted_finer(s, split, _PARTS), (before, after))
    (fine, worse), (_, better) = fitted
    if worse is None or better is None:
        return False
    left, less = excess(worse, fine), excess(better, fine)
    return bool(np.any((left - less > share * left) & (left > _PLAIN)))
