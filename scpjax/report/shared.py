"""What a fleet shares, as its page and its file tell it."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Any

from scpjax.diagnose.fleet import Spread
from scpjax.diagnose.shared_effect import HAS_IT, HAS_NOT, OPEN, SharedEffect, Sharing
from scpjax.fit.result import Estimate
from scpjax.report import page
from scpjax.report.numbers import interval, number, unit
from scpjax.report.pieces import title

_SHARED = (
    "An effect named in two actuators or more is fitted once more to all of these at once: each with a base of its "
    "own, the effect with the same values in all. ΔBIC: for the same values against each its own. p: of values that "
    "differ as much or more if all had the same (likelihood ratio). Held-out error: of all, over the noise, each "
    "with its own values → with the shared ones. Where an effect was not named it is asked for with the shared values, "
    "none of them fitted there; it may have one of another size."
)
_LEFT_OUT = "Not asked:"


def section(shared: Sharing) -> list[str]:
    """What one set of values does for all, and what it says of those in which the effect was not named."""
    rows = []
    for e in shared.effects:
        values = "; ".join(
            f"{k.replace('_', ' ')} {number(v.value)} ({interval(v.low, v.high)}) {unit(v.unit)}".rstrip()
            for k, v in e.parameters.items()
        )
        all_ = f"{len(e.actuators)}" + (f", apart: {', '.join(e.apart)}" if e.apart else "")
        chance = "< 0.001" if e.p < 1e-3 else f"{e.p:.3f}"
        held = " → ".join(f"{h:.3f}" if math.isfinite(h) else "–" for h in e.held_out)
        one = "yes" if e.is_shared else "no" if e.differs else "open"
        where = "; ".join(f"{says}: {', '.join(n)}" for says in (HAS_IT, HAS_NOT, OPEN) if (n := e.having(says)))
        name = title(e.name) + (f" ({e.law})" if e.law else "")
        rows.append((name, all_, one, values, number(e.delta_bic), chance, held, where or "–"))
    left = [f"{name}: {why}" for name, why in shared.left_out.items()]
    beside = [page.text(_LEFT_OUT, "small soft"), page.bullets(left)] if left else []
    if not rows:
        return beside
    head = (
        "Effect",
        "Served",
        "One for all",
        "Shared values (95 %)",
        "ΔBIC",
        "p",
        "Held-out error",
        "Where it was not named",
    )
    return [page.table(head, rows, (4, 5), tight=(2, 6)), page.text(_SHARED, "small soft"), *beside]


def shared_values(found: Sequence[Spread], shared: Sharing) -> dict[str, Estimate]:
    """Shared values by the keys of the parameters' spreads, where both are stated for the same."""
    out = {}
    for s in found:
        mechanism, _, name = s.key.split(" (")[0].partition(".")
        for e in shared.effects:
            same = all(math.isclose(r["value"], e.references.get(k, math.nan)) for k, r in s.references.items())
            if e.is_shared and e.name == mechanism and s.law == e.law and name in e.parameters and same:
                out[s.key] = e.parameters[name]
    return out


def plain(e: SharedEffect) -> dict[str, Any]:
    """For JSON."""
    return {
        "name": e.name,
        "law": e.law,
        "is_shared": e.is_shared,
        "actuators": list(e.actuators),
        "apart": list(e.apart),
        "parameters": {k: v.to_dict() for k, v in e.parameters.items()},
        "references": dict(e.references),
        "delta_bic": e.delta_bic,
        "p": e.p,
        "held_out": dict(zip(("own", "shared"), e.held_out, strict=True)),
        "elsewhere": {name: vars(other) for name, other in e.elsewhere.items()},
    }
