"""Estimators: the states a law needs, from the signals a robot has."""

from flexhinf.estimation.extended import ExtendedKalmanFilter
from flexhinf.estimation.filter import RecursiveFilter
from flexhinf.estimation.sigma_points import SigmaPoints
from flexhinf.estimation.unscented import UnscentedKalmanFilter

__all__ = ["ExtendedKalmanFilter", "RecursiveFilter", "SigmaPoints", "UnscentedKalmanFilter"]
