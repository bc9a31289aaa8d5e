"""Left-out mechanisms against their equations, written out here and integrated by scipy."""

import numpy as np
import pytest
from sim_cases import CASES, PLANT, case_id, case_of, multilevel, worst
from written_out import C_TH, HOOK, LAM, START, WARM, K, R, integrate, mechanics

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
    share, tau, slow, ratio = 0.4, 0.3, 0.3 if law in (3, 7) else 0.0, 7.0
    between = share * (1 - share) * C_TH / tau

    def rates(_t, z, u):
        t, x, v, t2, t3 = z
        loss, loss2 = (0.0, LAM * t2) if law in (1, 5) else (LAM * t, 0.0)
        quickly, slowly = (1 - slow) * between * (t - t2), slow * between / ratio * (t - t3)
        first = (u / R - loss - quickly - slowly) / ((1 - share) * C_TH)
        second = (quickly - loss2) / ((1 - slow) * share * C_TH)
        third = between / (share * C_TH) / ratio * (t - t3)
        mean = (1 - share) * t + share * ((1 - slow) * t2 + slow * t3)
        pulls = t2 if law < 2 else mean if law >= 6 else t
        return [first, *mechanics(x, v, pulls, K * x), second, third]

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
    moves, averages, series = law == 4, law in (3, 4), law in (1, 5)
    first, goes_on = 0.3 * (0.25 if law in (5, 6) else 1.0), series or law == 6

    def rates(_t, z, u):
        t, x, v, y, w, *more = z
        own = [((w if series else t) - y) / 0.3, (t - w) / first if goes_on else 0.0, 0.0, 0.0]
        if averages:
            left = (x if moves else t) - y - w / 2 - 3 * more[0] / 28 - more[1] / 84
            own = [w / 0.6, more[0] / 0.6, more[1] / 0.6, 1680 * left / 0.6]
        return [(u / R - LAM * t) / C_TH, *mechanics(x, v, t, K * x), *own]

    return rates, (*START, START[1] if moves else WARM, WARM if goes_on else 0.0, 0.0, 0.0)


def duffing(law):
    def rates(_t, z, u):
        t, x, v = z
        r = x / 0.01
        beyond = (abs(r) + HOOK(abs(r) - 0.1, 0.02) - HOOK(0.1, 0.02)) / 2
        near = abs(0.9 * r) ** 1.5
        steeper = np.expm1(2.0 * r) / (2.0 * r) - 1 if r else 0.0
        changes = (
            0.3 * r + 0.4 * r**2,
            5.0 * abs(r) ** 3.0,
            0.5 * beyond / max(abs(r), 1e-12),
            steeper,
            near / (1 - near),
        )
        change = changes[law]
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


def hysteresis(law):
    width, preisach, four = 0.15 * 0.01, law == 5, law in (6, 7)
    plays, thermal = law in (2, 3, 5) or four, law >= 3 and law != 6
    shares = np.array([1.0, 0.75, 0.25, 0.5] if four else [1.0, 0.6, 0.25])  # widths of plays, as they weigh
    weights = np.exp(-0.5 * shares)
    weights *= np.array([1.0, 1.4, 0.7, 1.2])[: len(shares)] / weights.sum()
    if four:  # and as they are
        shares = np.array([1.0, 0.8, 0.3, 0.6])
    sigmoid = lambda t: 0.3 * np.tanh((t / 50.0 - 0.2) / 0.3) * 0.01  # noqa: E731  # m

    def force(t, x, stops):
        stops = np.array(stops[: len(shares)])
        if preisach:  # what has come down from far above lies a width beyond
            behind = sigmoid(t) - sigmoid(0.0) - width * shares * (stops + 1)
            return -0.4 * K * np.dot(weights, behind)
        return 0.4 * K * width * (np.dot(weights, shares * stops) if plays else stops[0])

    def rates(_t, z, u):
        t, x, v, q, *others = z
        warming = (u / R - LAM * t) / C_TH
        moved = warming * 0.01 / 50.0 if thermal else v
        if preisach:
            moved *= 1 - np.tanh((t / 50.0 - 0.2) / 0.3) ** 2
        sharp = 16 if four else 8 if plays else 3
        filled = abs(q) ** sharp if moved * q > 0 else 0.0
        slip = (moved - abs(moved) * q) / width if law in (1, 4) else moved / width * (1 - filled)
        narrower = [0.0, 0.0, 0.0]
        if plays:
            for i, (share, y) in enumerate(zip(shares[1:], others, strict=False)):
                narrower[i] = moved / (width * share) * (1 - (y**sharp if moved * y > 0 else 0.0))
        return [warming, *mechanics(x, v, t, K * x + force(t, x, [q, *others])), slip, *narrower]

    if preisach:
        t, x, v = START
        return rates, (t, x - force(t, x, [-1.0] * 3) / K, v, -1.0, -1.0, -1.0, -1.0)
    return rates, (*START, 0.0, 0.0, 0.0, 0.0)


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
    warm, moved = wanted[:, felt], wanted[:, 1:2]
    if case == ("sensor_lag", 2):
        warm = 0.4 * wanted[:, 0] + 0.6 * warm
    if case == ("sensor_lag", 6):
        warm = 0.4 * wanted[:, 4] + 0.6 * warm
    if name == "sensor_lag" and law in (3, 4):
        mean = wanted[:, 3] + wanted[:, 5] / 42
        warm, moved = (mean, moved) if law == 3 else (wanted[:, 0], mean[:, None])
    np.testing.assert_allclose(found.outputs[:, 0] - float(model.ambient), warm, rtol=1e-6, atol=1e-6)
    assert worst(found.outputs[:, 1:], moved) < 1e-6
