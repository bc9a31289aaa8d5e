"""Drawn nylon, dry and moist: does moisture change the law, and how? Run ``python -m fits.nylon.run``.

No time was recorded, so the law is one of the temperature and of which way it goes (`fits.nylon.law`). Each recording
is fitted under every combination of curve and loop; then all together, with every choice of what may differ.
"""

from __future__ import annotations

import argparse
import json
import os
from collections.abc import Iterator, Sequence
from dataclasses import asdict
from pathlib import Path

import numpy as np
from matplotlib.figure import Figure

from fits.common import find
from fits.nylon.law import Fitted, Sample, Shared, at, compare, sample, shared, strain
from scpjax.recordings import read_recording
from scpjax.report.plot import BASE, EXTENDED, MEASURED, png

FILES = ("dry", "moist1d", "moist4d")
COMMON = ("bend", "strain")  # under which the recordings are compared parameter by parameter
UNITS = {"slope": "%/K", "growth": "%/K", "transition": "degC", "width": "K", "zero": "%"}


def law_lines(s: Sample, laws: Sequence[Fitted]) -> Iterator[str]:
    """The laws of one recording within reach of the best, and the best with another loop."""
    others = [next(f for f in laws if f.loop == loop) for loop in dict.fromkeys(f.loop for f in laws)]
    for fit in {(f.curve, f.loop): f for f in (*laws[:3], *others)}.values():
        yield (
            f"| {s.name} | {fit.curve}, loop {fit.loop} | {fit.rmse:.4f} | {fit.left_out:.4f} | "
            f"{fit.bic - laws[0].bic:.1f} | {_values(fit)} |"
        )


def _values(f: Fitted) -> str:
    units = {**UNITS, "loop": "K" if f.loop == "temperature" else "%"}
    shown = {k: v for k, v in f.values.items() if k != "zero"}
    return ", ".join(f"{k} {_estimate(v, f.std[k])} {units[k]}" for k, v in shown.items())


def _estimate(value: float, std: float) -> str:
    """Value and error; one without a finite error is only known to lie below what was recorded."""
    return f"{value:.3g} ± {std:.2g}" if np.isfinite(std) else f"at most {value:.3g}"


def common_lines(samples: Sequence[Sample], found: Sequence[Fitted]) -> Iterator[str]:
    """Parameters under one law, and what is read off the recordings without any."""
    names = [n for n in found[0].values if n != "zero"]
    units = {**UNITS, "loop": "%"}
    yield f"| | {' | '.join(s.name for s in samples)} |"
    yield "|---|" + "---:|" * len(samples)
    for name in names:
        cells = " | ".join(_estimate(f.values[name], f.std[name]) for f in found)
        yield f"| {name} ({units[name]}) | {cells} |"
    for celsius in (40.0, 60.0, 80.0):
        both = [at(s, celsius) for s in samples]
        yield f"| strain at {celsius:.0f} degC, up / down (%) | {' | '.join(f'{u:.3f} / {d:.3f}' for u, d in both)} |"
    left = [s.strain[-1] - s.strain[0] for s in samples]
    yield f"| strain left at the end (%) | {' | '.join(f'{x:.3f}' for x in left)} |"


def shared_lines(title: str, choices: Sequence[Shared]) -> Iterator[str]:
    """What has to differ between recordings."""
    names = max((c.differ for c in choices), key=len)
    yield f"{title}: what differs, BIC below that of everything differing"
    for c in choices[:4]:
        yield f"- {', '.join(c.differ) or 'nothing'}: {c.delta_bic:+.1f}"
    if choices[0].differ:
        yield f"- nothing: {next(c for c in choices if not c.differ).delta_bic:+.1f}"
    for name in names:
        least = min(c.delta_bic for c in choices if name not in c.differ)
        best = choices[0].delta_bic
        yield f"- {name} the same for all costs {least - best:.1f} beside the best choice"


def draw(samples: Sequence[Sample], laws: Sequence[Sequence[Fitted]], path: Path) -> Path:
    """Strain over temperature with the best law of each; it holds the recordings and stays out of the project."""
    figure = Figure(figsize=(8.6, 3.0), layout="constrained")
    for axis, s, mine in zip(figure.subplots(1, len(samples)), samples, laws, strict=True):
        axis.plot(s.temperature, s.strain, ".", color=MEASURED, ms=3, alpha=0.5, label="measured")
        for loop, colour in (("temperature", BASE), ("strain", EXTENDED)):
            f = next(g for g in mine if g.loop == loop)
            p = np.array([f.values.get(n, 1.0) for n in ("zero", "slope", "growth", "transition", "width", "loop")])
            said = strain(p, s.temperature, f.curve, loop)
            axis.plot(s.temperature, said, color=colour, lw=1, label=f"loop in {loop}")
        axis.set(title=s.name, xlabel="temperature (°C)")
    figure.axes[0].set_ylabel("contraction (%)")
    figure.axes[0].legend(frameon=False, fontsize=8)
    path.parent.mkdir(parents=True, exist_ok=True)
    path.write_bytes(png(figure))
    return path


def work(folder: Path, out: Path) -> list[str]:
    """All of it: lines of a page; figure and numbers in ``out``."""
    samples = [sample(read_recording(folder / f"{name}.csv")) for name in FILES]
    laws = [compare(s) for s in samples]
    lines = ["| recording | law | RMSE (%) | left out | ΔBIC | parameters |", "|---|---|---:|---:|---:|---|"]
    for s, mine in zip(samples, laws, strict=True):
        lines += law_lines(s, mine)
    common = [next(f for f in mine if (f.curve, f.loop) == COMMON) for mine in laws]
    lines += ["", f"Under one law ({COMMON[0]}, loop in {COMMON[1]}):", "", *common_lines(samples, common), ""]
    choices = {"all three": samples, "dry and moist1d": samples[:2], "moist1d and moist4d": samples[1:]}
    found = {title: shared(some, *COMMON) for title, some in choices.items()}
    for title, each in found.items():
        lines += [*shared_lines(title, each), ""]
    out.mkdir(parents=True, exist_ok=True)
    numbers = {
        "laws": {s.name: [asdict(f) for f in mine] for s, mine in zip(samples, laws, strict=True)},
        "shared": {title: [asdict(c) for c in each] for title, each in found.items()},
    }
    (out / "result.json").write_text(json.dumps(numbers, indent=1, default=str) + "\n", encoding="utf-8")
    (out / "result.md").write_text("\n".join(lines), encoding="utf-8")
    draw(samples, laws, out / "nylon.png")
    return lines


def main(argv: Sequence[str] | None = None) -> None:
    """Command line."""
    parser = argparse.ArgumentParser(prog="python -m fits.nylon.run", description=__doc__)
    parser.add_argument("--data", metavar="DIR", type=Path, default=os.environ.get("SCPJAX_DATA"))
    parser.add_argument("--out", metavar="DIR", type=Path, default=Path("out") / "nylon")
    given = parser.parse_args(argv)
    print("\n".join(work(find(given.data, "nylon"), given.out)))


if __name__ == "__main__":
    main()
