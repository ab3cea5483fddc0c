"""An estimator in a file of its own, as CONTRIBUTING.md prints it: no other file names it."""

from flexhinf import ExtendedKalmanFilter
from flexhinf.designs.estimators import EstimatorKind, register


def fast(task):
    """An extended Kalman filter that trusts its model a hundred times less."""
    noise = 100.0 * task.process_noise
    numbers = task.model, task.period, noise, task.measurement_noise, task.mean, task.covariance
    return ExtendedKalmanFilter(*numbers)


register(EstimatorKind("fast-ekf", "a fast extended Kalman filter", fast, kalman=True))
