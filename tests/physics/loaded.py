"""An actuator that moves a weight, in numbers that tests write its equations out with."""

from scpjax.physics import presets

GAIN, CONDUCTANCE, THERMAL_MASS, COEFFICIENT, STIFFNESS, DAMPING, MASS = 0.8, 0.14, 1.2, 0.02, 160.0, 8.0, 0.25
PLANT = presets.plant(
    resistance=1 / GAIN,
    conductance=CONDUCTANCE,
    thermal_mass=THERMAL_MASS,
    coefficient=COEFFICIENT,
    stiffness=STIFFNESS,
    damping=DAMPING,
    mass=MASS,
)
