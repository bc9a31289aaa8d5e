"""A selection whose fits are played: hypotheses are names, and the misfit that is told of them."""

from dataclasses import dataclass
from math import exp
from types import SimpleNamespace

from scpjax.diagnose import select, ways
from scpjax.diagnose.evidence import Comparison, Evidence


@dataclass(frozen=True)
class Played:
    """A hypothesis by its names, and the misfit (in units of the noise squared) that is told of it."""

    names: tuple[str, ...]
    cost: float
    own: tuple[str, ...] = ()

    @property
    def setup(self):
        """What differs by recording."""
        return SimpleNamespace(structure=SimpleNamespace(own=self.own))


def put(monkeypatch, name: str, value: object) -> None:
    """Puts something in the place of a name in the rooms of the selection that know it."""
    known = [room for room in (select, ways) if hasattr(room, name)]
    assert known, name
    for room in known:
        monkeypatch.setattr(room, name, value)


def played(monkeypatch, misfits: dict[str, float], held_out: dict[str, float] | None = None) -> list[tuple[str, ...]]:
    """Plays a selection in which names, in the order of the alphabet, leave these misfits, and the same or others of
    what is held out; what was gone on from.
    """
    asked: list[tuple[str, ...]] = []

    def with_one_more(state, split, rules, catalogue, *, max_steps, tell, contenders, patience):
        asked.append(state.names)
        assert not {*contenders} & {*state.names}
        assert state.names or not contenders
        found = []
        for name in "abcdef":
            after = "".join(sorted({*state.names, name}))
            if name in state.names or after not in misfits:
                continue
            now = Played((*state.names, name), misfits[after], state.own)
            fall = state.cost - now.cost
            found.append(Comparison(now, name, "", fall, 0.5, fall, 0.5, fall > 12))
        return sorted(found, key=lambda c: -c.delta_bic)

    put(monkeypatch, "try_all", with_one_more)
    put(monkeypatch, "ready_beside_names", lambda catalogue: None)
    left = held_out or {}
    put(monkeypatch, "_held_out", lambda state, split: left.get("".join(sorted(state.names)), 1.0))
    put(monkeypatch, "own_room", lambda *_: None)
    put(monkeypatch, "released", lambda *_: None)
    put(monkeypatch, "afresh", lambda state, split: state)
    put(monkeypatch, "other_laws", lambda state, *_: state)
    put(monkeypatch, "laws_of_two", lambda state, *_: state)
    put(monkeypatch, "prune", lambda state, split, rules, base=None: state)
    put(monkeypatch, "equals", lambda best, others, before, split: ())
    put(monkeypatch, "worthwhile", lambda *_: True)
    put(monkeypatch, "no_scale", lambda *_: False)
    put(monkeypatch, "at_its_least", lambda *_: False)
    put(monkeypatch, "at_noise", lambda state, split, level=1.0: state.cost <= 1)
    put(monkeypatch, "is_better", lambda a, b, split, rules: a.cost < b.cost)
    put(monkeypatch, "chance_against", lambda a, b, split, rules: 1 / (1 + exp((a.cost - b.cost) / 2)))
    put(monkeypatch, "one_promises_the_rest", lambda search, state: True)
    put(monkeypatch, "leap", lambda *_: None)
    put(monkeypatch, "in_order", lambda s, first, split: Played((first, *sorted({*s.names} - {first})), s.cost))
    return asked


def chosen(misfit: float = 1000.0) -> set[str]:
    """Names that the selection played ends with."""
    return set(select.choose(Played((), misfit), None, Evidence(), None).state.names)  # type: ignore[arg-type]
