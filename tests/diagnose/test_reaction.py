"""A heat that uses itself up, as drying's does: found in the heat balance, told in its units, and in place of names."""

import re

import numpy as np
import pytest
import scipy.integrate
from diagnose.heated import LOSS, base_of, lacking_in, recorded

from scpjax.diagnose import remainder
from scpjax.diagnose.answer import _nearest, answer
from scpjax.diagnose.choice import Choice
from scpjax.diagnose.evidence import Evidence
from scpjax.diagnose.given_up import beyond_names, form_rather_than_name
from scpjax.diagnose.patience import Patience
from scpjax.diagnose.reaction import Reaction
from scpjax.diagnose.remainder import AT_NOISE, level
from scpjax.diagnose.rivals import added
from scpjax.recordings import excitation
from scpjax.recordings.recording import Metadata, Recording

CONDUCTANCE, THERMAL_MASS, RESISTANCE, AMBIENT = 0.25, 1.6, 1.2, 294.0
BOUND, DOUBLES, AT, TAU = 120.0, 11.0, 40.0, 45.0  # [J], [K], [K], [s]
NOISE = 0.1


def dried(seed: int) -> Recording:
    """A wire in moist nylon, whose water goes at a rate that doubles every 11 K; by scipy."""
    time, drive = excitation.multilevel_random(duration_s=150, period_s=0.1, hold_s=8, low=0, high=4, seed=seed)
    z, path = np.array([0.0, 1.0]), [np.array([0.0, 1.0])]
    for i, gap in enumerate(np.diff(time)):

        def rates(t, z, i=i):
            going = z[1] * 2 ** ((z[0] - AT) / DOUBLES) / TAU
            return [(drive[i] ** 2 / RESISTANCE - CONDUCTANCE * z[0] - BOUND * going) / THERMAL_MASS, -going]

        z = scipy.integrate.solve_ivp(rates, (0.0, gap), z, rtol=1e-8, atol=1e-10).y[:, -1]
        path.append(z)
    read = np.array(path)[:, 0] + AMBIENT - 273.15 + NOISE * np.random.default_rng(seed).standard_normal(len(time))
    meta = Metadata(name=f"dried {seed}", known=(("resistance_ohm", RESISTANCE),), ambient_K=AMBIENT, model="te")
    return Recording.from_arrays(time, {"voltage_V": drive}, {"temperature_degC": read}, metadata=meta)


@pytest.fixture(scope="module")
def drying():
    return base_of(dried(3), dried(4))


def forced(base, parts, *names: str) -> Choice:
    state = base
    for name in names:
        state = added(state, name, parts)
    return Choice(state, (), dict.fromkeys(names, 0.9), dict.fromkeys(names, ()))


def test_heat_that_is_used_up_is_learned_in_its_units(drying):
    base, parts = drying
    assert level(base, parts) > 3.0
    choice, learned = beyond_names(parts, base, Choice(base, (), {}, {}), Evidence(), ["thermoelectric"])
    assert isinstance(learned, Reaction)
    assert level(learned.state, parts) < AT_NOISE
    binned, lacking = lacking_in(base, parts)
    said = answer(parts, base, choice, learned, binned, lacking, notes=(), patience=Patience(), settings={})
    assert said.verdict == "unexplained"
    assert said.location.subsystem == "thermoelectric"
    without, with_it = (float(x) for x in re.findall(r"misfit is ([\d.]+) times the noise", said.says))
    assert without == pytest.approx(level(base, parts), abs=0.06)
    assert with_it == pytest.approx(level(learned.state, parts), abs=0.1)  # it is fitted to all data
    assert said.closure is not None
    heat, time, steep = said.closure.terms.values()
    reference = said.model.values()["learned_reaction.reference_temperature"]
    assert reference / steep.value == pytest.approx(DOUBLES / np.log(2), abs=4 * reference / steep.value**2 * steep.std)
    assert time.value == pytest.approx(TAU * 2 ** ((AT - reference) / DOUBLES), abs=4 * time.std)
    joules = float(said.closure.expression.split("(")[1].split(" ±")[0])
    loss = said.model.values()["newton_cooling.conductance"]
    scale = loss * reference * said.model.values()["learned_reaction.reference_time"]
    assert joules == pytest.approx(BOUND, abs=4 * heat.std * scale)
    assert "J s(T) w" in said.closure.expression
    assert f"something that takes {joules:.3g} ± " in said.says
    assert "s(T)" not in said.says
    drawn = said.closure.curve
    assert drawn is not None
    assert (drawn.at[0], drawn.at_unit, drawn.unit) == (0.0, "K", "1/s")
    there = drawn.at > 0.4 * drawn.at[-1]
    rate = 2 ** ((drawn.at - AT) / DOUBLES) / TAU
    assert np.all(np.abs(drawn.value - rate)[there] < 4 * drawn.std[there])
    assert np.all(drawn.std[there] < 0.2 * rate[there])


def test_it_stands_in_place_of_several_names_that_it_does_better_than(drying):
    base, parts = drying
    names = forced(base, parts, "nonlinear_heat_loss", "sensor_drift")
    choice, learned = form_rather_than_name(parts, base, names, Evidence())
    assert isinstance(learned, Reaction)
    assert choice.state.names == ()
    assert _nearest(choice) == (
        "nearest in the catalogue: nonlinear_heat_loss with sensor_drift; not named, for what was learned in their "
        "place explains the same, and better",
    )
    binned, lacking = lacking_in(base, parts)
    said = answer(parts, base, choice, learned, binned, lacking, notes=(), patience=Patience(), settings={})
    assert said.verdict == "unexplained"
    others = '"heat loss grows faster than the temperature" with "a sensor drifts"'
    assert f"explains it better than {others} would: " in said.says
    assert "no mechanism of the catalogue explains" not in said.says


def test_names_stay_where_nothing_is_used_up():
    """A loss with the power 1.6 of the temperature, beside a name that is none."""
    base, parts = base_of(recorded(lambda t, temperature, x: 0.5 * LOSS * abs(temperature / 40.0) ** 0.6 * temperature))
    names = forced(base, parts, "nonlinear_heat_loss", "sensor_lag")
    choice, learned = form_rather_than_name(parts, base, names, Evidence())
    assert learned is None
    assert choice is names


@pytest.mark.parametrize("little", [0.05, 0.1])
def test_it_stands_in_place_of_one_name_that_does_not_reach_the_noise(drying, monkeypatch, little):
    """A wire and its core leave 6 % of the misfit: too much for the form of a law, or, with other bounds, not."""
    base, parts = drying
    one = forced(base, parts, "two_node_thermal")
    assert level(one.state, parts) > AT_NOISE
    monkeypatch.setattr(remainder, "_LITTLE_LEFT", little)
    assert remainder.form_at_most(base, one.state, parts) == (little == 0.1)
    choice, learned = beyond_names(parts, base, one, Evidence(), ["thermoelectric"])
    assert isinstance(learned, Reaction)
    assert level(learned.state, parts) < AT_NOISE
    assert choice.state.names == ()
    assert choice.given_up[0] == ("two_node_thermal",)
