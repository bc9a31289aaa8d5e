"""Differentiable simulation, fitting and diagnosis of small heated or sprung actuators."""

__version__ = "0.1.0"
