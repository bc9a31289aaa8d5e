"""A mechanism of one's own: moist nylon dries when it is heated, and the water takes heat with it.

    scpjax diagnose wet.csv --mechanism evaporation.py --out found

A class says which balance it adds to (here `heat`, with a state of its own), what its parameters are with units,
bounds and a null value at which it vanishes, where a search may start, and what it is in plain words.
"""

from scpjax.parameter import Parameter
from scpjax.physics.mechanism import Mechanism

REFERENCE = 50.0  # K above ambient at which water leaves with the time constant


class Evaporation(Mechanism):
    name = "evaporation"
    title = "Water evaporates from the polymer"
    subsystem = "thermoelectric"
    equation = "dw/dt = -w T / (50 K tau),  heat = -E w T / (50 K tau),  w(0) = 1"
    source = "first-order drying in proportion to the temperature excess; a model for this example"
    says = "Moist polymer dries while it is hot, and the water takes heat with it, the first time more than later."
    needs = ("thermal",)
    excited_by = "a long first heating from a moist start"
    states = ("water",)
    parameters = (
        Parameter(
            name="energy",
            symbol="E",
            unit="J",
            description="heat that all the water takes with it",
            typical=100.0,
            bounds=(0.1, 1e5),
            null=0.0,
            spread=2.0,
        ),
        Parameter(
            name="time_constant",
            symbol="τ",
            unit="s",
            description="time constant of drying at 50 K above ambient",
            typical=60.0,
            bounds=(1.0, 1e4),
            null=60.0,
            spread=2.0,
        ),
    )
    starts = ((30.0, 30.0), (100.0, 100.0))

    def _rate(self, p, view):
        (water,) = view.own
        return water * view.temperature / (REFERENCE * p.time_constant)

    def heat(self, p, view):
        return -p.energy * self._rate(p, view)

    def rates(self, p, view):
        return (-self._rate(p, view),)

    def initial(self, p, view):
        return (1.0 + 0.0 * view.temperature,)  # every recording begins moist
