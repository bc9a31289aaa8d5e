"""A base model from a user's own file: simulated as scipy does, settled, fitted, diagnosed, written and found again."""

import json
import subprocess
import sys
from pathlib import Path

import jax.numpy as jnp
import numpy as np
import pytest
from own_files import assert_refused
from scipy.integrate import solve_ivp

from scpjax.cli import main
from scpjax.physics.catalogue import catalogue, forget, left_out, mechanism, systems
from scpjax.physics.model import Model
from scpjax.physics.presets import system_structure
from scpjax.physics.settled import settled
from scpjax.recordings.files import write_recording
from scpjax.recordings.recording import Metadata, Recording
from scpjax.simulate.simulate import Exponential, simulate
from scpjax.simulate.trial import use, use_base

EXAMPLES = Path(__file__).resolve().parents[2] / "examples"
TANKS = EXAMPLES / "two_tanks.py"
TRUTH = {"two_tanks.gain": 0.05, "two_tanks.upper_rate": 0.03, "two_tanks.lower_rate": 0.015}
EDGE, SHARE, WEIR = 6.0, 0.6, 0.2


@pytest.fixture
def tanks():
    yield use_base(TANKS)
    forget(TANKS)


def drive(n: int = 260, seed: int = 0) -> np.ndarray:
    return np.repeat(np.random.default_rng(seed).uniform(0.0, 6.0, n // 20 + 1), 20)[:n]


def scipy_level(pump: np.ndarray, start: tuple[float, float], spill: bool) -> np.ndarray:
    """Level of the lower tank [V] every 4 s, by scipy alone."""

    def rates(t, h):
        u = pump[min(int(t / 4.0 + 1e-9), len(pump) - 1)]
        over = WEIR * max(h[0] - EDGE, 0.0) if spill else 0.0
        between = 0.03 * h[0]
        return [0.05 * u - between - over, between - 0.015 * h[1] + SHARE * over]

    time = 4.0 * np.arange(len(pump))
    return solve_ivp(rates, (0, time[-1]), start, t_eval=time, max_step=0.5, rtol=1e-9, atol=1e-10).y[1]


def recording(name: str, level: np.ndarray, pump: np.ndarray, noise: float = 0.0) -> Recording:
    level = level + noise * np.random.default_rng(5).standard_normal(len(level))
    time = 4.0 * np.arange(len(pump))
    return Recording.from_arrays(time, {"pump_V": pump}, {"level_V": level}, metadata=Metadata(name=name))


def spilling(share: float = SHARE) -> Model:
    structure = system_structure(systems()["two_tanks"]).with_mechanisms(mechanism("upper_overflow"))
    spill = {"upper_overflow.weir": WEIR, "upper_overflow.edge": EDGE, "upper_overflow.share": share}
    return Model(structure).replace({**TRUTH, **spill})


@pytest.mark.parametrize("method", [Exponential(order=2, substeps=8), Exponential(order=4, substeps=8)])
def test_it_is_simulated_as_scipy_does(tanks, method):
    pump = drive()
    truth = scipy_level(pump, (2.0, 3.0), spill=True)
    made = recording("made", truth, pump)
    said = np.asarray(simulate(spilling(), made, initial=jnp.array([2.0, 3.0]), method=method).outputs[:, 0])
    # the corner of the weir is rounded over 0.05 V, where the truth has a kink
    assert np.max(np.abs(said - truth)) < 0.03 < 0.05 * np.ptp(truth - scipy_level(pump, (2.0, 3.0), spill=False))
    without = scipy_level(pump, (2.0, 3.0), spill=False)
    plain = Model(system_structure(tanks)).replace(TRUTH)
    said = np.asarray(simulate(plain, made, initial=jnp.array([2.0, 3.0]), method=method).outputs[:, 0])
    np.testing.assert_allclose(said, without, atol=1e-5)


def test_it_settles_where_it_stands_still_and_shows_the_reading(tanks):
    model = spilling()
    for level in (2.0, 13.0):  # below, and above what lets the upper tank overflow
        z = settled(model, {0: level})
        assert float(z[1]) == pytest.approx(level)
        held = 0.015 * level  # what the lower tank loses
        upper = held / 0.03 if held / 0.03 < EDGE else (held + SHARE * WEIR * EDGE) / (0.03 + SHARE * WEIR)
        assert float(z[0]) == pytest.approx(upper, abs=0.02)
    assert np.all(np.asarray(settled(model, {})) == 0.0)


def test_it_is_fitted_written_and_found_again(tmp_path, monkeypatch, capsys):
    """As a user would, from the command line; a process that has not seen the base predicts with it."""
    monkeypatch.chdir(tmp_path)
    Path("base.py").write_text(TANKS.read_text())
    for i, name in enumerate(("one", "two")):
        pump = drive(seed=i)
        write_recording(recording(name, scipy_level(pump, (1.0, 2.0), False), pump, 0.01), f"{name}.csv")
    roles = ["--drive", "pump_V", "--response", "level_V"]
    try:
        assert main(["fit", "one.csv", "--base", "base.py", "--out", "found", "--quiet", *roles]) == 0
    finally:
        forget("base.py")
    found = json.loads(Path("found/fit.json").read_text())
    assert found["model"] == "two_tanks"
    for key, value in TRUTH.items():
        assert abs(found["parameters"][key]["value"] - value) < 4 * found["parameters"][key]["std"]
    call = [sys.executable, "-m", "scpjax.cli", "predict", "found/model.json", "two.csv", "--out", "said.csv"]
    done = subprocess.run(call, capture_output=True, text=True)
    assert done.returncode == 0, done.stderr
    said = np.genfromtxt("said.csv", delimiter=",", names=True)["level_V"]
    truth = scipy_level(drive(seed=1), (1.0, 2.0), False)
    assert np.sqrt(np.mean((said - truth)[60:] ** 2)) < 0.02
    assert main(["fit", "one.csv", "--base", "base.py", "--model", "te", "--out", "x"]) == 2
    assert "not allowed with" in capsys.readouterr().err


def test_a_base_comes_with_what_it_leaves_out_and_goes_with_it(tanks):
    mine = {m.name for m in left_out() if "two_tanks" in m.needs}
    assert mine == {"torricelli_outflow", "upper_overflow", "lower_overflow", "level_limit", "pump_threshold"}
    assert "two_tanks" not in {m.name for m in left_out()}
    forget(TANKS)
    assert not mine & set(catalogue())


SOURCE = TANKS.read_text()
FAULTS = {
    "no base": ((EXAMPLES / "evaporation.py").read_text(), "defines no base model"),
    "no states": (SOURCE.replace('states = ("upper", "lower")', "states = ()"), "has no states"),
    "no outputs": (SOURCE.replace('outputs = ("level_V",)', "outputs = ()"), "has no outputs"),
    "no rates": (SOURCE.replace("def rates", "def speeds"), "has no rates"),
    "null": (SOURCE.replace('by its level", 0.02)', 'by its level", 0.02, null=0.0)'), "upper_rate has a null value"),
    "start": (SOURCE.replace("(0.05, 0.02, 0.015),", "(0.05, 0.02),"), "starts do not give"),
    "one rate": (SOURCE.replace("between - p.lower_rate * lower)", ")"), "a tuple of 2"),
    "unknown": (SOURCE.replace("p.gain *", "p.gian *"), "two_tanks cannot be simulated"),
    "not its own": (SOURCE.replace('needs = ("two_tanks",)', 'needs = ("tanks",)'), "needs ['tanks']"),
    "no needs": (SOURCE.replace('needs = ("two_tanks",)', "needs = ()"), "acts in a balance that no base has"),
    "no null": (SOURCE.replace("spill = p.weir *", "spill = (0.1 + p.weir) *"), "does not vanish at its null"),
}


@pytest.mark.parametrize("fault", FAULTS)
def test_a_fault_is_named_in_one_line(fault, tmp_path):
    assert_refused(use_base, tmp_path, *FAULTS[fault])


def test_the_oscillator_rings_as_its_equation_says():
    try:
        use(EXAMPLES / "oscillator.py")
        structure = system_structure(systems()["oscillator"]).with_mechanisms(mechanism("nonlinear_capacitor"))
        w, z, cubic = 40.0, 0.05, 1.5
        model = Model(structure).replace(
            {
                "oscillator.frequency": w,
                "oscillator.damping": z,
                "oscillator.gain": 1.0,
                "nonlinear_capacitor.cubic": cubic,
            }
        )
        time = 0.005 * np.arange(400)
        u = 0.3 * np.sin(30.0 * time)
        made = Recording.from_arrays(time, {"drive_V": u}, {}, hold="linear", require_outputs=False)

        def rates(t, y):
            pull = w * w * (np.interp(t, time, u) - y[0] - cubic * y[0] ** 3)
            return [y[1], pull - 2 * z * w * y[1]]

        truth = solve_ivp(rates, (0, time[-1]), (0.0, 0.0), t_eval=time, max_step=0.005, rtol=1e-10, atol=1e-12).y[0]
        said = np.asarray(simulate(model, made).outputs[:, 0])
        assert np.max(np.abs(said - truth)) < 1e-4 * np.ptp(truth)
    finally:
        forget(EXAMPLES / "oscillator.py")
