from types import SimpleNamespace

import numpy as np
import pytest
from scipy.linalg import solve_continuous_are

from flexhinf.estimation import UnscentedKalmanFilter
from flexhinf.plant import Plant
from flexhinf.robot import paper_arm


class LinearLaw:
    """u = u* + K (x − x*), the smallest thing that is a law."""

    law_key = "linear"

    def __init__(self, states, inputs, gain, point=None, rest=None):
        self.state_names, self.input_names = tuple(states), tuple(inputs)
        self.gain = np.atleast_2d(np.asarray(gain, dtype=float))
        self.operating_point = np.zeros(len(self.state_names)) if point is None else np.asarray(point)
        self.operating_input = np.zeros(len(self.input_names)) if rest is None else np.asarray(rest)

    @property
    def law_data(self):
        return self.gain.ravel()

    def evaluate_law(self, x, data):
        return data.reshape(len(self.input_names), -1) @ x


def arm_law(pose=None):
    """LQR of the paper's weights about a pose."""
    problem = paper_arm().problem(pose=pose)
    a = np.zeros((5, 5))
    plant, point, rest = problem.plant, problem.operating_point, problem.operating_input
    a[:4, :4], b, _, _ = plant.linearise(point[:4], rest)
    a[4, 0] = 1.0
    b = np.vstack([b, [[0.0]]])
    riccati = solve_continuous_are(a, b, np.diag([3600.0, 0.0, 0.0, 0.0, 90000.0]), [[10.0]])
    return LinearLaw(problem.state_names, problem.input_names, -b.T @ riccati / 10.0, point, rest)


def arm_ukf(period=1e-3, **changes):
    settings = {"process_noise": 1e-8, "measurement_noise": 1e-6, "mean": np.zeros(4), "covariance": 1e-4}
    return UnscentedKalmanFilter(plant=paper_arm().plant(), period=period, **{**settings, **changes})


def two_inputs():
    """Two double integrators, the second without an integral, each measured."""
    plant = Plant(
        lambda x, u, d, p: np.array([x[1], u[0] + d[0], x[3], p.gain * u[1]]),
        lambda x, u, p: np.array([x[0], x[2]]),
        ("a", "da", "b", "db"), ("ua", "ub"), ("push",), {"gain": 2.0},
    )  # fmt: skip
    gain = [[-8.0, -5.0, 0.5, 0.0, -4.0], [0.0, 0.0, -3.0, -2.0, 0.0]]
    return plant, LinearLaw(("a", "da", "b", "db", "a_integral"), plant.inputs, gain)


@pytest.fixture(scope="session")
def made():
    """What the tests of closed loops are made of."""
    return SimpleNamespace(
        LinearLaw=LinearLaw, law=arm_law(), law_about=arm_law, ukf=arm_ukf, two_inputs=two_inputs
    )
