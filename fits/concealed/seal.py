"""The truth is sealed before anything is diagnosed: a hash of every truth.json and of every recording."""

from __future__ import annotations

import hashlib
import json
import os
from collections.abc import Sequence
from datetime import UTC, datetime
from pathlib import Path

SEAL = "seal.json"


class BrokenSeal(RuntimeError):
    """What is there is not what was sealed."""


def digest(folder: Path) -> dict[str, str]:
    """sha256 of each file of a case but the .part ones, by its path within the folder."""
    files = sorted(p for p in folder.rglob("*") if p.is_file() and p.suffix in (".json", ".csv", ".toml"))
    return {p.relative_to(folder).as_posix(): hashlib.sha256(p.read_bytes()).hexdigest() for p in files}


def seal(out: Path, names: Sequence[str]) -> Path:
    """Add cases to ``seal.json``. One that is sealed already must be as it was."""
    path = out / SEAL
    content = json.loads(path.read_text()) if path.exists() else {"made": datetime.now(UTC).isoformat(), "cases": {}}
    for name in names:
        found = digest(out / name)
        if content["cases"].setdefault(name, found) != found:
            raise BrokenSeal(f"{out / name} is not as it was sealed: remove it and make it again")
    part = path.with_suffix(".part")
    part.write_text(json.dumps(content, indent=1, sort_keys=True) + "\n", encoding="utf-8", newline="\n")
    os.replace(part, path)
    return path


def verify(out: Path, name: str) -> str:
    """Check one case; gives the hash of its truth."""
    path = out / SEAL
    if not path.exists():
        raise BrokenSeal(f"{out} has no {SEAL}: make the cases with generate.py")
    sealed = json.loads(path.read_text())["cases"].get(name)
    if sealed is None:
        raise BrokenSeal(f"{name} is not in {path}")
    found = digest(out / name)
    for file in sorted(set(sealed) | set(found)):
        if sealed.get(file) != found.get(file):
            raise BrokenSeal(f"{out / name / file} is not as it was sealed")
    return sealed["truth.json"]
