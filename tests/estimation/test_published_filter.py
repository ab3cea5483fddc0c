"""A published run of an unscented filter: the example of the NAG Library's g13ek (kalman_unscented_state).

A robot on two wheels sees the distance and the angle of a wall; the angle is stated from 0 to 2π and wraps twice. The
numbers are those of the example's data and results, to three decimals; the model is the one its manual states.
"""

import numpy as np
import pytest

from flexhinf.estimation import UnscentedKalmanFilter
from flexhinf.plant import Plant

RADIUS, TRACK, WALL, SLOPE = 3.0, 4.0, 5.814, 0.464
WHEELS = (0.4, 0.1)

MEASURED = np.array([
    [5.262, 5.923], [4.347, 5.783], [3.818, 6.181], [2.706, 0.085], [1.878, 0.442], [0.684, 0.836], [0.752, 1.300],
    [0.464, 1.700], [0.597, 1.781], [0.842, 2.040], [1.412, 2.286], [1.527, 2.820], [2.399, 3.147], [2.661, 3.569],
    [3.327, 3.659],
])  # fmt: skip

PUBLISHED = np.array([
    [0.664, -0.092, 0.104], [1.598, 0.081, 0.314], [2.128, 0.213, 0.378], [3.134, 0.674, 0.660],
    [3.809, 1.181, 0.906], [4.730, 2.000, 1.298], [4.429, 2.474, 1.762], [4.357, 3.246, 2.162],
    [3.907, 3.852, 2.246], [3.360, 4.398, 2.504], [2.552, 4.741, 2.750], [2.191, 5.193, 3.281],
    [1.309, 5.018, 3.610], [1.071, 4.894, 4.031], [0.618, 4.322, 4.124],
])  # fmt: skip

#: Lower Cholesky factor of the last covariance, to three digits.
PUBLISHED_ROOT = np.array([[1.92e-1, 0.0, 0.0], [-3.82e-1, 2.22e-2, 0.0], [1.58e-6, 2.23e-7, 9.95e-3]])


def rolled(x, u):
    """The pose after both wheels have turned by u."""
    forward, turned = 0.5 * RADIUS * (u[0] + u[1]), RADIUS / TRACK * (u[0] - u[1])
    return np.array([x[0] + np.cos(x[2]) * forward, x[1] + np.sin(x[2]) * forward, x[2] + turned])


def by_arctan2(angle):
    return np.arctan2(np.sin(angle - np.pi), np.cos(angle - np.pi)) + np.pi


def by_floor(angle):
    return angle - 2.0 * np.pi * np.floor(angle / (2.0 * np.pi))


class OfMap(UnscentedKalmanFilter):
    """The filter of a map x⁺ = F(x, u) instead of a flow."""

    def moved(self, run, x, u, p):
        return run.call(rolled, x, u)


@pytest.mark.oracle
@pytest.mark.parametrize("wrap", [by_arctan2, by_floor])
def test_the_published_states_to_every_printed_digit(wrap):
    def seen(x, u, p):
        distance = WALL - x[0] * np.cos(SLOPE) - x[1] * np.sin(SLOPE)
        return np.array([distance, wrap(x[2] - SLOPE)])

    def unused(x, u, d, p):
        return 0.0 * x

    plant = Plant(unused, seen, ("x", "y", "angle"), ("right", "left"))
    ukf = OfMap(plant, 1.0, 0.1**2, 0.01**2, np.zeros(3), 0.1**2)
    states = []
    for y in MEASURED:
        ukf.predict(WHEELS)
        ukf.correct(y)
        states.append(ukf.mean)
    assert np.sum(np.round(states, 3) == PUBLISHED) == PUBLISHED.size
    np.testing.assert_allclose(np.linalg.cholesky(ukf.covariance), PUBLISHED_ROOT, rtol=5e-3)
