"""Gains in a file, ``gains.toml``, that a loop, the rig and the firmware load."""

from __future__ import annotations

import difflib
import math
import os
import tomllib
from pathlib import Path
from typing import Any, get_args

from scpjax.control.controller import SUPPLY_V, Controller
from scpjax.control.errors import ControlError
from scpjax.control.pid import PID, AntiWindup, Form, Pair
from scpjax.control.problem import gains_of
from scpjax.recordings.files import write_text

_NUMBERS = ("Kp", "Ki", "Kd", "N")
_MORE: dict[str, type | tuple[type, ...]] = {
    "limit_V": (int, float),
    "form": str,
    "anti_windup": str,
    "tracking": (int, float),
    "reference_weight": (int, float),
    "derivative_weight": (int, float),
    "sample_s": (int, float),
    "title": str,
}
_TABLES = ("gains", "pid", "controller")


def save_gains(
    controller: Controller, path: str | os.PathLike[str], *, dt: float | None = None, title: str = ""
) -> Path:
    """Write the gains of a PID or of a pair's agonist; the antagonist's are the opposite.

    **Raises** `ControlError` for a controller without gains.
    """
    path, found = Path(path), gains_of(controller)
    pid = controller.agonist if isinstance(controller, Pair) else getattr(controller, "pair", controller)
    pid = pid.agonist if isinstance(pid, Pair) else pid
    assert isinstance(pid, PID)
    lines = ["# V^2 per degree, per degree second, per degree and second; N in rad/s. The antagonist has the opposite."]
    lines += [f"title = {_quoted(title)}"] if title else []
    lines += [f"{name} = {found[name]!r}" for name in _NUMBERS]
    lines += [f"limit_V = {math.sqrt(float(pid.high))!r}", f'form = "{pid.form}"', f'anti_windup = "{pid.anti_windup}"']
    lines += [f"sample_s = {float(dt)!r}"] if dt is not None else []
    usual = {"tracking": 1.0, "reference_weight": 1.0, "derivative_weight": 1.0}
    lines += [f"{k} = {float(getattr(pid, k))!r}" for k, v in usual.items() if float(getattr(pid, k)) != v]
    write_text(path, "\n".join(lines) + "\n")
    return path


def load_gains(path: str | os.PathLike[str]) -> PID:
    """The agonist's controller of a gains file: ``Kp Ki Kd N`` at the top or in a table ``[gains]``.

    **Raises** `ControlError`, one line with the file, for what is missing, misspelt or no number.
    """
    path = Path(path)
    content = _content(path)
    where = str(path)
    for name in content:
        if name not in (*_NUMBERS, *_MORE):
            close = difflib.get_close_matches(name, (*_NUMBERS, *_MORE), n=1, cutoff=0.5)
            nearest = f"did you mean {close[0]}? " if close else ""
            raise ControlError(f"unknown key {name!r}", where=where, mend=f"{nearest}it holds Kp, Ki, Kd and N")
    values = {}
    for name in _NUMBERS:
        if name not in content:
            raise ControlError(f"{name} is missing", where=where, mend=f"write {name} = 0.5 or the like")
        values[name] = _number(content[name], name, where)
    options: dict[str, Any] = {}
    for name, kind in _MORE.items():
        if name in content and name not in ("sample_s", "title"):
            value = content[name]
            options[name] = _number(value, name, where) if kind is not str else value
            if kind is str and not isinstance(value, str):
                raise ControlError(f"{name} is no text", where=where, mend='write it as "..."')
    limit = options.pop("limit_V", SUPPLY_V)
    for name, words in (("form", Form), ("anti_windup", AntiWindup)):
        if name in options and options[name] not in get_args(words):
            raise ControlError(f"no {name} {options[name]!r}", where=where, mend=f"use {', '.join(get_args(words))}")
    try:
        return PID.per_degree(*(values[n] for n in _NUMBERS), high=limit**2, **options)
    except ControlError as error:
        raise ControlError(error.problem, where=where, mend=error.mend) from error


def _content(path: Path) -> dict[str, Any]:
    where = str(path)
    if path.is_dir():
        raise ControlError("is a folder, not a gains file", where=where, mend=f"name {path / 'gains.toml'}")
    try:
        content = tomllib.loads(path.read_text(encoding="utf-8-sig"))
    except FileNotFoundError as error:
        mend = "use thesis, or a gains.toml as tune writes it"
        raise ControlError("no such gains file", where=where, mend=mend) from error
    except OSError as error:
        raise ControlError(f"cannot be read ({error.strerror})", where=where, mend="check it") from error
    except UnicodeDecodeError as error:
        raise ControlError("is not text", where=where, mend="name a gains.toml") from error
    except tomllib.TOMLDecodeError as error:
        raise ControlError(f"is not TOML: {error}", where=where, mend="write lines such as Kp = 0.5") from error
    for table in _TABLES:
        if isinstance(content.get(table), dict):
            return {k: v for k, v in content.items() if k != table} | content[table]
    return content


def _number(value: Any, name: str, where: str) -> float:
    if isinstance(value, bool) or not isinstance(value, int | float) or not math.isfinite(value):
        raise ControlError(
            f"{name} is {value!r}, no finite number", where=where, mend=f"write {name} = 0.5 or the like"
        )
    return float(value)


def _quoted(text: str) -> str:
    return '"' + text.replace("\\", "\\\\").replace('"', '\\"').replace("\n", " ") + '"'
