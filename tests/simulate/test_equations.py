"""Left-out mechanisms against their equations, written out here and integrated by scipy."""

import numpy as np
import pytest
from sim_cases import CASES, KINKED, PLANT, case_id, case_of, extended, multilevel, smooth, with_active, worst
from written_out import C_TH, LAM, PULL, START, WARM, K, R, integrate, mechanics, plant

from scpjax.simulate.simulate import Exponential, simulate


def copper(law):
    def rates(_t, z, u):
        t, x, v = z
        rise = 1 + 0.004 * t + (0.3 * (0.004 * t) ** 2 if law >= 2 else 0.0)
        power = u / R / rise if law in (0, 2) else u / R * rise
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
    if law == 4:
        return layers()
    share, tau, slow, ratio = 0.4, 0.3, 0.3 if law == 3 else 0.0, 7.0
    between = share * (1 - share) * C_TH / tau

    def rates(_t, z, u):
        t, x, v, t2, t3 = z
        loss, loss2 = (0.0, LAM * t2) if law in (1, 5) else (LAM * t, 0.0)
        quickly, slowly = (1 - slow) * between * (t - t2), slow * between / ratio * (t - t3)
        first = (u / R - loss - quickly - slowly) / ((1 - share) * C_TH)
        second = (quickly - loss2) / ((1 - slow) * share * C_TH)
        third = between / (share * C_TH) / ratio * (t - t3)
        return [first, *mechanics(x, v, t if law >= 2 else t2, K * x), second, third]

    return rates, (*START, WARM, WARM)


def layers():
    """A skin and two cells of a slab: half a cell from the skin to the first middle, a whole one to the next."""
    share, tau = 0.4, 0.3
    per_slab = 3 / 8 * share * (1 - share) * C_TH / tau  # W/K over the whole thickness

    def rates(_t, z, u):
        t, x, v, t2, t3 = z
        into, onward = 4 * per_slab * (t - t2), 2 * per_slab * (t2 - t3)
        first = (u / R - LAM * t - into) / ((1 - share) * C_TH)
        cell = share * C_TH / 2
        return [first, *mechanics(x, v, (t2 + t3) / 2, K * x), (into - onward) / cell, onward / cell]

    return rates, (*START, WARM, WARM)


def lag(law):
    def rates(_t, z, u):
        t, x, v, y, w = z
        late = ((w if law == 1 else t) - y) / 0.3
        return [(u / R - LAM * t) / C_TH, *mechanics(x, v, t, K * x), late, (t - w) / 0.3 if law == 1 else 0.0]

    return rates, (*START, WARM, WARM)


def duffing(law):
    def rates(_t, z, u):
        t, x, v = z
        r = x / 0.01
        beyond = (abs(r) + HOOK(abs(r) - 0.1, 0.02) - HOOK(0.1, 0.02)) / 2
        change = (0.3 * r + 0.4 * r**2, 5.0 * abs(r) ** 3.0, 0.5 * beyond / max(abs(r), 1e-12))[law]
        return [(u / R - LAM * t) / C_TH, *mechanics(x, v, t, K * x * (1 + change))]

    return rates, START


SMALL = 0.1 * 0.0025  # m, that activated creep may lack


def creeping(law):
    if law == 4:
        return activated()
    if law == 7:
        return going_on()
    first, second, ratio = {1: (0.3, 0.2, 4.0), 2: (0.15, 0.15, 10.0)}.get(law, (0.3, 0.0, 4.0))

    def time(t, ahead, quick):
        slower = {3: 4.0 if ahead * quick < 0 else 1.0, 5: np.exp((10.0 - t) / 15.0)}
        return 2.0 * slower.get(law, np.exp(abs(quick) / (0.2 * 0.0025)) if law == 6 else 1.0)

    def rates(_t, z, u):
        t, x, v, quick, slow, *_ = z
        immediate = x - quick - slow
        ahead = first * immediate - quick
        return [
            (u / R - LAM * t) / C_TH,
            *mechanics(x, v, t, K * immediate),
            ahead / time(t, ahead, quick),
            (second * immediate - slow) / (2.0 * ratio),
            0.0,
            0.0,
        ]

    # long at rest under the pull: the spring's own stretch, and what has crept since
    x = START[1]
    return rates, (START[0], (1 + first + second) * x, START[2], first * x, second * x, 0.0, 0.0)


def going_on():
    """Four branches, each five times as slow as the one before and 5^0.4 times as compliant, 0.3 together."""
    late = 5.0 ** np.arange(-1.5, 2.0)
    compliances = 0.3 * late**0.4 / np.sum(late**0.4)

    def rates(_t, z, u):
        t, x, v, *crept = z
        immediate = x - sum(crept)
        return [
            (u / R - LAM * t) / C_TH,
            *mechanics(x, v, t, K * immediate),
            *(compliances * immediate - crept) / (2.0 * late),
        ]

    return rates, (START[0], 1.3 * START[1], START[2], *compliances * START[1])


def activated():
    """A dashpot that flows as a hyperbolic sine of what pulls it, in the displacement crept itself."""

    def rates(_t, z, u):
        t, x, v, crept, *_ = z
        ahead = 0.3 * (x - crept) - crept
        return [
            (u / R - LAM * t) / C_TH,
            *mechanics(x, v, t, K * (x - crept)),
            SMALL / 2.0 * np.sinh(ahead / SMALL),
            0.0,
            0.0,
            0.0,
        ]

    x = START[1]
    return rates, (START[0], 1.3 * x, START[2], 0.3 * x, 0.0, 0.0, 0.0)


SHARES = np.array([1.0, 0.6, 0.25])  # widths of plays


def hysteresis(law):
    width, plays, preisach = 0.15 * 0.01, law in (2, 3, 5), law == 5
    weights = np.exp(-0.5 * SHARES)
    weights *= np.array([1.0, 1.4, 0.7]) / weights.sum()
    sigmoid = lambda t: 0.3 * np.tanh((t / 50.0 - 0.2) / 0.3) * 0.01  # noqa: E731  # m

    def force(t, x, stops):
        if preisach:  # what has come down from far above lies a width beyond
            behind = [
                sigmoid(t) - sigmoid(0.0) - width * share * (y + 1) for share, y in zip(SHARES, stops, strict=True)
            ]
            return -0.4 * K * np.dot(weights, behind)
        return 0.4 * K * width * (np.dot(weights, SHARES * np.array(stops)) if plays else stops[0])

    def rates(_t, z, u):
        t, x, v, q, *others = z
        warming = (u / R - LAM * t) / C_TH
        moved = warming * 0.01 / 50.0 if law >= 3 else v
        if preisach:
            moved *= 1 - np.tanh((t / 50.0 - 0.2) / 0.3) ** 2
        filled = abs(q) ** (8 if plays else 3) if moved * q > 0 else 0.0
        slip = (moved - abs(moved) * q) / width if law in (1, 4) else moved / width * (1 - filled)
        narrower = [
            moved / (width * share) * (1 - (y**8 if moved * y > 0 else 0.0)) if plays else 0.0
            for share, y in zip(SHARES[1:], others, strict=True)
        ]
        return [warming, *mechanics(x, v, t, K * x + force(t, x, [q, *others])), slip, *narrower]

    if preisach:
        t, x, v = START
        return rates, (t, x - force(t, x, [-1.0] * 3) / K, v, -1.0, -1.0, -1.0)
    return rates, (*START, 0.0, 0.0, 0.0)


def late(law):
    """Three lags of 25 ms each in series where the dead time is spread, begun at what keeps it as warm as it is."""
    kept = np.sqrt(LAM * WARM * R)

    def rates(_t, z, u):
        t, x, v, *lagged = z
        if law == 0:
            return [(u / R - LAM * t) / C_TH, *mechanics(x, v, t, K * x), 0.0, 0.0, 0.0]
        chain = [(a - b) / 0.025 for a, b in zip((np.sqrt(u), *lagged[:-1]), lagged, strict=True)]
        return [(lagged[-1] ** 2 / R - LAM * t) / C_TH, *mechanics(x, v, t, K * x), *chain]

    return rates, (*START, kept, kept, kept)


EQUATIONS = {
    "resistance_temperature": copper,
    "nonlinear_heat_loss": convection,
    "two_node_thermal": two_nodes,
    "sensor_lag": lag,
    "nonlinear_stiffness": duffing,
    "creep": creeping,
    "hysteresis": hysteresis,
    "input_delay": late,
}


@pytest.mark.parametrize("case", [c for c in CASES if c[0] in EQUATIONS], ids=case_id)
def test_mechanism_is_its_equation(case):
    name, law = case
    rates, z0 = EQUATIONS[name](law)
    recording = multilevel(hold_s=1.0)
    delay = {("input_delay", 0): 0.125, ("input_delay", 1): 0.05}.get(case, 0.0)
    wanted = integrate(rates, z0, recording, delay=delay)

    if case == ("creep", 4):  # its state is how far it is behind
        x, crept = wanted[:, 1], wanted[:, 3]
        wanted = np.array(wanted)
        wanted[:, 3] = np.tanh((0.3 * (x - crept) - crept) / (2.0 * SMALL))
        z0 = (*z0[:3], 0.0, 0.0, 0.0, 0.0)

    model, start = case_of(name, law)
    names = model.structure.state_names
    mine = [i for i, s in enumerate(names) if ("." not in s and s != "time") or s.startswith(name)]
    if name == "nonlinear_stiffness":  # its rest is found by one Newton step only: begin where the test says
        start = start.at[np.array(mine)].set(z0)
    np.testing.assert_allclose(start[np.array(mine)], z0, rtol=1e-12, atol=1e-15)
    substeps = 32 if case == ("nonlinear_stiffness", 2) else 8  # a knee, bent in a fiftieth of the way
    found = simulate(model, recording, initial=start, method=Exponential(substeps=substeps))
    assert worst(found.states[:, np.array(mine)], wanted) < (2e-5 if case == ("hysteresis", 1) else 1e-6)

    felt = {"sensor_lag": 3, "two_node_thermal": 3 if law in (1, 5) else 0}.get(name, 0)
    warm = wanted[:, felt]
    if case == ("sensor_lag", 2):
        warm = 0.4 * wanted[:, 0] + 0.6 * warm
    np.testing.assert_allclose(found.outputs[:, 0] - float(model.ambient), warm, rtol=1e-6, atol=1e-6)
    assert worst(found.outputs[:, 1:], wanted[:, 1:2]) < 1e-6


# -- as terms added to the plant

# a rounded corner as the equations state it: |x| with the corner of a hyperbola
HOOK = lambda x, w: np.sqrt(x * x + w * w)  # noqa: E731


def sagging(law):
    def left(z, u):
        volts, drawn = np.sqrt(u), np.sqrt(u) / 10 if law in (0, 3) else z[3]
        return (max(volts - 0.4 * 10 * drawn, 0.0) if law in (4, 7) else volts * (1 - 0.4 * drawn)) ** 2

    def fill(t, z, u):
        given = np.sqrt(left(z, u)) / 10
        return given / 6.0 if law in (1, 5) else (given - z[3]) / 2.0

    return plant(power=lambda t, z, u: left(z, u) / R, own=(fill,))


def dead_zone(law):
    def reaching(t, z, u):
        v = np.sqrt(u)
        if law == 1:
            return u / (1 + (3.0 / v) ** 10) / R if v > 0 else 0.0
        return (v - (HOOK(v + 3, 0.3) - HOOK(v - 3, 0.3)) / 2) ** 2 / R

    return plant(power=reaching)


def drifting_room(law):
    settled = lambda t: 1 - np.exp(-max(t, 0.0) / 1.5)  # noqa: E731
    shape = {
        0: lambda t: t / 6,
        1: settled,
        2: lambda t: np.sin(t / 1.5) - 0.5 * (1 - np.cos(t / 1.5)),
        3: lambda t: settled(t - 1.25) - settled(t - 3.5),
    }[law]
    return plant(loss=lambda t, z: -LAM * 0.4 * 20 * shape(t))


def bent_force(law):
    def force(t, z, u):
        r = z[0] / 20
        if law == 0:
            return PULL * z[0] * (1 + 0.6 * r)
        if law == 1:
            return PULL * z[0] / np.sqrt(1 + 0.6 * r * r)
        if law == 3:
            return PULL * z[0] * np.hypot(r, 0.02) ** 0.6
        beyond = (r + HOOK(r - 0.5, 0.1) - HOOK(0.5, 0.1)) / 2
        return PULL * (z[0] + 0.6 * 20 * beyond)

    return plant(force=force)


def softening(law):
    def force(t, z, u):
        r = z[0] / 20
        glass = (np.tanh((r - 0.5) / 0.2) + np.tanh(0.5 / 0.2)) / 2
        lost = (0.4 * r, 0.4 * glass, 1 - np.exp(-0.4 * r))[law]
        return PULL * z[0] + K * z[1] * lost

    return plant(force=force)


def slack(law):
    def force(t, z, u):
        pull, idle = PULL * z[0], K * 0.2 * 0.0025
        taken = (HOOK(pull + idle, 0.02 * idle) - HOOK(pull - idle, 0.02 * idle)) / 2
        if law == 2:
            return pull - idle if pull > 2 * idle else pull * abs(pull) / (4 * idle)
        return pull - (taken if law == 1 else 0.0)

    return plant(force=force)


def tiring(law):
    room = float(PLANT.ambient)
    wear = {
        0: lambda t, z, u: abs(z[2]) / 10 / 0.0005,
        1: lambda t, z, u: (max(z[0], 0) / 20) ** 1.7 / 6,
        2: lambda t, z, u: (max(z[0], 0) / 20) ** 1.7 / 6,
        3: lambda t, z, u: (np.tanh((z[0] / 20 - 0.5) / 0.2) + np.tanh(0.5 / 0.2)) / 2 / 6,
        4: lambda t, z, u: np.exp(4000 / (room + 20) - 4000 / (room + z[0])) / 6,
        5: lambda t, z, u: abs((u / R - LAM * z[0]) / C_TH) / 10 / 20,
    }[law]
    worn = lambda t, z: t / 6 if law == 2 else z[3]  # noqa: E731
    return plant(force=lambda t, z, u: PULL * z[0] * (1 - 0.6 * (1 - np.exp(-0.8 / 0.6 * worn(t, z)))), own=(wear,))


def pulled_back(law):
    def force(t, z, u):
        x = z[1] / 0.0025
        beyond = (x - 0.4 + HOOK(x - 0.4, 0.02) + 0.4 - HOOK(0.4, 0.02)) / 2
        f = lambda s: s + 1 - s**-2 - s**-3  # noqa: E731
        slope = 1 + 2 * 1.1**-3 + 3 * 1.1**-4
        rubber = 0.5 * (f(1.1 + x / 0.5) - f(1.1)) / slope
        return PULL * z[0] - 0.7 * K * 0.0025 * (beyond, beyond**2, rubber)[law]

    return plant(force=force)


def drifting_sensor(_law):
    return plant()


TERMS = {
    "supply_sag": (sagging, 8),
    "drive_dead_zone": (dead_zone, 2),
    "ambient_drift": (drifting_room, 4),
    "nonlinear_thermal_force": (bent_force, 4),
    "thermal_softening": (softening, 3),
    "slack": (slack, 3),
    "fatigue": (tiring, 6),
    "antagonist_load": (pulled_back, 3),
    "sensor_drift": (drifting_sensor, 6),
}


@pytest.mark.parametrize("case", [(n, law) for n, (_, laws) in TERMS.items() for law in range(laws)], ids=case_id)
def test_added_term_is_its_equation(case):
    name, law = case
    rates, z0 = TERMS[name][0](law)
    recording = multilevel(hold_s=1.0)
    wanted = integrate(rates, z0, recording)
    model = with_active(extended(PLANT.structure, name) if name in KINKED else smooth(), name, law)
    names = model.structure.state_names
    mine = np.array([i for i, s in enumerate(names) if s.startswith(name) or ("." not in s and s != "time")])
    start = model.initial(WARM).at[mine].set(np.array(z0))
    found = simulate(model, recording, initial=start, method=Exponential(substeps=8))
    # |v| has a corner at every reversal; springs that engage are felt a step ahead
    near, near_outputs = (5e-2, 3e-3) if name == "antagonist_load" and law < 2 else (2e-6, 3e-6)
    near = 2e-4 if name == "fatigue" else near
    assert worst(found.states[:, mine], wanted) < near
    warm, moved = wanted[:, 0] + float(model.ambient), wanted[:, 1].copy()
    if name == "slack" and law == 0:
        moved -= (HOOK(moved + 5e-4, 1e-5) - HOOK(moved - 5e-4, 1e-5)) / 2
    if name == "sensor_drift":
        shape = 1 - np.exp(-recording.time / 2) if law in (2, 3) else recording.time / 6
        far, hot = (moved, wanted[:, 0]) if law > 3 else (0.0025, 20)
        moved, warm = (moved + 0.5 * far * shape, warm) if law % 2 == 0 else (moved, warm + 0.5 * hot * shape)
    np.testing.assert_allclose(found.outputs[:, 0], warm, rtol=1e-6)
    assert worst(found.outputs[:, 1], moved) < near_outputs
