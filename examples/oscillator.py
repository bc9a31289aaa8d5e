"""A base model of one's own: an electronic oscillator, a series circuit whose voltage across the capacitor is recorded.

scpjax diagnose multisine.csv --base oscillator.py --drive drive_V --response response_V --out found
"""

from scpjax.parameter import Parameter
from scpjax.physics.mechanism import Mechanism
from scpjax.physics.system import System


class Oscillator(System):
    name = "oscillator"
    title = "Series oscillator"
    equation = "y'' + 2 z w y' + w^2 y = g w^2 u"
    source = "Kirchhoff's voltage law for R, L and C in series: w = 1/sqrt(L C), z = R/2 sqrt(C/L)"
    says = "Charge runs to and fro between coil and capacitor and loses a little in the resistor each time."
    states = ("response", "rate")
    outputs = ("response_V",)
    parameters = (
        Parameter(
            name="frequency", symbol="ω", unit="rad/s", description="natural frequency", typical=400.0,
            bounds=(1e-2, 1e7),
        ),
        Parameter(
            name="damping", symbol="ζ", unit="1", description="damping ratio", typical=0.05, bounds=(1e-4, 20.0),
        ),
        Parameter(
            name="gain", symbol="g", unit="1", description="response to a constant drive", typical=1.0,
            bounds=(-1e3, 1e3), scale="linear",
        ),
    )  # fmt: skip
    starts = ((400.0, 0.05, 1.0), (100.0, 0.2, 1.0), (1000.0, 0.2, 1.0))

    def rates(self, p, view):
        response, rate = view.own
        pull = p.frequency**2 * (p.gain * view.effort - response)
        return (rate, pull - 2.0 * p.damping * p.frequency * rate)

    def observe(self, p, view):
        return (view.own[0],)


class NonlinearCapacitor(Mechanism):
    name = "nonlinear_capacitor"
    title = "The capacitor's voltage is not proportional to its charge"
    subsystem = "balance"
    equation = "y'' -= w^2 (a y^2 + b y^3)"
    source = "Duffing's oscillator; as feedback of an analogue multiplier: Wigren, Schoukens, Silverbox (2013)"
    says = "At large amplitudes the restoring voltage grows more, or less, than in proportion."
    needs = ("oscillator",)
    excited_by = "small and large amplitudes"
    parameters = (
        Parameter(
            name="quadratic", symbol="a", unit="1/V", description="differs by direction", typical=0.0,
            bounds=(-1e3, 1e3), null=0.0, scale="linear", spread=5.0,
        ),
        Parameter(
            name="cubic", symbol="b", unit="1/V^2", description="the same in both", typical=0.0, bounds=(-1e4, 1e4),
            null=0.0, scale="linear", spread=20.0,
        ),
    )  # fmt: skip
    starts = ((0.1, 1.0), (-0.1, -0.2))

    def flows(self, p, view):
        y = view.states["response"]
        return {"rate": -(view.shared["frequency"] ** 2) * y * y * (p.quadratic + p.cubic * y)}


class NonlinearResistor(Mechanism):
    name = "nonlinear_resistor"
    title = "The resistor's loss is not proportional to the current"
    subsystem = "balance"
    equation = "y'' -= 2 z w c y'^3 / w^2"
    source = "van der Pol, Phil. Mag. 2 (1926) 978"
    says = "Strong currents are damped more, or less, than in proportion."
    needs = ("oscillator",)
    excited_by = "small and large amplitudes near resonance"
    parameters = (
        Parameter(
            name="cubic", symbol="c", unit="1/V^2", description="loss that grows with the square of the current",
            typical=0.0, bounds=(-1e4, 1e4), null=0.0, scale="linear", spread=20.0,
        ),
    )  # fmt: skip
    starts = ((1.0,), (-0.5,))

    def flows(self, p, view):
        rate, w = view.states["rate"], view.shared["frequency"]
        return {"rate": -2.0 * view.shared["damping"] * p.cubic * rate**3 / w}
