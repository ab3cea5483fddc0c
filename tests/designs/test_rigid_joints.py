"""Designs for arms of which some joints are rigid: scales, modes, noise levels, and the whole against MuJoCo."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

import flexhinf as fh
from flexhinf.analysis.modes import JointScales
from flexhinf.designs.noise_levels import EstimatorNoise, noise_variances
from flexhinf.plant import Penalty
from flexhinf.robot import Robot, load_robot
from flexhinf.robot.modes import modes_of, stiffness_and_inertia


@pytest.fixture
def whole() -> Robot:
    return load_robot("spatial-three-link")


@pytest.fixture
def mixed(whole: Robot) -> Robot:
    """Its shoulder rigid."""
    kept = tuple(p for p in whole.parameters if p.name not in ("stiffness_shoulder", "damping_shoulder"))
    return Robot(whole.name, kept, whole.penalty, whole.links, whole.drive, whole.home, rigid=("shoulder",))


def test_scales_are_the_limit_of_a_stiff_spring(whole: Robot, mixed: Robot) -> None:
    stiff = whole.with_values({"stiffness_shoulder": 1e10})
    own, limit = (JointScales.of(robot.plant(), robot.operating_point()) for robot in (mixed, stiff))
    assert own.antiresonance == pytest.approx(limit.antiresonance, rel=1e-6)
    np.testing.assert_allclose(own.vibration[[0, 2]], limit.vibration[[0, 2]], rtol=1e-9)
    np.testing.assert_allclose(own.damping, limit.damping, rtol=1e-7)
    np.testing.assert_allclose(own.per_input, limit.per_input, rtol=1e-7)
    target = np.array([5.0, 6.0, 7.0])
    weights, stiffer = own.weights(target, 0.3), limit.weights(target, 0.3)
    np.testing.assert_allclose(weights["link_position"], stiffer["link_position"], rtol=1e-7)
    np.testing.assert_allclose(weights["joint_torque_rate"], stiffer["joint_torque_rate"][[0, 2]], rtol=1e-7)
    both = np.hypot(stiffer["link_velocity"], stiffer["motor_velocity"])[1]
    assert weights["link_velocity"][1] == pytest.approx(both, rel=1e-7)


def test_rows_are_the_penalty_of_the_problem(mixed: Robot) -> None:
    scales = JointScales.of(mixed.plant(), mixed.operating_point())
    target = np.array([5.0, 6.0, 7.0])
    problem = mixed.problem(penalty=scales.penalty(target, 0.3))
    x = np.random.default_rng(0).normal(size=len(problem.state_names))
    rows = scales.rows(target, 0.3)
    h = problem.expand(1).h_parts[1] @ x
    assert h @ h == pytest.approx(float(np.sum((rows @ x) ** 2)), rel=1e-10)


def test_modes_are_named_with_the_motor_of_a_rigid_joint_as_its_link(mixed: Robot) -> None:
    plant, equilibrium = mixed.plant(), mixed.operating_point()
    stiffness, inertia, _ = energy = stiffness_and_inertia(plant, equilibrium)
    assert list(np.isinf(stiffness)) == [False, True, False]
    assert inertia[4, 4] == 0.0
    modes = modes_of(plant.linearise(*equilibrium)[0], mixed.joint_names, *energy)
    assert sorted(mode.joint for mode in modes if mode.vibration) == ["base", "elbow"]


def test_noise_acts_where_the_torques_act(mixed: Robot) -> None:
    plant = mixed.plant(measured=("joint_torque", "motor_position"))
    levels = dict(zip(plant.states, np.diag(EstimatorNoise(0.0, 1.0, 2.0, "").covariance(plant.states))))
    assert levels["link_velocity_base"] == 1.0
    assert levels["motor_velocity_base"] == levels["link_velocity_shoulder"] == 2.0
    stiffness = mixed.plant_parameters()["stiffness"]
    np.testing.assert_allclose(noise_variances(plant, 1e-8)[:2], 1e-8 * stiffness**2)


@pytest.mark.nightly("a whole design; tests/designs/test_must_show.py has one of two links")
def test_a_design_meets_its_specification_on_mujoco_and_within_the_tolerances(mixed: Robot) -> None:
    pytest.importorskip("mujoco")
    specification = fh.Specification(
        preset="damped",
        measured=("link_position", "motor_position"),
        degrees=(2,),
        rays=0,
        draws=10,
        mujoco=True,
        duration=4.0,  # the default ends while 10 % of the step remain
    )
    result = fh.design(mixed, specification).evidence
    assert result.met
    assert result.mujoco is not None
    difference = (
        result.mujoco.run.signals["state"][:, :3] - result.evaluation.step.run.signals["state"][:, :3]
    )
    assert np.abs(difference).max() < 1e-6
    assert result.rigid is None


@pytest.mark.nightly("the preset robust with three joints")
def test_the_preset_robust_stands_no_less_than_damped(mixed: Robot) -> None:
    robust = fh.Specification(preset="robust", measured=("motor_position",), degrees=(2,), rays=0, draws=0)
    found = fh.design(mixed, robust).evidence.synthesis.robust
    assert found is not None
    assert found.chosen.scale >= found.damped.scale > 0.0
    assert found.count > 1


def test_weights_by_a_plain_name_stand_for_the_joints_that_have_the_signal(mixed: Robot) -> None:
    weights: Any = {"link_position": [3.0, 4.0, 5.0], "motor_velocity": [0.5, 0.6]}
    weights |= {"joint_torque_rate": 0.1, "link_position_integral": 3.0}
    problem = mixed.problem(penalty=Penalty(weights, effort=1.0))
    assert np.isfinite(fh.smallest_gamma(problem))
    weights["motor_velocity"] = [0.5, 0.6, 0.7]
    with pytest.raises(fh.FlexhinfError, match="motor_velocity"):
        mixed.problem(penalty=Penalty(weights, effort=1.0))
