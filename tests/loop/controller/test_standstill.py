"""A start at rest anywhere, and encoders with offsets: what is put out there, and how the robot then moves."""

from __future__ import annotations

import math

import numpy as np
import pytest
from scipy.optimize import brentq
from tests.builders import runge_kutta
from tests.loop.conftest import LinearLaw, arm_ukf, two_inputs
from tests.refusals import refused_with

import flexhinf as fh
from flexhinf.errors import InvalidInput

# Kernels that run once each: 1 s instead of 3 s.
pytestmark = pytest.mark.usefixtures("unoptimised")

SENSORS = ("link_position", "motor_position")
ROBOT = fh.load_robot("planar-two-link")
PLANT = ROBOT.plant(SENSORS)


def two_links(goal: tuple[float, float], **options: object) -> fh.Controller:
    """A law of one pose, with a filter that begins there; 24 V."""
    law = fh.linear_law(ROBOT.problem(pose=goal, measured=SENSORS), gamma=math.inf)
    x = ROBOT.operating_point(goal)[0]
    ukf = fh.UnscentedKalmanFilter(PLANT, 1e-3, [0, 0, 1e-7, 1e-7] * 2, 1e-8, x, 1e-9)
    return fh.Controller(law, ukf, 1e-3, 24.0, **{"latency": 1, **options})  # type: ignore[arg-type]


def moved(
    controller: fh.Controller,
    x: np.ndarray,
    u: np.ndarray,
    offset: np.ndarray,
    count: int,
    command: object = None,
) -> tuple[float, np.ndarray]:
    """Largest deviation of a link, and inputs, of a loop with one sample of latency, written out."""
    start, inputs, worst, model = x, [], 0.0, PLANT.parameters.vector()
    for _ in range(count):
        y = np.ravel(np.asarray(PLANT.evaluate_output(x, u, model), dtype=float)) + offset
        inputs.append(controller.step(y, command))
        x, u = runge_kutta(lambda x, u=u: PLANT.derivative(x, u), x, 1e-3), inputs[-1]
        worst = max(worst, float(np.abs((x - start)[:2]).max()))
    return worst, np.array(inputs)


@pytest.mark.ci("a loop of its own")
@pytest.mark.quick_cases(1)
@pytest.mark.parametrize("kind", ["zero", "bumpless", "moving"])
def test_a_law_of_one_pose_holds_the_robot_wherever_it_starts(kind: str) -> None:
    controller = two_links((0.5, -0.7), **({"moving": True} if kind == "moving" else {"start": kind}))
    rng = np.random.default_rng(2)
    for pose in rng.uniform(-1.5, 1.5, (4, 2)):
        x, u = ROBOT.operating_point(pose)
        controller.reset(pose=pose)
        first = controller.step(None)
        assert first == pytest.approx(u, abs=1e-9)
        worst, inputs = moved(controller, x, u, np.zeros(4), 150)
        assert worst < 1e-8
        assert inputs == pytest.approx(np.tile(u, (150, 1)), abs=1e-6)
        if kind != "moving":  # the same with the command that says so
            controller.reset(pose=pose)
            assert moved(controller, x, u, np.zeros(4), 150, pose)[0] < 1e-8


@pytest.mark.quick_cases(2)
@pytest.mark.oracle
@pytest.mark.parametrize("pose", [-2.0, 0.4, 1.0, 2.5])
def test_integrals_of_a_cubic_law_are_the_root_of_its_input(pose: float) -> None:
    arm = fh.paper_arm()
    law = fh.solve_hji(arm.problem(), gamma=math.inf, degree=4)
    controller = fh.Controller(law, arm_ukf(), 1e-3, 48.0, latency=0)
    x, u = arm.operating_point([pose])
    root = brentq(lambda e: float(law.law(np.append(x, e))[0]) - u[0], -5.0, 5.0, xtol=1e-14)
    controller.reset(pose=[pose])
    assert controller.integrals == pytest.approx([root], rel=1e-6)
    assert controller.step(x[:1]) == pytest.approx(u, rel=1e-9)


@pytest.mark.ci("solves laws of two links")
def test_of_several_laws_the_nearest_holds_it() -> None:
    poses = ((0.0, 0.0), (1.0, -1.0))
    laws = [fh.linear_law(ROBOT.problem(pose=pose, measured=SENSORS), gamma=math.inf) for pose in poses]
    ukf = two_links((0.0, 0.0)).estimator
    controller = fh.Controller(fh.Schedule(laws), ukf, 1e-3, 24.0, latency=0)
    for pose in ((0.2, 0.1), (0.9, -0.7)):
        x, u = ROBOT.operating_point(pose)
        controller.reset(pose=pose)
        y = np.ravel(np.asarray(PLANT.evaluate_output(x, u, PLANT.parameters.vector()), dtype=float))
        assert controller.step(y, pose) == pytest.approx(u, abs=1e-9)


def test_a_controller_that_cannot_hold_a_pose_says_so() -> None:
    plant, law = two_inputs()
    with refused_with(InvalidInput, "model", "reset"):
        fh.Controller(law, None, 1e-2).reset(pose=[0.0])
    ukf = fh.UnscentedKalmanFilter(plant, 1e-2, 1e-6, 1e-6, np.zeros(4), 1e-4)
    without = LinearLaw(plant.states, plant.inputs, [[-8.0, -5.0, 0.5, 0.0], [0.0, 0.0, -3.0, -2.0]])
    with refused_with(InvalidInput, "integrals", "reset"):
        fh.Controller(without, ukf, 1e-2).reset(pose=[0.0])
    controller = two_links((0.5, -0.7), latency=0)
    weak = fh.Controller(controller.law, controller.estimator, 1e-3, 1.0)
    with refused_with(InvalidInput, 1, "saturation"):
        weak.reset(pose=[1.5, 0.0])
    with refused_with(InvalidInput, "pose"):
        controller.reset(pose=[0.0])
    arm = fh.paper_arm()
    quartic = fh.solve_hji(arm.problem(pose=[0.0]), gamma=math.inf, degree=4)

    class Blunt(LinearLaw):  # of which no integral makes more than 0.1
        def evaluate_law(self, x: object, data: object) -> object:
            return 0.1 * np.sin(super().evaluate_law(x, data))

    blunt = Blunt(quartic.state_names, quartic.input_names, [[-5.0, -1.0, 0.0, 0.0, -3.0]])
    with refused_with(InvalidInput, "hold", "pose"):
        fh.Controller(blunt, arm_ukf(), 1e-3, 48.0).reset(pose=[1.0])


@pytest.mark.ci("three runs of 2,500 steps in Python")
def test_half_a_milliradian_between_the_encoders_is_taken_in_slowly() -> None:
    """At rest at (0.3, 0.4), 0.5 mrad on both motor encoders, the same start with and without `offset_time`."""
    pose, offset = np.array([0.3, 0.4]), np.array([0.0, 0.0, 5e-4, 5e-4])
    x, u = ROBOT.operating_point(pose)
    worst, jump = {}, {}
    for name, time in (("at once", None), ("1 s", 1.0), ("5 s", 5.0)):
        controller = two_links((0.3, 0.4), start="bumpless", offset_time=time)
        controller.reset(pose=pose)
        deviation, inputs = moved(controller, x, u, offset, 2500)
        worst[name], jump[name] = deviation, float(np.abs(inputs - u).max())
    assert worst["at once"] > 2.5 * worst["1 s"] > 2.5 * 2.5 * worst["5 s"]
    assert jump["at once"] > 5.0 * jump["1 s"]


@pytest.mark.ci("two controllers of two links")
def test_the_first_measurement_is_that_of_the_start_and_its_offset_decays() -> None:
    """Estimates and inputs are those of a controller that is given y − b exp(−k h/τ)."""
    plain, fading = (two_links((0.3, 0.4), offset_time=time) for time in (None, 0.05))
    x, u = ROBOT.operating_point((0.3, 0.4))
    expected = np.ravel(np.asarray(PLANT.evaluate_output(x, u, PLANT.parameters.vector()), dtype=float))
    rng = np.random.default_rng(0)
    offset = np.array([1e-3, -2e-3, 5e-3, 3e-3])
    for k in range(60):
        y = expected + offset + (1e-4 * rng.standard_normal(4) if k else 0.0)
        if k == 20:
            assert fading.step(None, (0.3, 0.4)) == pytest.approx(plain.step(None, (0.3, 0.4)), abs=1e-9)
            continue
        own = plain.step(y - offset * math.exp(-k * 1e-3 / 0.05), (0.3, 0.4))
        assert fading.step(y, (0.3, 0.4)) == pytest.approx(own, abs=1e-9)
        assert fading.estimate == pytest.approx(plain.estimate, abs=1e-11)
        if not k:
            assert fading.estimate == pytest.approx(x, abs=1e-15)


def test_offsets_need_a_measurement_and_a_time() -> None:
    law = two_inputs()[1]
    with refused_with(InvalidInput, "offset_time", "estimator"):
        fh.Controller(law, None, 1e-2, offset_time=1.0)
    for wrong in (0.0, -1.0, math.inf, "long"):
        with refused_with(InvalidInput, "offset_time", "seconds"):
            two_links((0.0, 0.0), offset_time=wrong)
