"""A closure as a curve: what a spline can be, that it is found in its balance, and what is read off it."""

from collections.abc import Callable
from dataclasses import replace
from itertools import pairwise

import jax
import numpy as np
import pytest
import scipy.integrate
from diagnose.creeping import AMBIENT
from diagnose.heated import LOSS, base_of, lacking_in, recorded, rubbed, rubbed_by_air

from scpjax.diagnose import beyond, hypothesis
from scpjax.diagnose.answer import answer
from scpjax.diagnose.choice import Choice
from scpjax.diagnose.curve import CURVES, Curve, bend
from scpjax.diagnose.distil import distilled
from scpjax.diagnose.evidence import Evidence
from scpjax.diagnose.hypothesis import State, residual_on, trial_at
from scpjax.diagnose.patience import Patience
from scpjax.diagnose.remainder import level
from scpjax.diagnose.trials import integrable
from scpjax.fit.setup import carry
from scpjax.physics import presets
from scpjax.physics.catalogue import mechanism
from scpjax.physics.curves import PIECES, VARIABLES, basis, form_of, share_of, value_at
from scpjax.physics.model import Model
from scpjax.recordings.recording import Recording
from scpjax.report.report import write_diagnosis
from scpjax.simulate.simulate import energy_balance, simulate

PLACES = np.linspace(0.0, 1.0, 200)


@pytest.mark.parametrize("zero", [0.0, 0.4])
def test_splines_are_zero_at_rest_and_come_close_to_smooth_curves(zero):
    for wanted, off in ((np.expm1(PLACES) - np.expm1(zero), 1e-3), (np.tanh(4 * PLACES) - np.tanh(4 * zero), 2e-2)):
        apart = []
        for pieces in PIECES:
            matrix = basis(PLACES, zero, pieces)
            assert np.all(basis(np.array([zero]), zero, pieces) == 0)
            weights = np.linalg.lstsq(matrix, wanted, rcond=None)[0]
            apart.append(float(np.max(np.abs(matrix @ weights - wanted))))
        assert apart[0] < off
        assert all(after < before for before, after in pairwise(apart))


def test_pieces_are_scipys_b_splines():
    from scipy.interpolate import BSpline

    for pieces in PIECES:
        wanted = [BSpline.basis_element(np.arange(k - 2.0, k + 3.0), extrapolate=False) for k in range(pieces + 2)]
        values = np.nan_to_num(np.stack([b(pieces * PLACES) for b in wanted], axis=1))
        at_rest = np.nan_to_num(np.array([b(0.0) for b in wanted]))
        np.testing.assert_allclose(basis(PLACES, 0.0, pieces), values - at_rest, atol=1e-12)


def test_more_pieces_hold_what_fewer_do():
    for few, many in pairwise(basis(PLACES, 0.0, n) for n in PIECES):
        assert np.max(np.abs(many @ np.linalg.lstsq(many, few, rcond=None)[0] - few)) < 1e-9


@pytest.mark.parametrize("variable", VARIABLES)
def test_places_in_a_range_are_of_one_value_each(variable):
    low, high = (0.0, 70.0) if variable == "time" else (-3.0, 70.0)
    values = value_at(variable, PLACES, low, high)
    assert np.all(np.diff(values) > 0)
    assert (values[0], values[-1]) == pytest.approx((low, high))
    np.testing.assert_allclose(share_of(variable, values, low, high), PLACES, atol=1e-12)


def grown(model: Model, name: str, law: int, weights: np.ndarray, **ranges: float) -> Model:
    """A model with a curve in it."""
    m = mechanism(name)
    structure = model.structure.with_mechanisms(m)
    theta = structure.typical()
    theta[: len(model.structure.slots)] = np.asarray(model.theta)
    values = {f"{name}.{p.name}": w for p, w in zip(m.free_parameters(law), weights, strict=True)}
    laws = np.zeros(len(structure.mechanisms))
    laws[-1] = law
    values |= {f"{name}.{k}": v for k, v in ranges.items()}
    return Model(structure, theta, laws, float(model.ambient)).replace(values)


def by_scipy(recording: Recording, rate: Callable[[float, float], float]) -> list[float]:
    """Excess temperature [K] at every stamp, from its rate [K/s] under a voltage held between stamps."""
    path, time = [0.0], recording.time
    for i, u in enumerate(recording.inputs[:-1, 0]):
        found = scipy.integrate.solve_ivp(lambda t, z, u=u: [rate(z[0], u)], time[i : i + 2], [path[-1]], rtol=1e-9)
        path.append(found.y[0, -1])
    return path


def test_a_curve_in_the_heat_balance_is_the_loss_that_it_describes():
    """Power law of the loss, thesis (3.2) with lambda T (1 + b T / T_ref): the same as its own mechanism."""
    plant = presets.plant(
        resistance=1.2, conductance=0.1, thermal_mass=1.0, coefficient=0.02, stiffness=180.0, damping=8.0, mass=0.25
    )
    m = mechanism("learned_heat_curve")
    law = next(i for i in range(len(m.laws)) if form_of(m.forms, i)[0].name == "T s(T)")  # type: ignore[attr-defined]
    high, grows = 150.0, 0.6
    line = grows * PLACES  # s(T) = grows T / high: quadratic loss
    weights = np.linalg.lstsq(basis(PLACES, 0.0, PIECES[0]), line, rcond=None)[0]
    curved = grown(plant, m.name, law, weights, temperature_low=0.0, temperature_high=high)
    recording = recorded(lambda t, T, x: 0.0)
    warm = np.asarray(simulate(curved, recording).outputs)[:, 0] - float(plant.ambient)
    path = by_scipy(recording, lambda T, u: u**2 / 1.2 - 0.1 * T * (1 + grows * T / high))
    np.testing.assert_allclose(warm, path, atol=1e-3 * np.max(path))


def test_a_curve_of_the_store_is_a_thermal_mass_that_grows_and_keeps_the_balance():
    """(C_th + more(T)) dT/dt = u^2/R - lambda T, by scipy; what is supplied is stored or lost."""
    plant = presets.te(resistance=1.2, conductance=0.1, thermal_mass=1.0)
    m = mechanism("learned_heat_curve")
    law = next(i for i in range(len(m.laws)) if form_of(m.forms, i)[0].of == "store")  # type: ignore[attr-defined]
    high = 150.0
    peak = lambda T: 1.5 * (np.exp(-(((T / high - 0.5) / 0.2) ** 2)) - np.exp(-(2.5**2)))  # noqa: E731
    weights = np.linalg.lstsq(basis(PLACES, 0.0, PIECES[0]), peak(high * PLACES), rcond=None)[0]
    stores = lambda T: float(basis(np.array([T / high]), 0.0, PIECES[0])[0] @ weights)  # noqa: E731
    curved = grown(plant, m.name, law, weights, temperature_low=0.0, temperature_high=high)
    recording = recorded(lambda t, T, x: 0.0)
    warm = np.asarray(simulate(curved, recording).outputs)[:, 0] - float(plant.ambient)
    path = by_scipy(recording, lambda T, u: (u**2 / 1.2 - 0.1 * T) / (1 + stores(T)))
    np.testing.assert_allclose(warm, path, atol=1e-3 * np.max(path))
    plain = np.asarray(simulate(plant, recording).outputs)[:, 0] - float(plant.ambient)
    assert np.max(np.abs(warm - plain)) > 0.05 * np.max(plain)
    balance = {k: float(v) for k, v in energy_balance(curved, recording).items()}
    assert balance["supplied"] - balance["lost"] == pytest.approx(balance["stored"], rel=1e-3)
    assert balance["stored"] == pytest.approx(warm[-1] + scipy.integrate.quad(stores, 0.0, warm[-1])[0], rel=1e-3)


@pytest.mark.parametrize("name", CURVES)
def test_a_curve_of_no_weight_changes_nothing(name):
    plant = presets.plant(
        resistance=1.2, conductance=0.1, thermal_mass=1.0, coefficient=0.02, stiffness=180.0, damping=8.0, mass=0.25
    )
    m = mechanism(name)
    recording = recorded(lambda t, T, x: 0.0)
    before = np.asarray(simulate(plant, recording).outputs)
    run = jax.jit(lambda model: simulate(model, recording).outputs)
    for law in range(0, len(m.laws), 5):
        ranges = {"temperature_high": 90.0, "displacement_high": 0.02, "velocity_low": -0.1, "velocity_high": 0.1}
        model = grown(plant, name, law, np.zeros(len(m.free_parameters(law))), **ranges)
        np.testing.assert_allclose(np.asarray(run(model)), before, rtol=1e-8, atol=1e-12)


def test_a_curve_is_learned_drawn_and_distilled(tmp_path):
    """A loss that grows with the square of the displacement: found as a function of it, or of what goes with it."""
    base, parts = rubbed()
    binned, lacking = lacking_in(base, parts)
    found = bend(base, parts, Evidence(), ["thermoelectric"])
    assert found is not None
    assert level(found.state, parts) < 1.15
    said = answer(
        parts, base, Choice(base, (), {}, {}), found, binned, lacking, notes=(), patience=Patience(), settings={}
    )
    closure = said.closure
    assert closure is not None
    assert closure.subsystem == "thermoelectric"
    drawn = closure.curve
    assert drawn is not None
    # as a function it is the concealed loss where the actuator has been, but for what a conductance can take up
    states = np.asarray(recorded(rubbed_by_air).outputs)
    warm, moved = states[:, 0] - AMBIENT, states[:, 1]
    forms = {"T s(x)", "T s(T)", "s(x)"}
    assert drawn.product in forms
    others = {e.removeprefix("heat lost = ") for e in closure.equivalents}
    assert others & forms == forms - {drawn.product}  # temperature and displacement go together there
    assert all(other in said.says for other in others)
    at = 1e3 * moved if drawn.variable == "displacement" else warm
    factor = warm if drawn.product.startswith("T") else 1.0
    heat = factor * np.interp(at, drawn.at, drawn.value)
    heat += warm * (said.base_parameters["newton_cooling.conductance"].value - LOSS)
    truth = rubbed_by_air(0.0, warm, moved)
    assert np.sqrt(np.mean((heat - truth) ** 2)) < 0.1 * np.sqrt(np.mean(truth**2))
    assert np.all(drawn.std >= 0)
    assert drawn.share > 0.9
    assert drawn.expression in closure.expression
    page = write_diagnosis(said, tmp_path).read_text()
    assert "smooth curve" in page
    assert (tmp_path / "figures" / "closure.png").stat().st_size > 5000
    assert said.to_json()["closure"]["curve"]["product"] == drawn.product


def kinked(_t: float, temperature: float, _moved: float) -> float:
    """A loss [W] that begins at 30 K."""
    return 0.6 * LOSS * max(temperature - 30.0, 0.0)


def bent(_t: float, temperature: float, _moved: float) -> float:
    """A loss [W] that grows with the square of the temperature."""
    return 0.6 * LOSS * temperature**2 / 100.0


@pytest.mark.parametrize(("loss", "pieces"), [(kinked, PIECES[-1]), (bent, PIECES[0])])
def test_a_curve_has_as_many_pieces_as_its_shape_asks_for(loss, pieces):
    base, parts = base_of(recorded(loss))
    found = bend(base, parts, Evidence(), ["thermoelectric"])
    assert found is not None
    assert found.pieces == pieces
    assert level(found.state, parts) < 1.1


@pytest.mark.parametrize(("far", "wanted"), [(1.0, "curve"), (3.0, "terms")])
def test_terms_are_sought_where_no_curve_comes_down_to_the_noise(monkeypatch, far, wanted):
    base, parts = rubbed()
    scaled = type(base)(base.setup, base.trial, base.residual / level(base, parts) * far, base.cost)
    curve = Curve(scaled, "learned_heat_curve", 0, None)  # type: ignore[arg-type]
    better = type(base)(base.setup, base.trial, scaled.residual * 0.5, base.cost)
    monkeypatch.setattr(beyond, "bend", lambda *_: curve)
    monkeypatch.setattr(beyond, "learn", lambda *_: type("L", (), {"state": better, "terms": ("a",)})())
    found = beyond.closure(base, parts, Evidence())
    assert (found is curve) == (wanted == "curve")


@pytest.mark.parametrize(
    ("curve", "words"),
    [
        (lambda x: 0.3 * x**2, "0.3 W/(K mm²) x²"),
        (lambda x: -0.8 * np.tanh(x / 4.0), "tanh(x / "),
        (lambda x: 2.0 * np.maximum(x - 6.0, 0.0), "max(x - 6 mm, 0)"),
        (lambda x: 0.7 * np.exp(-(((x - 4.6) / 1.3) ** 2)), "W/K exp(-((x - 4."),
    ],
)
def test_the_expression_is_the_function_that_was_drawn(curve, words):
    at = np.linspace(0.0, 10.0, 61)
    said, near, share = distilled(at, curve(at), "x", "mm", "W/K")
    assert words in said
    assert share > 0.995
    assert np.max(np.abs(near - curve(at))) < 0.06 * np.max(np.abs(curve(at)))


@pytest.mark.parametrize(
    ("curve", "words"),
    [
        (lambda v: 0.3 * np.abs(v), "0.3 W/(K mm/s) |v|"),
        (lambda v: -0.2 * v * np.abs(v), "-0.2 W/(K (mm/s)²) |v| v"),
        (lambda v: 0.2 * v, "0.2 W/(K mm/s) v"),
    ],
)
def test_what_goes_both_ways_may_go_with_the_size(curve, words):
    at = np.linspace(-3.0, 4.0, 61)
    said, near, _ = distilled(at, curve(at), "v", "mm/s", "W/K")
    assert said == words
    np.testing.assert_allclose(near, curve(at), atol=1e-9)


def test_what_is_no_simple_function_gets_no_expression():
    at = np.linspace(0.0, 10.0, 61)
    said, _, share = distilled(at, np.sin(2 * at), "x", "mm", "N")
    assert said == ""
    assert share < 0.9


@pytest.mark.parametrize(("steep", "stands"), [(1.0, True), (-1.0, False)])
def test_a_curve_that_only_the_steps_of_the_integrator_hold_up_is_none(steep, stands):
    """A drag that grows with velocity is one; a push that does feeds itself, and what comes of it is up to the step."""
    base, parts = rubbed()
    m = mechanism("learned_force_curve")
    law = next(i for i in range(len(m.laws)) if form_of(m.forms, i)[0].variable == "velocity")  # type: ignore[attr-defined]
    problem = hypothesis.grown(base.setup, m)
    null = np.asarray(problem.starts[0])[: len(problem.structure.slots)]
    value = carry(base.setup.structure, problem.structure, base.values, null)
    index, fixed = problem.structure.index, problem.fixed.copy()
    low, high = -0.05, 0.05
    velocity, stiffness = low + PLACES * (high - low), value[index["elastic_spring.stiffness"]]
    force = steep * velocity * np.abs(velocity) / high
    wanted = force / stiffness / fixed[index[f"{m.name}.displacement_high"]]
    weights = np.linalg.lstsq(basis(PLACES, 0.5, PIECES[0]), wanted, rcond=None)[0]
    held = {p.name: w for p, w in zip(m.free_parameters(law), weights, strict=True)}
    for name, number in (held | {"velocity_low": low, "velocity_high": high}).items():
        fixed[index[f"{m.name}.{name}"]] = number
    laws = np.append(np.asarray(base.trial.laws), law)
    problem = replace(problem, fixed=fixed)
    trial = trial_at(problem, value, laws)
    state = State(problem, trial, residual_on(trial, parts.whole, problem), 0.0)
    assert integrable(state, parts) == stands
