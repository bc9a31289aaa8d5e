"""The plant's equations written out, and scipy's integration of such: what simulations are held against."""

import numpy as np
import scipy.integrate
import scipy.signal
from sim_cases import PARAMETERS

P = PARAMETERS
R, LAM, C_TH = P["resistance"], P["conductance"], P["thermal_mass"]
PULL, K, BETA, M = P["coefficient"], P["stiffness"], P["damping"], P["mass"]
WARM = 10.0
START = (WARM, PULL * WARM / K, 0.0)
HOOK = lambda x, w: np.sqrt(x * x + w * w)  # noqa: E731  # |x| with the corner of a hyperbola


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


def mechanics(x, v, pulling, spring):
    return [v, (PULL * pulling - BETA * v - spring) / M]


def plant(*, power=None, loss=0.0, force=None, own=()):
    """Rates of the plant with a term changed: own states follow the three of the plant."""

    def rates(t, z, u):
        warm, x, v = z[:3]
        into = u / R if power is None else power(t, z, u)
        back = -K * x - BETA * v + (PULL * warm if force is None else force(t, z, u))
        gone = LAM * warm + (loss(t, z) if callable(loss) else loss)
        return [(into - gone) / C_TH, v, back / M, *[rate(t, z, u) for rate in own]]

    return rates, (*START, *[0.0] * len(own))


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
