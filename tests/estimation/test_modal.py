"""The modal filter: pairs against SciPy's Riccati equation, a step against NumPy's text, and where it runs."""

import shutil
from functools import cache

import numpy as np
import pytest
from scipy.linalg import expm, solve_discrete_are
from tests.builders import linear_law
from tests.refusals import refused_with

import flexhinf as fh
from flexhinf.analysis.equilibrium_loop import EquilibriumLoop
from flexhinf.estimation import ExtendedKalmanFilter, ModalFilter
from flexhinf.estimation.modal import FADING
from flexhinf.export.recording import record
from flexhinf.plant import Plant
from flexhinf.plant.joints import elastic_joints

# Kernels that run once each: half of the time.
pytestmark = pytest.mark.usefixtures("unoptimised")

PERIOD = 1e-3
BOTH, MOTORS, TORQUE = (
    ("link_position", "motor_position"),
    ("motor_position",),
    ("joint_torque", "motor_position"),
)


@cache
def arm(robot="planar-two-link"):
    return fh.load_robot(robot)


@cache
def modal(robot="planar-two-link", measured=BOTH, links=0.5, motors=2.0):
    """A filter at a robot's home; random torques per sample are so large, N·m, encoders err by 1e-5 rad, 0.01 N·m."""
    plant, (x, _) = arm(robot).plant(measured), arm(robot).operating_point()
    n = len(plant.inputs)
    joints = elastic_joints(plant, x, np.zeros(n))
    noise, inverse = np.zeros((plant.n, plant.n)), np.linalg.inv(joints.link_inertia)
    noise[n : 2 * n, n : 2 * n] = (PERIOD * links) ** 2 * inverse @ inverse
    noise[3 * n :, 3 * n :] = np.diag((PERIOD * motors / joints.motor_inertia) ** 2)
    errors = np.concatenate([np.full(n, 1e-4 if kind == "joint_torque" else 1e-10) for kind in measured])
    return ModalFilter(ExtendedKalmanFilter(plant, PERIOD, noise, errors, x, 1e-8))


def controller(filter, robot="planar-two-link", latency=1):
    """A proportional law on the motors."""
    plant, point = filter.plant, arm(robot).operating_point()
    joints = elastic_joints(plant, *point)
    n = len(plant.inputs)
    stiff = np.diag(0.02 * joints.stiffness / joints.torque_per_input)
    damped = np.diag(0.1 * np.sqrt(joints.stiffness * joints.motor_inertia) / joints.torque_per_input)
    gain = np.hstack([np.zeros((n, 2 * n)), stiff, damped])
    return fh.Controller(linear_law(plant, -gain, *point), filter, PERIOD, moving=True, latency=latency)


@pytest.mark.oracle
@pytest.mark.parametrize("measured", [BOTH, MOTORS, TORQUE], ids=["encoders", "motors", "torque"])
def test_an_arm_of_one_joint_has_the_kalman_gain_of_its_model(measured):
    """Without gravity one joint is one pair, so SciPy's gain of the linearised model is that of the filter."""
    robot = fh.paper_arm()
    plant = robot.plant(measured).with_parameters(gravity=0.0)
    noise = np.diag([1e-14, 3e-9, 1e-15, 2e-8])
    ekf = ExtendedKalmanFilter(plant, PERIOD, noise, np.full(len(measured), 1e-9), np.zeros(4), 1e-8)
    (a, _, _, c) = plant.linearise(np.zeros(4), np.zeros(1))
    f = expm(PERIOD * a)
    p = solve_discrete_are(f.T, c.T, noise, 1e-9 * np.eye(len(c)))
    expected = p @ c.T @ np.linalg.inv(c @ p @ c.T + 1e-9 * np.eye(len(c)))
    found = ModalFilter(ekf).gain(np.array([0.4, 0.0, 0.3, 0.0]))
    np.testing.assert_allclose(found, expected, atol=1e-5 * np.abs(expected).max())


@pytest.mark.oracle
@pytest.mark.parametrize("measured", [BOTH, MOTORS, TORQUE], ids=["encoders", "motors", "torque"])
def test_like_motors_are_pairs_at_every_pose(measured):
    """With springs, motors and sensors alike the arm is n pairs, and L(q) solves its own Riccati equation."""
    plant = arm().plant(measured).with_parameters(
        stiffness=np.full(2, 300.0), motor_inertia=np.full(2, 0.2), friction=np.full(2, 0.3),
        torque_constant=np.full(2, 2.0), back_emf_constant=np.full(2, 2.0), resistance=np.full(2, 1.0), gravity=0.0,
    )  # fmt: skip
    rng = np.random.default_rng(3)
    size = np.concatenate([np.full(2, 1e-3 if kind == "joint_torque" else 1e-10) for kind in measured])
    home = elastic_joints(plant, np.zeros(8), np.zeros(2)).link_inertia
    noise = np.zeros((8, 8))
    noise[2:4, 2:4] = 1e-7 * np.linalg.inv(home) @ np.linalg.inv(home)
    noise[6:, 6:] = 1e-6 * np.eye(2)
    filter = ModalFilter(ExtendedKalmanFilter(plant, PERIOD, noise, size, np.zeros(8), 1e-8))
    for _ in range(3):
        x = np.concatenate([rng.uniform(-3.0, 3.0, 2), np.zeros(6)])
        inertia = elastic_joints(plant, x, np.zeros(2)).link_inertia
        inverse, k = np.linalg.inv(inertia), 300.0
        damping = elastic_joints(plant, x, np.zeros(2)).motor_damping[0]
        a = np.zeros((8, 8))
        a[:2, 2:4] = a[4:6, 6:] = np.eye(2)
        a[2:4, :2], a[2:4, 4:6] = -k * inverse, k * inverse
        a[6:, :2], a[6:, 4:6], a[6:, 6:] = (
            k / 0.2 * np.eye(2),
            -k / 0.2 * np.eye(2),
            -damping / 0.2 * np.eye(2),
        )
        random = noise.copy()
        # Without sensors of the links the random torques there fade by (1 + λ²/fast⁴)⁻¹, a function of K^½ M⁻¹ K^½.
        faded = np.linalg.inv(np.eye(2) + (measured == MOTORS) * (k * inverse @ inverse * k) / FADING**4)
        random[2:4, 2:4] = 1e-7 * faded @ inverse @ inverse @ faded
        c, f = plant.linearise(x, np.zeros(2))[3], expm(PERIOD * a)
        p = solve_discrete_are(f.T, c.T, random, np.diag(size))
        expected = p @ c.T @ np.linalg.inv(c @ p @ c.T + np.diag(size))
        np.testing.assert_allclose(filter.gain(x), expected, atol=1e-5 * np.abs(expected).max())


@pytest.mark.oracle
@pytest.mark.parametrize("measured", [BOTH, MOTORS, TORQUE], ids=["encoders", "motors", "torque"])
def test_a_step_is_the_text_in_numpy(measured):
    filter = modal("scara", measured)
    plant, n, rng = filter.plant, 4, np.random.default_rng(1)
    x = filter.initial.mean + 0.3 * rng.normal(size=4 * n)
    y, u, p = rng.normal(size=len(plant.outputs)), rng.normal(size=n), plant.parameters
    joints = elastic_joints(plant, x, np.zeros(n))
    root = np.sqrt(joints.stiffness)
    values, v = np.linalg.eigh(root[:, None] * np.linalg.inv(joints.link_inertia) * root)
    low, high = np.log([25.0, 4e6])
    place = (2.0 * np.log(values) - low - high) / (high - low)
    gains = np.array([np.polynomial.chebyshev.chebval(t, filter.initial.table) for t in place])
    innovation = y - plant.evaluate_output(x, u, p.vector())
    if measured == TORQUE:
        innovation[:n] /= root**2
    gain = np.zeros((4 * n, len(y)))
    for i in range(4):
        for j in range(len(measured)):
            function = v @ np.diag(gains[:, i * len(measured) + j]) @ v.T
            gain[i * n : (i + 1) * n, j * n : (j + 1) * n] = function * root / root[:, None]
    named = p.named(p.vector())
    corrected = filter.measurement_update(filter.initial_at(x), y, u, named, None)
    np.testing.assert_allclose(corrected.mean, x + gain @ innovation, rtol=1e-8, atol=1e-9)
    np.testing.assert_allclose(
        filter.time_update(corrected, u, named, None).mean,
        filter.filter.transition(corrected.mean, u, named),
        rtol=1e-14,
    )
    fixed = filter.at(x).measurement_update(filter.at(x).initial_at(x), y, u, named, None)
    np.testing.assert_allclose(fixed.mean, corrected.mean, rtol=1e-9, atol=1e-10)


@pytest.mark.quick_cases(2)
@pytest.mark.parametrize("measured", [BOTH, MOTORS], ids=["encoders", "motors"])
@pytest.mark.parametrize("robot", ["planar-two-link", "scara", "seven-link"])
def test_errors_decay_at_every_pose(robot, measured):
    filter = modal(robot, measured, *((2.0, 8.0) if robot == "seven-link" else (0.5, 2.0)))
    rng, n = np.random.default_rng(0), len(filter.plant.inputs)
    for _ in range(20):
        q = rng.uniform(-2.0, 2.0, n) * (np.array([1, 1, 0.02, 1]) if robot == "scara" else 1.0)
        x = np.concatenate([q, np.zeros(n), q, np.zeros(n)])
        a, _, _, h = filter.plant.linearise(x, np.zeros(n))
        error = (np.eye(4 * n) - filter.gain(x) @ h) @ expm(PERIOD * a)
        assert np.abs(np.linalg.eigvals(error)).max() < 1.0


@pytest.mark.ci("compiles a controller")
@pytest.mark.parametrize("robot", ["planar-two-link", "scara"])
@pytest.mark.parametrize("latency", [0, 2])
def test_compiled_and_saved_it_is_the_text(tmp_path, robot, latency):
    one = controller(modal(robot), robot, latency)
    one.save(tmp_path / "controller")
    other, filter = fh.load_controller(tmp_path / "controller"), one.estimator
    assert isinstance(other.estimator, ModalFilter)
    named = filter.plant.parameters.named(filter.plant.parameters.vector())
    x, u = arm(robot).operating_point()
    belief, acts, rng = filter.initial, [u] * latency, np.random.default_rng(2)
    for _ in range(20):
        y = filter.plant.evaluate_output(x, u, filter.plant.parameters.vector()) + 1e-3 * rng.normal(
            size=2 * len(u)
        )
        sent = one.step(y, np.concatenate([x, u]))
        np.testing.assert_array_equal(other.step(y, np.concatenate([x, u])), sent)
        belief = filter.measurement_update(belief, y, u, named, None)
        np.testing.assert_allclose(one.estimate, belief.mean, rtol=1e-9, atol=1e-11)
        acts.append(sent)
        belief = filter.time_update(belief, acts.pop(0), named, None)
    np.testing.assert_allclose(
        one.memory.named(one._history.memory).belief[0], belief.mean, rtol=1e-9, atol=1e-11
    )


@pytest.mark.ci("exports and compiles C")
@pytest.mark.oracle
@pytest.mark.skipif(shutil.which("gcc") is None, reason="missing: gcc")
@pytest.mark.parametrize("robot", ["planar-two-link", "scara"])
def test_in_c_it_steps_as_in_python(tmp_path, robot):
    """Bit by bit; with samples missing."""
    one = controller(modal(robot), robot)
    run, compiled = record(one), fh.load_compiled(fh.compile_controller(one, tmp_path / "arm.so"))
    for k, code in enumerate(run.codes):
        u = compiled.step(None if code == "PREDICTED" else run.y[k], run.r[k])
        assert compiled.code == code
        np.testing.assert_array_equal(u, run.u[k])


@pytest.mark.ci("compiles seven links")
def test_a_loop_runs_it_in_its_kernel():
    filter, (x, u) = modal("scara"), arm("scara").operating_point()
    one = controller(filter, "scara")
    start = x + 0.01 * (np.arange(16) % 8 == 0)
    run = fh.Loop(filter.plant, one).run(duration=0.1, initial_state=start, noise=1e-5)
    again = one.fresh()
    for y, estimate in zip(run.signals["output"], run.signals["estimate"]):
        again.step(y, np.concatenate([x, u]))
        np.testing.assert_array_equal(again.estimate, estimate)
    error = np.abs(run.signals["estimate"] - run.signals["state"])
    assert error[0, [0, 8]].min() > 1e-4  # the estimate begins at x*
    assert error[-20:, [0, 8]].max() < 5e-5


@pytest.mark.ci("linearises a loop of sixteen states")
def test_the_loop_is_linearised_with_the_gain_of_the_goal():
    """Differences of the controller that runs, at rest, where the innovation is zero: L(q) may as well stand still."""
    filter = modal("scara")
    one = controller(filter, "scara", 1)
    loop = EquilibriumLoop(
        one.law, filter, filter.plant, PERIOD, moving=True, latency=1, positions="link_position",
        equilibrium=arm("scara").operating_point(),
    )  # fmt: skip
    linear, (x, u) = loop.linear(), arm("scara").operating_point()
    r, start = np.concatenate([x, u]), one.initial_memory()
    seen = filter.plant.evaluate_output(x, u, filter.plant.parameters.vector())
    memory = one.evaluate(seen, r, one.evaluate(seen, r, start)[1])[1]
    for k in (0, 3, 5, 7):
        step = 1e-6 * np.eye(len(seen))[k]
        slope = (one.evaluate(seen + step, r, memory)[0] - one.evaluate(seen - step, r, memory)[0]) / 2e-6
        np.testing.assert_allclose(
            linear.law[:, loop.step.size + k], slope, rtol=1e-5, atol=1e-6 * np.abs(slope).max()
        )


def test_what_is_no_such_arm_is_refused():
    def make(plant, noise):
        return ModalFilter(ExtendedKalmanFilter(plant, PERIOD, noise, 1e-10, np.zeros(plant.n), 1e-8))

    with refused_with(fh.InvalidInput, "joint_torque", "motor_position"):
        make(arm().plant(("link_position_shoulder", "motor_position")), 1e-9)
    with refused_with(fh.InvalidInput, "process noise"):
        make(arm().plant(BOTH), 0.0)
    with refused_with(fh.InvalidInput, "elastic joints", "link_position"):
        make(Plant(lambda x, u, d, p: -x + u, lambda x, u, p: x, ("a",), ("b",), parameters={}), 1.0)
