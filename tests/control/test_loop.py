"""The compiled loop against plain Python with scipy's discretisation, against solve_ivp, and its own promises."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from loop_cases import DEG, PLANT, run_jit, signal, thesis_loop
from scipy.integrate import solve_ivp
from scipy.signal import cont2discrete

from scpjax.control.batch import batched
from scpjax.control.errors import ControlError
from scpjax.control.loop import Disturbance, Loop, play, run
from scpjax.control.pid import PID, Pair, thesis_pair
from scpjax.control.plant import Difference, Joint, check_dead_times
from scpjax.control.problem import Problem
from scpjax.control.sensor import Sensor
from scpjax.physics.catalogue import mechanism
from scpjax.physics.known import known_model
from scpjax.physics.model import Model
from scpjax.physics.presets import aaa


def by_hand(reference, dt=0.02, radius=0.015, gains=(0.5, 0.12, 0.47, 5.84), high=3.7**2):
    """Thesis (3.16)-(3.18) and (4.4) sample by sample, in degrees and cm."""
    a = np.array([[-1.5053, -1.2661, -0.1909], [1.0, 0.0, 0.0], [0.0, 1.0, 0.0]])
    c = np.array([0.0, 0.0, 0.03])
    ad, bd, *_ = cont2discrete((a, np.eye(3)[:, :1], c[None], np.zeros((1, 1))), dt)
    kp, ki, kd, n = gains
    x, integral, low_passed = np.zeros((2, 3)), np.zeros(2), np.zeros(2)
    angles, efforts = [], []
    for r in reference:
        y = np.degrees((c @ x[0] - c @ x[1]) / (100 * radius))
        for side, sign in enumerate((1.0, -1.0)):
            e = sign * (r - y)
            d = n * (kd * e - low_passed[side])
            u_c = kp * e + integral[side] + d
            u = min(max(u_c, 0.0), high)
            if not (u != u_c and e * u_c > 0):
                integral[side] += dt * ki * e
            low_passed[side] += dt * d
            x[side] = ad @ x[side] + bd[:, 0] * u
            efforts.append(u)
        angles.append(y)
    return np.array(angles), np.array(efforts).reshape(-1, 2)


@pytest.mark.parametrize("name", ["square", "sine"])
def test_loop_is_what_plain_python_computes(name):
    reference = signal(name, 35.0, duration=30.0)
    found = run_jit(thesis_loop(), reference, 0.02)
    angle, effort = by_hand(reference / DEG)
    np.testing.assert_allclose(np.asarray(found.angle) / DEG, angle, atol=1e-8)
    np.testing.assert_allclose(found.effort, effort, atol=1e-8)
    np.testing.assert_allclose(np.asarray(found.voltage) ** 2, effort, atol=1e-8)


def test_batches_are_the_single_runs():
    reference = signal("sine", duration=10.0)
    gains = jnp.array([[0.5, 0.12, 0.47, 5.84], [0.2, 0.05, 0.1, 10.0], [2.0, 0.3, 1.0, 3.0]])
    one = lambda g: run(Loop(thesis_loop().plant, Pair(PID.per_degree(*g))), reference).angle  # noqa: E731
    many = jax.jit(jax.vmap(one))(gains)
    for g, row in zip(gains, many, strict=True):
        angle, _ = by_hand(reference / DEG, gains=np.asarray(g))
        np.testing.assert_allclose(np.asarray(row) / DEG, angle, atol=1e-7)


def nonlinear(base: Model) -> Model:
    structure = base.structure.with_mechanisms(mechanism("nonlinear_heat_loss"), mechanism("creep"))
    extra = {"nonlinear_heat_loss.strength": 0.02, "creep.compliance": 0.2, "creep.time_constant": 20.0}
    model = Model(structure, ambient=base.ambient)
    return model.replace(base.values() | {k: v for k, v in extra.items() if k in model.structure.index})


def test_nonlinear_plant_in_the_loop_agrees_with_solve_ivp():
    model = nonlinear(known_model("plant"))
    loop = Loop(Difference(model, model, substeps=4), Pair(PID.per_degree(2.0, 0.5, 0.2, 8.0)))
    reference, dt = signal("sine", 5.0, duration=10.0), 0.02
    found = run_jit(loop, reference, dt)
    rates = jax.jit(lambda z, u: model.rates(z, u))
    z = np.zeros((2, model.structure.n_states))
    for k in range(0, 400):
        for side in (0, 1):
            u = np.asarray(found.effort[k, side])[None]
            z[side] = solve_ivp(lambda _, y, u=u: np.asarray(rates(y, u)), (0, dt), z[side], rtol=1e-8, atol=1e-12).y[
                :, -1
            ]
    moved = [float(model.observe(jnp.asarray(zi), jnp.zeros(1))[-1]) for zi in z]
    wanted = (moved[0] - moved[1]) / 0.015
    assert float(found.angle[400]) == pytest.approx(wanted, rel=2e-4, abs=1e-9)
    assert abs(wanted) > 0.5 * DEG


def test_joint_of_two_equal_sides_is_the_difference_of_stiffer_plants():
    """(3.7): on one coordinate stiffness, damping and mass of both add up, and temperatures pull against each other."""
    base = known_model("plant")
    joint = Joint(aaa(base, pulley_radius=0.015))
    two = base.replace({k: 2 * base.value(k) for k in ("elastic_spring.stiffness", "viscous_damping.damping",
                                                       "inertia.mass")})  # fmt: skip
    controller = Pair(PID.per_degree(1.0, 0.2, 0.1, 8.0))
    reference = signal("sine", 2.0, duration=10.0)
    found = run_jit(Loop(joint, controller), reference, 0.02)
    wanted = run_jit(Loop(Difference(two, two), controller), reference, 0.02)
    np.testing.assert_allclose(found.angle, wanted.angle, atol=1e-9)
    assert np.abs(found.angle).max() > 0.5 * DEG


def test_load_pushes_as_a_static_force():
    loop = Loop(Difference(PLANT, radius=None), PID(0.0))
    n = 20_000
    found = run(loop, jnp.zeros(n), disturbance=Disturbance(load=jnp.full(n, 0.3)))
    assert float(found.angle[-1]) == pytest.approx(0.3 / float(PLANT.value("elastic_spring.stiffness")), rel=1e-6)


def test_dead_time_shifts_the_effort():
    base = known_model("thesis")
    structure = base.structure.with_mechanisms(mechanism("input_delay"))
    late = Model(structure, ambient=base.ambient).replace(base.values() | {"input_delay.time": 0.1})
    for delay in (0.1, 0.11):
        model = late.replace({"input_delay.time": delay})
        pulse = jnp.zeros(300).at[10].set(1.0)
        controller = PID(1.0, high=100.0)
        # a huge radius: the angle does not feed back into the command
        quick = run(Loop(Difference(base, radius=1e6), controller), pulse).angle
        slow = run(Loop(Difference(model, radius=1e6), controller), pulse).angle
        share = (delay - 0.1) / 0.02
        wanted = (1 - share) * quick[: 300 - 5][1:] + share * quick[: 300 - 5][:-1]
        np.testing.assert_allclose(slow[6:], wanted, atol=1e-15)


@pytest.mark.parametrize("known", [True, False])
def test_a_dead_time_of_many_samples_is_a_delay(known):
    """Of 75 and of 140 samples, whether it is known when the loop is made or only inside a transformation."""
    base = known_model("thesis")
    late = Model(base.structure.with_mechanisms(mechanism("input_delay")), ambient=base.ambient)
    late = late.replace(base.values() | {"input_delay.time": 0.1})
    pulse = jnp.zeros(400).at[10].set(1.0)
    go = lambda m: run(Loop(Difference(m, radius=1e6), PID(1.0, high=100.0)), pulse, dt=0.02).angle  # noqa: E731
    quick = go(base)
    for samples in (75, 140):
        slow = (go if known else jax.jit(go))(late.replace({"input_delay.time": 0.02 * samples}))
        assert float(jnp.max(jnp.abs(slow))) > 0
        np.testing.assert_allclose(slow[samples:], quick[:-samples], atol=1e-12)


def test_a_dead_time_that_a_search_cannot_remember_is_refused():
    """A transformation that knows neither it nor the step has 64 samples; the plant would be left without a drive."""
    base = known_model("thesis")
    late = Model(base.structure.with_mechanisms(mechanism("input_delay")), ambient=base.ambient)
    late = late.replace(base.values() | {"input_delay.time": 1.5})
    loop = Loop(Difference(late, late), thesis_pair())
    reference = signal("sine", duration=10.0)
    with pytest.raises(ControlError, match=r"a dead time of 1.5 s is more than 63 samples of 0.02 s; .*0.024"):
        Problem(loop, reference, dt=0.02)
    assert float(jnp.max(jnp.abs(Problem(loop, reference[::2], dt=0.04).responses(loop.controller).angle))) > 0.01
    check_dead_times(loop.plant, 0.02)  # where the step is known: as long as its bound
    with pytest.raises(ControlError, match="a dead time of 5 s"):
        check_dead_times(Difference(late.replace({"input_delay.time": 5.0})), 0.02)


def test_the_temperature_of_a_response_is_that_of_the_heated_part():
    """A thermometer that lags behind shows less while it warms; what may grow too hot is the part itself."""
    base = known_model("thesis")
    model = Model(base.structure.with_mechanisms(mechanism("sensor_lag")), ambient=base.ambient)
    late = model.replace(base.values() | {"sensor_lag.time_constant": 3.0})
    step = jnp.full(300, 1.0)
    pid = PID(10.0, high=13.69)
    there, plain = (run(Loop(Difference(m, radius=None), pid), step, dt=0.02) for m in (late, base))
    np.testing.assert_allclose(there.temperature, plain.temperature, rtol=1e-3)
    seen = play(Difference(late, radius=None), there.effort, dt=0.02)[1]
    assert float(seen[-1, 0]) < float(there.temperature[-1, 0]) - 5


def test_sensor():
    quiet = thesis_loop()
    reference = signal("sine", duration=10.0)
    key = jax.random.key(3)
    noisy = Loop(quiet.plant, quiet.controller, Sensor(noise=0.5 * DEG))
    seen = run_jit(noisy, reference, 0.02, key=key)
    difference = np.asarray(seen.measured - seen.angle)
    assert difference.std() == pytest.approx(0.5 * DEG, rel=0.1)
    np.testing.assert_array_equal(run_jit(noisy, reference, 0.02, key=key).angle, seen.angle)
    late = run_jit(Loop(quiet.plant, quiet.controller, Sensor(delay=7)), reference, 0.02)
    np.testing.assert_allclose(late.measured[7:], late.angle[:-7], atol=1e-15)
    coarse = run_jit(Loop(quiet.plant, quiet.controller, Sensor(quantum=1.0 * DEG)), reference, 0.02)
    counts = np.asarray(coarse.measured) / DEG
    np.testing.assert_allclose(counts, np.round(counts), atol=1e-9)
    slow = run_jit(Loop(quiet.plant, quiet.controller, Sensor(every=5)), reference, 0.02)
    effort = np.asarray(slow.effort)[:500].reshape(100, 5, 2)
    np.testing.assert_array_equal(effort, np.broadcast_to(effort[:, :1], effort.shape))


def test_slow_controller_is_a_loop_of_slow_samples():
    """Linear plants are exact under a held effort: acting at every fifth sample is the loop with five times the dt."""
    slow = Loop(thesis_loop().plant, thesis_loop().controller, Sensor(every=5))
    fine = run_jit(slow, np.repeat(signal("square", duration=20.0, dt=0.1), 5), 0.02)
    coarse = run_jit(thesis_loop(), signal("square", duration=20.0, dt=0.1), 0.1)
    np.testing.assert_allclose(fine.angle[::5], coarse.angle, atol=1e-10)


def test_float32_works_and_is_near():
    reference = signal("sine", duration=10.0)
    wanted = run_jit(thesis_loop(), reference, 0.02).angle
    with jax.enable_x64(False):
        single = known_model("thesis")
        found = run(Loop(Difference(single, single), thesis_pair()), reference).angle
        assert found.dtype == jnp.float32
    np.testing.assert_allclose(found, wanted, atol=1e-3)


def test_wrong_shapes_and_numbers_are_refused():
    loop = thesis_loop()
    for reference, said in (
        (np.zeros((3, 4)), "shape"),
        (np.zeros(1), "shape"),
        (np.array([0.0, np.nan, 0.0]), "nan at sample 1"),
    ):
        with pytest.raises(ControlError, match=said):
            run(loop, reference)
    with pytest.raises(ControlError, match="5 samples of output for 10"):
        run(loop, np.zeros(10), disturbance=Disturbance(output=jnp.zeros(5)))
    with pytest.raises(ControlError, match="1 commands for a plant with 2"):
        Loop(loop.plant, PID(1.0))
    with pytest.raises(ControlError, match="radius is -1"):
        Difference(PLANT, PLANT, radius=-1.0)
    with pytest.raises(ControlError, match="is no joint"):
        Joint(PLANT)
    with pytest.raises(ControlError, match="no displacement"):
        Difference(known_model("te"))
    for options, said in (({"noise": -1.0}, "noise"), ({"delay": -1}, "delay"), ({"every": 0}, "every 0")):
        with pytest.raises(ControlError, match=said):
            Sensor(**options)


def test_pieces_on_threads_are_the_loops_one_by_one():
    reference = signal("sine", duration=4.0)
    rmse = lambda kp: jnp.mean(  # noqa: E731
        run(Loop(thesis_loop().plant, Pair(PID.per_degree(kp, 0.1, 0.3, 6.0))), reference).error ** 2
    )
    gains = np.linspace(0.1, 2.0, 23)
    found = batched(rmse, size=8, threads=2)(gains)
    np.testing.assert_allclose(found, jax.vmap(rmse)(jnp.asarray(gains)), rtol=1e-12)
    with pytest.raises(ControlError, match="leading axes"):
        batched(lambda a, b: a + b)(np.zeros(3), np.zeros(4))
