"""Recordings with concealed effects: base equations against closed forms, laws at their limits, the plan, the seal."""

import ast
import json
import sys
from pathlib import Path

import numpy as np
import pytest
from scipy import signal

from fits.concealed import cases as listing
from fits.concealed import generate
from fits.concealed.cases import Case, plan
from fits.concealed.drives import FAMILIES, draw_drive
from fits.concealed.effects.registry import CATALOGUE, EFFECTS, FOREIGN, OUTSIDE, kind_of
from fits.concealed.making import make
from fits.concealed.plants import KINDS, Plant, draw_plant
from fits.concealed.recorder import LEVELS, columns
from fits.concealed.seal import BrokenSeal, seal, verify
from fits.concealed.strength import base_fit, calibrate
from fits.concealed.system import simulate

FOLDER = Path(generate.__file__).parent
PERIOD = 0.1
NAMES = {
    "supply_sag", "input_delay", "drive_dead_zone", "resistance_temperature", "nonlinear_heat_loss", "two_node_thermal",
    "ambient_drift", "thermal_crosstalk", "nonlinear_thermal_force", "thermal_softening", "nonlinear_stiffness",
    "hysteresis", "friction", "creep", "slack", "fatigue", "antagonist_load", "sensor_lag", "sensor_drift",
}  # fmt: skip


def plant(kind="full") -> Plant:
    return draw_plant(kind, np.random.default_rng(3))


def steps(sides=1, *levels) -> np.ndarray:
    """10 s at each level [V], all sides alike."""
    return np.repeat(np.array(levels or (0.0, 3.0, 1.0)), 100)[:, None] * np.ones(sides)


def effect(name, law, p, strength):
    made = kind_of(name, law)(law, p, np.random.default_rng(5))
    made.strength = strength
    return made


def exact(p: Plant, volts: np.ndarray) -> np.ndarray:
    """Temperature and displacement of the base equations, by scipy's own discretisation of a linear system."""
    a = np.array(
        [
            [-p.conductance / p.thermal_mass, 0, 0],
            [0, 0, 1],
            [p.coefficient / p.mass, -p.stiffness / p.mass, -p.damping / p.mass],
        ]
    )
    b = np.array([[1 / (p.resistance * p.thermal_mass)], [0], [0]])
    step = signal.cont2discrete((a, b, np.eye(3)[:2], np.zeros((2, 1))), PERIOD)
    return signal.dlsim((*step[:4], PERIOD), volts**2)[1]


def test_nothing_concealed_is_the_closed_form():
    p = plant()
    found = simulate(p, (), steps(), PERIOD)
    assert np.allclose(found, exact(p, steps()), rtol=1e-6, atol=[1e-5, 1e-9])
    power = 3.0**2 / p.resistance
    seconds = np.arange(100) * PERIOD
    warm = power / p.conductance * (1 - np.exp(-seconds / p.settling))
    assert np.allclose(found[100:200, 0], warm, rtol=1e-6, atol=1e-6)


def test_a_joint_pulls_as_two():
    p = plant("joint")
    volts = steps(2, 0.0, 3.0)
    volts[:, 1] = 0
    found = simulate(p, (), volts, PERIOD)
    assert found.shape == (200, 3)
    assert np.all(found[:, 1] == 0)
    long = np.vstack([volts, np.tile(volts[-1:], (1500, 1))])
    last = simulate(p, (), long, PERIOD)[-1]
    assert last[2] == pytest.approx(p.coefficient * last[0] / (2 * p.stiffness), rel=1e-4)


def test_a_warm_start_is_where_the_drive_before_led():
    p = plant()
    found = simulate(p, (), steps(1, 0.0), PERIOD, before=([2.5], 10.0))
    whole = simulate(p, (), steps(1, 2.5, 0.0), PERIOD)
    assert np.allclose(found, whole[100:], rtol=1e-6, atol=[1e-5, 1e-9])


@pytest.mark.parametrize("which", [*EFFECTS.values(), *FOREIGN.values()], ids=lambda c: c.__name__)
def test_no_effect_at_no_strength(which):
    """At (nearly) no strength the readings are those of the base equations; at some they are not."""
    name = which.name
    for law, kinds in which.laws.items():
        p = plant("full" if "full" in kinds else kinds[0])
        volts = steps(p.sides, 0.0, 3.7, 3.7, 3.7, 1.0)
        if p.sides == 2:
            volts[:, 1] *= 0.5
        none = simulate(p, (), volts, PERIOD)
        e = effect(name, law, p, 1e-9)
        scale = np.abs(none).max(axis=0) + 1e-9
        off = np.abs(simulate(p, [e], volts, PERIOD) - none).max(axis=0) / scale
        assert np.all(off < 2e-3), (law, off)
        e.strength = e.most
        assert np.any(np.abs(simulate(p, [e], volts, PERIOD) - none).max(axis=0) / scale > 0.02), law


def test_a_delay_shifts_and_nothing_else():
    p = plant("te")
    late = simulate(p, [effect("input_delay", "pure", p, 0.7)], steps(), PERIOD)
    assert np.allclose(late[7:], simulate(p, (), steps(), PERIOD)[:-7], rtol=1e-6, atol=1e-6)


def test_a_lagging_sensor_is_a_first_order_filter():
    p = plant("te")
    lagged = simulate(p, [effect("sensor_lag", "first", p, 2.0)], steps(), PERIOD)[:, 0]
    true = simulate(p, (), steps(), PERIOD)[:, 0]
    residual = 2.0 * np.gradient(lagged, PERIOD) + lagged - true
    assert np.abs(residual[105:195]).max() < 2e-3 * true.max()


def test_steady_states():
    """Held long, laws reach what their equations say."""
    p = plant()
    volts = np.full((2500, 1), 2.0)
    power = 4.0 / p.resistance

    def last(name, law, strength):
        e = effect(name, law, p, strength)
        return e, *simulate(p, [e], volts, PERIOD)[-1]

    _, t, x = last("resistance_temperature", "linear", 0.004)
    assert p.conductance * t * (1 + 0.004 * t) == pytest.approx(power, rel=1e-4)
    assert p.stiffness * x == pytest.approx(p.coefficient * t, rel=1e-4)
    _, t, x = last("nonlinear_stiffness", "cubic", 0.5)
    assert p.stiffness * x * (1 + 0.5 * (x / p.travel) ** 2) == pytest.approx(p.coefficient * t, rel=1e-4)
    _, t, x = last("slack", "sharp", 0.1)
    assert x == pytest.approx(p.coefficient * t / p.stiffness - 0.1 * p.travel, rel=1e-4)
    _, t, x = last("creep", "kelvin_voigt", 0.3)
    assert x == pytest.approx(1.3 * p.coefficient * t / p.stiffness, rel=3e-3)
    _, t, x = last("thermal_softening", "linear", 0.4)
    assert p.stiffness * (1 - 0.4 * t / p.hottest) * x == pytest.approx(p.coefficient * t, rel=1e-4)
    _, t, x = last("nonlinear_heat_loss", "radiation", 0.5)
    room = p.ambient + 273.15
    radiated = 0.5 * p.conductance * ((t + room) ** 4 - room**4) / (4 * room**3)
    assert p.conductance * t + radiated == pytest.approx(power, rel=1e-4)


def test_plays_and_friction_remember():
    p = plant("plant")
    volts = np.concatenate([np.full(1500, v) for v in (2.0, 3.2, 2.0)])[:, None]
    base = simulate(p, (), volts, PERIOD)[:, 1]
    assert base[1499] == pytest.approx(base[-1], rel=1e-4)
    for name, law in (("hysteresis", "plays"), ("hysteresis", "stops"), ("hysteresis", "duhem"), ("friction", "dahl")):
        x = simulate(p, [effect(name, law, p, 0.1)], volts, PERIOD)[:, 1]
        assert x[-1] - x[1499] > 0.01 * p.travel, law


def test_the_engine_is_not_used():
    """Not by what generates: only the standard library, numpy, scipy, tqdm and this folder."""
    waiting, seen, names = ["generate"], set(), set()
    while waiting:
        module = waiting.pop()
        if module in seen:
            continue
        seen.add(module)
        path = FOLDER / f"{module.replace('.', '/')}.py"
        for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
            found = [a.name for a in node.names] if isinstance(node, ast.Import) else []
            if isinstance(node, ast.ImportFrom):
                found = [f"{node.module}.{a.name}" for a in node.names]
            for name in found:
                parts = name.split(".")
                if parts[:2] == ["fits", "concealed"]:
                    inner = ".".join(parts[2:])
                    waiting += [
                        m for m in (inner, inner.rpartition(".")[0]) if (FOLDER / f"{m.replace('.', '/')}.py").exists()
                    ]
                else:
                    names.add(parts[0])
    assert {"system", "effects.memory", "strength"} <= seen
    assert names - set(sys.stdlib_module_names) == {"numpy", "scipy", "tqdm"}


def test_the_plan_is_what_was_asked():
    cases = plan()
    assert len({c.name for c in cases}) == len({c.label for c in cases}) == len(cases)
    assert set(CATALOGUE) == NAMES
    assert len(OUTSIDE) >= 4
    for name in CATALOGUE:
        mine = [c for c in cases if c.sort == "single" and c.effects[0][0] == name]
        assert {c.seed for c in mine} == {1, 2, 3, 4, 5, *range(11, 21)}
        assert {c.tier for c in mine} == {"weak", "moderate", "strong"}
        assert {c.level for c in mine} == set(LEVELS)
        assert {law for c in mine for _, law in c.effects} == set(EFFECTS[name].laws)
    for case in cases:
        for name, law in case.effects:
            assert case.kind in kind_of(name, law).laws[law]
    foreign = [c for c in cases if c.sort == "foreign"]
    assert {c.effects[0][0] for c in foreign} == NAMES == set(FOREIGN)
    for name in FOREIGN:
        assert not set(FOREIGN[name].laws) & set(EFFECTS[name].laws)
        assert issubclass(FOREIGN[name], EFFECTS[name])
    nulls = [c for c in cases if c.sort == "null"]
    assert len(nulls) >= 50
    assert {m for c in nulls for m in c.mess} == {"warm", "skipped", "outliers"}
    assert {c.kind for c in nulls} == set(KINDS)
    chosen = generate.choose(subset=True)
    assert 35 <= len(chosen) <= 45
    assert {e for c in chosen for e, _ in c.effects} >= NAMES
    assert listing.seen() <= {c.name for c in cases}  # a further draw leaves the earlier ones as they were
    unseen = generate.choose(unseen=True)
    assert [c for c in cases if c.name not in listing.seen()] == unseen
    few = generate.choose(unseen=True, number=20)
    assert len(few) == 20
    assert [c for c in unseen if c in few] == few


@pytest.mark.parametrize("family", FAMILIES)
def test_drives_lie_within_the_rig(family):
    for sides in (1, 2):
        volts = draw_drive(family, sides, PERIOD, np.random.default_rng(1))
        assert volts.shape[1] == sides
        assert volts.min() >= 0
        assert 2.0 < volts.max() <= 3.7
        assert len(volts) * PERIOD > 100


@pytest.mark.parametrize("kind", KINDS)
def test_the_base_model_fits_itself(kind):
    p = plant(kind)
    volts = draw_drive("multilevel", p.sides, PERIOD, np.random.default_rng(1))
    found = base_fit(p, columns(p, "fine"), [(volts, simulate(p, (), volts, PERIOD))], PERIOD)
    assert found.worst < 1.0001


def test_strength_is_found_for_a_misfit():
    strength, reached = calibrate(lambda s: float(np.sqrt(1 + (40 * s**1.5) ** 2)), 3.0, 1.0, 10.0)
    assert reached == pytest.approx(3.0, rel=0.15)
    assert strength == pytest.approx((np.sqrt(8) / 40) ** (1 / 1.5), rel=0.15)
    assert calibrate(lambda s: 1.0 + s, 30.0, 1.0, 2.0) == (2.0, 3.0)


def test_a_strength_that_cannot_be_simulated_is_too_strong():
    def misfit(s: float) -> float:
        return float(np.sqrt(1 + (4 * s) ** 2)) if s < 1.2 else float("inf")

    strength, reached = calibrate(misfit, 9.0, 1.0, 10.0)  # asks for 2.24
    assert 1.0 <= strength < 1.2
    assert reached == pytest.approx(misfit(strength), rel=1e-3)
    strength, reached = calibrate(misfit, 4.0, 8.0, 10.0)  # begins too far
    assert strength == pytest.approx(np.sqrt(15) / 4, rel=0.12)
    assert reached == pytest.approx(misfit(strength), rel=1e-3)
    with pytest.raises(ValueError, match="no misfit at any strength"):
        calibrate(lambda s: float("inf"), 4.0, 1.0, 10.0)


@pytest.fixture(scope="module")
def made(tmp_path_factory) -> tuple[Path, Case]:
    case = next(c for c in plan() if c.sort == "null" and c.kind == "te" and c.mess == ("warm", "skipped", "outliers"))
    out = tmp_path_factory.mktemp("cases")
    make(case, out)
    seal(out, [case.name])
    return out, case


def test_a_case_is_recordings_and_the_truth(made):
    out, case = made
    truth = json.loads((out / case.name / "truth.json").read_text())
    assert truth["effects"] == []
    assert truth["misfit"] == 1.0
    assert truth["label"] == case.label
    given = sorted((out / case.name / "given").glob("*.csv"))
    assert [f"given/{f.stem}" for f in given] == [k for k in truth["files"] if k.startswith("given")]
    table = np.loadtxt(given[0], delimiter=",", skiprows=1)
    assert np.diff(table[:, 0]).max() > 1.5 * np.diff(table[:, 0]).min()  # skipped samples
    kept = sorted((out / case.name / "kept").glob("*.csv"))[0]
    table = np.loadtxt(kept, delimiter=",", skiprows=1)
    assert (
        abs(table[0, 2] - truth["plant"]["ambient"])
        < 5 * truth["files"][f"kept/{kept.stem}"]["noise"]["temperature_degC"]
    )


def test_a_case_is_the_same_every_time(made, tmp_path):
    out, case = made
    make(case, tmp_path)
    for path in sorted((out / case.name).rglob("*.*")):
        assert (tmp_path / case.name / path.relative_to(out / case.name)).read_bytes() == path.read_bytes()


def test_the_seal_holds_and_breaks(made):
    out, case = made
    hashed = verify(out, case.name)
    assert len(hashed) == 64
    truth = out / case.name / "truth.json"
    whole = truth.read_text()
    try:
        truth.write_text(whole.replace('"effects": []', '"effects": ["creep"]'))
        with pytest.raises(BrokenSeal, match=r"truth\.json"):
            verify(out, case.name)
        with pytest.raises(BrokenSeal):
            seal(out, [case.name])
    finally:
        truth.write_text(whole)
    assert verify(out, case.name) == hashed
    with pytest.raises(BrokenSeal, match="not in"):
        verify(out, "other")
