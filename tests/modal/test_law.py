"""The modal law against eigenvectors and a spline; compiled, stored, as C; and sampled loops at many poses."""

import re
from dataclasses import replace
from itertools import pairwise

import numpy as np
import pytest
from scipy.interpolate import CubicSpline
from tests.modal.conftest import PERIOD, held, known_robot, law_slope, problem_of, sampled_loop, tuned_law
from tests.refusals import refused_with

import flexhinf as fh
from flexhinf.errors import InvalidInput, NumericalFailure
from flexhinf.export.controller_c import code_of
from flexhinf.modal import ModalLaw, Pair, PairWeights, modes
from flexhinf.modal.law import workspace
from flexhinf.modal.pair import smallest_damping
from flexhinf.plant.joints import elastic_joints

#: Arms of others, from a package that no lock has.
OTHERS = [
    pytest.param(name, marks=pytest.mark.nightly("an arm from a package of 414 MB"))
    for name in ("panda", "ur5")
]
ROBOTS = ["planar-two-link", "seven-link", *OTHERS]


def eigen(law, table, x, q):
    """−J K^-½ κ V (Σ k_i(Λ) Vᵀ K^½ x_i) with motors made alike, by LAPACK's eigenvectors."""
    plant, n = law.plant, len(q)
    u = np.zeros(n)
    rest = np.concatenate([q, 0 * q, q, 0 * q])
    joints, kappa, beta = elastic_joints(plant, rest, u), law.gains.motor, law.gains.damping
    stiffness, motor, root = joints.stiffness, joints.motor_inertia, np.sqrt(joints.stiffness)
    lam, v = np.linalg.eigh(root[:, None] * np.linalg.inv(joints.link_inertia) * root)
    parts = x.reshape(5, n)
    alike = (stiffness - kappa * motor) * (parts[2] - parts[0])
    alike += (joints.motor_damping - beta * motor) * parts[3]
    k = table(lam)
    f = sum(k[:, i] * (v.T @ (root * part)) for i, part in enumerate(parts))
    f -= k[:, 5] * (v.T @ (root * alike / (kappa * motor)))
    return -motor / root * kappa * (v @ f) / joints.torque_per_input


@pytest.mark.quick_cases(1)
@pytest.mark.oracle
@pytest.mark.parametrize("name", ROBOTS)
def test_it_is_that_of_eigenvectors(name):
    law, rng = tuned_law(name), np.random.default_rng(0)
    n = len(law.input_names)
    grid = np.geomspace(*law.gains.ends, 2000)
    spline = CubicSpline(np.log(grid), law.gains(grid))
    for q in workspace(law.plant, 5, 3):
        x, state, u = rng.normal(size=5 * n), np.concatenate([q, rng.normal(size=3 * n)]), rng.normal(size=n)
        found = law.evaluate_about(x, state, u, law.law_data)
        for table in (law.gains, lambda lam: spline(np.log(lam))):
            np.testing.assert_allclose(
                found, eigen(law, table, x, q), rtol=0, atol=1e-9 * np.abs(found).max()
            )
        np.testing.assert_array_equal(law.evaluate_about(0 * x, state, u, law.law_data), 0.0)


@pytest.mark.ci("laws of six and seven joints")
@pytest.mark.oracle
def test_its_gains_are_those_of_the_pairs_laws():
    """The Riccati equations of the λ of a pose themselves, not the poles fitted to a grid."""
    law, rng = tuned_law("seven-link"), np.random.default_rng(1)
    weights, gains = PairWeights(), law.gains

    def table(lam):
        solved = [weights.gains(Pair(each, gains.motor, gains.damping), PERIOD) for each in lam]
        return np.column_stack([solved, 1 / (1 + (lam / 350.0**2) ** 2)])

    q = workspace(law.plant, 1, 5)[0]
    x = rng.normal(size=35)
    found = law.evaluate_about(x, np.concatenate([q, 0 * q, q, 0 * q]), 0 * q, law.law_data)
    np.testing.assert_allclose(found, eigen(law, table, x, q), atol=0.02 * np.abs(found).max())


@pytest.mark.quick_cases(1)
@pytest.mark.oracle
@pytest.mark.parametrize("name", ["planar-two-link", "seven-link"])
def test_kernel_file_and_c_are_python(name, tmp_path):
    robot, law, rng = known_robot(name), tuned_law(name), np.random.default_rng(2)
    n = len(law.input_names)
    controller = fh.Controller(law, None, PERIOD, moving=True)
    controller.save(tmp_path / "law")
    others = [fh.load_controller(tmp_path / "law")]
    others.append(fh.load_compiled(fh.compile_controller(controller, tmp_path / "law.so")))
    for q in workspace(law.plant, 3, 7):
        x_d, u_d = robot.operating_point(np.clip(q, -2.0, 2.0))
        x = x_d + 1e-2 * rng.normal(size=4 * n)
        deviation = np.concatenate([x - x_d, np.zeros(n)])
        expected = u_d + law.evaluate_about(deviation, x_d, u_d, law.law_data)
        for each in (controller, *others):
            each.reset()
            np.testing.assert_allclose(each.step(x, np.concatenate([x_d, u_d])), expected, rtol=1e-9)


@pytest.mark.ci("writes the C of two robots twice")
def test_the_c_is_bounded(tmp_path):
    """Operations do not depend on the pose; the springs of seven links are one function in a loop, in a file too. What
    decides whether the output may act grows with the inputs alone."""
    decides = re.compile(r"static NOINLINE void arm_decided\w*\(.*?\n}\n", re.DOTALL)
    for name, most in (("planar-two-link", 41_350), ("seven-link", 114_950)):
        controller = fh.Controller(tuned_law(name), None, PERIOD, moving=True)
        controller.save(tmp_path / f"{name} law")
        for way, each in (("made", controller), ("read", fh.load_controller(tmp_path / f"{name} law"))):
            source = code_of(each, "arm", "double").source
            decision = sum(map(len, decides.findall(source)))
            assert len(source.encode()) - decision < most, way
            assert 0 < decision < 5_100 * len(each.law.input_names), way


def test_numbers_are_data():
    law, robot = tuned_law("planar-two-link"), known_robot("planar-two-link")
    softer = robot.with_values(
        {each.name: 0.9 * each.value for each in robot.parameters if "stiff" in each.name}
    )
    other = ModalLaw.tuned(softer.problem(penalty={"link_position": 1.0, "link_position_integral": 1.0}))
    assert len(other.gains.poles) == len(law.gains.poles)
    assert other.law_key == law.law_key
    assert not np.array_equal(other.law_data, law.law_data)


@pytest.mark.quick_cases(1)
@pytest.mark.oracle
@pytest.mark.parametrize("name", ["planar-two-link", "seven-link"])
def test_modes_are_those_of_links_against_fixed_motors(name):
    plant, n = known_robot(name).plant(), len(known_robot(name).joint_names)
    for q, found in zip(
        workspace(plant, 3), modes(plant, workspace(plant, 3), tuned_law(name).joints.stiffness)
    ):
        weightless = plant.with_parameters(gravity=0.0)
        a = weightless.linearise(np.concatenate([q, 0 * q, q, 0 * q]), 0 * q)[0]
        np.testing.assert_allclose(np.sort(np.linalg.eigvals(-a[n : 2 * n, :n]).real), found, rtol=1e-8)


@pytest.mark.ci("laws of six and seven joints")
@pytest.mark.oracle
@pytest.mark.parametrize(
    ("name", "least"),
    [
        ("planar-two-link", 0.2),
        *(
            pytest.param(name, 0.2, marks=pytest.mark.nightly("six and seven joints"))
            for name in ("seven-link", "panda", "ur5")
        ),
    ],
)
def test_sampled_loops_at_200_poses(name, least):
    """State known, one sample of latency predicted, gravity at every pose: stable, and damped below 350 rad/s."""
    robot, law = known_robot(name), tuned_law(name)
    plant, n = robot.plant(), len(robot.joint_names)
    places, damping, modulus = list(range(n)), [], []
    for q in workspace(plant, 200, 1):
        x, u = robot.operating_point(q)
        a, b, _, _ = plant.linearise(x, u)
        z = np.linalg.eigvals(sampled_loop(a, b, law_slope(law, x, u), 1, places))
        modulus.append(np.abs(z).max())
        damping.append(smallest_damping(z, PERIOD, 350.0))
    assert max(modulus) < 1.0
    assert min(damping) > least


@pytest.mark.ci("laws of six and seven joints")
@pytest.mark.oracle
@pytest.mark.parametrize("name", ["seven-link", *OTHERS[1:]])
def test_motors_that_are_unlike_are_made_alike(name):
    """K/J that differ by a factor of 300 from joint to joint."""
    robot, rng, values = known_robot(name), np.random.default_rng(5 if name == "ur5" else 6), {}
    for joint in robot.joint_names:
        spring, rotor = 8.0 ** rng.uniform(-1.0, 1.0, 2)
        for name, factor in (("stiffness", spring), ("motor_inertia", rotor), ("friction", rotor)):
            values[f"{name}_{joint}"] = factor * robot.nominal[f"{name}_{joint}"]
    other = robot.with_values(values)
    law = ModalLaw.tuned(other.problem(penalty={"link_position": 1.0, "link_position_integral": 1.0}))
    ratio = law.joints.stiffness / law.joints.motor_inertia
    assert ratio.max() > 250.0 * ratio.min()
    plant, damping = other.plant(), []
    for q in workspace(plant, 40, 1):
        x, u = other.operating_point(q)
        a, b, _, _ = plant.linearise(x, u)
        z = np.linalg.eigvals(sampled_loop(a, b, law_slope(law, x, u), 1, list(range(len(q)))))
        assert np.abs(z).max() < 1.0
        damping.append(smallest_damping(z, PERIOD, 350.0))
    assert min(damping) > 0.2


@pytest.mark.ci("laws of six and seven joints")
@pytest.mark.parametrize("name", ["seven-link", *OTHERS])
def test_the_integral_torque_changes_less_than_an_unknown_payload_does(name):
    """Integrals count errors, so a move changes the torque that they hold, smoothly. It changes by less than what they
    hold does: the weight of a kilogram at the last link, in the same moves."""
    robot, law = known_robot(name), tuned_law(name)
    plant, n, values = robot.plant(), len(robot.joint_names), dict(robot.plant_parameters())
    heavier = {**values, "mass": np.asarray(values["mass"]) + np.eye(n)[-1]}
    rows = []
    for q in workspace(plant, 24, 9):
        (x, u), loaded = robot.operating_point(q), robot.operating_point(q, parameters=heavier)[1]
        rows.append((law_slope(law, x, u)[:, 4 * n :], loaded - u))
    held, own = [], []
    for (gain, torque), (other, later) in pairwise(rows):
        held.append(np.abs(other @ np.linalg.solve(gain, torque) - torque).max())
        own.append(np.abs(later - torque).max())
    assert np.median(held) < 0.9 * np.median(own)
    assert max(held) < max(own)


@pytest.mark.ci("a loop of its own; those of designs arrive in quick tests")
@pytest.mark.oracle
def test_moves_of_a_real_loop_arrive():
    """Latency, filter, noise and dry friction, half across the range, on springs of 17 rad/s."""
    robot, law = known_robot("planar-two-link"), tuned_law("planar-two-link")
    plant = robot.plant(("link_position", "motor_position"))
    start, goal = np.array([-1.5, 2.0]), np.array([1.0, -1.0])
    way = fh.JerkLimited(start, goal, 2.0, 6.0, 60.0, smoothing=0.1)
    moving = fh.Moving(way, robot.inverse_dynamics)
    x, _ = robot.operating_point(start)
    noise = np.diag(np.repeat([1e-12, 1e-6, 1e-12, 1e-4], 2))
    ukf = fh.UnscentedKalmanFilter(plant, PERIOD, noise, 1e-10, x, 1e-8)
    controller = fh.Controller(law, ukf, PERIOD, moving=True, latency=1)
    true = robot.plant(("link_position", "motor_position"), extras="coulomb_friction")
    run = fh.Loop(true, controller).run(moving, noise=1e-5, duration=8.0, initial_state=x, seed=1)
    error = np.abs(run.signals["state"][-300:, :2] - goal).max()
    assert error < 1e-3


def test_what_it_cannot_serve_is_refused():
    robot = known_robot("planar-two-link")
    penalty = {"link_position": 1.0}
    with refused_with(InvalidInput, "integrates", "link_position_shoulder"):
        ModalLaw.tuned(
            robot.problem(penalty=penalty, integrate=(), command=None, disturbances=("link_torque",))
        )
    with refused_with(InvalidInput, "poses", "(N, 2)"):
        ModalLaw.tuned(problem_of("planar-two-link"), poses=np.zeros((3, 4)))
    with refused_with(InvalidInput, "period", 0.0):
        ModalLaw.tuned(problem_of("planar-two-link"), 0.0)


@pytest.mark.ci("gains of many pairs")
def test_a_rigid_joint_has_the_gains_of_a_spring_as_stiff_for_its_motor_as_the_others():
    robot = known_robot("planar-two-link")
    rigid = replace(robot, rigid=("shoulder",))
    joints = elastic_joints(robot.plant(), *robot.operating_point())
    like = joints.motor_inertia[0] * joints.stiffness[1] / joints.motor_inertia[1]
    spring = robot.with_values({"stiffness_shoulder": like})
    penalty, poses = {"link_position": 1.0}, np.random.default_rng(5).uniform(-3.0, 3.0, (20, 2))
    law = ModalLaw.tuned(rigid.problem(penalty=penalty), poses=poses)
    other = ModalLaw.tuned(spring.problem(penalty=penalty), poses=poses)
    rng = np.random.default_rng(6)
    for q in poses:
        error, rate, motor, speed, integral = rng.normal(size=(5, 2))
        motor[0], speed[0] = error[0], rate[0]
        x, u = np.concatenate([q, 0 * q, q, 0 * q]), np.zeros(2)
        whole = np.concatenate([error, rate, motor, speed, integral])
        keep = [0, 1, 2, 3, 5, 7, 8, 9]
        mine = law.evaluate_about(whole[keep], x[keep[:6]], u, law.law_data)
        assert mine == pytest.approx(other.evaluate_about(whole, x, u, other.law_data), rel=1e-9)
    assert law.compliance.matrix(poses[0], rigid.plant().parameters.vector()) == pytest.approx(
        np.linalg.inv(
            elastic_joints(
                robot.plant(), np.tile(np.concatenate([poses[0], 0 * poses[0]]), 2), u
            ).link_inertia
        )
    )


@pytest.mark.ci("gains of three ranges of pairs")
def test_a_spring_too_fast_for_its_samples_is_named_with_what_helps():
    """A wrist of 1.3e-4 kg·m² on a usual spring, as of an arm without a tool, vibrates beyond what samples show."""
    robot, penalty = fh.load_robot("planar-two-link"), {"link_position": 1.0}
    light = {
        "mass": 0.05,
        "centre_of_mass_x": 0.001,
        "inertia_zz": 1.3e-4,
        "inertia_xx": 1e-4,
        "inertia_yy": 1e-4,
    }
    wrist = robot.with_values(
        {f"{name}_elbow": value for name, value in light.items()} | {"stiffness_elbow": 4e3}
    )
    poses = np.random.default_rng(5).uniform(-2.0, 2.0, (3, 2))
    with refused_with(NumericalFailure, "'elbow'", "883.4 Hz", "rigid = true") as caught:
        ModalLaw.tuned(wrist.problem(penalty=penalty), poses=poses)
    period, inertia = map(float, re.findall(r"--period (\S+);.* with (\S+) kg", caught.value.advice)[0])
    other = ModalLaw.tuned(wrist.problem(penalty=penalty), period, poses=poses)
    assert other.gains.sweep[0] < 1.0
    heavier = wrist.with_values({"inertia_zz_elbow": inertia, "inertia_yy_elbow": inertia})
    assert ModalLaw.tuned(heavier.problem(penalty=penalty), poses=poses).gains.sweep[0] < 1.0
    kept = tuple(p for p in wrist.parameters if p.name not in ("stiffness_elbow", "damping_elbow"))
    rigid = replace(wrist, parameters=kept, rigid=("elbow",))
    law, plant = ModalLaw.tuned(rigid.problem(penalty=penalty), poses=poses), rigid.plant()
    for q in poses:
        x, u = rigid.operating_point(q)
        a, b, _, _ = plant.linearise(x, u)
        gain = law.slope_at(q)
        stepped, driven = held(a, b, 1e-3)
        whole = np.block(
            [[stepped + driven @ gain[:, :6], driven @ gain[:, 6:]], [1e-3 * np.eye(2, 6), np.eye(2)]]
        )
        assert np.abs(np.linalg.eigvals(whole)).max() < 1.0
