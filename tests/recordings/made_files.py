"""A small recording on disk, whole or changed in a line."""

from pathlib import Path

HEADER = "time_s,voltage_V,temperature_degC,displacement_mm"


def rows(n: int = 12, change: dict[int, str] | None = None) -> list[str]:
    """Rows 0.1 s apart; ``change`` replaces some by number."""
    made = [f"{k / 10:g},{3 * (k > 3)},{23 + k / 2:g},{k / 10:g}" for k in range(n)]
    for k, row in (change or {}).items():
        made[k] = row
    return made


def write(folder: Path, text: str | bytes | None = None, toml: str | None = None) -> Path:
    path = folder / "run.csv"
    text = "\n".join([HEADER, *rows()]) + "\n" if text is None else text
    path.write_bytes(text if isinstance(text, bytes) else text.encode())
    if toml is not None:
        path.with_suffix(".toml").write_text(toml)
    return path


def table(header: str = HEADER, change: dict[int, str] | None = None, n: int = 12) -> str:
    return "\n".join([header, *rows(n, change)]) + "\n"
