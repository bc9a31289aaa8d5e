"""The ways of simulating against each other, against scipy and against equations written out here."""

import numpy as np
import pytest
import scipy.fft
import scipy.integrate
import scipy.linalg
import scipy.signal
from sim_cases import (
    CASES,
    KINKED,
    PARAMETERS,
    PLANT,
    at_null,
    case_id,
    extended,
    multilevel,
    recorded,
    smooth,
    with_active,
    worst,
)

from scpjax.errors import ModelError
from scpjax.physics import presets
from scpjax.physics.catalogue import left_out
from scpjax.simulate.simulate import Adaptive, Exact, Exponential, simulate

P = PARAMETERS
TIGHT = Adaptive(rtol=1e-11, atol=1e-13)
A = np.array(
    [
        [-P["conductance"] / P["thermal_mass"], 0, 0],
        [0, 0, 1],
        [P["coefficient"] / P["mass"], -P["stiffness"] / P["mass"], -P["damping"] / P["mass"]],
    ]
)
B = np.array([[1 / (P["resistance"] * P["thermal_mass"])], [0.0], [0.0]])


def lsim(effort, time, z0=(0.0, 0.0, 0.0), *, linear=True):
    """scipy's states of the plant."""
    system = (A, B, np.eye(3), np.zeros((3, 1)))
    return scipy.signal.lsim(system, effort, time, X0=np.asarray(z0), interp=linear)[1]


# -- reductions ------------------------------------------------------------------------------------


@pytest.mark.parametrize("order", [2, 4])
@pytest.mark.parametrize("names", [None, *((k,) for k in KINKED if k in {m.name for m in left_out()})])
def test_every_left_out_mechanism_vanishes_at_its_null(names, order):
    structure = smooth() if names is None else extended(PLANT.structure, *names)
    recording = multilevel()
    found = simulate(at_null(structure), recording, method=Exponential(order=order)).states[:, :3]
    assert worst(found, simulate(PLANT, recording, method=Exact()).states) < 1e-9


@pytest.mark.parametrize("hold", ["zero_order", "linear"])
@pytest.mark.parametrize("column", ["voltage_V", "power_W"])
def test_fixed_steps_are_exact_where_nothing_is_nonlinear(hold, column):
    model = PLANT if column == "voltage_V" else _driven_by_power()
    recording = multilevel(hold=hold, column=column)
    exact = simulate(model, recording, method=Exact()).states
    assert worst(simulate(model, recording, method=Exponential(order=4)).states, exact) < 1e-12


def _driven_by_power():
    structure = presets.structure("plant", drive="power")
    return type(PLANT)(structure).replace(PLANT.values() | {"joule_heating.gain": 1.0})


def test_exact_refuses_a_nonlinear_model():
    with pytest.raises(ModelError, match="not linear"):
        simulate(at_null(extended(PLANT.structure, "creep")), multilevel(), method=Exact())


# -- holds -----------------------------------------------------------------------------------------


def test_zero_order_hold_is_scipys_on_a_fine_grid():
    recording = multilevel()
    fine = np.repeat(recording.inputs[:, 0], 64)[: 64 * (recording.n - 1) + 1]
    time = np.arange(fine.size) * (0.05 / 64)
    wanted = lsim(fine**2, time, linear=False)[::64]
    assert worst(simulate(PLANT, recording).states, wanted) < 1e-10


def refined(effort_at, recording, z0=(0.0, 0.0, 0.0)):
    """scipy's piecewise linear response on grids 64 and 128 times finer, extrapolated to none."""
    coarse, fine = (
        lsim(effort_at(k), recording.time[0] + np.arange(k * (recording.n - 1) + 1) * (0.05 / k), z0)[::k]
        for k in (64, 128)
    )
    return fine + (fine - coarse) / 3


def test_linear_hold_of_volts_is_a_parabola_of_power():
    recording = multilevel(hold="linear")

    def effort_at(k):
        fine = np.interp(np.arange(k * (recording.n - 1) + 1) / k, np.arange(recording.n), recording.inputs[:, 0])
        return fine**2

    assert worst(simulate(PLANT, recording).states, refined(effort_at, recording)) < 1e-8


def test_linear_hold_of_power_is_scipys_first_order_hold():
    recording = multilevel(hold="linear", column="power_W")
    wanted = lsim(recording.inputs[:, 0] * P["resistance"], recording.time)
    assert worst(simulate(_driven_by_power(), recording).states, wanted) < 1e-10


@pytest.mark.parametrize("column", ["voltage_V", "power_W"])
def test_band_limited_hold_is_the_cosine_series_of_the_samples(column):
    recording = multilevel(hold="band_limited", column=column)
    n, z0 = recording.n, (4.0, 0.001, -0.02)
    series = scipy.fft.dct(recording.inputs[:, 0], type=1) / (n - 1)
    series[[0, -1]] /= 2

    def effort_at(k):
        phase = np.pi * np.arange(k * (n - 1) + 1) / (k * (n - 1))
        column_at = np.cos(np.outer(phase, np.arange(n))) @ series
        return column_at**2 if column == "voltage_V" else column_at * P["resistance"]

    model = PLANT if column == "voltage_V" else _driven_by_power()
    found = simulate(model, recording, initial=np.array(z0)).states
    assert worst(found, refined(effort_at, recording, z0)) < 1e-7


def test_band_limited_fixed_steps_converge_to_the_exact_ones():
    recording = multilevel(hold="band_limited")
    exact = simulate(PLANT, recording).states
    errors = [worst(simulate(PLANT, recording, method=Exponential(substeps=k)).states, exact) for k in (4, 8)]
    assert errors[1] < 1e-5
    assert errors[0] / errors[1] > 8  # the parabola through three points of the effort: third order and more


def _uneven(n=60):
    return 1.3 + np.cumsum(np.random.default_rng(1).choice([0.02, 0.05, 0.0713, 0.4], n))


def test_uneven_stamps_zero_order_is_the_augmented_exponential():
    time = _uneven()
    recording = recorded(time, {"voltage_V": multilevel().inputs[: time.size, 0]})
    z = np.array([2.0, 0.001, 0.01, 0.0])
    wanted = [z[:3]]
    for gap, volts in zip(np.diff(time), recording.inputs[:-1, 0], strict=True):
        whole = np.block([[A, B * volts**2], [np.zeros((1, 4))]])
        z = scipy.linalg.expm(whole * gap) @ np.r_[z[:3], 1.0]
        wanted.append(z[:3])
    found = simulate(PLANT, recording, initial=np.array([2.0, 0.001, 0.01])).states
    assert worst(found, np.array(wanted)) < 1e-12


def test_uneven_stamps_linear_hold_is_the_integrated_equation():
    time = _uneven(30)
    volts = multilevel(hold_s=0.1).inputs[: time.size, 0]
    recording = recorded(time, {"voltage_V": volts}, hold="linear")
    z, wanted = np.zeros(3), [np.zeros(3)]
    for i, gap in enumerate(np.diff(time)):

        def rates(t, z, i=i, gap=gap):
            return A @ z + B[:, 0] * (volts[i] + (volts[i + 1] - volts[i]) * t / gap) ** 2

        z = scipy.integrate.solve_ivp(rates, (0, gap), z, method="DOP853", rtol=1e-12, atol=1e-15).y[:, -1]
        wanted.append(z)
    assert worst(simulate(PLANT, recording).states, np.array(wanted)) < 1e-10


def test_band_limited_hold_of_uneven_stamps_is_refused():
    time = _uneven()
    recording = recorded(time, {"voltage_V": np.ones(time.size)}, hold="band_limited")
    for method in (Exact(), Exponential(), Adaptive()):
        with pytest.raises(ModelError, match="uniform time stamps"):
            simulate(PLANT, recording, method=method)


@pytest.mark.parametrize("hold", ["linear", "band_limited"])
def test_adaptive_follows_the_same_holds(hold):
    recording = multilevel(hold=hold)
    exact = simulate(PLANT, recording).states
    assert worst(simulate(PLANT, recording, method=TIGHT).states, exact) < 1e-6


def test_adaptive_says_when_it_gives_up():
    with pytest.raises(ModelError, match="raise max_steps"):
        simulate(PLANT, multilevel(), method=Adaptive(max_steps=50))


# -- mechanisms ------------------------------------------------------------------------------------


def _case(name, law):
    structure = extended(PLANT.structure, name) if name in KINKED else smooth()
    model = with_active(structure, name, law)
    return model, model.initial(temperature=10.0)


# of the states and of the outputs: |v| has a kink at every reversal; friction and springs are felt a step ahead
ROUGH = {
    "fatigue": (2e-4, 1e-5),
    "hysteresis-Duhem": (2e-5, 1e-6),
    "friction": (5e-2, 5e-3),
    "antagonist_load": (3e-2, 3e-3),
}


@pytest.mark.parametrize("case", CASES, ids=case_id)
def test_fixed_steps_agree_with_adaptive_ones(case):
    """Eight steps to a sample of 0.05 s: the hardening spring rings at 30 rad/s, hysteresis has kinks."""
    states, outputs = ROUGH.get(case_id(case), ROUGH.get(case[0], (1e-6, 1e-7)))
    model, z0 = _case(*case)
    recording = multilevel()
    wanted = simulate(model, recording, initial=z0, method=TIGHT)
    found = simulate(model, recording, initial=z0, method=Exponential(substeps=8))
    assert worst(found.states, wanted.states) < states
    assert worst(found.outputs, wanted.outputs) < outputs
    without = simulate(at_null(model.structure), recording, initial=z0, method=Exponential(substeps=8)).outputs
    assert worst(found.outputs, without) > 1e-3  # it does something to agree on


def _adaptive_and_stepped(name, values, method_of, factors):
    """Adaptive states, and the errors of a way of stepping with each number of substeps."""
    model, z0 = _case(name, 0)
    recording = multilevel()
    wanted = simulate(model.replace(values), recording, initial=z0, method=TIGHT).states[:, :2]
    small = with_active(extended(PLANT.structure, name), name).replace(values)
    return [
        worst(simulate(small, recording, initial=z0[:3], method=method_of(k)).states[:, :2], wanted) for k in factors
    ]


@pytest.mark.parametrize("order", [2, 4])
def test_order_of_convergence(order):
    errors = _adaptive_and_stepped("nonlinear_stiffness", {}, lambda k: Exponential(order=order, substeps=k), (2, 4, 8))
    orders = np.log2(np.array(errors[:-1]) / errors[1:])
    np.testing.assert_allclose(orders, order, atol=0.25)


def test_delay_that_is_no_multiple_of_the_step_converges():
    errors = _adaptive_and_stepped(
        "input_delay", {"input_delay.time": 0.1234}, lambda k: Exponential(order=2, substeps=k), (1, 8)
    )
    assert errors[1] < errors[0] / 20
    assert errors[1] < 1e-4


# -- equations written out -------------------------------------------------------------------------


def integrate(rates, z0, recording, *, delay=0.0):
    """States at the stamps: a tight Runge-Kutta from one change of the drive to the next.

    What a delay brings over from before the recording are the volts that kept the actuator as warm as ``z0`` is.
    """
    time, volts = recording.time, recording.inputs[:, 0]
    switches = np.flatnonzero(np.diff(volts)) + 1
    edges = np.r_[time[0], time[switches] + delay, time[-1]]
    levels = volts[np.r_[0, switches]]
    if delay:
        edges, levels = np.r_[time[0], time[0] + delay, edges[1:]], np.r_[np.sqrt(LAM * z0[0] * R), levels]
    states, z = np.zeros((time.size, len(z0))), np.asarray(z0, float)
    for start, stop, level in zip(edges[:-1], edges[1:], levels, strict=True):
        at = np.flatnonzero((time >= start - 1e-12) & (time <= stop + 1e-12))
        solution = scipy.integrate.solve_ivp(
            rates,
            (start, stop),
            z,
            method="DOP853",
            t_eval=np.unique(np.r_[np.clip(time[at], start, stop), stop]),
            args=(level**2,),
            rtol=1e-11,
            atol=1e-14,
        )
        states[at], z = solution.y[:, : at.size].T, solution.y[:, -1]
    return states


R, LAM, C_TH = P["resistance"], P["conductance"], P["thermal_mass"]
PULL, K, BETA, M = P["coefficient"], P["stiffness"], P["damping"], P["mass"]
WARM = 10.0
START = (WARM, PULL * WARM / K, 0.0)


def mechanics(x, v, pulling, spring):
    return [v, (PULL * pulling - BETA * v - spring) / M]


def copper(law):
    def rates(_t, z, u):
        t, x, v = z
        power = u / R / (1 + 0.004 * t) if law == 0 else u / R * (1 + 0.004 * t)
        return [(power - LAM * t) / C_TH, *mechanics(x, v, t, K * x)]

    return rates, START


def convection(law):
    room = float(PLANT.ambient)
    glow = lambda t: (room + t) ** 4 - room**4 - 4 * room**3 * t  # noqa: E731

    def rates(_t, z, u):
        t, x, v = z
        extra = abs(t / 50.0) ** 0.6 * t if law == 0 else 50.0 * glow(t) / glow(50.0)
        return [(u / R - LAM * (t + 0.8 * extra)) / C_TH, *mechanics(x, v, t, K * x)]

    return rates, START


def two_nodes(law):
    share, tau = 0.4, 0.3
    between = share * (1 - share) * C_TH / tau

    def rates(_t, z, u):
        t, x, v, t2 = z
        loss, loss2 = (0.0, LAM * t2) if law == 1 else (LAM * t, 0.0)
        first = (u / R - loss - between * (t - t2)) / ((1 - share) * C_TH)
        second = (between * (t - t2) - loss2) / (share * C_TH)
        return [first, *mechanics(x, v, t if law == 2 else t2, K * x), second]

    return rates, (*START, WARM)


def lag(_law):
    def rates(_t, z, u):
        t, x, v, y = z
        return [(u / R - LAM * t) / C_TH, *mechanics(x, v, t, K * x), (t - y) / 0.3]

    return rates, (*START, WARM)


def duffing(_law):
    def rates(_t, z, u):
        t, x, v = z
        r = x / 0.01
        return [(u / R - LAM * t) / C_TH, *mechanics(x, v, t, K * x * (1 + 0.3 * r + 0.4 * r**2))]

    return rates, START


def creeping(law):
    first, second, ratio = {0: (0.3, 0.0, 4.0), 1: (0.3, 0.2, 4.0), 2: (0.15, 0.15, 10.0), 3: (0.3, 0.0, 4.0)}[law]

    def rates(_t, z, u):
        t, x, v, quick, slow = z
        immediate = x - quick - slow
        ahead = first * immediate - quick
        return [
            (u / R - LAM * t) / C_TH,
            *mechanics(x, v, t, K * immediate),
            ahead / (8.0 if law == 3 and ahead * quick < 0 else 2.0),
            (second * immediate - slow) / (2.0 * ratio),
        ]

    # long at rest under the pull: the spring's own stretch, and what has crept since
    x = START[1]
    return rates, (START[0], (1 + first + second) * x, START[2], first * x, second * x)


def hysteresis(law):
    width = 0.15 * 0.01

    def rates(_t, z, u):
        t, x, v, q, q2 = z
        warming = (u / R - LAM * t) / C_TH
        moved = warming * 0.01 / 50.0 if law == 3 else v
        filled = abs(q) ** (8 if law >= 2 else 3) if moved * q > 0 else 0.0
        slip = (v - abs(v) * q) / width if law == 1 else moved / width * (1 - filled)
        other = 3 * moved / width * (1 - (q2**8 if moved * q2 > 0 else 0.0)) if law >= 2 else 0.0
        force = 0.4 * K * width * (q if law < 2 else (q + q2 / 3) / 2)
        return [warming, *mechanics(x, v, t, K * x + force), slip, other]

    return rates, (*START, 0.0, 0.0)


def plain(_law):
    def rates(_t, z, u):
        t, x, v = z
        return [(u / R - LAM * t) / C_TH, *mechanics(x, v, t, K * x)]

    return rates, START


EQUATIONS = {
    "resistance_temperature": copper,
    "nonlinear_heat_loss": convection,
    "two_node_thermal": two_nodes,
    "sensor_lag": lag,
    "nonlinear_stiffness": duffing,
    "creep": creeping,
    "hysteresis": hysteresis,
    "input_delay": plain,
}


@pytest.mark.parametrize("case", [c for c in CASES if c[0] in EQUATIONS], ids=case_id)
def test_mechanism_is_its_equation(case):
    name, law = case
    rates, z0 = EQUATIONS[name](law)
    recording = multilevel(hold_s=1.0)
    delay = 0.1 if name == "input_delay" else 0.0
    wanted = integrate(rates, z0, recording, delay=delay)

    model, start = _case(name, law)
    names = model.structure.state_names
    mine = [i for i, s in enumerate(names) if ("." not in s and s != "time") or s.startswith(name)]
    if name == "nonlinear_stiffness":  # its rest is found by one Newton step only: begin where the test says
        start = start.at[np.array(mine)].set(z0)
    np.testing.assert_allclose(start[np.array(mine)], z0, rtol=1e-12, atol=1e-15)
    found = simulate(model, recording, initial=start, method=Exponential(substeps=8))
    assert worst(found.states[:, np.array(mine)], wanted) < (2e-5 if case == ("hysteresis", 1) else 1e-6)

    felt = {"sensor_lag": 3, "two_node_thermal": 3 if law == 1 else 0}.get(name, 0)
    np.testing.assert_allclose(found.outputs[:, 0] - float(model.ambient), wanted[:, felt], rtol=1e-6, atol=1e-6)
    assert worst(found.outputs[:, 1:], wanted[:, 1:2]) < 1e-6


# -- stiffness -------------------------------------------------------------------------------------


def _ringing():
    stiff = {**P, "stiffness": P["mass"] * 34.0**2, "damping": 0.05, "thermal_mass": 12.0}
    return stiff, presets.plant(**stiff)


def test_ringing_weight_with_slow_heat_is_exact_at_long_steps():
    """34 rad/s and 0.1 s steps, heat that takes a minute."""
    stiff, model = _ringing()
    recording = multilevel(duration=100.0, period=0.1, hold_s=20.0)
    a = A.copy()
    a[0, 0] = -stiff["conductance"] / stiff["thermal_mass"]
    a[2, 1:] = -stiff["stiffness"] / stiff["mass"], -stiff["damping"] / stiff["mass"]
    b = np.array([[1 / (stiff["resistance"] * stiff["thermal_mass"])], [0.0], [0.0]])
    system = (a, b, np.eye(3), np.zeros((3, 1)))
    z0 = np.array([0.0, 0.01, 0.0])
    wanted = scipy.signal.lsim(system, recording.inputs[:, 0] ** 2, recording.time, X0=z0, interp=False)[1]
    for method in (Exact(), Exponential(order=2), Exponential(order=4)):
        assert worst(simulate(model, recording, initial=z0, method=method).states, wanted) < 1e-9


def test_ringing_weight_with_nonlinear_heat_loss_at_long_steps():
    stiff, model = _ringing()
    recording = multilevel(duration=100.0, period=0.1, hold_s=20.0)
    c, lam = stiff["thermal_mass"], stiff["conductance"]
    structure = extended(model.structure, "nonlinear_heat_loss")
    extra = {"nonlinear_heat_loss.strength": 0.8, "nonlinear_heat_loss.exponent": 0.6}
    z0 = (WARM, 0.01, 0.0)

    def rates(_t, z, u):
        t, x, v = z
        heat = (u / R - lam * t * (1 + 0.8 * (abs(t) / 50.0) ** 0.6)) / c
        return [heat, v, (PULL * t - stiff["damping"] * v - stiff["stiffness"] * x) / M]

    wanted = integrate(rates, z0, recording)
    nonlinear = type(model)(structure).replace(model.values() | extra)
    found = simulate(nonlinear, recording, initial=np.array(z0)).states
    assert worst(found, wanted) < 1e-6
