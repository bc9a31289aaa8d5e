"""What is not missed is taken out."""

from types import SimpleNamespace

from scpjax.diagnose import pruning
from scpjax.diagnose.evidence import Evidence


def test_what_only_led_the_others_to_a_better_fit_is_taken_out(monkeypatch):
    """``b`` was added, and without it the rest fits as well from where it stands now."""
    mechanism = SimpleNamespace(laws=("",))
    structure = SimpleNamespace(mechanism=lambda name: mechanism, count_free=lambda name, law: 1)
    setup = SimpleNamespace(structure=structure)

    def state(names):
        return SimpleNamespace(names=names, setup=setup, laws=dict.fromkeys(names, ""))

    monkeypatch.setattr(pruning, "without", lambda s, name, split: state(tuple(n for n in s.names if n != name)))
    missed = lambda fewer, s, name, *_: SimpleNamespace(accepted=name != "b")  # noqa: E731
    monkeypatch.setattr(pruning, "compare", missed)
    assert pruning.prune(state(("a", "b")), None, Evidence()).names == ("a",)  # type: ignore[arg-type]
    assert pruning.prune(state(("a", "c")), None, Evidence()).names == ("a", "c")  # type: ignore[arg-type]
    monkeypatch.setattr(pruning, "worthwhile", lambda fewer, s, base, split, rules: fewer.names != ("a",))
    base = state(())
    assert pruning.prune(state(("a", "c")), None, Evidence(), base).names == ("a",)  # type: ignore[arg-type]
