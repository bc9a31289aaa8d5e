"""The thesis from its own numbers. Run ``python -m fits.thesis.run``.

Takes two minutes; ``--quick`` leaves the diagnosis out. Writes result.json, result.md and figures/ into this folder, or
``--out``.
"""

from __future__ import annotations

import argparse
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
    grams = f"k/m + λβ/(C_th m) with m in grams, against a1 | {i.in_grams[0]:.3f} | {i.in_grams[1]:.3f}"
    yield f"| {grams} (a1) |"
    by_plant, by_table, measured = (1e3 * x for x in i.stroke)
    beside = f"by Table 4.14 {by_table:.1f}, seen {measured:.1f}"
    yield f"| displacement at 3.41 V for long (mm) | {by_plant:.1f} | {beside} |"
    yield ""
    yield (
        f"The complex pair stands for a mean delay of {i.pair_delay:.2f} s; the fastest oscillation that the recording "
        f"could show is {i.nyquist:.0f} rad/s."
    )


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
    shares = ", ".join(f"{f} {steady.share_of(f, laws):.2f}" for f in steady.FACTORS)
    yield f"Probability of each factor by BIC weights over all {len(laws)} combinations: {shares}."
    best = next(law for law in laws if law.factors == ("loss",))
    n, error = best.values["loss"], best.std["loss"]
    yield f"As a power of the voltage: x grows as V^({2 / (1 + n):.2f} ± {2 * error / (1 + n) ** 2:.2f})."
    hot = next(law for law in laws if law.factors == ("copper", "hotter"))
    yield (
        f"Copper alone bends enough only if the wire were {steady.hottest(hot):.0f} K above ambient; at the 138 K of "
        f"Figure 3.8 its BIC is {steady.copper_at(138.0) - laws[0].bic:.0f} above the best."
    )


def joint_lines(accounts: Sequence[turning.Account]) -> Iterator[str]:
    """(c) in numbers: the best accounts, and every effect alone."""
    factor, error = turning.single()
    yield f"C of the actuator alone (Tables 4.5, 4.8): {factor:.1f} ± {error:.1f} times that of Table 4.14."
    ratio = np.median(turning.MEASURED / turning.said({}))
    yield f"With it (3.11) turns too far: the median of measured over said is {ratio:.2f}."
    tau, spread = turning.cooling_time()
    back = "Times back to the start (Tables 4.11, 4.12)"
    yield f"{back}: time constant {tau:.2f} ± {spread:.2f} s; C_th/λ {turning.TAU:.2f} s."
    yield ""
    yield "| effects | RMSE (deg) | load pair left out | table left out: 4.9, 4.11, 4.12 | ΔBIC | parameters |"
    yield "|---|---:|---:|---|---:|---|"
    for a in accounts:
        values = ", ".join(f"{k} = {v:.3g} ± {a.std[k]:.2g} {turning.EFFECTS[k][1]}" for k, v in a.values.items())
        tables = ", ".join(f"{v:.1f}" for v in (a.tables or {}).values())
        yield (f"| {a.name} | {a.rmse:.2f} | {a.left_out:.2f} | {tables} | {a.bic - accounts[0].bic:.1f} | {values} |")


def work(out: Path, *, quick: bool = False) -> dict[str, Any]:
    """Everything, written to ``out``; the numbers."""
    (out / "figures").mkdir(parents=True, exist_ok=True)
    i, laws = plant.implied(), steady.compare()
    drawn = steady.resampled(laws)
    every = turning.compare()
    shown = [a for k, a in enumerate(every) if k < 8 or len(a.effects) <= 1 or set(a.effects) == {"C", "mu"}]
    accounts = [turning.judged(a) for a in shown]
    found = None if quick else plant.missing()
    figures.poles(out / "figures" / "poles.png")
    figures.steady_laws(out / "figures" / "steady.png", laws)
    alone, freed = (next(a for a in accounts if a.effects == e) for e in ((), ("C",)))
    words = (("C of the actuator alone", alone), ("(3.11), C multiplied", freed), (_short(accounts[0]), accounts[0]))
    figures.joint(out / "figures" / "joint.png", words)
    lines = ["# (a) The identified plant", "", *plant_lines(i), ""]
    if found is not None:
        figures.plant_overlay(out / "figures" / "plant.png", found)
        lines += [*diagnosis_lines(found), ""]
    lines += ["# (b) Table 4.4", "", *steady_lines(laws, drawn), "", "# (c) The joint", "", *joint_lines(accounts), ""]
    (out / "result.md").write_text("\n".join(lines), encoding="utf-8")
    result = {
        "plant": {k: v for k, v in asdict(i).items() if k != "poles"},
        "missing": None if found is None else {k: v for k, v in found.to_json().items() if k != "settings"},
        "steady": [asdict(law) for law in laws],
        "joint": [asdict(a) for a in accounts],
    }
    (out / "result.json").write_text(json.dumps(result, indent=1, default=float) + "\n", encoding="utf-8")
    print("\n".join(lines))
    return result


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
