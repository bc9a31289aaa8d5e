"""The page: what was asked and what came of it, as Markdown, with figures beside it."""

from __future__ import annotations

import math
import os
from collections import Counter
from collections.abc import Mapping, Sequence
from pathlib import Path

import numpy as np

from fits.concealed.effects.foreign import HELD
from fits.concealed.figures import draw_calibration, draw_confusion, draw_kept
from fits.concealed.score import GOOD, HARMLESS, Score
from fits.concealed.tally import NEAR, by_method, by_verdict, calibration, goals, median, named_and_judged

Others = Mapping[str, Mapping[str, float]]
_WHAT = """\
Recordings were made by code of its own (`fits/concealed`, scipy's LSODA, laws written out there and partly other ones
than the catalogue's), with physics concealed in them that the base model does not have. What it was, was sealed by
sha256 before anything was diagnosed. The engine saw the given files; other files, driven differently, were kept back.
Strength is the misfit of the best base model over the noise: weak 1.2 to 3, moderate to 8.5, strong above; of
several effects, of the one that is weakest alone. Below 1.2 nothing can be seen (`unseen`).
"Foreign" are single effects under laws that the catalogue does not hold; of those chosen,
{held}
are its own (the dead time was already, two stores are since a case under them had gone wrong) and do not count towards
the goal for foreign laws. Some of the plan's other laws were none of the catalogue's either, and have come into it
since, after cases under them had been missed or predicted badly: a drive that comes through suddenly, a supply that
tires by what is asked of it, a spring that grows exponentially or nears its full length, a weight lifted off its
support, hysteresis of four plays, a pull that saturates more abruptly than one law of that had it. Also since the plan
was made: the toe of a tendon, a link that a joint raises, fatigue that sets in at a temperature, a curved resistance,
two layers behind one another.
"""


def write_page(
    folder: Path,
    scores: Sequence[Score],
    others: Others,
    *,
    commit: str,
    of: int,
    asked: Sequence[str] = (),
    first: Sequence[Score] = (),
) -> Path:
    """``concealed.md`` and ``concealed/*.svg`` in a folder; ``commit``: of all answers; ``first``: what was answered at
    first where a case was asked again.
    """
    pictures = folder / "concealed"
    pictures.mkdir(parents=True, exist_ok=True)
    text = [
        "# Concealed physics: can it be named?\n",
        f"{len(scores)} of the plan's {of} cases (see [how it was made](#how-it-was-made)).\n",
        _WHAT.format(held=_held()),
        "## What was asked\n",
        *_goals(scores, commit, first),
        "## What was said\n",
        "A row is what was concealed, a column what was named (equivalents count as right).\n",
        f"![Confusion]({draw_confusion(scores, pictures)})\n",
        *_outcomes(scores),
        "## Files that were kept back\n",
        "Worst column and file of each case: RMSE of a free run over the noise. The baselines were told the noise and "
        "chose lags, degree, thresholds and smoothing on held-out stretches of the given files.\n",
        *_kept(scores, others),
        f"![Kept files]({draw_kept(scores, others, pictures)})\n",
        "## Are the probabilities true?\n",
        *_calibration(scores),
        f"![Calibration]({draw_calibration(scores, pictures)})\n",
        "## Minutes\n",
        *_minutes(scores),
        *_wrong(scores),
        *_made(asked, commit),
    ]
    path = folder / "concealed.md"
    part = folder / "concealed.part"
    part.write_text("\n".join(text) + "\n", encoding="utf-8", newline="\n")
    os.replace(part, path)
    return path


def _held() -> str:
    """Laws that were foreign."""
    return ", ".join(f"`{effect}: {law}`" for effect, law in sorted(HELD))


def _made(asked: Sequence[str], commit: str) -> list[str]:
    """The commands and the commits."""
    commands = [f"- `{f'python fits/concealed/run.py {options}'.strip()}`" for options in asked or [""]]
    stopped = (
        "Of a run that was stopped, what it had answered by then counts (`fits/concealed/seen.txt` tells of some). "
        "`--unseen` left out what stood in that file at the commit of the run, so today it chooses other cases: which "
        "were asked, and of which commit, is in `concealed/results.json`, and `--only NAME` asks one again."
    )
    return ["## How it was made\n", *commands, f"\n{stopped} Commits of the package: {commit}.\n"]


def _table(header: Sequence[str], rows: Sequence[Sequence[object]]) -> str:
    lines = [f"| {' | '.join(header)} |", f"|{'---|' * len(header)}"]
    return "\n".join([*lines, *(f"| {' | '.join(map(str, row))} |" for row in rows)]) + "\n"


def _goals(scores: Sequence[Score], commit: str, first: Sequence[Score]) -> list[str]:
    rows = []
    new = [*(s for s in scores if s.first), *first]
    for g, unseen in zip(goals(scores), goals(new), strict=True):
        low, high = g.interval()
        sign = "at most" if g.at_most else "at least"
        share = f"{g.hits} of {g.of}, {g.told} ({low:.0%} to {high:.0%})" if g.of else "no such case"
        apart = f"{unseen.hits} of {unseen.of}" if unseen.of else ""
        rows.append((g.title, f"{sign} {g.asked:.0%}", share, apart, {True: "yes", False: "**no**", None: ""}[g.met]))
    by = ", ".join(c for c in commit.split(", ") if c in {s.commit for s in new})
    say = (
        f"Of {len(new)} cases it is noted that the engine was asked them for the first time{by and f' ({by})'}; they "
        f"are counted apart, too, with what was said then: {len(first)} of them were asked again since, and count with "
        "their last answer elsewhere. Of the others that was not noted, or it had been run on them before. It was "
        "changed after most of either, with some in view: `fits/concealed/seen.txt` tells.\n"
    )
    return [say, _table(("", "asked", "found (95 % interval)", "asked first", "met"), rows)]


def _outcomes(scores: Sequence[Score]) -> list[str]:
    order = (
        "right",
        "equivalent",
        "partly",
        "unnamed",
        "missed",
        "extra",
        "misnamed",
        "alarm",
        "false name",
        "misplaced",
    )
    there = [o for o in (*order, "failed") if any(s.outcome == o for s in scores)]
    rows = []
    for sort in ("single", "foreign", "pair", "triple", "null", "outside"):
        for tier in ("strong", "moderate", "weak", "unseen", "none"):
            chosen = Counter(s.outcome for s in scores if s.sort == sort and s.tier == tier)
            if chosen:
                rows.append((sort, "" if tier == "none" else tier, chosen.total(), *(chosen[o] or "" for o in there)))
    return [_table(("", "strength", "cases", *there), rows)]


def _kept(scores: Sequence[Score], others: Others) -> list[str]:
    methods, common = by_method(scores, others)
    rows = []
    for sort in ("null", "single", "foreign", "pair", "triple", "outside"):
        names = [s.name for s in scores if s.sort == sort]
        mine = {m: [n for n in names if n in errors] for m, errors in methods.items()}
        rows += [_error_row(sort, m, [methods[m][n] for n in given]) for m, given in mine.items() if given]
        both = [n for n in names if n in common]
        if both and any(given and given != both for given in mine.values()):
            rows += [
                _error_row(f"{sort}, given to all", m, [methods[m][n] for n in both])
                for m, given in mine.items()
                if given
            ]
    return [_table(("", "method", "cases", "median", "90 %", "within 1.15", "diverged"), rows)]


def _error_row(sort: str, method: str, errors: Sequence[float]) -> tuple[object, ...]:
    x = np.array(errors)
    far = int(np.sum(~np.isfinite(x)))
    return (sort, method, len(x), *(_number(v) for v in _quantiles(x)), f"{np.mean(x <= 1.15):.0%}", far or "")


def _quantiles(x: np.ndarray) -> tuple[float, float]:
    ordered = np.sort(x)
    return float(ordered[(len(x) - 1) // 2]), float(ordered[math.ceil(0.9 * (len(x) - 1))])


def _number(x: float) -> str:
    return f"{x:.2f}" if math.isfinite(x) else "diverged"


def _calibration(scores: Sequence[Score]) -> list[str]:
    bins, gap = calibration(pair for s in scores for pair in s.believed)
    if not bins:
        return ["Nothing was named.\n"]
    rows = [(f"{b.believed:.1%}", f"{b.right:.1%}", b.number) for b in bins]
    trusted = [(verdict, right, of) for verdict, (right, of) in by_verdict(scores).items()]
    return [
        f"Names given: mean gap between probability and truth {100 * gap:.1f} points (asked: at most 5).\n",
        _table(("probability said", "share that was right", "names"), rows),
        _table(("verdict", "names that were right", "of"), trusted),
    ]


def _minutes(scores: Sequence[Score]) -> list[str]:
    x = [s.minutes for s in scores if math.isfinite(s.minutes)]
    if not x:
        return [""]
    return [
        f"Diagnosis of a case: median {median(x):.2f}, nine in ten under {float(np.quantile(x, 0.9)):.2f}, "
        f"longest {max(x):.2f}; {sum(x):.0f} in all.\n"
    ]


def _wrong(scores: Sequence[Score]) -> list[str]:
    """Every case that was not as it should be, so that nobody has to look for them."""
    rows = []
    for s in scores:
        fine = HARMLESS if s.sort in ("single", "foreign") and s.tier in ("weak", "unseen") else GOOD
        if s.outcome not in fine:
            said = " + ".join(s.named) or s.verdict or s.error
            rows.append((f"`{s.name}`", s.label, f"{s.misfit:.1f}", s.outcome, said))
    text = [_table(("case", "", "misfit", "outcome", "said"), rows)] if rows else []
    far = sorted((s for s in scores if named_and_judged(s) and s.kept > NEAR), key=lambda s: -s.kept)
    if far:
        rows = [(f"`{s.name}`", s.label, s.verdict, " + ".join(s.named), _number(s.kept)) for s in far]
        text.append(f"Named right, but with kept files beyond {NEAR} of the noise:\n")
        text.append(_table(("case", "", "verdict", "said", "kept files"), rows))
    return ["## Not as it should be\n", *text] if text else []
