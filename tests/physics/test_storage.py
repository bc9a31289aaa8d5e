"""Models come back from their files bit by bit, and a file that is none is refused by name."""

import json

import jax
import numpy as np
import pytest

from scpjax.errors import ModelError
from scpjax.physics import presets
from scpjax.physics.catalogue import catalogue, left_out
from scpjax.physics.known import KNOWN_MODELS, known_model
from scpjax.physics.model import Model
from scpjax.physics.storage import load_model, save_model


def random_model(name: str, seed: int) -> Model:
    """A preset with every mechanism, random values and laws, and the ends of the range of numbers."""
    rng = np.random.default_rng(seed)
    s = presets.structure(
        name,
        drive="pwm",
        pulley_radius=0.0150000000000001 if name == "aaa" else None,
        pulley_mass=0.1 if name == "aaa" else 0.0,
        distinct=("elastic_spring.stiffness",) if name == "aaa" else (),
    ).with_mechanisms(*left_out())
    theta = rng.normal(size=len(s.slots)) * 10.0 ** rng.integers(-30, 30, size=len(s.slots))
    theta[:3] = np.pi / 3, 5e-324, 1.7976931348623157e308
    laws = [rng.integers(len(m.laws)) for m in s.mechanisms]
    return Model(s, theta, laws, 293.15000000000003)


@pytest.mark.parametrize("name", ["te", "tm", "plant", "aaa"])
@pytest.mark.parametrize("seed", range(5))
def test_round_trip_is_exact(tmp_path, name, seed):
    model = random_model(name, seed)
    extra = {"drive": ["pwm"], "response": ["displacement_mm"], "noise": {"displacement_mm": 0.1 + 0.2}}
    loaded, back = load_model(save_model(model, tmp_path / "model.json", extra=extra))
    assert loaded.structure == model.structure
    assert back == extra
    for a, b in zip(jax.tree.leaves(loaded), jax.tree.leaves(model), strict=True):
        assert np.asarray(a).tobytes() == np.asarray(b).tobytes()


def test_a_law_that_came_to_need_a_parameter_is_refused_with_the_mend(tmp_path):
    built = presets.structure("plant").with_mechanisms(catalogue()["friction"])
    stribeck = [float(m.name == "friction") for m in built.mechanisms]
    path = save_model(Model(built, laws=stribeck), tmp_path / "model.json")
    content = json.loads(path.read_text())
    del content["parameters"]["friction.faster"]
    path.write_text(json.dumps(content))
    with pytest.raises(ModelError, match=r"friction\.faster' is missing; fit again, .*, or give its value$"):
        load_model(path)


def test_what_the_file_says(tmp_path):
    model = presets.te(resistance=2.0, conductance=0.3, thermal_mass=2.0)
    content = json.loads(save_model(model, tmp_path / "model.json").read_text())
    assert content["schema"] == "scpjax.model/1"
    assert content["parameters"]["joule_heating.gain"]["value"] == 0.5
    assert content["parameters"]["newton_cooling.conductance"] == {"value": 0.3, "unit": "W/K"}
    assert content["ambient_K"] == 293.15
    assert [p.name for p in tmp_path.iterdir()] == ["model.json"]


@pytest.mark.parametrize("preset", ["te", "tm", "plant", "aaa"])
def test_a_parameter_of_other_laws_that_came_later_is_not_asked_for(tmp_path, preset):
    """A file names what its laws use (no weights of plays under Bouc-Wen's law, no stress for an Eyring's dashpot that
    is not there, fixed though it is); the rest has its null value.
    """
    whole = random_model(preset, 0)
    s, laws = whole.structure, [0] * len(whole.structure.mechanisms)
    path = save_model(Model(s, np.asarray(whole.theta), laws, 293.15), tmp_path / "model.json")
    content = json.loads(path.read_text())
    theta = np.asarray(whole.theta).copy()
    gone = []
    for slot in s.slots:
        if 0 not in s.mechanism(slot.mechanism).only_under.get(slot.parameter.name, (0,)):
            del content["parameters"][slot.key]
            theta[slot.index] = slot.parameter.null
            gone.append(slot.key)
    assert preset == "te" or {"creep.reference", "hysteresis.middle"} <= set(gone)
    path.write_text(json.dumps(content))
    np.testing.assert_array_equal(load_model(path)[0].theta, theta)


def test_a_parameter_that_the_law_uses_is_asked_for(tmp_path):
    s = presets.structure("tm").with_mechanisms(catalogue()["hysteresis"])
    theta = np.arange(1.0, len(s.slots) + 1.0)
    path = save_model(Model(s, theta, [0] * len(s.mechanisms), 293.15), tmp_path / "model.json")
    content = json.loads(path.read_text())
    del content["parameters"]["hysteresis.middle"]
    path.write_text(json.dumps(content))
    load_model(path)

    for row in content["mechanisms"]:
        if row["name"] == "hysteresis":
            row["law"] = "plays"
    path.write_text(json.dumps(content))
    with pytest.raises(ModelError, match=r"'hysteresis.middle' is missing"):
        load_model(path)


def change(path: list, value):
    def apply(content: dict) -> None:
        place = content
        for key in path[:-1]:
            place = place[key]
        if value is None:
            del place[path[-1]]
        else:
            place[path[-1]] = value

    return apply


CHANGES = {
    "schema": (change(["schema"], "scpjax.model/2"), ("'scpjax.model/2'", "scpjax.model/1")),
    "no schema": (change(["schema"], None), ("no model file",)),
    "mechanism": (
        change(["mechanisms", 0, "name"], "joule_heatin"),
        ("'joule_heatin'", "did you mean 'joule_heating'?"),
    ),
    "mechanism twice": (change(["mechanisms", 0, "name"], "newton_cooling"), ("twice",)),
    "law": (change(["mechanisms", 0, "law"], "cubic"), ("law of joule_heating", "'cubic'")),
    "unknown parameter": (
        change(["parameters", "joule_heating.gian"], {"value": 1}),
        ("did you mean 'joule_heating.gain'?",),
    ),
    "parameter missing": (
        change(["parameters", "joule_heating.gain"], None),
        ("'joule_heating.gain' is missing",),
    ),
    "text": (
        change(["parameters", "joule_heating.gain", "value"], "1"),
        ("joule_heating.gain is not a number",),
    ),
    "unit": (change(["parameters", "newton_cooling.conductance", "unit"], "mW/K"), ("'mW/K'", "'W/K'")),
    "drive": (change(["drive"], "volts"), ("'volts'", "voltage")),
    "sides": (change(["sides"], ["left"]), ("sides",)),
    "ambient": (change(["ambient_K"], None), ("ambient_K",)),
    "kind": (change(["thermal"], "yes"), ('"thermal"', "true or false")),
    "extra": (change(["extra"], []), ('"extra"',)),
}


@pytest.mark.parametrize("name", CHANGES)
def test_a_file_that_is_none_is_refused(tmp_path, name):
    alter, says = CHANGES[name]
    path = save_model(presets.te(resistance=2.0, conductance=0.3, thermal_mass=2.0), tmp_path / "model.json")
    content = json.loads(path.read_text())
    alter(content)
    path.write_text(json.dumps(content))
    with pytest.raises(ModelError) as error:
        load_model(path)
    assert str(error.value).startswith(f"{path}")
    for words in says:
        assert words in str(error.value)


@pytest.mark.parametrize("text", ["", "{", "[1]", "null", '{"schema": NaN}', "\x00"])
def test_no_json(tmp_path, text):
    (tmp_path / "model.json").write_text(text)
    with pytest.raises(ModelError, match=r"model\.json"):
        load_model(tmp_path / "model.json")


def test_what_is_not_finite_is_not_saved(tmp_path):
    model = presets.te(resistance=2.0, conductance=0.3, thermal_mass=2.0).replace({"joule_heating.gain": np.nan})
    with pytest.raises(ModelError, match=r"joule_heating\.gain is nan"):
        save_model(model, tmp_path / "model.json")
    assert not list(tmp_path.iterdir())


def test_known_models_are_those_of_the_thesis():
    assert set(KNOWN_MODELS) == {"te", "tm", "plant", "aaa", "thesis"}
    compact = presets.to_compact(known_model("thesis"))
    np.testing.assert_allclose(
        [compact.b0, compact.a2, compact.a1, compact.a0], [0.0300e-2, 1.5053, 1.2661, 0.1909], rtol=1e-9
    )
    plant = known_model("plant").values()
    assert plant["elastic_spring.stiffness"] == 102.84
    assert plant["joule_heating.gain"] == pytest.approx(1 / 1.07)
    assert known_model("plant", drive="current").values()["joule_heating.gain"] == 1.07
    assert known_model("aaa").structure.pulley_radius == 0.015
    assert all(known_model(n, drive="temperature" if n == "tm" else "pwm").structure.slots for n in KNOWN_MODELS)
    with pytest.raises(ModelError, match="no gain for this drive"):
        known_model("te", drive="gain")
