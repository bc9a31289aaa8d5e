"""What a fleet of diagnoses says: effects, spreads and outliers of made ones, against numbers worked out apart."""

import numpy as np
import pytest
from scipy import stats

from scpjax.diagnose.fleet import Member, effects, outliers, spreads, summary


def member(name: str, stiffness: float, std: float = 2.0, **named: float) -> Member:
    """A diagnosis with one base parameter and some effects, each with a parameter of size 0.3."""
    e = lambda v, s, u: {"value": v, "std": s, "unit": u, "low": v - 2 * s, "high": v + 2 * s, "at_limit": False}  # noqa: E731
    content = {
        "verdict": "explained" if named else "adequate",
        "says": "",
        "mechanisms": [
            {
                "name": k,
                "law": "",
                "probability": p,
                "equivalents": ["hysteresis"],
                "parameters": {"size": e(0.3, 0.01, "1")},
            }
            for k, p in named.items()
        ],
        "parameters": {"elastic_spring.stiffness": e(stiffness, std, "N/m")},
    }
    return Member(name, content)


FLEET = [
    *(member(n, 100.0 + d, creep=0.99) for n, d in zip("abcdef", (-1.5, 0.2, 1.1, -0.4, 0.9, -0.1), strict=True)),
    member("odd", 160.0, friction=0.8),
    Member("lost", None, "lost.csv: no columns"),
]


def test_effects_are_counted():
    assert effects(FLEET) == {"creep": tuple("abcdef"), "friction": ("odd",)}
    says = summary(FLEET, spreads(FLEET))
    assert says[0] == "7 of 8 actuators were diagnosed: 7 explained."
    assert says[1] == "Left out of the base model: creep in 6, friction in 1."
    assert "elastic_spring.stiffness" in says[2]
    assert says[2].startswith("Different")
    assert says[3] == "The same in all to within the errors: creep.size."


def test_cochran_tells_scatter_from_error():
    same = spreads(FLEET[:6])
    k = next(s for s in same if s.key == "elastic_spring.stiffness")
    x = np.log([98.5, 100.2, 101.1, 99.6, 100.9, 99.9])
    w = (np.exp(x) / 2.0) ** 2
    q = np.sum(w * (x - np.sum(w * x) / w.sum()) ** 2)
    assert k.logarithmic
    assert k.differs == pytest.approx(stats.chi2.sf(q, 5))
    assert k.relative == 0.0
    wide = [member(str(i), v, std=0.1) for i, v in enumerate((80.0, 90.0, 100.0, 110.0, 125.0))]
    (s,) = spreads(wide)
    assert s.differs < 1e-6
    assert s.relative == pytest.approx(np.std(np.log([80, 90, 100, 110, 125]), ddof=1), rel=0.02)


def test_an_estimate_at_its_limit_has_no_error():
    a, b = member("a", 100.0), member("b", 200.0)
    b.content["parameters"]["elastic_spring.stiffness"]["at_limit"] = True
    (s,) = spreads([a, b])
    assert s.differs == 1.0
    assert np.isinf(s.std[1])


def test_what_is_not_like_the_others_is_told():
    found = outliers(FLEET, spreads(FLEET))
    assert found[0].name == "odd"
    assert found[0].score > 3.5
    assert "elastic_spring.stiffness = 160 N/m is far above the others' 100.2 N/m" in found[0].says
    assert {o.says for o in found[1:]} == {
        "friction was named here and in none of the others",
        "creep was not named here, but in 6 of 7",
    }
    assert all(o.name == "odd" for o in found)
    assert not outliers(FLEET[:4], spreads(FLEET[:4])), "four are too few"
    assert not outliers(FLEET[:6], spreads(FLEET[:6]))
