"""Kalman filters with the whole model: unscented and extended."""

from __future__ import annotations

from flexhinf.designs.estimators.kinds import EstimatorKind, EstimatorTask, register
from flexhinf.designs.specification import ESTIMATED_BY
from flexhinf.estimation import ExtendedKalmanFilter, UnscentedKalmanFilter


def _unscented(task: EstimatorTask) -> UnscentedKalmanFilter:
    numbers = task.process_noise, task.measurement_noise, task.mean, task.covariance
    return UnscentedKalmanFilter(task.model, task.period, *numbers, form="covariance")


def _extended(task: EstimatorTask) -> ExtendedKalmanFilter:
    numbers = task.process_noise, task.measurement_noise, task.mean, task.covariance
    return ExtendedKalmanFilter(task.model, task.period, *numbers, form="covariance")


register(EstimatorKind("ukf", ESTIMATED_BY["ukf"], _unscented, kalman=True))
register(EstimatorKind("ekf", ESTIMATED_BY["ekf"], _extended, kalman=True))
