"""The thesis from its own numbers. Run ``python -m fits.thesis.run``.

Takes some minutes; ``--quick`` leaves the diagnosis out. Writes result.json, result.md and figures/ into this folder,
or ``--out``.
"""

from __future__ import annotations

import argparse
import itertools
import json
from collections.abc import Iterator, Sequence
from dataclasses import asdict
from pathlib import Path
from typing import Any

import jax
import numpy as np

from fits.thesis import figures, plant, steady, turning
from scpjax.diagnose.result import Diagnosis

HERE = Path(__file__).resolve().parent


def plant_lines(i: plant.Implied) -> Iterator[str]:
    """(a) in numbers: what the identified coefficients imply, beside what was measured."""
    yield "| from (4.4) by (3.15), SI | identified | measured (Table 4.14) |"
    yield "|---|---:|---:|"
    yield f"| thermal pole λ/C_th (1/s) | {i.thermal_pole:.3f} | {i.thermal_measured:.3f} |"
    yield f"| k from a1 (N/m) | {i.k_from_a1:.3f} | {i.k_measured:.2f} |"
    yield f"| k from a0 (N/m) | {i.k_from_a0:.3f} | {i.k_measured:.2f} |"
    yield f"| k from the complex pair, m ω² (N/m) | {i.k_from_pair:.3f} | {i.k_measured:.2f} |"
    yield f"| resonance of weight and coil (rad/s) | {i.pair_frequency:.2f} | {i.frequency:.1f} |"
    yield f"| its damping ratio | {i.pair_ratio:.2f} | {i.ratio_measured:.3f} |"
    yield f"| stretch of that spring under the load of 82.7 g (m) | {i.sag:.2f} | {i.sag_measured:.4f} |"
    yield f"| β from a2 (N s/m) | {i.damping:.4f} | {i.damping_measured:.4f} |"
    yield f"| C from b0, displacement in metres (N/K) | {i.coefficient:.2e} | {i.coefficient_printed:.2e} |"
    yield f"| C with which the measured k has the gain of (4.4) (N/K) | {i.coefficient_at_k:.4f} | |"
    thousandth, a1 = i.a1_by_thousandth
    yield f"| k/m + λβ/(C_th m) with a thousandth of the measured k, against a1 | {a1:.3f} (a1) | {thousandth:.3f} |"
    by_plant, by_table, measured = (1e3 * x for x in i.stroke)
    beside = f"by Table 4.14 {by_table:.1f}, seen {measured:.1f}"
    yield f"| displacement at 3.41 V for long (mm) | {by_plant:.1f} | {beside} |"
    yield ""
    yield (
        f"The complex pair stands for a mean delay of {i.pair_delay:.2f} s; the fastest oscillation that the recording "
        f"could show is {i.nyquist:.0f} rad/s."
    )


def stand_in_lines(found: Sequence[plant.StandIn]) -> Iterator[str]:
    """(a): what may stand behind the heat in place of the pair."""
    yield "What stands behind a pole of heat, fitted to what (4.4) does without noise; ΔBIC expected with 10 % of it:"
    yield ""
    yield "| behind the heat | its pole (1/s) | its numbers | RMSE (mm) | ΔBIC |"
    yield "|---|---:|---|---:|---:|"
    for f in found:
        pole = f"{f.pole:.3f}" + (" as measured" if f.held else "")
        values = ", ".join(f"{k} = {v:.3g}" if v > 1e-3 else f"{k} < 0.001" for k, v in f.values.items())
        yield f"| {f.name} | {pole} | {values} | {f.rmse:.3f} | {f.bic:.0f} |"


def diagnosis_lines(d: Diagnosis) -> Iterator[str]:
    """What the library says of recordings made by (4.4) when the mechanics are held as measured."""
    yield f"Diagnosis with k, m, β, R and C_th held as measured: {d.verdict}. {d.says}"
    for m in d.mechanisms:
        values = ", ".join(f"{k} = {e.value:.3g} ± {e.std:.2g} {e.unit}" for k, e in m.parameters.items())
        form = dict.fromkeys(d.only_by_form(m), " (only if its law has a slightly different form)")
        told = ", ".join(f"{e}{form.get(e, '')}" for e in m.equivalents)
        others = f"; not told from {told}" if told else ""
        yield f"- `{m.name}`: {values}; probability {m.probability:.2f}{others}"
    for column, before in d.base.held_out.items():
        after, noise = d.extended.held_out[column], d.base.noise[column]
        yield f"- held-out {column}: {before['rmse']:.3f} without, {after['rmse']:.3f} with it (noise {noise:.3f})"
    first = [r for r in d.ranking if r.round == 1][:4]
    tried = ", ".join(f"{r.name} {r.delta_bic:.0f} ({100 * r.held_out_gain:.0f} %)" for r in first)
    yield f"- fall of the BIC (and of the held-out error) by each alone: {tried}"
    places = ", ".join(f"{latent.place} {latent.evidence:.0f}" for latent in d.missing)
    yield f"- evidence that something is missing, by place (nats), before any name: {places}"
    for key in ("newton_cooling.conductance", "thermal_actuation.coefficient"):
        e = d.base_parameters[key]
        yield f"- {key} = {e.value:.4f} ± {e.std:.4f} {e.unit}"


def steady_lines(laws: Sequence[steady.Law], drawn: dict[tuple[str, ...], tuple[float, float, float]]) -> Iterator[str]:
    """(b) in numbers: every combination."""
    yield "| law | RMSE (mm) | voltage left out | actuator left out | ΔBIC | over actuators drawn anew | parameters |"
    yield "|---|---:|---:|---:|---:|---:|---|"
    names = {"hotter": "ln q", "loss": "n", "saturation": "d (1/V²)", "offset": "x0 (mm)"}
    for law in laws:
        mean, std, _ = drawn[law.factors]
        values = ", ".join(f"{names[k]} = {v:.2f} ± {law.std[k]:.2f}" for k, v in law.values.items())
        yield (
            f"| {law.name} | {law.rmse:.2f} | {law.voltage_left_out:.2f} | {law.actuator_left_out:.2f} | "
            f"{law.bic - laws[0].bic:.1f} | {mean:.1f} ± {std:.1f} | {values} |"
        )
    yield ""
    shares = ", ".join("{} {:.2f} to {:.2f}".format(f, *steady.share_of(f, laws)) for f in steady.FACTORS)
    yield f"Probability of each factor over all {len(laws)} combinations, before the data and by BIC weights: {shares}."
    exponent, error, (least, most) = steady.power()
    yield (
        f"As a power of the voltage: x grows as V^({exponent:.2f} ± {error:.2f}), the error over actuators drawn anew; "
        f"of single actuators {least:.2f} to {most:.2f}."
    )
    hot = next(law for law in laws if law.factors == ("copper", "hotter"))
    yield (
        f"Copper alone bends enough only if the wire were {steady.hottest(hot):.0f} K above ambient; at the 138 K of "
        f"Figure 3.8 its BIC is {steady.copper_at(138.0) - laws[0].bic:.0f} above the best."
    )


ALONE = ("kp",), ("kp", "kl", "delay"), ("kp", "kl", "lag")
"""Accounts of the joint that are told under every reading of the tables."""


def joint_lines(accounts: Sequence[turning.Account]) -> Iterator[str]:
    """(c): the best accounts, and every effect alone; the first is the best."""
    yield "| effects | RMSE (deg) | load pair left out | table left out: 4.9, 4.11, 4.12 | ΔBIC | parameters |"
    yield "|---|---:|---:|---|---:|---|"
    for a in accounts:
        values = ", ".join(f"{k} = {v:.3g} ± {a.std[k]:.2g} {turning.EFFECTS[k][1]}" for k, v in a.values.items())
        tables = ", ".join(f"{v:.1f}" for v in (a.tables or {}).values())
        yield (f"| {a.name} | {a.rmse:.2f} | {a.left_out:.2f} | {tables} | {a.bic - accounts[0].bic:.1f} | {values} |")


def single_lines() -> Iterator[str]:
    """(c): how far the actuator alone moves, twice, and what the times back to the start say."""
    factor, error = turning.single()
    steady_ = turning.single(supposed=turning.Supposed(steady=True))[0]
    yield f"C of the actuator alone, in units of Table 4.14's: {factor:.1f} ± {error:.1f} by its 5 s (Tables 4.5, 4.8),"
    yield f"{steady_:.1f} by what it does for long (Table 4.4)."
    for supposed, name in ((turning.SUPPOSED, "5 s"), (turning.Supposed(steady=True), "what it does for long")):
        ratio = np.median(turning.MEASURED / turning.said({}, supposed=supposed))
        yield f"With C by {name} (3.11) turns too far: the median of measured over said is {ratio:.2f}."
    yield ""
    yield f"Times back to the start (Tables 4.11, 4.12), by what the eye still sees; C_th/λ is {turning.TAU:.2f} s:"
    yield ""
    yield "| smallest angle seen (deg) | dead time (s) | time constant (s) | RMSE (s) |"
    yield "|---:|---:|---:|---:|"
    for smallest, delay in itertools.product((0.25, 0.5, 1.0, 2.0), (0.0, 2.4)):
        tau, spread, left = turning.cooling_time(smallest, delay)
        yield f"| {smallest} | {delay} | {tau:.1f} ± {spread:.1f} | {left:.1f} |"


def reading_lines() -> Iterator[str]:
    """(c): the same under what else the tables may mean, and each table by itself."""
    yield "Under other readings of the tables (ΔBIC to the best account of the same reading; C not fitted):"
    yield ""
    yield "| reading | effects | RMSE (deg) | ΔBIC | parameters |"
    yield "|---|---|---:|---:|---|"
    names = {
        turning.Supposed(steady=True): "C by what the actuator does for long",
        turning.Supposed(from_rest=True): "Table 4.9's angles are turns from rest",
    }
    for supposed, name in names.items():
        every = turning.compare(supposed=supposed)
        fixed = [a for a in every if "C" not in a.effects]
        told = [every[0], *fixed[:2], next(a for a in fixed if "kp" not in a.effects)]
        told += [next(a for a in every if a.effects == e) for e in ALONE]
        for account in {a.effects: a for a in told}.values():
            values = ", ".join(f"{k} = {v:.3g} ± {account.std[k]:.2g}" for k, v in account.values.items())
            row = f"{name} | {account.name} | {account.rmse:.2f} | {account.bic - every[0].bic:.1f} | {values}"
            yield f"| {row} |"
    own = turning.compare(most=3, use=turning.TABLES == "4.9")
    shown = [
        *own[:6],
        next(a for a in own if a.effects == ("C", "mu")),
        next(a for a in own if a.effects == ("kp", "kl")),
    ]
    yield ""
    yield "Table 4.9 by itself (12 angles), ΔBIC and RMSE (deg) of the best accounts, and of two without anything late:"
    for a in shown:
        yield f"- {a.name}: {a.bic - own[0].bic:.1f}, {a.rmse:.2f}"


def work(out: Path, *, quick: bool = False) -> dict[str, Any]:
    """Everything, written to ``out``; the numbers."""
    (out / "figures").mkdir(parents=True, exist_ok=True)
    i, laws = plant.implied(), steady.compare()
    drawn = steady.resampled(laws)
    every = turning.compare()
    shown = [a for k, a in enumerate(every) if k < 10 or len(a.effects) <= 1 or a.effects in _TOLD]
    accounts, behind = [turning.judged(a) for a in shown], plant.stand_ins()
    found = None if quick else plant.missing()
    figures.poles(out / "figures" / "poles.png")
    figures.steady_laws(out / "figures" / "steady.png", laws)
    alone, freed = (next(a for a in accounts if a.effects == e) for e in ((), ("C",)))
    words = (("C of the actuator alone", alone), ("(3.11), C multiplied", freed), (_short(accounts[0]), accounts[0]))
    figures.joint(out / "figures" / "joint.png", words)
    lines = ["# (a) The identified plant", "", *plant_lines(i), "", *stand_in_lines(behind), ""]
    if found is not None:
        figures.plant_overlay(out / "figures" / "plant.png", found)
        lines += [*diagnosis_lines(found), ""]
    lines += ["# (b) Table 4.4", "", *steady_lines(laws, drawn), ""]
    lines += ["# (c) The joint", "", *single_lines(), "", *joint_lines(accounts), "", *reading_lines(), ""]
    (out / "result.md").write_text("\n".join(lines), encoding="utf-8")
    result = {
        "plant": {k: v for k, v in asdict(i).items() if k != "poles"},
        "behind": [asdict(f) for f in behind],
        "missing": None if found is None else {k: v for k, v in found.to_json().items() if k != "settings"},
        "steady": [asdict(law) for law in laws],
        "joint": [asdict(a) for a in accounts],
    }
    (out / "result.json").write_text(json.dumps(result, indent=1, default=float) + "\n", encoding="utf-8")
    print("\n".join(lines))
    return result


_TOLD = (*ALONE, ("kp", "kl"), ("C", "mu"), ("C", "kp", "mu"))


def _short(account: turning.Account) -> str:
    return "C of the actuator alone\n+ " + " + ".join(account.effects)


def main(argv: Sequence[str] | None = None) -> None:
    """Command line."""
    parser = argparse.ArgumentParser(prog="python -m fits.thesis.run", description=__doc__)
    parser.add_argument("--out", metavar="FOLDER", type=Path, default=HERE)
    parser.add_argument("--quick", action="store_true", help="leave the diagnosis of the identified plant out")
    given = parser.parse_args(argv)
    jax.config.update("jax_enable_x64", True)
    work(given.out, quick=given.quick)


if __name__ == "__main__":
    main()
