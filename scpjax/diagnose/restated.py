"""How the parameters of mechanisms go with the fixed numbers for which they are stated, which differ by actuator.

A strength at T_ref is another number at another T_ref, and the same physics. A new mechanism may stand here or not:
what does not is compared among actuators that state it for the same.
"""

_BY: tuple[tuple[dict[str, int], tuple[str, ...]], ...] = (
    (
        {},
        (
            *("ambient_drift.begin", "ambient_drift.end", "ambient_drift.time_constant", "antagonist_load.angle"),
            *(
                f"antagonist_load.strength ({w})"
                for w in ("one-sided spring", "rubber band", "uneven, one-sided spring")
            ),
            *("antagonist_load.excess", "creep.compliance", "creep.shift", "drive_dead_zone.corner"),
            *("creep.time_constant (activated)", "creep.time_constant (hardening)", "drive_dead_zone.sharpness"),
            *("drive_dead_zone.shoulder", "fatigue.acceleration", "fatigue.activation", "fatigue.most"),
            *("friction.faster", "friction.static", "hysteresis.inner", "hysteresis.middle", "hysteresis.sharpness"),
            *("hysteresis.fourth", *(f"hysteresis.{play}_width" for play in ("middle", "inner", "fourth"))),
            *(f"hysteresis.strength ({law})" for law in ("Bouc-Wen", "Duhem", "plays", "four plays")),
            *("nonlinear_heat_loss.exponent", "nonlinear_stiffness.abruptness", "nonlinear_stiffness.engaged"),
            *(f"nonlinear_thermal_force.growth ({law})" for law in ("threshold", "glass transition", "power")),
            *("nonlinear_thermal_force.abruptness", "nonlinear_stiffness.exponent", "slack.corner"),
            *("sensor_drift.exponent", "sensor_drift.time_constant"),
            *("supply_sag.sag (cell)", "supply_sag.sag (shared cell)", "supply_sag.time_constant"),
            *(f"supply_sag.at_once ({s}Thevenin{more})" for s in ("", "shared ") for more in ("", ", two branches")),
            *("supply_sag.slow_share", "supply_sag.slow_ratio"),
            "thermal_softening.softening (glass transition)",
        ),
    ),
    (
        {"reference": 1},
        (
            *("ambient_drift.drift", "ambient_drift.quadrature", "antagonist_load.length", "antagonist_load.onset"),
            *("antagonist_load.strength (link)", "antagonist_load.strength (lifted weight)", "creep.activation"),
            *("creep.hardening", "drive_dead_zone.threshold", "friction.presliding", "friction.strength"),
            *(f"hysteresis.width ({law})" for law in ("Bouc-Wen", "Duhem", "plays", "four plays")),
            *("nonlinear_stiffness.knee", "nonlinear_thermal_force.transition", "nonlinear_thermal_force.width"),
            *("sensor_drift.drift (displacement settling)", "slack.gap"),
            *("thermal_softening.transition", "thermal_softening.width"),
        ),
    ),
    (
        {"reference": -1},
        (
            *("antagonist_load.strength (hardening)", "fatigue.loss (strokes)", "friction.velocity_time"),
            *("nonlinear_stiffness.nearness", "nonlinear_stiffness.quadratic", "nonlinear_stiffness.steepness"),
            *(f"supply_sag.sag ({s}{law})" for s in ("", "shared ") for law in ("load", "polarisation", "late load")),
            *(f"supply_sag.sag ({s}Thevenin{more})" for s in ("", "shared ") for more in ("", ", two branches")),
            *("nonlinear_thermal_force.growth (quadratic)", "thermal_softening.softening (linear)"),
            "thermal_softening.softening (exponential)",
        ),
    ),
    ({"reference": -2}, ("nonlinear_stiffness.cubic", "nonlinear_thermal_force.growth (saturating)")),
    (
        {"reference_temperature": 1},
        (
            *("fatigue.onset", "fatigue.width", "hysteresis.centre", "hysteresis.span"),
            *(f"hysteresis.width (thermal {law})" for law in ("plays", "Duhem", "Preisach", "four plays")),
            "sensor_drift.drift (temperature settling)",
        ),
    ),
    ({"reference_temperature": -1}, ("fatigue.loss (thermal cycles)",)),
    (
        {"reference_time": -1},
        (
            *("fatigue.loss (onset)", "fatigue.loss (time)"),
            *("sensor_drift.drift (displacement gain)", "sensor_drift.drift (temperature gain)"),
        ),
    ),
    ({"reference": 1, "reference_time": -1}, ("ambient_drift.drift (linear)", "sensor_drift.drift (displacement)")),
    ({"reference_temperature": 1, "reference_time": -1}, ("sensor_drift.drift (temperature)",)),
    ({"reference": 1, "reference_time": 1}, ("supply_sag.capacity",)),
    (
        {"reference": -1, "reference_time": -1},
        tuple(f"supply_sag.sag ({s}{law})" for s in ("", "shared ") for law in ("charge", "exhaustion")),
    ),
    (
        {"reference": 1, "reference_temperature": -1},
        tuple(f"hysteresis.strength (thermal {law})" for law in ("plays", "Duhem", "Preisach", "four plays")),
    ),
)
POWERS: dict[str, dict[str, int]] = {key: powers for powers, keys in _BY for key in keys}
"""By parameter, or parameter and law: the powers of the references that, times its value, make what does not depend on
what it was stated for. Others, as a strength at T_ref under a power that is estimated too, cannot be restated alone.
"""


def powers_of(key: str, law: str) -> dict[str, int] | None:
    """`POWERS` of a parameter, of any side or recording; None where it cannot be restated."""
    name = key.split("@")[0]
    return POWERS.get(f"{name} ({law})", POWERS.get(name))
