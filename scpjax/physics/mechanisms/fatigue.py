"""A coil that pulls less and less the more it has been used."""

from typing import ClassVar

import jax.numpy as jnp

from scpjax.parameter import Parameter
from scpjax.physics.mechanism import Mechanism, Side, Values, View
from scpjax.physics.smooth import rise

_COLD = 1e-6  # of the reference excess, below which nothing ages: a power's slope is finite there
_FROZEN = 50.0  # K, below which no actuator is
STROKES = 10.0  # travels of the reference displacement, or of the reference excess, for which the loss is stated


class Fatigue(Mechanism):
    name = "fatigue"
    title = "The coil tires"
    subsystem = "thermomechanical"
    equation = (
        "F = P (1 - b (1 - exp(-a w/b))), P all that warmth pulls, w = 0 at the start;  "
        "law strokes: dw/dt = |v|/(10 x_ref);  law heat: dw/dt = (max(T, 0)/T_ref)^n / t_ref;  law time: w = t/t_ref;  "
        "law onset: dw/dt = (tanh((T/T_ref - c)/d) + tanh(c/d))/2 / t_ref;  "
        "law Arrhenius: dw/dt = exp(E (1/(T_amb + T_ref) - 1/(T_amb + T))) / t_ref;  "
        "law thermal cycles: dw/dt = |dT/dt|/(10 T_ref)"
    )
    source = (
        "loss of stroke over cycles of twisted and coiled nylon: Haines et al., Science 343 (2014) 868; annealing "
        "under load, and its onset at a transition: Struik, Physical Aging in Amorphous Polymers and Other Materials, "
        "ch. 4; ageing of polymers by Arrhenius' law: Celina, Gillen, Assink, Polym. Degrad. Stab. 90 (2005) 395; "
        "thermal cycles: Coffin, Trans. ASME 76 (1954) 931, here in proportion to the path of the temperature"
    )
    says = "With every stroke, or every hot minute, the coil's pull grows weaker."
    needs = ("mechanical",)
    excited_by = "the same input again and again"
    timed = True
    only_under: ClassVar[dict[str, tuple[int, ...]]] = {
        "acceleration": (1,),
        "onset": (3,),
        "width": (3,),
        "activation": (4,),
    }
    laws = ("strokes", "heat", "time", "onset", "Arrhenius", "thermal cycles")
    law_needs: ClassVar[dict[int, tuple[str, ...]]] = {5: ("thermal",)}
    states = ("wear",)
    parameters = (
        Parameter(
            name="loss",
            symbol="a",
            unit="1",
            description="share of the force that would be lost, at the pace of the beginning, in ten travels of the "
            "reference displacement (strokes) or of the reference excess (thermal cycles), the reference time at the "
            "reference excess (heat, Arrhenius) or in that time (time)",
            typical=0.3,
            bounds=(0.003, 30.0),
            null=0.0,
            spread=1.5,
        ),
        Parameter(
            name="most",
            symbol="b",
            unit="1",
            description="share of the force that is lost in the end",
            typical=0.6,
            bounds=(0.02, 1.0),
            null=0.6,
            spread=0.5,
        ),
        Parameter(
            name="acceleration",
            symbol="n",
            unit="1",
            description="power of the temperature excess with which it ages (law heat)",
            typical=1.0,
            bounds=(0.3, 6.0),
            null=1.0,
            spread=0.6,
        ),
        Parameter(
            name="onset",
            symbol="c",
            unit="1",
            description="temperature excess above which it ages, as a share of the reference excess (law onset)",
            typical=0.4,
            bounds=(0.03, 1.5),
            null=0.4,
            spread=0.7,
        ),
        Parameter(
            name="width",
            symbol="d",
            unit="1",
            description="width of that onset, as a share of the reference excess (law onset)",
            typical=0.15,
            bounds=(0.03, 1.0),
            null=0.15,
            spread=0.7,
        ),
        Parameter(
            name="activation",
            symbol="E",
            unit="K",
            description="activation energy over the gas constant (law Arrhenius)",
            typical=5000.0,
            bounds=(500.0, 40000.0),
            null=5000.0,
            spread=0.7,
        ),
        Parameter(
            name="reference",
            symbol="x_ref",
            unit="m",
            description="displacement that counts as a travel",
            typical=0.01,
            bounds=(1e-12, 1e12),
            null=0.01,
            fixed=True,
        ),
        Parameter(
            name="reference_temperature",
            symbol="T_ref",
            unit="K",
            description="temperature excess at which the loss is stated",
            typical=50.0,
            bounds=(1e-6, 1e9),
            null=50.0,
            fixed=True,
        ),
        Parameter(
            name="reference_time",
            symbol="t_ref",
            unit="s",
            description="time for which the loss is stated",
            typical=100.0,
            bounds=(1e-9, 1e9),
            null=100.0,
            fixed=True,
        ),
    )
    starts = ((0.3, 0.6, 1.0, 0.4, 0.15, 5000.0, 0.0, 0.0, 0.0),)

    def pull_factor(self, p: Values, view: View) -> Side:
        wear = p.loss * jnp.where(p.law == 2, view.time / p.reference_time, view.own[0])
        return 1.0 + p.most * jnp.expm1(-wear / p.most)

    def rates(self, p: Values, view: View) -> tuple[Side, ...]:
        strokes = jnp.abs(view.velocity) / (STROKES * p.reference)
        excess = jnp.maximum(view.temperature / p.reference_temperature, _COLD)
        heat = (excess**p.acceleration - _COLD**p.acceleration) / p.reference_time
        onset = rise(view.temperature / p.reference_temperature, p.onset, p.width) / p.reference_time
        hottest, hot = view.ambient + p.reference_temperature, jnp.maximum(view.ambient + view.temperature, _FROZEN)
        arrhenius = jnp.exp(p.activation * (1.0 / hottest - 1.0 / hot)) / p.reference_time
        cycles = jnp.abs(view.warming) / (STROKES * p.reference_temperature)
        which = [p.law == law for law in (0, 3, 4, 5)]
        return (jnp.select(which, [strokes, onset, arrhenius, cycles * jnp.ones_like(heat)], heat),)

    def initial(self, p: Values, view: View) -> tuple[Side, ...]:
        return (jnp.zeros_like(view.displacement),)
