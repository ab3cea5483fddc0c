"""Penalties on torques of the springs and their rates: by hand, and by what the rate is the derivative of."""

from __future__ import annotations

import numpy as np
import pytest
from tests.refusals import refused_with

import flexhinf as fh
from flexhinf.errors import InvalidInput
from flexhinf.plant import Penalty
from flexhinf.robot.layout import Layout
from flexhinf.robot.signals import robot_penalty


def _h(problem: fh.GeneralisedPlant, x: np.ndarray) -> np.ndarray:
    return problem.fields(x[None])[3][0]


def test_the_rate_is_the_derivative_of_the_torque_along_any_motion() -> None:
    """One weight on torques and one on rates, two problems: h of the rates is d/dt of h of the torques."""
    robot = fh.load_robot("planar-two-link")
    weights = [0.7, 1.3]
    torque = robot.problem({"joint_torque": weights})
    rate = robot.problem({"joint_torque_rate": weights})
    rng = np.random.default_rng(0)
    for _ in range(5):
        x, u, d = rng.normal(size=10), rng.normal(size=2), np.zeros(2)
        table = torque.plant.parameters
        moved = np.asarray(
            torque.flow(x + torque.operating_point, u, d, table.named(table.vector())), dtype=float
        )
        step = 1e-6 * moved
        slope = (_h(torque, x + step) - _h(torque, x - step)) / 2e-6
        assert slope == pytest.approx(_h(rate, x), rel=1e-6)


def test_weights_by_hand_in_any_mix() -> None:
    robot = fh.load_robot("planar-two-link")
    weights = {
        "joint_torque_rate_elbow": 0.2, "joint_torque": [0.5, 0.0], "motor_velocity_shoulder": 3.0,
        "link_position_integral": 2.0,
    }  # fmt: skip
    x = np.arange(1.0, 11.0)
    k1, k2 = 400.0, 200.0
    wanted = [3.0 * x[6], 2.0 * x[8], 2.0 * x[9], 0.5 * k1 * (x[4] - x[0]), 0.2 * k2 * (x[7] - x[3])]
    assert _h(robot.problem(weights), x) == pytest.approx(wanted)


def test_a_single_joint_has_plain_names_and_a_stiffer_spring_counts_more() -> None:
    x = np.array([0.1, 0.2, 0.4, 0.9, 0.0])
    for stiffness in (100.0, 250.0):
        robot = fh.paper_arm().with_values({"stiffness": stiffness})
        h = _h(robot.problem({"joint_torque_rate": 0.1, "joint_torque": 0.2}), x)
        assert sorted(h) == pytest.approx([0.2 * stiffness * 0.3, 0.1 * stiffness * 0.7])


def test_a_penalty_without_torques_stays_as_it_is_and_its_effort_stays_too() -> None:
    of_robot = ("a", "b"), ("link_position_a", "link_position_b"), {}, Layout(2)
    plain = Penalty({"link_position_a": 1.0}, 3.0)
    assert robot_penalty(plain, *of_robot) is plain
    as_matrix = Penalty(np.eye(2))
    assert robot_penalty(as_matrix, *of_robot) is as_matrix
    mixed = robot_penalty(Penalty({"joint_torque_rate_b": 2.0}, 3.0), *of_robot)
    assert mixed.effort == 3.0


@pytest.mark.parametrize("name", ["joint_torque_rates", "joint_torque_rate_wrist", "motor_torque_rate"])
def test_what_is_no_signal_is_refused_by_name(name: str) -> None:
    robot = fh.load_robot("planar-two-link")
    with pytest.raises(InvalidInput, match=name):
        robot.problem({"joint_torque_rate": 1.0, name: 1.0})
    with refused_with(InvalidInput, "'joint_torque_rate'", "[1.0, 2.0, 3.0]"):
        robot.problem({"joint_torque_rate": [1.0, 2.0, 3.0]})


@pytest.mark.parametrize(
    ("name", "meant"), [("link_positon", "link_position"), ("joint_torqe_rate", "joint_torque_rate")]
)
def test_a_misspelt_weight_of_a_robot_is_answered_with_the_nearest_name(name: str, meant: str) -> None:
    for robot in ("paper", "planar-two-link"):
        with pytest.raises(InvalidInput, match=f"{name!r}[\\s\\S]*{meant!r};") as caught:
            fh.load_robot(robot).problem({name: 3.0})
        assert "motor_voltage" not in str(caught.value)  # an input has no weight in h(x)
