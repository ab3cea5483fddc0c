"""The feedforward of dry friction, against its formula and a joint that SciPy integrates."""

from typing import Any

import numpy as np
import pytest
from scipy.integrate import solve_ivp
from tests.refusals import refused_with

import flexhinf as fh
from flexhinf.designs.plans import stated_dry_friction
from flexhinf.errors import InvalidInput
from flexhinf.loop import DryFriction
from flexhinf.loop.controller.friction import friction_input
from flexhinf.plant import Parameters
from flexhinf.robot import Parameter

FORCE, SMOOTHING, TIME, GOAL = 2.0, 0.02, 2.0, 1.0
ARM = fh.paper_arm().with_parameters(
    Parameter("coulomb_friction", FORCE), Parameter("friction_smoothing", SMOOTHING)
)


class MotorPD(fh.Law):
    """A PD on the motor's side of the spring."""

    state_names = ("link_position", "link_velocity", "motor_position", "motor_velocity")
    input_names = ("motor_voltage",)
    operating_point, operating_input = np.zeros(4), np.zeros(1)
    law_key: Any = "PD of the tests of dry friction"

    @property
    def law_data(self) -> np.ndarray:
        return np.array([10.0, 5.0])

    def evaluate_law(self, x: np.ndarray, data: np.ndarray) -> np.ndarray:
        return np.array([-(data[0] * x[2] + data[1] * x[3])])


def by_scipy(overcome: bool) -> np.ndarray:
    """Largest and last error of the link, in continuous time: by the equations and numbers of the paper's tables."""
    inertia, weight, stiffness, motor, viscous = 1.0, 9.8, 100.0, 1.0, 0.1
    resistance, torque, back = 10.0, 9.0, 1.0

    quintic = np.poly1d([6.0, -15.0, 10.0, 0.0, 0.0, 0.0])
    orders = [GOAL * quintic.deriv(k).coeffs / TIME**k for k in range(5)]
    rest = np.array([GOAL, 0.0, 0.0, 0.0, 0.0])

    def planned(t: float) -> np.ndarray:  # q and its derivatives, of a quintic
        return np.array([np.polyval(c, t / TIME) for c in orders]) if t < TIME else rest

    def rates(t: float, x: np.ndarray) -> list[float]:
        q, v, a, j, s = planned(t)
        load = inertia * a + weight * np.sin(q)
        rate = inertia * j + weight * np.cos(q) * v
        bend = inertia * s + weight * (np.cos(q) * a - np.sin(q) * v**2)
        theta, speed, acceleration = q + load / stiffness, v + rate / stiffness, a + bend / stiffness
        needed = motor * acceleration + viscous * speed + load
        if overcome:
            needed += FORCE * np.tanh((4.0 * speed / SMOOTHING) ** 3)
        voltage = resistance / torque * needed + back * speed - 10.0 * (x[2] - theta) - 5.0 * (x[3] - speed)
        drive = torque * (voltage - back * x[3]) / resistance
        spring = stiffness * (x[2] - x[0])
        lost = viscous * x[3] + FORCE * np.tanh(x[3] / SMOOTHING)
        return [x[1], (spring - weight * np.sin(x[0])) / inertia, x[3], (drive - lost - spring) / motor]

    times = np.linspace(0.0, TIME + 1.0, 301)
    run = solve_ivp(rates, (0.0, TIME + 1.0), np.zeros(4), t_eval=times, method="Radau", rtol=1e-5, atol=1e-7)
    error = run.y[0] - [planned(t)[0] for t in times]
    return np.array([np.abs(error).max(), abs(error[-1])])


@pytest.mark.oracle
def test_a_joint_that_scipy_integrates_makes_the_same_errors() -> None:
    move, found = fh.Moving(fh.Quintic(0.0, GOAL, TIME), ARM.inverse_dynamics), {}
    for overcome in (False, True):
        controller = fh.Controller(
            MotorPD(), None, 1e-3, moving=True, dry_friction=stated_dry_friction(ARM) if overcome else None
        )
        run = fh.Loop(ARM.plant(extras="coulomb_friction"), controller).run(move, duration=TIME + 1.0)
        error = np.abs(run.signal("state", "link_position") - np.ravel(move.derivatives(run.time, 0)[0]))
        found[overcome] = np.array([error.max(), error[-1]])
        np.testing.assert_allclose(found[overcome][0], by_scipy(overcome)[0], rtol=0.03)
    assert found[True][0] < 0.25 * found[False][0]


def test_it_is_the_formula_and_hardly_hears_noise_below_the_smoothing() -> None:
    level, smoothing = np.array([2.0, 0.5]), np.array([0.01, 0.02])
    commands = {
        speed: np.array([9.0, 9.0, *speed]) for speed in ((0.0, 0.0), (8e-4, -1.6e-3), (0.0025, -1.0))
    }
    table = np.array([level, smoothing])
    still, noisy, moving = (friction_input((2, 3), r, table) for r in commands.values())
    np.testing.assert_array_equal(still, 0.0)
    assert np.all(np.abs(noisy) < 0.04 * level)
    np.testing.assert_allclose(moving, [2.0 * np.tanh(1.0), -0.5], rtol=1e-12)
    curve = np.array([*table, [3.0, 0.5], [0.5, 0.1]])
    for speed in (0.1, 0.5, 3.0):  # Stribeck's, which falls from 3 to 2; the second motor states none
        found = friction_input((2, 3), np.array([0.0, 0.0, speed, speed]), curve)
        np.testing.assert_allclose(found, [2.0 + np.exp(-((speed / 0.5) ** 2)), 0.5], rtol=1e-12)


def test_a_joint_without_a_static_friction_keeps_its_own_at_low_speeds() -> None:
    """It had none there, in the true plant too, where another joint stated one."""
    arm = fh.load_robot("planar-two-link").with_parameters(
        Parameter("static_friction_shoulder", 1.5), Parameter("stribeck_velocity_shoulder", 0.2)
    )
    p = arm.plant_parameters()
    gain = arm.drive_kind.torque_per_input(Parameters(p))
    np.testing.assert_array_equal(p["static_friction"], [1.5, arm.nominal["coulomb_friction_elbow"]])
    friction = stated_dry_friction(arm)
    assert friction is not None
    np.testing.assert_allclose(friction.static, p["static_friction"] / gain)
    np.testing.assert_allclose(friction.level, p["coulomb_friction"] / gain)
    assert friction.stribeck == (0.2, 0.1)


@pytest.mark.ci("a loop for each latency")
@pytest.mark.parametrize("latency", [0, 2])
def test_the_estimator_sees_the_inputs_without_it(latency: int) -> None:
    """Where the true robot has that friction, a filter that knows none estimates as on one without."""
    names, seen = ("motor_velocity",), []
    friction = DryFriction([3.0], [1e-3], names)
    for own in (None, friction):
        ekf = fh.ExtendedKalmanFilter(fh.paper_arm().plant(), 1e-3, 1e-8, 1e-8, np.zeros(4), 1e-6)
        controller = fh.Controller(MotorPD(), ekf, 1e-3, moving=True, latency=latency, dry_friction=own)
        rest, moving, inputs = np.zeros(5), np.array([0.0, 0.1, 0.0, 0.2, 1.0]), []
        for k in range(8):
            inputs.append(controller.step([1e-4 * k], moving if k else rest)[0])
        seen.append((np.array(inputs), controller.estimate))
    np.testing.assert_allclose(seen[1][0] - seen[0][0], [0.0, *[3.0] * 7], rtol=1e-9)
    np.testing.assert_allclose(seen[1][1], seen[0][1], rtol=1e-9, atol=1e-12)


def test_it_is_saved_copied_named_and_refused(tmp_path: object) -> None:
    friction = stated_dry_friction(ARM)
    assert friction == DryFriction([FORCE * 10.0 / 9.0], [SMOOTHING], ["motor_velocity"])
    controller = fh.Controller(MotorPD(), None, 1e-3, moving=True, dry_friction=friction)
    controller.save(f"{tmp_path}/controller")
    for same in (fh.load_controller(f"{tmp_path}/controller"), controller.fresh()):
        assert same.dry_friction == friction
        command = np.array([0.1, 0.2, 0.3, 0.4, 0.5])
        np.testing.assert_array_equal(same.step(np.zeros(4), command), controller.step(np.zeros(4), command))
    assert "dry friction" in repr(controller)
    assert stated_dry_friction(fh.paper_arm()) is None
    with refused_with(InvalidInput, "dry friction", "moving=True", "motor_velocity"):
        fh.Controller(MotorPD(), None, 1e-3, dry_friction=friction)
    with refused_with(InvalidInput, "dry friction", "-1.0"):
        DryFriction([-1.0], [0.1], ["motor_velocity"])
