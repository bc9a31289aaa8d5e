"""What a diagnosis says, and its JSON form ``scpjax.diagnosis/1``."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Any, Literal

import numpy as np

from scpjax.diagnose.proposal import NextExperiment
from scpjax.fit.result import Estimate, Trace
from scpjax.physics.model import Model

Verdict = Literal["adequate", "explained", "unexplained"]
CLEARLY = 10.0
"""Difference of BIC (5 nats) from which one law is clearly ahead of another."""


@dataclass(frozen=True)
class Scores:
    """Scores per column (file column, in the file's unit): ``{"temperature_degC": {"rmse":, "nrmse":, "mae":}}``."""

    model: str
    train: dict[str, dict[str, float]]
    held_out: dict[str, dict[str, float]]
    noise: dict[str, float]


@dataclass(frozen=True)
class Window:
    """A stretch of a recording and its share of all misfit in excess of the noise."""

    recording: str
    start_s: float
    end_s: float
    share: float


@dataclass(frozen=True)
class Location:
    """Where base model and recordings part."""

    subsystem: str
    column: str
    windows: tuple[Window, ...] = ()
    regimes: dict[str, float] = field(default_factory=dict)
    depends_on: tuple[tuple[str, float], ...] = ()  # (variable, strength 0..1), strongest first
    whiteness: dict[str, float] = field(default_factory=dict)  # p-value per column: residuals are white
    input_independence: dict[str, float] = field(default_factory=dict)  # p-value: independent of past input
    period_s: float | None = None  # with which what nothing explains swings, whatever the drive does
    period_m: float | None = None  # of displacement, after which what nothing explains repeats


FREE = "free form"
"""What the law of a mechanism is called that goes by a learned curve."""


@dataclass(frozen=True)
class Reference:
    """A fixed number, in SI, that parameters are stated for: the excess temperature of which a drift is a share."""

    value: float
    unit: str
    symbol: str


@dataclass(frozen=True)
class Named:
    """A mechanism that the evidence supports. ``probability``: by the evidence against the others and none, times how
    often names of such a verdict were right (`scpjax.diagnose.answer.TRUSTED`). ``as_well``: terms that no mechanism of
    the catalogue is and that predict the same here, as "heat lost = T s(x)". ``by_recording``: parameters of which each
    recording has a value of its own ("drift@monday"); another recording is predicted with their mean. ``references``:
    the fixed numbers in which the parameters are stated, such as the temperature of which a drift is a share."""

    name: str
    title: str
    subsystem: str
    law: str
    probability: float
    parameters: dict[str, Estimate]
    equivalents: tuple[str, ...]
    says: str
    equation: str
    source: str
    as_well: tuple[str, ...] = ()
    by_recording: tuple[str, ...] = ()
    references: dict[str, Reference] = field(default_factory=dict)

    @property
    def stated(self) -> str:
        """For which fixed numbers its parameters are stated, in a sentence; empty where for none."""
        if not self.references:
            return ""
        return f"Stated for {', '.join(f'{r.symbol} = {r.value:.3g} {r.unit}' for r in self.references.values())}."

    @property
    def differs(self) -> str:
        """What differs by recording, in a sentence; empty where nothing does."""
        if not self.by_recording:
            return ""
        words = [p.replace("_", " ") for p in self.by_recording]
        listed = " and ".join(filter(None, (", ".join(words[:-1]), words[-1])))
        return f"It differs by recording ({listed}); another recording is predicted with the mean."


@dataclass(frozen=True)
class Ranked:
    """A mechanism tried: evidence when it is added to what had been named before it."""

    name: str
    delta_bic: float
    held_out_gain: float
    probability: float
    law: str = ""
    round: int = 1


@dataclass(frozen=True)
class Latent:
    """What is missing in one balance: ``mean`` with standard deviation ``std`` at ``time`` [s] of each recording, of
    what the base model's own parameters cannot take up: the misfit says nothing of the rest.

    ``evidence`` is the gain of the log marginal likelihood over nothing missing, in nats; ``explained`` the share of
    the sum of squares that it takes away; ``depends_on`` how much of it a smooth function of each variable explains.
    """

    subsystem: str
    place: str  # "heat", "heat_antagonist", "force", "temperature reading", ...
    unit: str
    evidence: float
    explained: float
    length_s: float
    time: tuple[np.ndarray, ...]
    mean: tuple[np.ndarray, ...]
    std: tuple[np.ndarray, ...]
    depends_on: tuple[tuple[str, float], ...]
    leading: tuple[np.ndarray, ...] = ()  # the first of ``depends_on`` at ``time``; SI, temperature above ambient


@dataclass(frozen=True)
class Drawn:
    """A curve of a closure: ``product`` ("T s(x)") with s in ``unit``, its values and standard deviations at places
    ``at`` of the ``variable``, in ``at_unit``; ``expression``, whose values are ``near``, comes close to it with that
    ``share`` of its variation."""

    variable: str
    at_unit: str
    product: str
    unit: str
    at: np.ndarray
    value: np.ndarray
    std: np.ndarray
    expression: str
    near: np.ndarray
    share: float


@dataclass(frozen=True)
class Closure:
    """A learned closure: ``expression`` with its units, what it ``depends_on`` and how much better it predicts;
    ``curve``, where it is one and no sum of terms; ``equivalents``: other forms that predict the same here;
    ``in_a_sentence``: what it is for the verdict, where the whole expression is too long for one."""

    subsystem: str
    place: str
    depends_on: tuple[str, ...]
    expression: str
    terms: dict[str, Estimate]
    held_out_gain: float
    delta_bic: float
    curve: Drawn | None = None
    equivalents: tuple[str, ...] = ()
    in_a_sentence: str = ""


@dataclass(frozen=True, kw_only=True)
class Diagnosis:
    """The whole answer. ``says`` is the verdict in one sentence."""

    verdict: Verdict
    says: str
    base: Scores
    extended: Scores
    location: Location
    mechanisms: tuple[Named, ...]
    ranking: tuple[Ranked, ...]
    closure: Closure | None = None
    missing: tuple[Latent, ...] = ()  # what each balance or sensor would have to add, best evidence first
    base_parameters: dict[str, Estimate]  # of the extended model, by key
    not_identifiable: tuple[str, ...]
    notes: tuple[str, ...]
    model: Model
    base_model: Model
    traces: tuple[Trace, ...]
    seconds: float
    settings: dict[str, Any]
    next_experiment: NextExperiment | None = None

    def only_by_form(self, m: Named) -> tuple[str, ...]:
        """Equivalents of the only name that its law, as the catalogue has it, is clearly ahead of: what they leave more
        of the misfit is what a law's form may decide. None of a name beside others, which is compared beside them, of
        one by a curve, and in a base of the user's own, where no round compares the same.
        """
        if len(self.mechanisms) != 1 or m.law == FREE or self.model.structure.system:
            return ()
        first = {r.name: r.delta_bic for r in self.ranking if r.round == 1}
        return tuple(e for e in m.equivalents if e in first and first.get(m.name, -np.inf) - first[e] >= CLEARLY)

    def to_json(self) -> dict[str, Any]:
        """Plain values only, in the form of the contract; more keys than it asks for, none fewer."""
        return {
            "schema": "scpjax.diagnosis/1",
            "verdict": self.verdict,
            "says": self.says,
            "base": _scores(self.base),
            "extended": _scores(self.extended),
            "location": {
                "subsystem": self.location.subsystem,
                "column": self.location.column,
                "windows": [vars(w) for w in self.location.windows],
                "regimes": self.location.regimes,
                "depends_on": [{"variable": v, "strength": s} for v, s in self.location.depends_on],
                "whiteness_p": self.location.whiteness,
                "input_independence_p": self.location.input_independence,
                "period_s": self.location.period_s,
                "period_m": self.location.period_m,
            },
            "mechanisms": [
                {
                    "name": m.name,
                    "law": m.law,
                    "subsystem": m.subsystem,
                    "probability": m.probability,
                    "parameters": {k: e.to_dict() for k, e in m.parameters.items()},
                    "equivalents": list(m.equivalents),
                    "equivalents_by_form": list(self.only_by_form(m)),
                    "as_well": list(m.as_well),
                    "by_recording": list(m.by_recording),
                    "references": {k: {"value": r.value, "unit": r.unit} for k, r in m.references.items()},
                    "says": m.says,
                    "equation": m.equation,
                    "source": m.source,
                }
                for m in self.mechanisms
            ],
            "ranking": [vars(r) for r in self.ranking],
            "parameters": {k: e.to_dict() for k, e in self.base_parameters.items()},
            "not_identifiable": list(self.not_identifiable),
            "closure": None if self.closure is None else _closure(self.closure),
            "missing": [_latent(latent) for latent in self.missing],
            "next_experiment": None if self.next_experiment is None else self.next_experiment.to_json(),
            "notes": list(self.notes),
            "seconds": self.seconds,
            "settings": self.settings,
        }


def _scores(s: Scores) -> dict[str, Any]:
    return {"model": s.model, "train": s.train, "held_out": s.held_out, "noise": s.noise}


def _closure(c: Closure) -> dict[str, Any]:
    return {
        "subsystem": c.subsystem,
        "place": c.place,
        "depends_on": list(c.depends_on),
        "expression": c.expression,
        "in_a_sentence": c.in_a_sentence or c.expression,
        "held_out_gain": c.held_out_gain,
        "delta_bic": c.delta_bic,
        "terms": {k: e.to_dict() for k, e in c.terms.items()},
        "curve": None if c.curve is None else _drawn(c.curve),
        "equivalents": list(c.equivalents),
    }


def _drawn(d: Drawn) -> dict[str, Any]:
    return {
        "product": d.product,
        "variable": d.variable,
        "variable_unit": d.at_unit,
        "unit": d.unit,
        "at": d.at.tolist(),
        "value": d.value.tolist(),
        "std": d.std.tolist(),
        "expression": d.expression,
        "share": d.share,
    }


def _latent(latent: Latent) -> dict[str, Any]:
    return {
        "subsystem": latent.subsystem,
        "place": latent.place,
        "unit": latent.unit,
        "evidence_nats": latent.evidence,
        "explained": latent.explained,
        "depends_on": [{"variable": v, "strength": s} for v, s in latent.depends_on],
    }
