"""Gains files and verdicts: what is wrong is said in one line, and what was written is read again."""

import math

import numpy as np
import pytest
from loop_cases import DEG, PLANT, run_jit, signal, thesis_loop

from scpjax.control.errors import ControlError
from scpjax.control.gains import load_gains, save_gains
from scpjax.control.loop import Loop
from scpjax.control.pid import PID, Pair, thesis_pair
from scpjax.control.plant import Difference
from scpjax.control.problem import gains_of
from scpjax.control.verdict import check_finite, judge

GOOD = "Kp = 0.5\nKi = 0.12\nKd = 0.47\nN = 5.84\n"


def test_what_is_saved_is_loaded(tmp_path):
    pid = PID.per_degree(0.51, 0.123, 0.471, 5.8, form="tustin", anti_windup="back_calculation", tracking=2.5,
                         derivative_weight=0.0, high=9.0)  # fmt: skip
    path = save_gains(Pair(pid), tmp_path / "gains.toml", dt=0.02, title='say "so"')
    found = load_gains(path)
    assert gains_of(found) == pytest.approx(gains_of(pid), rel=1e-14)
    assert (found.form, found.anti_windup) == ("tustin", "back_calculation")
    assert float(found.high) == pytest.approx(9.0)
    assert float(found.derivative_weight) == 0.0
    assert "sample_s = 0.02" in path.read_text()


@pytest.mark.parametrize("text", [GOOD, "[gains]\n" + GOOD, "[pid]\n" + GOOD])
def test_four_numbers_are_enough(tmp_path, text):
    path = tmp_path / "gains.toml"
    path.write_text(text)
    found = gains_of(load_gains(path))
    assert found == pytest.approx(gains_of(thesis_pair()))


@pytest.mark.parametrize(("text", "said"), [
    (GOOD.replace("0.5", "nan"), "Kp is nan, no finite number"),
    (GOOD.replace("5.84", "-5.84"), "N is -5.84"),
    (GOOD.replace("Kd = 0.47\n", ""), "Kd is missing"),
    (GOOD.replace("Kp", "kp"), "unknown key 'kp'; did you mean Kp?"),
    (GOOD.replace("0.12", '"much"'), "Ki is 'much'"),
    (GOOD.replace("0.12", "true"), "Ki is True"),
    (GOOD + 'form = "euler"\n', "no form 'euler'"),
    (GOOD + "limit_V = 0\n", "not in order"),
    ("Kp 0.5", "is not TOML"),
    (b"\xff\xfe\x00", "is not text"),
])  # fmt: skip
def test_bad_files_are_refused_in_one_line(tmp_path, text, said):
    path = tmp_path / "gains.toml"
    path.write_bytes(text if isinstance(text, bytes) else text.encode())
    with pytest.raises(ControlError) as caught:
        load_gains(path)
    assert said in str(caught.value)
    assert str(path) in str(caught.value)
    assert "\n" not in str(caught.value)


def test_missing_files_and_folders_are_refused(tmp_path):
    for path, said in ((tmp_path / "none.toml", "no such gains file"), (tmp_path, "is a folder")):
        with pytest.raises(ControlError, match=said):
            load_gains(path)


def test_a_good_loop_is_good():
    verdict = judge(thesis_loop(), signal("sine"))
    assert verdict.good
    assert verdict.says == ()


def test_out_of_reach_says_how_far_it_goes():
    verdict = judge(thesis_loop(), signal("sine", 100.0))
    assert verdict.stability == "stable"
    assert not verdict.within
    (said,) = verdict.says
    assert "-82.2 and 82.2 deg" in said
    far = run_jit(thesis_loop(), np.full(20_000, 2.0), 0.02).angle
    assert float(far[-1]) == pytest.approx(verdict.reach[1], rel=1e-4)


def test_a_single_actuator_cannot_push():
    loop = Loop(Difference(PLANT), thesis_pair().agonist)
    verdict = judge(loop, signal("sine"))
    assert not verdict.within
    assert verdict.reach[0] == 0.0


def test_unstable_loops_are_said_to_be():
    wild = Loop(thesis_loop().plant, Pair(PID.per_degree(20.0, 5.0, 0.01, 2.0)))
    verdict = judge(wild, signal("sine"))
    assert verdict.stability == "oscillates"
    assert "unstable" in verdict.says[0]


def test_a_plant_that_runs_away_diverges():
    loose = PLANT.replace({"elastic_spring.stiffness": -50.0})
    loop = Loop(Difference(loose, loose), thesis_pair())
    verdict = judge(loop, signal("sine"))
    assert verdict.stability == "diverges"
    assert not verdict.good
    response = run_jit(loop, np.full(30_000, 10 * DEG), 0.05)
    assert not math.isfinite(float(response.angle[-1]))
    with pytest.raises(ControlError, match="unstable: its angle is not finite from"):
        check_finite(response)
