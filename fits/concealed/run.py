"""The proof: diagnoses recordings with concealed effects, scores them, runs baselines on the same files, writes a page.

    python fits/concealed/run.py [--subset | --all | --cases N | --only PATTERN | --unseen] [--out DIR] [--docs docs]

Recordings are made and their truth is sealed first (generate.py). Every answer is kept in --out as soon as it is there:
a run that was stopped goes on where it was. The subset of forty takes an hour or two, all of them many.
"""

from __future__ import annotations

import argparse
import json
import queue
import signal
import sys
import threading
import time
from collections.abc import Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

if __package__ in (None, ""):
    sys.path.insert(0, str(Path(__file__).resolve().parents[2]))

from tqdm import tqdm

from fits.commit import commit
from fits.concealed.baselines import sindy
from fits.concealed.cases import Case, plan, seen
from fits.concealed.generate import generate, selected, selection
from fits.concealed.page import write_page
from fits.concealed.pool import Worker
from fits.concealed.score import Score, score, worst
from fits.concealed.seal import BrokenSeal, verify
from fits.concealed.store import Store, write_whole
from fits.concealed.tally import goals

OUT = Path("out/concealed")
Job = tuple[str, str, str]  # name, method, sealed hash


class Run:
    """One run over some cases. ``way``: library or command; ``limit``: seconds for one answer; ``asked``: the options
    that chose the cases, of each of the runs that are scored together; ``earlier``: the ``results.json`` of runs whose
    answers do not lie here, to be told with them."""

    def __init__(
        self,
        cases: Sequence[Case],
        out: Path,
        *,
        way: str,
        methods: Sequence[str],
        limit: float,
        asked: Sequence[str] = (),
        earlier: Mapping[str, Any] | None = None,
    ):
        self.cases, self.out, self.way, self.methods, self.limit = list(cases), out, way, list(methods), limit
        self.store = Store(out)
        self.sealed = {c.name: verify(out / "cases", c.name) for c in self.cases}
        self.commit, self.asked, self.earlier, self.known = commit(), list(asked), earlier or {}, seen()

    def truth(self, name: str) -> dict[str, Any]:
        """What was concealed."""
        return json.loads((self.out / "cases" / name / "truth.json").read_text(encoding="utf-8"))

    def missing(self, *, retry: bool) -> list[Job]:
        """Answers that are not there yet; with ``retry`` also those that were errors."""
        jobs = []
        for case in self.cases:
            for method in self.methods:
                found = self.store.read(case.name, method, self.sealed[case.name])
                if found is None or (retry and "error" in found):
                    jobs.append((case.name, method, self.sealed[case.name]))
        return jobs

    def answer(self, jobs: Sequence[Job], *, workers: int) -> None:
        """Ask for every answer, the first ones first, and keep each."""
        waiting: queue.SimpleQueue[Job] = queue.SimpleQueue()
        for job in jobs:
            waiting.put(job)
        bar = tqdm(total=len(jobs), desc="diagnosing", unit="answer", smoothing=0.1, disable=not jobs)
        pool = [Worker(limit=self.limit, log=self.out / f"worker{i}.log") for i in range(workers)]
        threads = [threading.Thread(target=self._serve, args=(w, waiting, bar), daemon=True) for w in pool]
        try:
            for thread in threads:
                thread.start()
            for thread in threads:
                while thread.is_alive():
                    thread.join(0.5)
        finally:
            for worker in pool:
                worker.close()
            bar.close()

    def _serve(self, worker: Worker, waiting: queue.SimpleQueue[Job], bar: Any) -> None:
        while True:
            try:
                name, method, sealed = waiting.get_nowait()
            except queue.Empty:
                return
            found = worker.ask(self._job(name, method))
            self.store.write(
                name, method, sealed, {"commit": self.commit, "way": self.way, "first": name not in self.known, **found}
            )
            bar.set_postfix_str(f"{name} {method}{' failed' if 'error' in found else ''}", refresh=False)
            bar.update()

    def _job(self, name: str, method: str) -> dict[str, Any]:
        folder = (self.out / "cases" / name).absolute()
        job: dict[str, Any] = {
            "do": self.way if method == "scpjax" else method,
            "given": [str(f) for f in sorted((folder / "given").glob("*.csv"))],
            "kept": [str(f) for f in sorted((folder / "kept").glob("*.csv"))],
            "out": str((self.out / "reports" / name).absolute()),
        }
        if method != "scpjax":  # the baselines are told the noise; scpjax finds it
            job["noise"] = next(iter(self.truth(name)["files"].values()))["noise"]
        return job

    def scores(self) -> tuple[list[Score], dict[str, dict[str, float]]]:
        """Scores of the cases that have been diagnosed, and kept-file error over noise by baseline and case."""
        found, others = [], {m: {} for m in self.methods if m != "scpjax"}
        for case in self.cases:
            sealed, truth = self.sealed[case.name], self.truth(case.name)
            answer = self.store.read(case.name, "scpjax", sealed)
            if answer is not None:
                noted = {"commit": answer["commit"], "first": answer.get("first", False), "sealed": sealed}
                found.append(replace(score(truth, answer), **noted))
            for method, errors in others.items():
                answer = self.store.read(case.name, method, sealed)
                if answer is not None:
                    kept = {
                        f: {c: float("inf") if v is None else v for c, v in row.items()}
                        for f, row in answer.get("kept", {}).items()
                    }
                    errors[case.name] = worst(kept, truth) if kept else float("inf")
        here = {s.name for s in found}
        found += [Score.read(row) for row in self.earlier.get("cases", ()) if row["name"] not in here]
        for method, errors in self.earlier.get("baselines", {}).items():
            known = others.setdefault(method, {})
            known |= {n: float("inf") if e is None else e for n, e in errors.items() if n not in known}
        return found, others

    def first_answers(self, found: Sequence[Score]) -> list[Score]:
        """The first answers of cases that the engine was asked again later, changed with some of them in view: what
        it had said is not forgotten.
        """
        first = {row["name"]: Score.read(row) for row in self.earlier.get("cases", ()) if row["first"]}
        first |= {row["name"]: Score.read(row) for row in self.earlier.get("first_answers", ())}
        again = {s.name for s in found if not s.first}
        return [s for name, s in first.items() if name in again]

    def commits(self) -> str:
        """Of the package, by which the answers that are there were given, and the earlier ones."""
        answers = (self.store.read(c.name, "scpjax", self.sealed[c.name]) for c in self.cases)
        earlier = [c for c in self.earlier.get("commit", "").split(", ") if c]
        return ", ".join(dict.fromkeys([*earlier, *(a["commit"] for a in answers if a is not None)])) or self.commit

    def report(self, docs: Path | None) -> list[Score]:
        """Write ``results.json``, the page and its figures."""
        found, others = self.scores()
        first = self.first_answers(found)
        content = {
            "schema": "scpjax.concealed/1",
            "commit": self.commits(),
            "asked": self.options(),
            "written": time.strftime("%Y-%m-%d %H:%M"),
            "of": len(plan()),
            "goals": [
                {"title": g.title, "share": g.share if g.of else None, "of": g.of, "asked": g.asked, "met": g.met}
                for g in goals(found)
            ],
            "cases": [s.plain() for s in found],
            "first_answers": [s.plain() for s in first],
            "baselines": {m: {n: v if v < float("inf") else None for n, v in e.items()} for m, e in others.items()},
        }
        write_whole(self.out / "results.json", content)
        for folder in filter(None, (self.out, docs)):
            write_page(folder, found, others, commit=self.commits(), of=len(plan()), asked=self.options(), first=first)
        if docs is not None:
            write_whole(docs / "concealed" / "results.json", content)
        return found

    def options(self) -> list[str]:
        """That chose the cases, of all runs."""
        return list(dict.fromkeys([*self.earlier.get("asked", ()), *self.asked]))


def parse(argv: Sequence[str] | None) -> argparse.Namespace:
    """Command line."""
    parser = argparse.ArgumentParser(description="Diagnose concealed effects, score, compare with baselines.")
    selection(parser)
    parser.add_argument("--all", action="store_true", help="every case of the plan (days); default: the subset")
    parser.add_argument("--out", metavar="DIR", type=Path, default=OUT, help="default: %(default)s")
    parser.add_argument("--docs", metavar="DIR", type=Path, help="write the page there as well")
    parser.add_argument("--way", choices=("library", "command"), default="library", help="default: %(default)s")
    parser.add_argument("--workers", metavar="N", type=int, default=1, help="processes (default: %(default)s)")
    parser.add_argument("--limit", metavar="S", type=float, default=1200, help="seconds for one answer (%(default)s)")
    which = parser.add_mutually_exclusive_group()
    which.add_argument("--no-baselines", action="store_true", help="scpjax only")
    which.add_argument("--only-baselines", action="store_true", help="all but scpjax")
    parser.add_argument("--retry", action="store_true", help="ask again where the answer was an error")
    parser.add_argument(
        "--score-only", action="store_true", help="score what is there; without a selection all of it, of several runs"
    )
    parser.add_argument(
        "--add",
        metavar="FILE",
        type=Path,
        help="results.json of runs elsewhere, as docs/concealed/results.json, told together with these",
    )
    given = parser.parse_args(argv)
    if not (given.all or given.cases or given.only or given.sort or given.seeds or given.unseen or given.subset):
        given.subset, given.all = not given.score_only, given.score_only
    return given


def _asked(given: argparse.Namespace) -> str:
    """The options that chose the cases, as they are written."""
    words = [f"--sort {s}" for s in given.sort] + [f"--only '{p}'" for p in given.only]
    words += ["--seeds " + " ".join(map(str, given.seeds))] * bool(given.seeds)
    words += (
        ["--unseen"] * given.unseen
        + [f"--cases {given.cases}"] * (given.cases is not None)
        + ["--subset"] * given.subset
    )
    return " ".join(words + ["--all"] * given.all)


def _stopped(signal_number: int, frame: object) -> None:
    raise KeyboardInterrupt


def main(argv: Sequence[str] | None = None) -> None:
    """Make, seal, diagnose, score, write."""
    signal.signal(signal.SIGTERM, _stopped)
    given = parse(argv)
    cases = selected(given)
    methods = [] if given.only_baselines else ["scpjax"]
    if not given.no_baselines:
        methods.append("narx")
        if sindy.installed():
            methods.append("pysindy")
        else:
            print("PySINDy is not installed: left out of the comparison (pip install '.[baselines]')", file=sys.stderr)
    if not given.score_only:
        generate(cases, given.out / "cases", workers=given.workers)
    else:
        cases = [c for c in cases if (given.out / "cases" / c.name / "truth.json").exists()]
    options, store = _asked(given), Store(given.out)
    if not given.score_only:
        store.note(options)
    asked = store.notes() if given.score_only and given.all else [options]
    earlier = json.loads(given.add.read_text(encoding="utf-8")) if given.add else None
    try:
        run = Run(cases, given.out, way=given.way, methods=methods, limit=given.limit, asked=asked, earlier=earlier)
    except BrokenSeal as error:
        print(error, file=sys.stderr)
        raise SystemExit(2) from None
    if not given.score_only:
        try:
            run.answer(run.missing(retry=given.retry), workers=given.workers)
        except KeyboardInterrupt:
            print("stopped; the same command goes on from here", file=sys.stderr)
            raise SystemExit(130) from None
    found = run.report(given.docs)
    for goal in goals(found):
        if goal.of:
            print(f"{'met   ' if goal.met else 'NOT MET'} {goal.told:>7} of {goal.of:3d}  {goal.title}")
    print(
        f"page: {(given.docs or given.out) / 'concealed.md'}; figures beside it; scores: {given.out / 'results.json'}"
    )


if __name__ == "__main__":
    main()
