"""The thesis from its own numbers: the arithmetic against the library's, fits against made truths, the page in step."""

import math
from dataclasses import replace

import numpy as np
import pytest

from fits.thesis import plant, run, steady, turning
from fits.thesis_control.joint import turned
from scpjax.diagnose.table import diagnose_steady, resistance_times_conductance
from scpjax.physics.presets import Compact, from_compact
from scpjax.recordings.thesis import SteadyState, table_4_4_recordings


def test_the_stiffness_of_the_pair_is_that_of_the_inverted_compact_form():
    row, a, found = plant.COEFFICIENTS, plant.ACTUATOR, plant.implied()
    compact = Compact(b0=row.b0, a2=row.a2, a1=row.a1, a0=row.a0)
    made = from_compact(compact, mass=a.mass_kg, resistance=a.resistance_ohm, thermal_mass=a.heat_capacity_J_per_K)
    assert float(made.value("elastic_spring.stiffness")) == pytest.approx(found.k_from_pair, rel=1e-9)
    pole = float(made.value("newton_cooling.conductance")) / a.heat_capacity_J_per_K
    assert pole == pytest.approx(found.thermal_pole, rel=1e-9)
    assert 700 < found.k_measured / found.k_from_a0 < found.k_measured / found.k_from_a1 < 1200


def test_copper_meets_its_equation():
    volts, r, q = np.array([0.5, 2.0, 3.5]), 0.33, 0.3
    t = steady.temperature(volts, r, q)
    np.testing.assert_allclose(q * r * t * (1 + steady.COPPER * t), volts**2, rtol=1e-12)


def test_the_laws_agree_with_the_library_where_both_have_them():
    table = table_4_4_recordings()
    scores = {s.law.name: s for s in diagnose_steady(table, r_lambda=resistance_times_conductance()).scores}
    for name, factors in (("linear", ()), ("copper", ("copper",)), ("loss", ("loss",)), ("zero", ("offset",))):
        law = steady.fit_law(factors, table)[0]
        assert law.rmse == pytest.approx(1e3 * scores[name].rmse_m, rel=1e-4)
        assert steady.left_out(factors, table)[0] == pytest.approx(1e3 * scores[name].cv_rmse_m, rel=1e-3)


def test_factors_are_found_in_a_table_made_with_them():
    table = [
        SteadyState(s.code, s.mass_kg, s.voltage_V, (k + 1) * 1e-3 * s.voltage_V ** (2 / 1.4) + 0.5e-3)
        for k, s in enumerate(table_4_4_recordings())
    ]
    law = steady.fit_law(("loss", "offset"), table)[0]
    assert law.values["loss"] == pytest.approx(0.4, abs=1e-4)
    assert law.values["offset"] == pytest.approx(0.5, abs=1e-3)


def test_an_actuator_left_out_does_not_shape_the_law():
    table = list(table_4_4_recordings())
    spoilt = [*table[:-1], replace(table[-1], displacement_m=table[-1].displacement_m[::-1].copy())]
    others = [steady.fit_law(("loss",), t[:-1])[1] for t in (table, spoilt)]
    assert others[0] == pytest.approx(others[1])
    assert steady.left_out(("loss",), spoilt)[1] > 2 * steady.left_out(("loss",), table)[1]


def test_the_joint_in_closed_form_is_the_simulated_one():
    which = next(i for i, (_, t) in enumerate(turning.TRIALS) if t.on_s == 5.0 and t.agonist_mass_kg == 0.040)
    use = np.arange(len(turning.TRIALS)) == which
    simulated = math.degrees(turned([turning.TRIALS[which][1]], 7.0, 0.07)[0])
    assert turning.said({"C": 7.0, "mu": 0.07}, use)[0] == pytest.approx(simulated, abs=0.02)


def test_effects_are_found_in_angles_made_with_them(monkeypatch):
    truth = {"kp": 150.0, "kl": 80.0, "lag": 1.0}
    monkeypatch.setattr(turning, "MEASURED", turning.said(truth))
    found = turning.fit(tuple(truth))
    assert found.rmse < 1e-3
    for key, value in truth.items():
        assert found.values[key] == pytest.approx(value, rel=1e-2)


def test_the_actuator_alone_moves_as_measured():
    factor, error = turning.single()
    at_five = turning.FORCE * factor * turning.HOT * turning.heating(5.0) / turning.STIFFNESS
    assert at_five == pytest.approx(np.mean([11.8e-3, 13.3e-3, 12.8e-3]))
    assert 0 < error < 0.1 * factor


def test_the_actuator_alone_moves_for_long_as_measured():
    factor, _ = turning.single(supposed=turning.Supposed(steady=True))
    assert turning.FORCE * factor * turning.HOT / turning.STIFFNESS == pytest.approx(11.4e-3)
    assert factor < turning.single()[0]


def test_times_back_are_those_of_the_balance_that_made_them(monkeypatch):
    trials = [
        (n, replace(t, return_s=2.0 + 6.0 * math.log(math.degrees(t.angle_rad) / 0.5))) for n, t in turning.TRIALS
    ]
    monkeypatch.setattr(turning, "TRIALS", tuple(trials))
    assert turning.cooling_time(0.5, 2.0) == pytest.approx((6.0, 0.0, 0.0), abs=1e-9)
    assert turning.cooling_time(1.0, 2.0)[0] > 7.0


def test_what_stands_behind_the_heat_is_found_where_it_does(monkeypatch):
    """(4.4) replaced by a pole of heat and a Butterworth filter: that one fits, to nothing, and the others do not."""
    w, pole = 1.3, 0.15
    bottom = np.polymul([1.0, pole], [1.0, math.sqrt(2.0) * w, w**2])
    made = replace(plant.COEFFICIENTS, a2=bottom[1], a1=bottom[2], a0=bottom[3])
    monkeypatch.setattr(plant, "COEFFICIENTS", made)
    best, *others = plant.stand_ins()
    assert best.name.startswith("a low-pass filter")
    assert (best.pole, best.values["cutoff (rad/s)"]) == pytest.approx((pole, w), rel=1e-3)
    assert best.rmse < 1e-3 < 0.02 < min(o.rmse for o in others)


def test_the_written_result_is_what_the_script_says_now():
    written = (run.HERE / "result.md").read_text(encoding="utf-8")
    best = turning.judged(turning.fit(("kp", "kl", "delay", "slow")))
    lines = [*run.plant_lines(plant.implied()), *run.stand_in_lines(plant.stand_ins()), *run.single_lines()]
    for line in [*lines, *run.joint_lines([best])]:
        assert line in written
    laws = steady.compare()
    for line in run.steady_lines(laws, steady.resampled(laws)):
        assert line in written
