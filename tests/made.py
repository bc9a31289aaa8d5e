"""A diagnosis made by hand, for what only reads one."""

import numpy as np

from scpjax.diagnose.result import Diagnosis, Location, Named, Scores
from scpjax.fit.result import Estimate, Trace
from scpjax.physics import presets
from scpjax.recordings.recording import Recording


def made_diagnosis(recording: Recording, *, stiffness: float = 100.0, named: str = "creep") -> Diagnosis:
    """Of one recording: a plant with that stiffness, and one mechanism named (none: "")."""
    base = presets.plant(
        resistance=1.0, conductance=0.3, thermal_mass=2.0, coefficient=0.01, stiffness=stiffness, damping=0.5, mass=0.1
    )
    k = Estimate(stiffness, 2.0, "N/m", stiffness - 4, stiffness + 4, "stiffness of the coil", "k")
    size = Estimate(0.3, 0.01, "1", 0.28, 0.32, "share", "J")
    x = np.asarray(recording.output("displacement"))
    trace = Trace(
        recording.metadata.name, "displacement_mm", recording.time, recording.inputs, ("voltage_V",), 1e3 * x,
        np.ones(len(x)), 1e3 * x, 1e3 * x, np.zeros(len(x), bool),
    )  # fmt: skip
    scores = {"displacement_mm": {"rmse": 0.2, "nrmse": 95.0, "mae": 0.1}}
    mechanisms = (
        Named(named, named.capitalize(), "thermomechanical", "", 0.97, {"size": size}, (), "It gives.", "", ""),
    )
    return Diagnosis(
        verdict="explained" if named else "adequate",
        says=f"Left out of the base model: {named}." if named else "Nothing is missing.",
        base=Scores("plant", scores, scores, {"displacement_mm": 0.1}),
        extended=Scores("plant", scores, scores, {"displacement_mm": 0.1}),
        location=Location("thermomechanical", "displacement_mm"),
        mechanisms=mechanisms if named else (),
        ranking=(),
        base_parameters={"elastic_spring.stiffness": k},
        not_identifiable=(),
        notes=(),
        model=base,
        base_model=base,
        traces=(trace,),
        seconds=1.0,
        settings={"files": [recording.metadata.path]},
    )
