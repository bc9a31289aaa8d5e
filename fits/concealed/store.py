"""Answers on disk: one file for each case and method, written whole or not at all, bound to the sealed truth."""

from __future__ import annotations

import json
import os
from pathlib import Path
from typing import Any

METHODS = ("scpjax", "narx", "pysindy")


class Store:
    """Answers below ``out/answers``."""

    def __init__(self, out: Path):
        self.out = out

    def notes(self) -> list[str]:
        """Options of the runs that put answers there."""
        path = self.out / "asked.json"
        return json.loads(path.read_text(encoding="utf-8"))["options"] if path.exists() else []

    def note(self, options: str) -> None:
        """One more run."""
        known = self.notes()
        if options not in known:
            write_whole(self.out / "asked.json", {"options": [*known, options]})

    def path(self, name: str, method: str) -> Path:
        """Where an answer lies."""
        return self.out / "answers" / f"{name}.{method}.json"

    def read(self, name: str, method: str, sealed: str) -> dict[str, Any] | None:
        """The answer, unless there is none or it was given for another truth."""
        path = self.path(name, method)
        if not path.exists():
            return None
        content = json.loads(path.read_text(encoding="utf-8"))
        return content if content["truth_sha256"] == sealed else None

    def write(self, name: str, method: str, sealed: str, answer: dict[str, Any]) -> None:
        """Put an answer in its place."""
        write_whole(self.path(name, method), {"truth_sha256": sealed, **answer})


def write_whole(path: Path, content: dict[str, Any]) -> None:
    """JSON that is never half there."""
    path.parent.mkdir(parents=True, exist_ok=True)
    part = path.with_suffix(".part")
    part.write_text(json.dumps(content, indent=1) + "\n", encoding="utf-8", newline="\n")
    os.replace(part, path)
