"""A Kalman filter whose gains at each pose are those of pairs of a link and a motor."""

from __future__ import annotations

from flexhinf.designs.estimators.kinds import EstimatorKind, EstimatorTask, register
from flexhinf.designs.specification import ESTIMATED_BY, Specification
from flexhinf.estimation import ExtendedKalmanFilter, ModalFilter
from flexhinf.estimation.modal import has_equal_joints
from flexhinf.robot import Robot

#: Its name.
MODAL = "modal"


def fits_modal(robot: Robot, s: Specification) -> bool:
    """Whether the same sensors at every elastic joint make pairs, of which the filter has its gains."""
    return not robot.rigid and has_equal_joints(robot.plant(s.measured), len(robot.joint_names))


def estimator_name_at_any_pose(robot: Robot, s: Specification) -> str:
    """The estimator of a law with gains at any pose, by the sensors."""
    return MODAL if fits_modal(robot, s) else "ekf"


def _modal(task: EstimatorTask) -> ModalFilter:
    numbers = task.process_noise, task.measurement_noise, task.mean, task.covariance
    kalman = ExtendedKalmanFilter(task.model, task.period, *numbers, form="covariance")
    return ModalFilter(kalman, task.goal)


register(EstimatorKind(MODAL, ESTIMATED_BY[MODAL], _modal))
