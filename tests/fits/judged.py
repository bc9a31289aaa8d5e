"""A truth and an answer, made up for the proof's judge."""


def truth(*effects, sort="single", catalogue=True, subsystem="thermoelectric", tier="strong", name="a"):
    return {
        "name": name,
        "label": f"{sort}-{'+'.join(effects)}",
        "sort": sort,
        "tier": tier,
        "kind": "full",
        "noise": "fine",
        "mess": [],
        "seed": 1,
        "subset": True,
        "effects": list(effects),
        "catalogue": catalogue,
        "subsystems": [subsystem] * len(effects),
        "misfit": 5.0,
        "files": {"kept/3_sweep": {"noise": {"temperature_degC": 0.1, "displacement_mm": 0.05}}},
    }


def said(*names, verdict=None, subsystem="thermoelectric", equivalents=None, probability=0.99):
    """A result with a diagnosis that names these."""
    mechanisms = [
        {"name": n, "subsystem": subsystem, "probability": probability, "equivalents": (equivalents or {}).get(n, [])}
        for n in names
    ]
    diagnosis = {
        "schema": "scpjax.diagnosis/1",
        "verdict": verdict or ("explained" if names else "adequate"),
        "location": {"subsystem": subsystem},
        "mechanisms": mechanisms,
        "ranking": [{"name": "friction", "probability": 0.02}, {"name": "creep", "probability": 0.4}],
    }
    kept = {"3_sweep": {"temperature_degC": 0.11, "displacement_mm": 0.1}}
    return {"diagnosis": diagnosis, "kept": kept, "kept_base": {}, "seconds": 30.0}
