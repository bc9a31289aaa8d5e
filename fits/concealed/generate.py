"""Makes recordings with something concealed in them, and seals what it was.

    python fits/concealed/generate.py --out DIR [--sort single] [--only PATTERN] [--seeds 1 2] [--cases N]
                                      [--subset] [--unseen]

Equations, laws, integration and noise are this folder's own: nothing of scpjax is used. A case is a folder whose name
tells nothing: given/*.csv to diagnose, kept/*.csv to be judged on, truth.json. Cases that are there are left alone.
"""

from __future__ import annotations

import argparse
import fnmatch
import sys
from collections.abc import Sequence
from concurrent.futures import ProcessPoolExecutor
from pathlib import Path

if __package__ in (None, ""):
    sys.path.insert(0, str(Path(__file__).resolve().parents[2]))

from tqdm import tqdm

from fits.concealed.cases import SORTS, Case, plan, seen
from fits.concealed.making import make
from fits.concealed.seal import seal

OUT = Path("out/concealed/cases")


def choose(
    *,
    sorts: Sequence[str] = (),
    only: Sequence[str] = (),
    seeds: Sequence[int] = (),
    subset: bool = False,
    unseen: bool = False,
    number: int | None = None,
) -> list[Case]:
    """Cases of the plan; ``only``: patterns such as *creep* on the label or the name; ``unseen``: none of those that
    the engine was built with (``seen.txt``); ``number``: spread evenly."""
    known = seen() if unseen else frozenset()
    cases = [
        c
        for c in plan()
        if (not sorts or c.sort in sorts)
        and (not seeds or c.seed in seeds)
        and (not subset or c.subset)
        and c.name not in known
        and (not only or any(fnmatch.fnmatch(c.label, f"*{p}*") or c.name == p for p in only))
    ]
    if number is None or number >= len(cases):
        return cases
    return [cases[i * len(cases) // number] for i in range(number)]


def selection(parser: argparse.ArgumentParser) -> None:
    """Options that say which cases."""
    parser.add_argument("--sort", "--kind", dest="sort", choices=SORTS, action="append", default=[], help="repeatable")
    parser.add_argument("--only", metavar="PATTERN", action="append", default=[], help="part of a label, as *creep*s1")
    parser.add_argument(
        "--seeds",
        metavar="N",
        type=int,
        nargs="+",
        default=[],
        help="1 to 5; 6 to 10: more pairs, triples, nulls; 11 to 20: more of all",
    )
    parser.add_argument("--cases", metavar="N", type=int, help="so many of them, spread evenly")
    parser.add_argument("--subset", action="store_true", help="the balanced selection of about forty")
    parser.add_argument("--unseen", action="store_true", help="only those never run while the engine was built")


def selected(given: argparse.Namespace) -> list[Case]:
    """What the options choose."""
    cases = choose(
        sorts=given.sort,
        only=given.only,
        seeds=given.seeds,
        subset=given.subset,
        unseen=given.unseen,
        number=given.cases,
    )
    if not cases:
        print("no case of the plan is so: fits/concealed/generate.py --list prints them", file=sys.stderr)
        raise SystemExit(2)
    return cases


def generate(cases: Sequence[Case], out: Path, *, workers: int = 1) -> None:
    """Make and seal cases."""
    out.mkdir(parents=True, exist_ok=True)
    missing = [c for c in cases if not (out / c.name / "truth.json").exists()]
    bar = tqdm(total=len(missing), desc="making recordings", unit="case", disable=not missing)
    if workers == 1:
        for case in missing:
            make(case, out)
            bar.update()
    else:
        with ProcessPoolExecutor(workers) as pool:
            for _ in pool.map(make, missing, [out] * len(missing)):
                bar.update()
    bar.close()
    seal(out, [c.name for c in cases])


def main(argv: Sequence[str] | None = None) -> None:
    """Command line."""
    parser = argparse.ArgumentParser(description="Make recordings with concealed effects, and seal the truth.")
    selection(parser)
    parser.add_argument("--out", metavar="DIR", type=Path, default=OUT, help="default: %(default)s")
    parser.add_argument("--workers", metavar="N", type=int, default=1)
    parser.add_argument("--list", action="store_true", help="print name and label of each and make nothing")
    given = parser.parse_args(argv)
    cases = selected(given)
    if given.list:
        print("\n".join(f"{c.name} {c.label}" for c in cases))
        return
    generate(cases, given.out, workers=given.workers)
    print(f"{len(cases)} cases in {given.out}")


if __name__ == "__main__":
    main()
