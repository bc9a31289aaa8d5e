"""Closure of the energy balance: a heat flow or store learned from the recordings as a smooth curve, without a name."""

from dataclasses import replace

import jax.numpy as jnp
import numpy as np

from scpjax.physics.curves import Form, LearnedCurve, product
from scpjax.physics.mechanism import Side, Values, View

LEAST = 0.1  # of the thermal mass, that a curve leaves of it
_NODES, _SHARES = (0.5 + 0.5 * np.polynomial.legendre.leggauss(24)[0], 0.5 * np.polynomial.legendre.leggauss(24)[1])


class LearnedHeatCurve(LearnedCurve):
    name = "learned_heat_curve"
    title = "Learned heat flow"
    subsystem = "thermoelectric"
    equation = (
        "heat = -lambda T_high f s(w), s a spline that is 0 at rest; law of store: C_th (1 + s(T)), at least C_th/10, "
        "in place of C_th"
    )
    says = "A heat flow or store that no mechanism of the catalogue describes, as a smooth curve."
    needs = ("thermal",)
    forms = (
        Form("temperature", "displacement"),
        Form("temperature", "temperature", names=("nonlinear_heat_loss",)),
        Form("", "displacement"),
        Form("temperature", "velocity"),
        Form("effort", "temperature", names=("resistance_temperature",)),
        Form("effort", "displacement"),
        Form("", "temperature", "store"),
        Form("", "effort", names=("supply_sag", "drive_dead_zone")),
        Form("", "time", names=("ambient_drift",)),
    )

    def heat(self, p: Values, view: View) -> Side:
        return -view.shared["conductance"] * p.temperature_high * product(self.forms, p, view)

    def capacity(self, p: Values, view: View) -> Side:
        more = jnp.maximum(product(self.forms, p, view, "store"), LEAST - 1.0)
        return view.shared["thermal_mass"] * more

    def stored(self, p: Values, view: View) -> Side:
        """The integral of `capacity` over the temperature, from rest."""
        total = jnp.zeros_like(view.temperature)
        for node, share in zip(_NODES, _SHARES, strict=True):
            total = total + share * self.capacity(p, replace(view, temperature=node * view.temperature))
        return total * view.temperature
