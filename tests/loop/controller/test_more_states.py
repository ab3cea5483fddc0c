"""A controller whose estimator estimates more than the law's states, and loads that the input balances."""

from __future__ import annotations

import copy
import pickle

import numpy as np
import pytest
from tests.builders import FORMS, KALMAN, LinearLaw, forced_pendulum, linear_law, still
from tests.refusals import refused_with

import flexhinf as fh
from flexhinf.errors import InvalidInput
from flexhinf.estimation import ExtendedKalmanFilter, UnscentedKalmanFilter
from flexhinf.loop.controller.options import holding_function

# Kernels that run once each: 2 s instead of 4 s.
pytestmark = pytest.mark.usefixtures("unoptimised")

PERIOD = 0.01


NOISE = {"angle": 1e-8, "speed": 1e-6, "wind": 1e-4, "pull": 1e-6, "angle_seen_offset": 1e-12}


def reordered():
    """The same with the states in another order, and one between them that nothing depends on."""

    def turned(x, u, d, p):
        rates = forced_pendulum().flow(np.array([x[2], x[0]]), u, d, p)
        return np.array([rates[1], -x[1], rates[0]])

    return fh.Plant(
        turned, lambda x, u, p: x[2:], ("speed", "other", "angle"), ("torque",), ("wind",), {"pull": 4.0},
        ("angle_seen",),
    )  # fmt: skip


def plain(integral=()):
    """About 0.3 rad, which 4 sin 0.3 holds."""
    gain = [-6.0, -3.0, -4.0] if integral else [-6.0, -3.0]
    return linear_law(forced_pendulum(), gain, [0.3, 0.0], [4.0 * np.sin(0.3)], integral)


def controller(law=None, kind=UnscentedKalmanFilter, form="covariance", plant=None, **options):
    plant = plant or forced_pendulum().augmented(("pull",), ("wind",), ("angle_seen",))
    start = {"angle": 0.3, "pull": 4.0}
    estimator = kind(
        plant, PERIOD, [NOISE.get(name, 1e-9) for name in plant.states], 1e-6,
        [start.get(name, 0.0) for name in plant.states], [0.01 * (name != "other") for name in plant.states], form=form,
    )  # fmt: skip
    return fh.Controller(law or plain(("angle",)), estimator, PERIOD, **options)


def samples(count=25):
    return 0.3 + 0.05 * np.sin(0.3 * np.arange(count))


# The law reads its own states --------------------------------------------------------------------------
@pytest.mark.quick_cases(1)
@pytest.mark.oracle
@FORMS
@KALMAN
@pytest.mark.parametrize("pieces", [False, True])
def test_a_step_is_that_of_filter_and_law(kind, form, pieces):
    """Against the filter's own `correct` and `predict`, and the law's formula in NumPy."""
    control = controller(plain(), kind, form, latency=0)
    control = control.in_pieces() if pieces else control
    assert control.estimated == ("angle", "speed", "pull", "wind", "angle_seen_offset")
    estimator = kind(**control.estimator.settings())
    estimator.predict([0.0])
    estimator.reset()
    acted = control.input_before()
    for y in samples():
        estimator._u = np.array(acted)
        estimator.correct([y])
        expected = 4.0 * np.sin(0.3) - 6.0 * (estimator.mean[0] - 0.3) - 3.0 * estimator.mean[1]
        u = control.step([y])
        assert u[0] == pytest.approx(expected, rel=1e-9)
        np.testing.assert_allclose(control.estimate, estimator.mean, rtol=1e-7, atol=1e-10)
        estimator.predict(u)
        acted = u


@pytest.mark.oracle
def test_the_order_of_the_estimated_states_does_not_matter():
    first = controller(kind=ExtendedKalmanFilter, plant=forced_pendulum(), latency=1)
    second = controller(kind=ExtendedKalmanFilter, plant=reordered(), latency=1)
    assert second.estimated == ("speed", "other", "angle")
    for y in samples():
        u, other = first.step([y]), second.step([y])
        np.testing.assert_allclose(other, u, rtol=1e-9)
        np.testing.assert_allclose(second.estimate[[2, 0]], first.estimate, rtol=1e-9, atol=1e-12)
    np.testing.assert_allclose(second.input_before(), first.input_before(), rtol=1e-12)
    np.testing.assert_allclose(second.windup.line, first.windup.line, rtol=1e-9)
    missing = first.step(None), second.step(None)
    np.testing.assert_allclose(missing[1], missing[0], rtol=1e-9)


@pytest.mark.quick_cases(1)
@pytest.mark.oracle
@pytest.mark.parametrize("latency", [0, 1, 3])
@pytest.mark.parametrize(
    "option", [{}, {"offset_time": 0.2}, {"compensate": ("wind",)}, {"start": "bumpless"}]
)
def test_a_loop_is_the_controller_step_by_step(latency, option):
    plant = forced_pendulum().augmented(disturbances=("wind",), offsets=("angle_seen",))
    control = controller(plant=plant, latency=latency, **option)
    run = fh.Loop(forced_pendulum(), control).run(disturbance={"wind": 0.4}, noise=1e-3, duration=0.6)
    assert run.names["estimate"] == control.estimated
    stepped = control.fresh()
    for y, u, estimate in zip(*(run.signals[name] for name in ("output", "input", "estimate"))):
        np.testing.assert_allclose(stepped.step(y), u, rtol=1e-8)
        np.testing.assert_allclose(stepped.estimate, estimate, rtol=1e-7, atol=1e-9)


@pytest.mark.ci("compiles four controllers as C")
@pytest.mark.parametrize(
    ("form", "option"), [("square_root", {"compensate": "wind"}), ("covariance", {})], ids=str
)
def test_it_is_saved_pickled_copied_and_exported(tmp_path, form, option):
    control = controller(form=form, latency=2, **option)
    control.save(tmp_path / "controller")
    others = [
        fh.load_controller(tmp_path / "controller"), pickle.loads(pickle.dumps(control)), copy.copy(control),
    ]  # fmt: skip
    expected = [control.step([y]) for y in samples()]
    for other in others:
        assert other.code_key[1:] != ()
        np.testing.assert_array_equal([other.step([y]) for y in samples()], expected)
    compiled = fh.load_compiled(fh.compile_controller(control, tmp_path / "library.so"))
    np.testing.assert_allclose([compiled.step([y]) for y in samples()], expected, rtol=1e-9)
    np.testing.assert_allclose(compiled.estimate, control.estimate, rtol=1e-9, atol=1e-12)
    assert compiled.states == control.estimated
    files = {file.name for file in fh.export_c(control, tmp_path / "code", limits=False).iterdir()}
    assert {"controller.c", "README.md", "controller_test.c"} <= files
    assert "pull" in control.summary()["estimated too"]


@pytest.mark.quick_cases(1)
@pytest.mark.parametrize("moving", [False, True])
def test_it_starts_at_rest_at_a_pose(moving):
    """The load and the parameters stay where the estimate begins."""
    control = controller(kind=ExtendedKalmanFilter, moving=moving, latency=1)
    control.reset(pose=[0.5])
    u = control.step([0.5])
    assert u[0] == pytest.approx(4.0 * np.sin(0.5), rel=1e-9)
    np.testing.assert_allclose(control.estimate, [0.5, 0.0, 4.0, 0.0, 0.0], atol=1e-9)


# The load is balanced ---------------------------------------------------------------------------------
@pytest.mark.oracle
def test_a_load_moves_input_and_state_as_the_equilibrium_does():
    """An elastic joint of stiffness K: a load d asks for −d, and the motor stands by −d/K beside where it stood."""

    def joint(x, u, d, p):
        twist = 80.0 * (x[2] - x[0])
        return np.array([x[1], (twist - 5.0 * np.sin(x[0]) + d[0]) / 0.7, x[3], (2.0 * u[0] - twist) / 0.2])

    names = (("q", "v", "t", "w"), ("drive",), ("load",))
    for sampled in (False, True):

        def stepped(x, u, d, p):
            return x + 1e-3 * joint(x, u, d, p)

        plant = fh.Plant(stepped if sampled else joint, lambda x, u, p: x[2:3], *names, sampled=sampled)
        estimator = ExtendedKalmanFilter(
            plant.augmented(disturbances="load"), 1e-3, 1e-8, 1e-8, np.zeros(5), 1.0
        )
        control = fh.Controller(
            linear_law(plant, [-3.0, -1.0, -5.0, -1.0]), estimator, 1e-3, compensate="load"
        )
        np.testing.assert_allclose(control.balance[0][:, 0], [0.0, 0.0, -1.0 / 80.0, 0.0], atol=1e-12)
        np.testing.assert_allclose(control.balance[1], [[-0.5]], rtol=1e-12)


@pytest.mark.oracle
@pytest.mark.parametrize("sampled", [False, True])
def test_the_input_that_holds_a_joint_balances_its_spring(sampled):
    """2 u = K twist keeps the motor's velocity, whatever it is: of the joint's rates as of a map from step to step."""

    def rates(x, u, d, p):
        return np.array([x[1], 80.0 * (x[2] - x[0]) / 0.7, x[3], (2.0 * u[0] - 80.0 * (x[2] - x[0])) / 0.2])

    def stepped(x, u, d, p):
        return x + 1e-3 * rates(x, u, d, p)

    plant = fh.Plant(
        stepped if sampled else rates,
        lambda x, u, p: x[2:3],
        ("q", "v", "t", "w"),
        ("drive",),
        sampled=sampled,
    )
    held = holding_function(plant)(np.array([0.2, 0.1, 0.25, 0.3]))
    assert float(held) == pytest.approx(80.0 * 0.05 / 2.0, rel=1e-12)


@pytest.mark.oracle
def test_without_an_integral_the_load_sags_the_robot_and_its_balance_does_not():
    """Sag of the linear loop under wind w: 6 Δ + 4 cos(0.3) Δ = w, with small Δ."""
    plant, sag = forced_pendulum().augmented(disturbances=("wind",)), {}
    for compensate in (None, ("wind",)):
        control = controller(plain(), plant=plant, compensate=compensate)
        run = fh.Loop(forced_pendulum(), control).run(disturbance={"wind": 0.05}, duration=20.0)
        sag[compensate] = run.signal("state", "angle")[-1] - 0.3
        assert run.signal("estimate", "wind")[-1] == pytest.approx(0.05, rel=1e-4)
    assert sag[None] == pytest.approx(0.05 / (6.0 + 4.0 * np.cos(0.3)), rel=2e-3)
    assert abs(sag[("wind",)]) < 1e-7


@pytest.mark.ci("three runs of 8 s")
def test_the_motors_sensor_alone_does_not_let_the_paper_arm_sag():
    """The filter without the load explains it by drift; with it, the load is found. R^v is the same otherwise."""
    plant = fh.load_robot("paper").plant(("motor_position",))
    problem = plant.with_objective(
        {"link_position": 10.0, "link_position_integral": 30.0}, "disturbance", ("link_position",)
    )
    law, drift, sag = fh.linear_law(problem, gamma=40.0), [1e-10, 1e-8, 1e-10, 1e-8], {}
    for name, more, compensate in (
        ("none", (), None),
        ("found", (1e-4,), None),
        ("balanced", (1e-4,), "link_torque"),
    ):
        model = plant.augmented(disturbances="link_torque") if more else plant
        count = len(more)
        estimator = UnscentedKalmanFilter(
            model, 1e-3, [*drift, *more], 1e-8, np.zeros(4 + count), [1e-6] * 4 + [1.0] * count
        )
        control = fh.Controller(law, estimator, 1e-3, compensate=compensate)
        run = fh.Loop(plant, control).run(disturbance={"link_torque": fh.Step(1.0, at=0.1)}, duration=8.0)
        sag[name] = np.abs(run.signal("state", "link_position"))
    end = {name: values[-1] for name, values in sag.items()}
    assert end["none"] > 0.01  # d / K = 10 mrad, and what the drift adds
    assert max(end["found"], end["balanced"]) < 3e-4
    peak, total = ({name: pick(values) for name, values in sag.items()} for pick in (np.max, np.sum))
    assert peak["balanced"] < 0.6 * peak["found"] < 0.4 * peak["none"]  # 20, 36 and 61 mrad
    assert total["balanced"] < 0.7 * total["found"] < 0.3 * total["none"]


@pytest.mark.ci("8 s of a filter of ten states")
@pytest.mark.oracle
def test_two_joints_with_gravity_and_voltages():
    """X = −1/K for the motors and U = −R/k_t at a pose, and no sag of either link under a load on both."""
    robot, pose = fh.load_robot("planar-two-link"), [0.4, 0.6]
    plant, x = robot.plant(("motor_position",)), robot.operating_point(pose)[0]
    links = plant.expanded("link_position")
    weights = {"link_position": 1.0, "link_position_integral": 3.0}
    law = fh.linear_law(plant.with_objective(weights, "disturbance", links, pose), gamma=60.0)
    model = plant.augmented(disturbances="link_torque")
    drift = [1e-10] * 2 + [1e-8] * 2 + [1e-10] * 2 + [1e-8] * 2
    estimator = UnscentedKalmanFilter(
        model, 1e-3, [*drift, 4e-4, 4e-4], 1e-8, np.append(x, [0.0, 0.0]), [1e-6] * 8 + [1.0] * 2
    )
    control = fh.Controller(law, estimator, 1e-3, compensate="link_torque")
    values, (state, push) = plant.parameters.values, control.balance
    np.testing.assert_allclose(state[4:6], np.diag(-1.0 / values["stiffness"]), atol=1e-12)
    np.testing.assert_allclose(np.delete(state, [4, 5], axis=0), 0.0, atol=1e-12)
    np.testing.assert_allclose(push, np.diag(-values["resistance"] / values["torque_constant"]), atol=1e-12)
    load = {"link_torque_shoulder": 2.0, "link_torque_elbow": -1.0}
    run = fh.Loop(plant, control).run(disturbance=load, duration=8.0)
    away = [run.signal("state", name)[-1] - at for name, at in zip(links, pose)]
    assert np.abs(away).max() < 2e-4  # load / K is 5 mrad for both


@pytest.mark.ci("8 s of a filter of five states")
def test_a_soft_spring_is_found_while_the_arm_moves():
    """12 % less stiffness than the model has, by the link's encoder alone, in one step of the paper's arm."""
    arm = fh.paper_arm()
    plant = arm.plant(("link_position",))
    estimator = UnscentedKalmanFilter(
        plant.augmented(("stiffness",)), 1e-3, [1e-10] * 4 + [1e-4], 1e-6, [0.0] * 4 + [100.0], [1e-6] * 4 + [100.0],
        form="square_root",
    )  # fmt: skip
    control = fh.Controller(fh.linear_law(arm.problem(), gamma=246.0), estimator, 1e-3)
    run = fh.Loop(plant.with_parameters(stiffness=88.0), control).run(
        {"link_position": fh.Step(np.pi / 2, at=0.5)}, noise=1e-3, duration=8.0
    )
    assert run.status == "completed"
    assert run.signal("estimate", "stiffness")[-1] == pytest.approx(88.0, rel=5e-3)


@pytest.mark.ci("two runs of a filter of five states")
def test_an_offset_of_an_encoder_is_found_at_power_on():
    """0.5 mrad on the motor's encoder of the paper's arm, at rest: the link moves 100 times less."""
    plant = fh.load_robot("paper").plant(("link_position", "motor_position"))
    truth = plant.augmented(offsets="motor_position")
    problem = plant.with_objective(
        {"link_position": 10.0, "link_position_integral": 30.0}, "disturbance", ("link_position",)
    )
    law, moved = fh.linear_law(problem, gamma=40.0), {}
    for model, more, start in ((plant, [], [1e-6] * 4), (truth, [1e-16], [1e-8] * 4 + [1e-6])):
        estimator = UnscentedKalmanFilter(
            model, 1e-3, [1e-10, 1e-8, 1e-10, 1e-8, *more], 1e-10, np.zeros(model.n), start
        )
        run = fh.Loop(truth, fh.Controller(law, estimator, 1e-3)).run(
            initial_state={"motor_position_offset": 5e-4}, duration=2.0
        )
        moved[model.n] = np.abs(run.signal("state", "link_position")).max()
    assert run.signal("estimate", "motor_position_offset")[-1] == pytest.approx(5e-4, rel=1e-2)
    assert moved[5] < 0.01 * moved[4]


# What does not fit ------------------------------------------------------------------------------------
def test_what_is_no_estimated_load_is_not_compensated():
    with refused_with(InvalidInput, "pull", "wind"):
        controller(compensate=("pull",))
    with refused_with(InvalidInput, "wind", "augmented"):
        controller(plant=forced_pendulum(), compensate=("wind",))
    with refused_with(InvalidInput, "compensate", "None"):
        fh.Controller(plain(("angle",)), None, PERIOD, compensate=("wind",))
    with refused_with(InvalidInput, "wind"):
        controller(compensate=("wind", "wind"))


def test_a_load_that_no_input_reaches_is_not_compensated():
    def two(x, u, d, p):
        return np.array([x[1], u[0] - x[0], -x[2] + d[0]])

    plant = fh.Plant(two, lambda x, u, p: x, ("a", "b", "c"), ("u",), ("load",))
    estimator = ExtendedKalmanFilter(
        plant.augmented(disturbances="load"), PERIOD, 1e-6, 1e-6, np.zeros(4), 1.0
    )
    control = fh.Controller(still(plant), estimator, PERIOD, compensate="load")
    np.testing.assert_allclose(control.balance[0][:, 0], [0.0, 0.0, 1.0], atol=1e-12)  # c may stand anywhere
    with refused_with(InvalidInput, "load", "held", "compensate"):
        fh.Controller(linear_law(plant, np.zeros(4), integrals=("c",)), estimator, PERIOD, compensate="load")


def test_an_estimator_without_the_laws_states_is_refused():
    with refused_with(InvalidInput, "rate", "speed", "augmented"):
        controller(LinearLaw(("angle", "rate"), ("torque",), [-6.0, -3.0]))
    from flexhinf.analysis.equilibrium_loop import EquilibriumLoop

    control = controller()
    with refused_with(InvalidInput, "wind", "Loop.run"):
        EquilibriumLoop(plain(("angle",)), control.estimator, forced_pendulum(), PERIOD)
