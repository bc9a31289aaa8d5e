"""Every effect by its name."""

from __future__ import annotations

from fits.concealed.effect import Effect
from fits.concealed.effects import elastic, electric, foreign, memory, outside, sensing, thermal


def _of(module: object) -> list[type[Effect]]:
    found = [c for c in vars(module).values() if isinstance(c, type) and issubclass(c, Effect) and hasattr(c, "name")]
    return [c for c in found if c.__module__ == getattr(module, "__name__", "")]


EFFECTS: dict[str, type[Effect]] = {
    c.name: c for module in (electric, thermal, elastic, memory, sensing, outside) for c in _of(module)
}
CATALOGUE = tuple(n for n, c in EFFECTS.items() if c.catalogue)
OUTSIDE = tuple(n for n, c in EFFECTS.items() if not c.catalogue)
FOREIGN: dict[str, type[Effect]] = {c.name: c for c in _of(foreign)}
"""The same effects under laws that the library does not hold."""


def kind_of(name: str, law: str) -> type[Effect]:
    """The effect that has this law."""
    return FOREIGN[name] if name in FOREIGN and law in FOREIGN[name].laws else EFFECTS[name]
